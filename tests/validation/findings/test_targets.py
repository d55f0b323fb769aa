"""A target that contradicts all others is found by leaving it out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.kinematics.chains import Chains
from calib_pin.observations import Observations
from calib_pin.setup import CameraSetup, FrameSetup, PointSetup, Setup
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.explanations import explain
from calib_pin.validation.findings.readings import (
    line_order,
    target_frames,
    targets,
)

ARM = calib_pin.load_chain("space6")
NAMES = ("a", "b", "c")


def measured(wrong: float) -> Observations:
    """Three points of the tool, the last of which is off in a new way each time."""
    points = {n: PointSetup((0.1 * k, 0.05, 0.2)) for k, n in enumerate(NAMES)}
    setup = Setup(targets=points)
    problem = nominal_problem(ARM, "position", setup)
    rng = np.random.default_rng(4)
    theta = calib_pin.draw_errors(problem.parameters, rng)
    rows = calib_pin.simulate(
        problem, theta, rng, count=90, noise=1e-4, target=NAMES * 30
    ).only
    values = rows.values.copy()
    values[2::3] += wrong * rng.normal(size=(30, 3))
    return Observations.of(
        replace(rows, values=values, lines=np.arange(2, 92), files=("m.csv",) * 90)
    )


def case_of(data: Observations) -> Case:
    return Case.of_robot(Chains.of(ARM), data, Setup())


def test_it_is_left_out() -> None:
    case = case_of(measured(0.05))
    found = explain(case, (targets,))
    assert found is not None
    (fault,) = found.faults
    assert fault.code == "target"
    assert fault.reading.without == tuple(str(line) for line in range(4, 92, 3))
    assert found.after < 0.5 * found.before


def test_groups_with_a_tool_of_their_own() -> None:
    """Three points of one tool, and three of another that the file does not tell."""
    names = [f"{tool}/{name}" for tool in ("old", "new") for name in NAMES]
    points = {
        n: PointSetup((0.1 * (k % 3), 0.05, 0.2), False) for k, n in enumerate(names)
    }
    tools = [
        FrameSetup((0.0, 0.0, 0.1)),
        FrameSetup((0.05, -0.2, 0.0), (0.3, 0.0, 1.0)),
    ]
    rng, parts = np.random.default_rng(4), []
    for own, frame in zip((names[:3], names[3:]), tools, strict=True):
        setup = Setup(targets={n: points[n] for n in own}, tool_frame=frame)
        problem = nominal_problem(ARM, "position", setup)
        none = np.zeros(len(problem.parameters))
        parts.append(
            calib_pin.simulate(
                problem, none, rng, count=45, noise=1e-4, target=tuple(own) * 15
            ).only
        )
    data = Observations.of(*(replace(part, sigma=None) for part in parts))
    case = Case.of_robot(Chains.of(ARM), data, Setup(targets=points))
    found = explain(case, (targets, target_frames))
    assert found is not None
    (fault,) = found.faults
    assert fault.code == "target-frames"
    assert fault.advice == "give each a tool of its own (a column 'tool')"


@pytest.mark.slow
def test_a_board_whose_lines_are_shifted_has_no_wrong_corner() -> None:
    """Three of four corners keep their joints if the lines are shifted by one."""
    board = {
        name: PointSetup((0.1 + 0.05 * (k % 2), 0.05 * (k // 2), 0.15))
        for k, name in enumerate("abcd")
    }
    camera = CameraSetup("world", (900.0, 910.0), (640.0, 500.0))
    setup = Setup(camera=camera, targets=board)
    away = FrameSetup((0.1, -0.2, 6.0), (0.3, -0.2, 0.4))
    problem = nominal_problem(ARM, "camera", replace(setup, base_frame=away))
    rng = np.random.default_rng(2)
    theta = calib_pin.draw_errors(problem.parameters, rng)
    q = np.repeat(ARM.random_configurations(60, rng), 4, axis=0)
    names = tuple("abcd" * 60)
    rows = calib_pin.simulate(problem, theta, rng, q=q, target=names, noise=0.2).only
    below = replace(
        rows.rows(np.arange(1, 240)),
        q=rows.q[:-1],
        lines=np.arange(2, 241),
        files=("m.csv",) * 239,
    )
    case = Case.of_robot(Chains.of(ARM), Observations.of(below), setup)
    found = explain(case, (line_order, targets))
    assert found is not None
    assert [fault.reading.shift for fault in found.faults] == [1]
    assert found.after < 0.4
