"""Rows of a fleet: their order, and how they become columns."""

from __future__ import annotations

import math

from calib_pin.validation.fleet import (
    Drift,
    Expected,
    FleetRow,
    by_urgency,
    fleet_columns,
)


def row(job: str, verdict: str = "good", size: float = 1e-4, drifted: bool = False):
    expected = Expected(1e-3, size, 2.0 * size)
    return FleetRow(
        job, verdict=verdict, expected=expected, drift=Drift("x", 1e-3, 1e-4, drifted)
    )


def test_who_needs_attention_comes_first():
    rows = [
        row("accurate", size=1e-5),
        row("inaccurate", size=1e-3),
        row("drifted", size=1e-5, drifted=True),
        row("unchecked", "unchecked"),
        row("untrusted", "untrusted"),
        FleetRow("failed"),
        row("nothing to gain", "no-gain", size=2e-4),
        row("unknown", size=math.nan),
    ]
    assert [found.job for found in by_urgency(rows)] == [
        *("failed", "untrusted", "unchecked", "drifted", "unknown"),
        *("inaccurate", "nothing to gain", "accurate"),
    ]
    assert by_urgency(reversed(by_urgency(rows)))[0].job == "failed"


def test_columns_have_every_row_and_no_nan():
    found = fleet_columns([row("a"), FleetRow("b", findings=())])
    assert {len(column) for column in found.values()} == {2}
    assert found["expected_bound"] == [2e-4, ""]
    assert found["drift_beyond"] == [False, False]
    assert found["verdict"] == ["good", "failed"]
    assert not any(
        isinstance(cell, float) and math.isnan(cell)
        for column in found.values()
        for cell in column
    )
