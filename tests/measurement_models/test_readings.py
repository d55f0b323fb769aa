"""Measurements that are read otherwise than their columns say."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib_pin
from calib_pin.errors import CalibPinError
from calib_pin.measurement_models.readings import read_otherwise
from calib_pin.observations import Measurements, Observations
from calib_pin.setup import ConvertedSetup, ReadingSetup

ARM = calib_pin.load_chain("space6")
COUNT = 6


def positions(file: str, first: int = 2, count: int = COUNT) -> Measurements:
    """Measurements whose joints and values tell their line."""
    lines = np.arange(first, first + count)
    q = np.outer(lines, np.linspace(0.01, 0.06, 6))
    values = lines[:, None] + np.array([0.1, 0.2, 0.3])
    return Measurements(
        ARM.joints, q, "position", values, lines=lines, files=(file,) * count
    )


DATA = Observations.of(positions("a.csv"), positions("b.csv", 12))
"""Two files with the lines 2 to 7 and 12 to 17."""


def read(**keys: object) -> Observations:
    return read_otherwise(DATA, ReadingSetup(**keys))  # type: ignore[arg-type]


def lines_of_joints(data: Observations) -> list[float]:
    return np.round(data.q[:, 0] / 0.01, 9).tolist()


def test_plain_reading_changes_nothing() -> None:
    assert read() is DATA


def test_joint_positions_stand_below() -> None:
    found = read(shift=2)
    assert found.lines.tolist() == [2, 3, 4, 5, 12, 13, 14, 15]
    assert lines_of_joints(found) == [4, 5, 6, 7, 14, 15, 16, 17]
    found = read(shift=-1)
    assert found.lines.tolist() == [3, 4, 5, 6, 7, 13, 14, 15, 16, 17]
    assert lines_of_joints(found) == [2, 3, 4, 5, 6, 12, 13, 14, 15, 16]


def test_joint_positions_stand_above_from_a_line_on() -> None:
    found = read(shift=-1, shift_from=("a.csv:5",))
    assert found.lines.tolist() == [2, 3, 4, 6, 7, *range(12, 18)]
    assert lines_of_joints(found) == [2, 3, 4, 5, 6, *range(12, 18)]
    with pytest.raises(CalibPinError, match=r"a\.csv:9, where no measurement"):
        read(shift=1, shift_from=("a.csv:9",))


def test_joint_positions_of_the_configuration_below() -> None:
    block = DATA.blocks[0]
    q = np.repeat(np.arange(4.0), 3)[:, None] * 0.01 * np.ones(block.q.shape[1])
    images = replace(block.rows(np.arange(len(q)) % len(block)), q=q)
    images = replace(images, lines=np.arange(2, 14), files=("a.csv",) * 12)
    found = read_otherwise(
        Observations.of(images), ReadingSetup(shift_configurations=1)
    )
    assert found.lines.tolist() == [*range(2, 11)]
    assert lines_of_joints(found) == [1, 1, 1, 2, 2, 2, 3, 3, 3]


def test_files_are_reversed_one_by_one() -> None:
    assert lines_of_joints(read(reversed=True)) == [
        *range(7, 1, -1),
        *range(17, 11, -1),
    ]


def test_two_lines_are_exchanged() -> None:
    found = lines_of_joints(read(exchanged=(("a.csv:3", "b.csv:12"),)))
    assert found == [2, 12, 4, 5, 6, 7, 3, 13, 14, 15, 16, 17]


def test_axes_and_scale() -> None:
    values = read(axes=("-y", "x", "z"), scale=2.0).only.values
    # The column x holds -y, the column y holds x.
    np.testing.assert_allclose(values[0], [2 * 2.2, -2 * 2.1, 2 * 2.3])


def test_some_lines_are_in_another_unit() -> None:
    part = ConvertedSetup(0.5, lines=("a.csv:6", "b.csv:13"))
    factors = read(converted=(part,)).only.values[:, 0] / DATA.only.values[:, 0]
    np.testing.assert_allclose(factors, [1] * 4 + [0.5] * 4 + [1] * 4)
    part = ConvertedSetup(0.5, ("a.csv:6", "b.csv:13"), True, (ARM.joints[1],))
    ratio = read(converted=(part,)).q / DATA.q
    assert (ratio[:, 1] == [1, 1, 1, 1, 0.5, 1, 1, 0.5, 1, 1, 1, 1]).all()
    assert (np.delete(ratio, 1, axis=1) == 1.0).all()


def test_a_lag_is_a_part_of_the_last_motion_in_the_file() -> None:
    found = lines_of_joints(read(lag={ARM.joints[0]: 0.25}))
    assert found == [2, *(k - 0.25 for k in range(3, 8)), 12] + [
        k - 0.25 for k in range(13, 18)
    ]


def test_a_drift_grows_over_all_files() -> None:
    moved = DATA.only.values - read(drift=(0.0, 0.0, 0.011)).only.values
    np.testing.assert_allclose(moved[:, 2], np.linspace(0.0, 0.011, 12), atol=1e-12)
    assert not moved[:, :2].any()


def test_stations_and_tools_change_from_a_line_on() -> None:
    found = read(moved=("a.csv:4", "b.csv:12"), remounted=("b.csv:12",))
    names = {(b.station, b.tool): b.lines.tolist() for b in found.blocks}
    assert names == {
        ("station1", "tool1"): [2, 3],
        ("station2", "tool1"): [4, 5, 6, 7],
        ("station3", "tool2"): [*range(12, 18)],
    }


def test_lines_are_left_out() -> None:
    assert 6 not in read(without=("a.csv:6",)).lines
    assert len(read(without=("a.csv:6", "b.csv:12"))) == 10
    # Measurements from no file are counted.
    rows = replace(positions(""), lines=np.zeros(COUNT, np.int64))
    found = read_otherwise(Observations.of(rows), ReadingSetup(without=("2",)))
    assert lines_of_joints(found) == [2, 4, 5, 6, 7]


@pytest.mark.parametrize(
    "keys",
    [
        {"without": ("6",)},  # Which file?
        {"without": ("a.csv:12",)},
        {"without": ("c.csv:6",)},
        {"moved": ("a.csv:1",)},
        {"shift": 6},
        {"lag": {"no_joint": 0.1}},
    ],
)
def test_what_is_not_there_is_refused(keys: dict[str, object]) -> None:
    with pytest.raises(CalibPinError):
        read(**keys)


@pytest.mark.parametrize(
    "text",
    [
        "axes: [x, x, z]",
        "without: [a]",
        "exchanged: [[1, 2, 3]]",
        "shift: 0.5",
        "converted: [{factor: 2, lines: [3]}]",
    ],
)
def test_bad_keys_are_refused(text: str, tmp_path: Path) -> None:
    setup = tmp_path / "setup.yaml"
    setup.write_text(f"reading: {{{text}}}\n")
    with pytest.raises(CalibPinError):
        calib_pin.read_setup(setup)


def test_a_file_is_read_as_its_setup_says(tmp_path: Path) -> None:
    file, setup = tmp_path / "a.csv", tmp_path / "setup.yaml"
    calib_pin.write_measurements(file, positions("a.csv"))
    setup.write_text("reading: {shift: 1, without: [3, 'a.csv:5'], axes: [y, x, z]}\n")
    reading = calib_pin.read_setup(setup).reading
    assert reading.without == ("3", "a.csv:5")
    plain = calib_pin.read_measurements(file, ARM)
    found = calib_pin.read_measurements(file, ARM, reading=reading)
    assert found.lines.tolist() == [2, 4, 6]
    np.testing.assert_array_equal(found.q, plain.q[[1, 3, 5]])
    np.testing.assert_array_equal(
        found.only.values, plain.only.values[[0, 2, 4]][:, [1, 0, 2]]
    )
