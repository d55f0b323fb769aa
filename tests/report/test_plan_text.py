"""The report of a plan: what a reader must be able to see in it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calib_pin.planning.plan import Plan, Step
from calib_pin.report.plan_text import plan_report
from calib_pin.report.tables import significant
from calib_pin.report.terminal import plain_text
from calib_pin.solvers import Status


def text(planned: Plan, **changes: Any) -> str:
    return plain_text(plan_report(replace(planned, **changes)))


def rows(report: str, head: str) -> list[list[str]]:
    """Cells of the lines below a heading, up to the next empty line."""
    lines = report.split(head)[1].splitlines()[1:]
    block = lines[: lines.index("")]
    return [line.split() for line in block]


def test_what_was_planned(planned):
    report = text(planned)
    first, second, *_ = report.splitlines()
    assert first == (
        "space6: 6 joints from base_link to tool; position, 14 configurations"
    )
    assert "120" in second and str(planned.tried) in second
    assert max(map(len, report.splitlines())) <= 80
    assert "in addition to 40" in " ".join(text(planned, measured=40).split())
    stopped = text(planned, status=Status.ITERATIONS)
    assert f"greedy ({Status.ITERATIONS.value})" in stopped


def test_collisions(planned):
    unknown, free, hit = (
        " ".join(text(planned, blocked=blocked).split())
        for blocked in (None, (), (2, 4))
    )
    # A plan that was not checked must not look as if it had been.
    assert "not checked" in unknown
    assert "No configuration" in free and "not checked" not in free
    assert "number 3, 5" in hit and "not checked" not in hit


def test_the_criterion_against_the_number(planned):
    report = text(planned)
    cells = rows(report, "Accuracy against number of configurations")
    assert cells[0][-1] == "[mm]"
    found = {int(row[0]): float(row[-1]) for row in cells[1:-1]}
    of = {step.count: 1e3 * step.value for step in planned.steps}
    assert all(value == pytest.approx(of[n], abs=6e-5) for n, value in found.items())
    # The fewest, the plan itself and the most are always there.
    assert {planned.steps[0].count, 14, planned.steps[-1].count} <= set(found)
    assert list(found) == sorted(found)
    assert len(found) <= 16
    (own,) = [row for row in cells if row[1:2] == ["planned"]]
    assert int(own[0]) == 14
    assert cells[-1][:3] == ["14", "random", "baseline"]
    assert float(cells[-1][-1]) == pytest.approx(1e3 * planned.random, abs=6e-5)


def test_other_criteria_show_the_tip_as_well(planned):
    steps = tuple(Step(n, float(n), 1e-3 / n) for n in range(10, 29))
    report = text(planned, criterion="O1", value=14.0, random=7.5, steps=steps)
    assert "O1" in report and "[mm]" in report
    (own,) = [line for line in report.splitlines() if "planned" in line]
    numbers = [float(cell) for cell in own.split()[2:]]
    assert numbers == [14.0, pytest.approx(1.0 / 14, abs=1e-4)]
    (random,) = [line for line in report.splitlines() if "random baseline" in line]
    assert float(random.split()[3]) == 7.5


def test_steps_of_no_value(planned):
    """Where chance would not do at all there is no number, but no failure either."""
    steps = (Step(0, 2e-4, 2e-4), *planned.steps)
    lines = text(planned, steps=steps, random=float("inf")).splitlines()
    (line,) = [line for line in lines if line.startswith("0 ")]
    assert line.split() == ["0", "0.2000"]
    (line,) = [line for line in lines if "random baseline" in line]
    assert "nan" not in line


def test_what_a_fit_will_know(planned):
    report = text(planned)
    position = f"{1e3 * planned.predicted.position:.4f} mm"
    assert position in report
    assert f"{planned.predicted.rank} of {planned.predicted.rank}" in report
    errors = planned.predicted.robot_errors
    identifiable = [e for e in errors if e.status == "identifiable"]
    assert len(identifiable) == planned.predicted.directions.robot.shape[1]
    lines = report.splitlines()
    for error in identifiable:
        shown = significant(
            {"m": 1e3, "rad": np.degrees(1.0)}[error.unit] * error.sigma
        )
        assert any(error.of[0] in line and shown in line.split() for line in lines)


def test_weak_directions_are_named(planned):
    directions = planned.predicted.directions
    weak = replace(
        directions, robot=directions.robot[:, 2:], weak=directions.robot[:, :2]
    )
    parameters = tuple(
        replace(p, status="weak", sigma=None) if k < 9 and k > 6 else p
        for k, p in enumerate(planned.parameters)
    )
    report = text(
        planned,
        predicted=replace(planned.predicted, directions=weak),
        parameters=parameters,
    )
    assert "(2 weakly observable" in " ".join(report.split())
    assert f"{planned.predicted.rank - 2} of {planned.predicted.rank}" in report
    owner, kind, first = parameters[7].name.split(".")
    second = parameters[8].name.split(".")[2]
    assert report.split("at nominal):")[1].split() == [
        f"{owner}.{kind}.{first}|{second}"
    ]
