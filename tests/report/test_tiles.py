"""The headline: sizes before and after, and what has to be used for them."""

from __future__ import annotations

from dataclasses import replace

import pytest

from calib_pin.report.tables import significant
from calib_pin.report.tiles import EVERYTHING, URDF, change, tiles


def test_sizes_are_means_of_held_out_measurements(calibrated):
    found = [*tiles(calibrated)]
    assert len(found) == len(calibrated.errors) + 1  # And over the workspace.
    for error, tile, factor in zip(calibrated.errors, found, (1e3, None), strict=False):
        before, after = error.validation_before, error.validation_after
        assert before is not None and after is not None
        (step,) = tile.steps
        assert (step.before.value, step.after.value) == (before.mean, after.mean)
        assert step.change == change(before.mean, after.mean)
        assert factor is None or step.before.text == significant(factor * before.mean)
    assert [tile.unit for tile in found] == ["mm", "deg", "mm"]


def test_of_more_than_a_urdf_holds_there_are_two(calibrated):
    worse = tuple(
        replace(error, validation_after=error.validation_before)
        for error in calibrated.errors
    )
    alone = replace(calibrated, errors=worse)
    for error, tile in zip(
        calibrated.errors, tiles(replace(calibrated, urdf=alone)), strict=False
    ):
        urdf, everything = tile.steps
        assert (urdf.name, everything.name) == (URDF, EVERYTHING)
        assert urdf.before == everything.before
        assert urdf.after.value == urdf.before.value
        assert error.validation_after is not None
        assert everything.after.value == error.validation_after.mean


def test_what_is_not_good_says_so(calibrated):
    """Predictions are those of a model that has to be right."""
    for verdict in ("no-gain", "unchecked", "untrusted"):
        found = [*tiles(replace(calibrated, verdict=verdict))]
        assert len(found) == len(calibrated.errors)
        assert all(tile.steps[0].change == "" for tile in found)


@pytest.mark.parametrize(
    ("before", "after", "told"),
    [
        *((1.0, 0.5249, "-48 %"), (1.0, 1e-9, "-99.9 %"), (1.0, 0.0, "-100 %")),
        *((1.0, 0.996, "+0 %"), (1.0, 3.0, "+200 %")),
        *((0.0, 1.0, ""), (1.0, float("nan"), "")),
    ],
)
def test_changes_in_percent(before, after, told):
    assert change(before, after) == told
