"""Figures of a plan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib_pin.report.figures.plans import (
    criterion_by_count,
    planned_positions,
    tool_positions,
)


def test_the_plan_and_chance_are_marked(planned, draw):
    drawn = draw(criterion_by_count, planned)
    (axes,) = drawn.figure.axes
    curve, own, random = axes.lines
    steps = planned.steps
    np.testing.assert_allclose(curve.get_xdata(), [step.count for step in steps])
    np.testing.assert_allclose(curve.get_ydata(), [1e3 * step.value for step in steps])
    np.testing.assert_allclose(own.get_data(), [[14], [1e3 * planned.value]])
    np.testing.assert_allclose(random.get_data(), [[14], [1e3 * planned.random]])
    assert str(axes.get_ylabel()).endswith("[mm]")


def test_another_criterion_stands_beside_the_tip_error(planned, draw):
    plan = replace(planned, criterion="O1", random=np.inf)
    drawn = draw(criterion_by_count, plan)
    left, right = drawn.figure.axes
    assert left.get_ylabel() == "O1"
    np.testing.assert_allclose(
        right.lines[0].get_ydata(), [1e3 * step.position for step in plan.steps]
    )
    assert criterion_by_count(replace(planned, steps=planned.steps[:1])) is None


def test_positions_are_those_of_the_nominal_robot(planned, draw):
    points = tool_positions(planned)
    chain, error = planned.problem.only.error.chain, planned.problem.only.error
    tool = error.tool.translation
    for point, T in zip(points, chain.poses(planned.q), strict=True):
        np.testing.assert_allclose(point, T[:3, :3] @ tool + T[:3, 3], atol=1e-9)
    drawn = draw(planned_positions, planned)
    for axes, side in zip(drawn.figure.axes, ((0, 1), (0, 2), (1, 2)), strict=True):
        way, stops, first = axes.lines
        np.testing.assert_allclose(way.get_data(), points[:, side].T)
        np.testing.assert_allclose(stops.get_data(), points[:, side].T)
        np.testing.assert_allclose(first.get_data(), points[:1, side].T)
        numbers = [text.get_text() for text in axes.texts]
        assert numbers[0] == "1" and set(numbers) <= {str(k) for k in range(1, 15)}
    assert planned_positions(replace(planned, q=planned.q[:0], aims=())) is None
