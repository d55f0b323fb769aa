"""What decides trust as people read it, from results that are made up."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calib_pin.estimation.evidence import (
    ExpectedAccuracy,
    Finding,
    Gain,
    VarianceComponent,
)
from calib_pin.report.blocks import Line
from calib_pin.report.text import format_report
from calib_pin.report.trust import findings
from calib_pin.validation.result import CalibrationResult
from tests.report.results import changed, full_report

WORKSPACE = ExpectedAccuracy(
    nominal=(2.47e-3, 3.1e-3),
    calibrated=(0.312e-3, 0.4e-3),
    bound=(0.39e-3, 0.5e-3),
    unmodeled=(0.2e-3, 0.3e-3),
    better=0.9995,
    share=0.93,
)
EVIDENCE: dict[str, Any] = {
    "noise": (
        VarianceComponent(
            *("position", "m", 1e-4, False, 4.012, 4.012e-4, (3.71e-4, 4.33e-4)),
            *(0.61, 240.0, True, 2.04e-5, 3.98e-4, 1e-9),
        ),
        VarianceComponent(
            *("orientation", "rad", 1e-4, True, 1.0, np.nan, (np.nan, np.nan)),
            *(0.0, 240.0, False),
        ),
    ),
    "gains": (Gain("5-fold", "position", 40, 1e-3, 1e-4, 1e-6, 1.0, 1.02),),
    "measured": replace(WORKSPACE, nominal=(0.756e-3, 1e-3), better=1.0, share=1.0),
    "workspace": WORKSPACE,
    "findings": (
        Finding(
            "scale",
            "warning",
            "all lengths came out 0.5 % longer",
            {"scale": 5e-3},
            "check the unit of the lengths",
        ),
    ),
}


@pytest.fixture(scope="module")
def result(calibrated: CalibrationResult) -> CalibrationResult:
    return changed(calibrated, **EVIDENCE, verdict="good", reason="")


def words(result: CalibrationResult, **changes: Any) -> str:
    return " ".join(full_report(changed(result, **changes)).split())


def test_the_verdict_comes_first_then_findings(result):
    (found,) = result.findings
    said = f"Warning: {found.message}; {found.remedy}."
    assert words(result).startswith(f"GOOD: . {said} space7: ")
    unused = words(result, verdict="no-gain", reason="0.1 mm", findings=())
    assert unused.startswith("NO GAIN: 0.1 mm. ")
    bad = words(result, verdict="untrusted", reason="it did not converge.")
    assert bad.startswith(f"UNTRUSTED: it did not converge. {said}")
    noted = words(result, findings=(replace(found, severity="info"),))
    assert noted.startswith("GOOD: ") and f"Info: {found.message}" in noted
    # The reason says it once, and with what to do about it.
    text = words(result, verdict="untrusted", reason=found.message)
    assert text.startswith(f"UNTRUSTED: {said[9:]}") and "Warning" not in text
    assert text.endswith(f"Next: {found.remedy}.")


def test_three_findings_and_how_many_more(result):
    """Without details; of what is not to be trusted the last line says what to do."""
    (found,) = result.findings
    many = tuple(replace(found, message=f"fault {k}") for k in range(5))
    text = format_report(changed(result, findings=many))
    assert [f"fault {k}" in text for k in range(5)] == 3 * [True] + 2 * [False]
    assert "2 more findings: see the page, or --details." in text
    assert "Next: " not in text and "more finding" not in full_report(result)
    lines = replace(found, setup={"tip": "tool0"})
    remark = replace(lines, severity="info")
    steps = [((), "calib-pin plan"), ((remark,), "calib-pin plan")]
    for some, said in (*steps, ((lines,), "the lines above")):
        bad = changed(result, findings=some, verdict="untrusted", reason="it is")
        *_, last = format_report(bad).split("Next: ")
        assert said in " ".join(last.split())


def test_errors_come_first_with_lines_to_copy(result):
    shift = Finding(
        "line-shift",
        "error",
        "measurements stand one line below",
        setup={"reading": {"shift": 1}},
        figure="residuals-over-order",
    )
    text = full_report(changed(result, findings=(*result.findings, shift)))
    lines = text.splitlines()
    first, second = (
        next(k for k, line in enumerate(lines) if line.startswith(tone))
        for tone in ("Error: ", "Warning: ")
    )
    assert first < second
    assert [x for x in lines if x.startswith("  reading")] == ["  reading: {shift: 1}"]
    # The page has the figure, and leads to it; a terminal has none.
    assert "residuals-over-order" not in text
    (line,) = (b for b in findings((shift,), "") if isinstance(b, Line) and b.figure)
    assert "residuals-over-order" in line.text


def test_two_accuracies(result):
    lines = full_report(result).splitlines()
    start = lines.index("Expected tool-point error (rms)")
    cells = [line.split() for line in lines[start + 1 : start + 6]]
    assert " ".join(cells[1][1:]) == "0.76 0.31 0.39 0.20 mm 100 % 100 %"
    assert " ".join(cells[3][1:]) == "2.5 0.31 0.39 0.20 mm > 99 % 93 %"
    assert cells[4] == ["0.18", "0.023", "0.029", "0.017", "deg"]
    both = {"left": result.accuracy, "right": result.accuracy}
    text = full_report(replace(result, accuracies=both))
    assert all(f"{of}, workspace" in text for of in both)
    assert max(map(len, text.splitlines())) <= 80
    none = words(result, measured=None, workspace=None)
    assert "Expected tool-point error" not in none


def test_noise(result):
    lines = full_report(result).splitlines()
    start = lines.index("Noise (1 sigma of a component, with its 95 % interval)")
    cells = [line.split() for line in lines[start + 1 : start + 4]]
    assert cells[1] == [
        *("position", "0.10", "assumed", "0.40", "0.37", "0.43"),
        *("0.020", "0.40", "mm"),
    ]
    assert cells[2] == ["orientation", "0.0057", "stated", *5 * "-", "deg"]
    assert "position: configurations differ more " in words(result)
    assert "(p = 1e-09)" in words(result) and "orientation: " not in words(result)
    # Stated noise that stands leaves nothing to say.
    stands = replace(result.statistics.noise[0], contradicted=False, unmodeled=0.0)
    stands = replace(stands, lack_of_fit=None)
    assert "position: " not in words(result, noise=(stands,))
