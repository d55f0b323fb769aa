"""Weeks of ten measurements on simulated robots with known errors, in short."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import recalibration


def check(found: list[recalibration.Outcome], most: float) -> None:
    """Errors beside those of the best filter, and verdicts."""
    weeks = [week for outcome in found for week in outcome.weeks]
    ours, best, older = (
        np.sqrt(np.mean([getattr(week, name) ** 2 for week in weeks]))
        for name in ("error", "optimal", "older")
    )
    assert ours < most * best
    # Refitting pays, most of all behind the jump.
    assert ours < 0.6 * older
    assert np.mean([week.status == "good" for week in weeks]) > 0.9
    assert sum(outcome.alarms for outcome in found) <= 1


def test_a_few_weeks() -> None:
    """Of the first kind, with the jump of its week."""
    (found,) = [recalibration.run(number, weeks=4) for number in (0,)]
    assert len(found.weeks) == 4 and found.announced
    check([found], 1.8)


@pytest.mark.slow
@pytest.mark.parametrize("kind", range(len(recalibration.KINDS)))
def test_weeks_of_all_kinds(kind: int) -> None:
    numbers = [kind + k * len(recalibration.KINDS) for k in range(5)]
    found = [recalibration.run(number) for number in numbers]
    check(found, 1.35)
    assert sum(outcome.announced for outcome in found) >= 3
