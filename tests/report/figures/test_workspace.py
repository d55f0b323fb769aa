"""Points in the workspace from three sides: predictions, drift, and plans."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib_pin.report.figures.workspace import (
    SIDES,
    criterion_by_count,
    planned_positions,
    tip_in_workspace,
    tool_positions,
)


def test_every_point_is_seen_from_three_sides_the_largest_in_front(calibrated, draw):
    tip = calibrated.accuracy.tip
    *views, scale = draw(tip_in_workspace, calibrated).figure.axes
    assert scale.get_xlabel() == "uncertainty [mm], rms"
    order = np.argsort(tip.position)
    for axes, side in zip(views, SIDES, strict=True):
        (points,) = axes.collections
        np.testing.assert_allclose(points.get_offsets(), tip.points[order][:, side])
        np.testing.assert_allclose(points.get_array(), 1e3 * tip.position[order])
        names = [f"{'xyz'[k]} [m]" for k in side]
        assert [axes.get_xlabel(), axes.get_ylabel()] == names
        assert axes.get_aspect() == 1.0


def test_the_plan_and_chance_are_marked(planned, draw):
    (axes,) = draw(criterion_by_count, planned).figure.axes
    curve, own, random = axes.lines
    steps = planned.steps
    np.testing.assert_allclose(curve.get_xdata(), [step.count for step in steps])
    np.testing.assert_allclose(curve.get_ydata(), [1e3 * step.value for step in steps])
    np.testing.assert_allclose(own.get_data(), [[14], [1e3 * planned.value]])
    np.testing.assert_allclose(random.get_data(), [[14], [1e3 * planned.random]])
    assert str(axes.get_ylabel()).endswith("[mm]")


def test_another_criterion_stands_beside_the_tip_error(planned, draw):
    plan = replace(planned, criterion="O1", random=np.inf)
    left, right = draw(criterion_by_count, plan).figure.axes
    assert left.get_ylabel() == "O1"
    sizes = [1e3 * step.position for step in plan.steps]
    np.testing.assert_allclose(right.lines[0].get_ydata(), sizes)
    assert criterion_by_count(replace(planned, steps=planned.steps[:1])) is None


def test_positions_are_those_of_the_nominal_robot(planned, draw):
    points = tool_positions(planned)
    chain, error = planned.problem.only.error.chain, planned.problem.only.error
    tool = error.tool.translation
    for point, T in zip(points, chain.poses(planned.q), strict=True):
        np.testing.assert_allclose(point, T[:3, :3] @ tool + T[:3, 3], atol=1e-9)
    *views, _ = draw(planned_positions, planned).figure.axes
    for axes, side in zip(views, SIDES, strict=True):
        way, first = axes.lines
        np.testing.assert_allclose(way.get_data(), points[:, side].T)
        np.testing.assert_allclose(first.get_data(), points[:1, side].T)
    assert planned_positions(replace(planned, q=planned.q[:0], aims=())) is None
