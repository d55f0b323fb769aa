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


def test_collisions(planned):
    """A plan that was not checked must not look as if it had been."""
    for blocked, said in ((None, "not checked"), ((), "No conf"), ((2, 4), "ber 3, 5")):
        shown = " ".join(text(planned, blocked=blocked).split())
        assert said in shown and ("not checked" in shown) == (blocked is None)


def test_other_criteria_show_the_tip_as_well_and_nothing_of_no_value(planned):
    steps = tuple(Step(n, float(n), 1e-3 / max(n, 1)) for n in range(29))
    change = {"criterion": "O1", "value": 14.0, "random": float("inf"), "steps": steps}
    report = text(planned, **change)
    assert "O1" in report and "[mm]" in report and "nan" not in report
    (own,) = [line.split()[2:] for line in report.splitlines() if "planned" in line]
    assert [*map(float, own)] == [14.0, pytest.approx(1.0 / 14, abs=1e-4)]
    (random,) = [x.split() for x in report.splitlines() if "random baseline" in x]
    assert random[3:] == ["inf"]


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
