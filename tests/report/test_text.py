"""The report as people read it: plain, 80 columns, mm and degrees, nothing cut off."""

from __future__ import annotations

import io
import re
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from calib_pin.estimation.evidence import Outlier
from calib_pin.io.urdf import load_robot
from calib_pin.kinematics.chain import Chain
from calib_pin.report.accuracy import evaluated
from calib_pin.report.identification import identified
from calib_pin.report.tables import quantity, significant
from calib_pin.report.terminal import laid_out, plain_text
from calib_pin.report.text import format_report, report
from calib_pin.setup import Setup
from calib_pin.validation.assessment import identify
from calib_pin.validation.evaluation import evaluate
from calib_pin.validation.result import CalibrationResult
from tests.report.results import LADDER, arm, changed, full_report, solve
from tests.shared import simulated


@pytest.fixture(scope="module")
def result() -> CalibrationResult:
    return solve(setup=Setup(fixed=("base.frame.r*",)))


def section(text: str, title: str) -> list[str]:
    """The lines from a title to the next empty line."""
    lines = text.splitlines()
    start = next(k for k, line in enumerate(lines) if line.startswith(title))
    end = next((k for k in range(start, len(lines)) if not lines[k]), len(lines))
    return lines[start:end]


# --- form --------------------------------------------------------------------------


def test_plain_text_of_80_columns(result):
    text = full_report(result)
    assert text.isascii()
    assert "\x1b" not in text
    assert text.endswith("\n")
    assert not re.search(r" $", text, re.MULTILINE)
    assert "\n\n\n" not in text
    assert max(map(len, text.splitlines())) <= 80


def test_plain_or_in_colors_by_where_it_goes(result, monkeypatch):
    expected = full_report(result)
    stream = io.StringIO()
    Console(file=stream, force_terminal=True, width=100).print(laid_out(report(result)))
    assert "\x1b[" in stream.getvalue()
    for variable, value in (("FORCE_COLOR", "1"), ("COLUMNS", "40")):
        monkeypatch.setenv(variable, value)
    assert full_report(result) == expected
    monkeypatch.setattr("rich.console._is_jupyter", lambda: True)
    assert full_report(result) == expected


def test_names_are_neither_markup_nor_cut():
    for names in (
        ("[bold]a[/red]", ":robot:", "[b"),
        tuple(f"left_arm_{'very_' * k}long_{k}_joint" for k in (1, 7, 20)),
    ):
        text = full_report(solve(("arm", *names), setup=Setup(parameters=("dh",))))
        assert max(map(len, text.splitlines())) <= 80
        assert "…" not in text
        solid = re.sub(r"\s+", "", text)
        for name in names:
            assert name in solid


# --- content -----------------------------------------------------------------------


def test_verdict_and_subject(result):
    position = next(e for e in result.errors if e.name == "position")
    workspace = result.accuracy.workspace
    sizes = [
        *(position.validation_after.rms, position.validation_before.rms),
        *(s.position for s in (workspace.calibrated, workspace.bound)),
        workspace.nominal.position,
    ]
    text = full_report(result)
    *verdict, subject = text.split("\n\n")[0].splitlines()
    found = " ".join(verdict)
    assert found.startswith("GOOD: ")
    assert re.findall(r"[\d.]+ mm", found) == [f"{1e3 * size:.3g} mm" for size in sizes]
    assert subject == "arm: 3 joints from base to c; pose, 30 measurements fitted"
    for reason in ("it did not converge", "it did not converge."):
        text = full_report(changed(result, verdict="untrusted", reason=reason))
        assert text.splitlines()[0] == "UNTRUSTED: it did not converge."


def test_accuracy_in_millimeters_and_degrees_and_how_far_the_robot_moves(result):
    *table, said, more, moves = section(full_report(result), "Accuracy")
    first, last = table[2].split(), table[-1].split()
    position, orientation = result.errors
    assert len(table) == 2 + 2 * 2 * 2 and table[4].split()[0] == "validation"
    assert first[:3] == ["position", "fitted", "nominal"] and first[-1] == "mm"
    assert float(first[3]) == pytest.approx(1e3 * position.before.mean, rel=1e-3)
    assert (last[0], last[-1]) == ("calibrated", "deg")
    largest = np.degrees(orientation.validation_after.max)
    assert float(last[4]) == pytest.approx(largest, abs=1e-4)
    assert "5-fold" in said and "base frame, tool frame" in more
    found = re.fullmatch(r"\D+([\d.]+) mm \((\w+)\), ([\d.]+) deg \((\w+)\)\.", moves)
    corrections = result.model.urdf_corrections()
    shifts = {j: 1e3 * np.linalg.norm(M.translation) for j, M in corrections.items()}
    cosines = {j: (np.trace(M.rotation) - 1.0) / 2.0 for j, M in corrections.items()}
    assert found and shifts[found[2]] == max(shifts.values())
    assert float(found[1]) == pytest.approx(shifts[found[2]], rel=1e-3)
    assert cosines[found[4]] == min(cosines.values())
    turn = np.degrees(np.arccos(cosines[found[4]]))
    assert float(found[3]) == pytest.approx(turn, abs=1e-4)


def test_ranks(result):
    text = " ".join(" ".join(section(full_report(result), "Identifiability")).split())
    ranks = result.identifiability
    known = sum(p.status == "identifiable" for p in result.parameters)
    for said in (
        f"free parameters {ranks.parameters} (",
        f"{known} identifiable",
        # 4 * 2 + 2 * 1 + 6, of which three rotations of the base are held.
        "Everett's count 4R + 2P + 6 = 16, for geometry and full poses",
        f"practical rank {ranks.rank} ",
        *("condition number", "O1", "O2", "O3", "O4", "O5"),
    ):
        assert said in text


def test_every_parameter_is_listed_with_its_status(result):
    text = full_report(result)
    lines = section(text, "Identifiable parameters")[2:]
    names = [line.split()[0] for line in lines]
    known = [p for p in result.parameters if p.status == "identifiable"]
    assert names == [p.name for p in known]
    for line, parameter in zip(lines, known, strict=True):
        _, value, sigma, unit = line.split()
        factor = 1e3 if unit == "mm" else np.degrees(1.0)
        assert unit == {"m": "mm", "rad": "deg"}[parameter.unit]
        # Two digits of the standard deviation, and the value to the same place.
        assert float(sigma) == pytest.approx(factor * parameter.sigma, rel=0.05)
        assert len(value.partition(".")[2]) == len(sigma.partition(".")[2])
        last = 0.5 * 10.0 ** -len(sigma.partition(".")[2])
        assert float(value) == pytest.approx(factor * parameter.value, abs=1.001 * last)
    assert section(text, "fixed:") == ["fixed:", "  base.frame.rx|ry|rz"]
    bounded = changed(result, at_bounds=("j2.placement.x", "j2.placement.y"))
    assert section(full_report(bounded), "at a bound:")[1:] == ["  j2.placement.x|y"]


def test_groups_are_formulae(result):
    lines = section(full_report(result), "Identifiable linear combinations")
    numbered = {line.split()[0]: k for k, line in enumerate(lines)}
    for group in result.groups:
        # A long sum goes on in the next lines, the value stands beside the first.
        start = numbered[str(group.number)]
        below = "".join(lines[start : start + len(group.terms)])
        assert all(name in below for name, _ in group.terms)
        factor = {"m": 1e3, "rad": np.degrees(1.0)}[group.unit]
        assert group.sigma and significant(factor * group.sigma) in lines[start]


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        *((0.0, "0.0000"), (8.1e-3, "8.100"), (1.2345678, "1235"), (1e-12, "1.0e-09")),
        *((99.9996e-3, "100.00"), (123.45, "1.2e+05")),
        *((float("inf"), "inf"), (float("nan"), "-")),
    ],
)
def test_numbers(value, shown):
    assert quantity(value, "m").text == shown


@pytest.mark.parametrize(
    ("value", "text"),
    [
        *((0.0123, "0.012"), (0.0996, "0.10"), (0.4321, "0.43"), (9.96, "10")),
        *((123.4, "120"), (0.0, "0"), (float("inf"), "inf"), (-0.0567, "-0.057")),
    ],
)
def test_significant_digits(value, text):
    assert significant(value) == text


def test_chi_square(result):
    dof = result.statistics.dof
    for stated in ("stated", "assumed"):
        known = {"chi2": dof, "stated_sigma": stated == "stated"}
        lines = section(full_report(changed(result, **known)), "Statistics")
        assert f"{dof} dof (95 %: " in "".join(lines)
        assert f"the {stated} sigma" in "".join(lines)


def test_outliers_are_counted(result):
    which = (f"rows.csv:{k}" for k in range(7))
    rows = tuple(Outlier(row, 1, 1234.6, 0.4321, "target ball") for row in which)
    text = full_report(changed(result, outliers=rows))
    lines = section(text, "Outliers (7 of 30)")
    assert lines[2].split() == ["rows.csv:0", "1234.6", "0.43", "target", "ball"]
    assert "2 more" in lines[-1]
    assert "Outliers" not in full_report(changed(result, outliers=()))


def test_structure_without_estimates():
    found = identify(Chain(load_robot("pa10")), "pose")
    text = plain_text(identified(found, fitted=False))
    assert "std. dev." not in text and "practical rank" not in text
    assert re.search("structural rank +34 ", text)
    lines = section(text, "Identifiable errors of the robot")
    assert len([x for x in lines[2:] if ".placement." in x]) == 22
    assert lines[2].endswith(" joint_2.placement.rz + joint_3.placement.ry")
    assert "linear combinations" not in text
    more = plain_text(identified(found, fitted=False, details=True))
    assert section(more, "identifiable:")[1] == "  joint_2.placement.x|rx"
    assert section(more, "Identifiable linear combinations")
    assert max(map(len, (text + more).splitlines())) <= 80


def test_evaluations(result):
    chain = arm("arm", "j1", "j2", "j3")
    rows = simulated("pose", count=12, seed=2, robot=chain, noise=None)[0].data
    nominal = plain_text(evaluated(evaluate(chain, rows)))
    assert nominal.splitlines()[2].split()[:2] == ["position", "12"]
    assert " mm" in nominal and " deg" in nominal
    assert "registered" in nominal
    assert "registered" not in plain_text(evaluated(evaluate(result.model, rows)))


def test_directions_that_large_errors_reveal(result):
    assert "1 observable" in full_report(changed(result, revealed=1))
    assert "0 observable" in full_report(result)


def test_a_reason_that_several_candidates_share_is_said_once(result):
    lost = LADDER.candidates[2]
    more = (*LADDER.candidates, replace(lost, name="+ ripple"))
    found = changed(result, model_selection=replace(LADDER, candidates=more))
    text = " ".join(format_report(found).split())
    assert "Not tried: + compliance, + ripple: no masses." in text
    assert text.count("no masses") == 1
