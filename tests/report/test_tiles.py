"""The headline: sizes before and after, and what has to be used for them."""

from __future__ import annotations

from dataclasses import replace

import pytest

from calib_pin.report.tables import significant
from calib_pin.report.tiles import EVERYTHING, URDF, change, tiles
from calib_pin.validation.result import CalibrationResult
from tests.report.test_written_result import CASES


@pytest.fixture(scope="module")
def held_out() -> CalibrationResult:
    return CASES["position"]()


@pytest.fixture(scope="module")
def learned() -> CalibrationResult:
    return CASES["learned"]()


def test_sizes_are_means_of_held_out_measurements(held_out: CalibrationResult) -> None:
    (error,), (tile, workspace) = held_out.errors, tiles(held_out)
    before, after = error.validation_before, error.validation_after
    assert before is not None and after is not None
    (step,) = tile.steps
    assert (step.before.value, step.after.value) == (before.mean, after.mean)
    assert step.before.text == significant(1e3 * before.mean)
    assert step.change == change(before.mean, after.mean)
    assert tile.unit == "mm" and "held-out" in tile.label and step.name == ""
    assert "over the workspace" in workspace.label


def test_of_something_learned_there_are_two(learned: CalibrationResult) -> None:
    assert learned.urdf is not None
    for error, tile in zip(learned.errors, tiles(learned), strict=False):
        alone, everything = tile.steps
        assert (alone.name, everything.name) == (URDF, EVERYTHING)
        (urdf,) = (e for e in learned.urdf.errors if e.name == error.name)
        assert urdf.validation_after is not None and error.validation_after is not None
        assert alone.after.value == urdf.validation_after.mean
        assert everything.after.value == error.validation_after.mean
        assert alone.before == everything.before


def test_what_is_not_good_says_so(held_out: CalibrationResult) -> None:
    """Predictions are those of a model that has to be right."""
    for verdict in ("no-gain", "unchecked", "untrusted"):
        (tile,) = tiles(replace(held_out, verdict=verdict))
        assert "not" in tile.remark and tile.steps[0].change == ""
    fitted = replace(held_out.errors[0], validation_before=None, validation_after=None)
    tile, *_ = tiles(replace(held_out, errors=(fitted,)))
    assert "fitted" in tile.label


@pytest.mark.parametrize(
    ("before", "after", "told"),
    [
        (1.0, 0.5249, "-48 %"),
        (1.0, 1e-9, "-99.9 %"),
        (1.0, 0.0, "-100 %"),
        (1.0, 0.996, "+0 %"),
        (1.0, 3.0, "+200 %"),
        (0.0, 1.0, ""),
        (float("inf"), 1.0, ""),
        (1.0, float("nan"), ""),
    ],
)
def test_changes_in_percent(before: float, after: float, told: str) -> None:
    assert change(before, after) == told
