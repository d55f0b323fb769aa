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
from calib_pin.validation.comparison import (
    Comparison,
    Difference,
    compare,
)
from calib_pin.validation.frame_drift import Displacement


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
        known = {"stated_sigma": noise is not None, "sigma0": noise or 1.0}
        statistics = replace(result.statistics, **known)
        result = replace(result, statistics=statistics)
    if "hashes" in changes:
        provenance = replace(result.provenance, hashes=changes.pop("hashes"))
        result = replace(result, provenance=provenance)
    if "predicted" in changes:
        sizes, tip = changes.pop("predicted"), None
        if sizes is not None:
            assert result.accuracy.tip is not None
            p, o = (np.full(1, size) for size in sizes)
            tip = replace(
                result.accuracy.tip, position=p, orientation=o, of_robot=sizes
            )
        result = replace(result, accuracies={"": replace(result.accuracy, tip=tip)})
    return replace(found, second=replace(result, **changes))


# --- the verdict -------------------------------------------------------------------


def test_no_drift(still):
    words = words_of(still)
    assert words.startswith("No drift beyond the noise of both: the tool points")
    drift, noise = still.drift, still.explained
    for size in (1e3 * drift.position.rms, 1e3 * noise[0]):
        assert f"{size:.4f} mm" in words
    assert f"{np.degrees(drift.orientation.rms):.4f} deg rms where" in words
    assert "differ by more than" not in words


def test_a_move(moved):
    words = words_of(moved)
    assert words.startswith("The robot changed: tool-point drift 0.")
    leading = moved.differences[0]
    row = next(
        line
        for line in text_of(moved).splitlines()
        if line.startswith(leading.terms[0][0])
    )
    sigma = significant(np.degrees(leading.sigma))
    places = len(sigma.partition(".")[2])
    expected = [
        f"{np.degrees(leading.change):+.{places}f}",
        sigma,
        f"{leading.significance:.1f}",
        "deg",
    ]
    assert row.split()[-4:] == expected


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        (
            {"noise": None},
            "The robot changed, or was measured at other configurations:",
        ),
        (
            {"hashes": ("rows 0",)},
            "The two disagree on the tool point, which differs by 0.",
        ),
        (
            {"predicted": None},
            r"The tool points are 0\.\d+ mm and 0\.\d+ deg rms apart; the files",
        ),
        (
            {"predicted": (1.0, 1.0)},
            r"The robot changed, .*joint_4.*; the tool points differ",
        ),
        (
            {"predicted": (1.0, 1.0), "noise": 2.0},
            "No drift beyond the noise of both",
        ),
    ],
)
def test_other_verdicts(changes, expected, moved):
    assert re.match(expected, words_of(second(moved, **changes)))


def test_tips_at_the_same_places(still):
    drift = replace(still.drift, drift=np.full(1000, 1e-9), turn=np.full(1000, 1e-9))
    words = words_of(replace(still, drifts={"": drift}))
    assert words.startswith("No drift: both predict the same tool points.")
    assert "Largest difference" not in words


def test_what_must_not_be_trusted_comes_first(moved):
    bad = second(moved, verdict="untrusted", reason="not converged.")
    lines = text_of(bad).splitlines()
    assert lines[0] == "UNTRUSTED: B (1.json): not converged."
    assert lines[1].startswith("The two disagree on the tool point")


# --- what stands below -------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"noise": 1.5}, "measurements at the same configurations would settle it"),
        ({"hashes": ("rows 0",)}, "Both fit the same measurements"),
        ({"hashes": ("rows 0", "more")}, "They share a measurement file"),
    ],
)
def test_doubts(changes, expected, moved):
    assert expected in words_of(second(moved, **changes))
    assert expected not in words_of(moved)


def test_other_nominal_robots(moved):
    words = words_of(replace(moved, same_nominal=False))
    assert words.startswith("The two disagree on the tool point")
    assert "only the tool points are compared, not the parameters" in words
    assert "std. dev." not in words


def test_other_parameters(moved):
    model = moved.second.model
    learned = replace(model, setup=replace(model.setup, learned="network"))
    words = words_of(second(moved, model=learned))
    assert words.startswith("The two disagree on the tool point")
    assert "described by different parameters" in words
    assert "placement + network" in words


def test_where_it_differs_most(moved):
    drift = moved.drift
    words = words_of(moved)
    x, y, z = 1e3 * drift.points[drift.farthest]
    assert f"tool point at {x:.1f}, {y:.1f}, {z:.1f} mm in base_link" in words
    angles = ", ".join(f"{a:.1f}" for a in np.degrees(drift.q[drift.farthest]))
    assert f"joints at {angles} deg" in words


def test_frames_that_moved(still):
    found = replace(
        still,
        displacements=(
            Displacement("base", 0.8, 0.1),
            Displacement("tool", 0.2, None, of_tool=True),
        ),
    )
    words = words_of(found)
    assert "which is no drift of the robot base 800.0 mm and 5.730 deg, rel" in words
    assert "tool 200.0 mm, relative to the tip link" in words
    assert "that of B was elsewhere" in words
    assert "was elsewhere" not in words_of(still)
    assert "Displaced in B" not in words_of(replace(still, displacements=()))


def test_counts(still):
    single = sum(not d.terms for d in still.differences)
    known = f"{single} parameters and {len(still.differences) - single} combinations"
    said = f"Both identify {known} of the robot; {known} agree within 3"
    assert said in words_of(still)
    none = replace(still, differences=(), alone=(("j.dh.d", "j.dh.a"), ()))
    words = words_of(replace(none, sums_alone=(2, 0)))
    assert "No parameter and no combination of the robot is identified by" in words
    assert "2 combinations are identified in A only, 0 in B only." in words
    assert "identifiable in A only: j.dh.d|a" in words
    assert "in B only:" not in words


def test_positions_tell_no_orientations(still):
    (position, _) = still.second.errors
    words = words_of(second(still, errors=(position,)))
    assert "The measurements contain no orientations." in words
    assert "deg rms" not in words


def test_accuracy_of_older_files(still):
    position, orientation = still.second.errors
    old = replace(position, after=replace(position.after, p95=np.nan))
    text = text_of(second(still, errors=(old, orientation)))
    table = text[text.index("Accuracy") :].splitlines()
    row = next(line.split() for line in table if line.split()[:1] == ["B"])
    assert row[3] == "-"
    assert row[1] == f"{1e3 * position.after.mean:.4f}"
    assert "Validation: A none, B none. The measurements differ" in text


def test_80_columns_and_no_number_cut(moved):
    long = "left_arm_very_long_" * 3 + "joint.placement.rz"
    terms = tuple((f"{long}{k}", 1.0) for k in range(3))
    expression = " + ".join(name for name, _ in terms)
    difference = Difference(expression, "rad", 0.0, -123.456, 1.234, terms)
    found = replace(
        moved,
        differences=(difference, *moved.differences),
        alone=((long,), ()),
        first=replace(
            moved.first,
            provenance=replace(
                moved.first.provenance,
                file="a/very/long/path/" * 8 + "calibration.json",
            ),
        ),
    )
    text = text_of(found)
    assert max(map(len, text.splitlines())) <= 80
    assert "…" not in text and text.isascii()
    assert not re.search(r" $", text, re.MULTILINE)
    assert f"{np.degrees(-123.456):+.0f}" in text
    assert re.sub(r"\s", "", found.first.provenance.file) in re.sub(r"\s", "", text)
