"""The comparison as people read it: the verdict first, 80 columns, nothing cut off."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import calib_pin
from calib_pin.report.comparison import comparison_report
from calib_pin.report.tables import significant
from calib_pin.report.terminal import plain_text
from calib_pin.validation.comparison import Comparison, Difference, compare
from calib_pin.validation.result import Coefficient
from tests.report.results import changed


@pytest.fixture(scope="module")
def still(recorded) -> Comparison:
    chain = calib_pin.load_chain("space6")
    return compare(recorded(chain, "pose", 0), recorded(chain, "pose", 1))


@pytest.fixture(scope="module")
def moved(recorded) -> Comparison:
    chain = calib_pin.load_chain("space6")
    later = recorded(chain, "pose", 1, {"joint_4.placement.rz": 2e-3})
    return compare(recorded(chain, "pose", 0), later)


def text_of(found: Comparison) -> str:
    return plain_text(comparison_report(found))


def words_of(found: Comparison) -> str:
    return " ".join(text_of(found).split())


def second(found: Comparison, **changes: Any) -> Comparison:
    """A comparison with another second calibration."""
    result = found.second
    if "noise" in changes:
        noise = changes.pop("noise")
        changes |= {"stated_sigma": noise is not None, "sigma0": noise or 1.0}
    if "hashes" in changes:
        hashes = changes.pop("hashes")
        changes["provenance"] = replace(result.provenance, hashes=hashes)
    drift = replace(found.drift, oriented="errors" not in changes)
    if "size" in changes:
        size = changes.pop("size")
        drift = replace(drift, explained=None if size is None else (size, size))
    later = changed(result, **changes)
    return replace(found, second=later, drifts={"": drift})


# --- the verdict -------------------------------------------------------------------


def test_no_drift(still):
    words = words_of(still)
    assert words.startswith("No drift beyond the noise of both: the tool points")
    drift, noise = still.drift, still.drift.explained
    for size in (1e3 * drift.position.rms, 1e3 * noise[0]):
        assert f"{size:.4f} mm" in words
    assert f"{np.degrees(drift.orientation.rms):.4f} deg rms where" in words
    assert "differ by more than" not in words


def test_a_move(moved):
    words = words_of(moved)
    assert words.startswith("The robot changed: tool-point drift 0.")
    leading = moved.differences[0]
    (row,) = (
        line.split()[-4:]
        for line in text_of(moved).splitlines()
        if line.startswith(leading.terms[0][0])
    )
    sigma = significant(np.degrees(leading.sigma))
    change = f"{np.degrees(leading.change):+.{len(sigma.partition('.')[2])}f}"
    assert row == [change, sigma, f"{leading.significance:.1f}", "deg"]


CHANGED = "The robot changed"
DISAGREE = "The two disagree on the tool point"


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"noise": None}, f"{CHANGED}, or was measured"),
        ({"hashes": ("rows 0",)}, DISAGREE),
        ({"size": None}, r"The tool points are 0\.\d+ mm and 0\.\d+ deg rms apart"),
        ({"size": 1.0}, rf"{CHANGED}, .*joint_4.*"),
        ({"size": 1.0, "noise": 2.0}, "No drift beyond the noise"),
    ],
)
def test_other_verdicts(changes, expected, moved):
    assert re.match(expected, words_of(second(moved, **changes)))


def test_tips_at_the_same_places(still):
    drift = replace(still.drift, drift=np.full(1000, 1e-9), turn=np.full(1000, 1e-9))
    words = words_of(replace(still, drifts={"": drift}))
    assert words.startswith("No drift: ")
    assert "Largest difference" not in words


# --- what stands below -------------------------------------------------------------


def test_doubts_and_the_place_of_the_largest_difference(moved):
    bad = second(moved, verdict="untrusted", reason="not converged.")
    lines = text_of(bad).splitlines()
    assert lines[0] == "UNTRUSTED: B (1.json): not converged."
    assert lines[1].startswith(DISAGREE)
    model = moved.second.model
    learned = replace(model, setup=replace(model.setup, learned="network"))
    other = words_of(second(moved, model=learned))
    assert other.startswith(DISAGREE) and "placement + network" in other
    assert words_of(replace(moved, same_nominal=False)).startswith(DISAGREE)
    drift, words = moved.drift, words_of(moved)
    x, y, z = 1e3 * drift.points[drift.farthest]
    assert f"at {x:.1f}, {y:.1f}, {z:.1f} mm in base_link" in words
    angles = np.degrees(drift.q[drift.farthest])
    assert f"at {', '.join(f'{a:.1f} deg' for a in angles)}" in words


def test_counts(still):
    single = sum(not d.terms for d in still.differences)
    known = f"{single} parameters and {len(still.differences) - single} combinations"
    assert f"{known} of the robot; {known} agree within 3" in words_of(still)
    words = words_of(replace(still, differences=()))
    assert "is identified by both" in words


def test_what_positions_lack(still):
    position, _ = still.second.errors
    assert "deg rms" not in words_of(second(still, errors=(position,)))


def test_80_columns_and_no_number_cut(moved):
    long = "left_arm_very_long_" * 3 + "joint.placement.rz"
    terms = tuple(Coefficient(f"{long}{k}", 1.0) for k in range(3))
    expression = " + ".join(name for name, _ in terms)
    difference = Difference(expression, "rad", 0.0, -123.456, 1.234, terms)
    file = "a/very/long/path/" * 8 + "calibration.json"
    provenance = replace(moved.first.provenance, file=file)
    found = replace(
        moved,
        differences=(difference, *moved.differences),
        first=replace(moved.first, provenance=provenance),
    )
    text = text_of(found)
    assert max(map(len, text.splitlines())) <= 80
    assert "…" not in text and text.isascii()
    assert not re.search(r" $", text, re.MULTILINE)
    assert f"{np.degrees(-123.456):+.0f}" in text
    assert file in re.sub(r"\s", "", text)
