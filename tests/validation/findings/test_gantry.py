"""Robots whose only lengths are the travels of their joints."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import calib_pin
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.setup import FrameSetup, PlaneSetup, Setup

AXES = {
    "x": ("prismatic", "1 0 0", (0.0, 3.0)),
    "y": ("prismatic", "0 1 0", (0.0, 2.0)),
    "z": ("prismatic", "0 0 1", (-0.8, 0.0)),
    "c": ("revolute", "0 0 1", (-3.0, 3.0)),
    "a": ("revolute", "1 0 0", (-1.7, 1.7)),
}
NORMALS = ((0, 0, 1), (1, 0, 0), (0, 1, 0), (1, 1, 0), (1, 0, 1))
OFFSETS = (-0.3, -1.0, -0.8, -2.2, -1.7)


def test_gains_that_draw_contacts_to_a_point_explain_nothing(tmp_path: Path) -> None:
    """They free the scale: 0.03 mm of noise would drop to 0.0002 mm."""
    parts = ['<link name="l0"/>']
    for k, (name, (kind, axis, (low, high))) in enumerate(AXES.items()):
        parts += [
            f'<link name="l{k + 1}"/><joint name="{name}" type="{kind}">',
            f'<parent link="l{k}"/><child link="l{k + 1}"/><axis xyz="{axis}"/>',
            '<origin xyz="0 0 -0.1"/>',
            f'<limit lower="{low}" upper="{high}" effort="1" velocity="1"/></joint>',
        ]
    file = tmp_path / "gantry.urdf"
    file.write_text(f'<robot name="gantry">{"".join(parts)}</robot>')
    chain = calib_pin.load_chain(file)
    pairs = zip(NORMALS, OFFSETS, strict=True)
    planes = {f"p{k}": PlaneSetup(*plane) for k, plane in enumerate(pairs)}
    setup = Setup(tool_frame=FrameSetup((0.03, 0.02, -0.1)), planes=planes)
    problem = nominal_problem(chain, "plane-contact", setup)
    rng = np.random.default_rng(0)
    errors = calib_pin.draw_errors(problem.parameters, rng)
    rows = calib_pin.simulate(problem, errors, rng, count=200, noise=3e-5)
    result = calib_pin.calibrate(chain, rows.only, setup, validate=False)
    assert "model-lacks" not in {finding.code for finding in result.findings}
