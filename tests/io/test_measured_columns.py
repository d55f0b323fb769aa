"""Files of configurations: what a controller needs, and back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import calib_pin
from calib_pin.io.measurements import encode_configurations, read_configurations
from calib_pin.kinematics.joint_columns import JointColumns
from calib_pin.setup import JointMap
from tests.shared import chain_of, joint, urdf_of

CHAIN = calib_pin.load_chain("space6")
Q = CHAIN.random_configurations(7, np.random.default_rng(0))


def write_configurations(path: Path, *about: Any, **more: Any) -> list[str]:
    path.write_bytes(encode_configurations(*about, **more))
    return path.read_text().splitlines()


def test_joint_maps_are_undone(tmp_path: Path) -> None:
    """By the formula of the setup file; couplings, mutual ones too, can be undone."""
    rng, names = np.random.default_rng(0), [f"A{k}" for k in range(6)]
    signs = rng.choice([-1, 1], 6).tolist()
    gears = rng.choice([-50.0, 0.02, 1.5], 6).tolist()
    joints = dict[str, JointMap]()
    for k, name in enumerate(CHAIN.joints):
        coupled = {other: float(rng.uniform(-2.0, 2.0)) for other in names[:k]}
        offset = float(rng.uniform(-3.0, 3.0))
        joints[names[k]] = JointMap(name, signs[k], gears[k], offset, coupled)
    mutual = {"A5": 0.25, "track": 2.0}
    for given in (joints, joints | {"A0": replace(joints["A0"], coupled=mutual)}):
        columns, before = JointColumns.of(CHAIN, given), Q.copy()
        values = dict(zip(columns.names, columns.values(Q).T, strict=True))
        assert Q.tobytes() == before.tobytes()
        for k, one in enumerate(given.values()):
            coupled = sum(c * values[name] for name, c in one.coupled.items())
            inner = values[names[k]] + coupled
            position = one.sign * one.gear * inner + one.offset
            np.testing.assert_allclose(position, Q[:, k], rtol=0.0, atol=1e-9)
        header, *_ = write_configurations(tmp_path / "plan.csv", CHAIN, Q, joints=given)
        assert header.split(",") == [*columns.names]
        found = read_configurations(tmp_path / "plan.csv", CHAIN, given)
        np.testing.assert_allclose(found, Q, rtol=0.0, atol=1e-9)


def test_a_map_of_one_joint_leaves_the_others_bit_by_bit() -> None:
    found = JointColumns.of(CHAIN, {"A": JointMap(CHAIN.joints[2], gear=0.1)}).values(Q)
    others = [0, 1, 3, 4, 5]
    assert found[:, others].tobytes() == Q[:, others].tobytes()


def test_a_mimic_joint_that_stands_still_needs_no_leader() -> None:
    still = '<mimic joint="side" multiplier="0" offset="0.2"/>'
    joints = (
        joint("side", "base beside"),
        joint("still", "base link", more=still),
        joint("moves", "link tip"),
    )
    columns = JointColumns.of(chain_of(urdf_of(*joints), "base", "tip"))
    assert columns.names == ("moves",)
    values = np.array([[0.3], [-0.4]])
    assert columns.positions(values).tolist() == [[0.2, 0.3], [0.2, -0.4]]
    assert columns.values(columns.positions(values)).tolist() == values.tolist()
