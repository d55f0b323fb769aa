"""The data sets: what a user states of each, and which measurements ask what.

Stated are the robot, its chain, the way of measuring and, of the Pandas, that two
sockets are 50 mm apart. Nothing else is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import calib_pin
from benchmarks.verdict.real import known_distances
from calib_pin.observations import Measurements, Observations
from calib_pin.setup import Setup

WAM = Path(__file__).with_name("wam.urdf")
BOTH = ("train.csv", "validate.csv")

Choice = Callable[[Measurements], NDArray[np.bool_]]
"""Mask of some measurements, shape (N,)."""


@dataclass(frozen=True)
class Term:
    """Measurements of a data set.

    Attributes:
        name: What they are, in a table.
        folder: Their folder.
        files: Its files.
        only: Which of their measurements; None for all.
        registered: Whether they stand in a frame of their own, with another mounting,
            so that base and tool are registered on them.
    """

    name: str
    folder: str
    files: tuple[str, ...]
    only: Choice | None = None
    registered: bool = False

    def there(self, data: Path) -> bool:
        """Whether a folder has all files."""
        return all((data / self.folder / name).is_file() for name in self.files)

    def read(self, data: Path, chain: calib_pin.Chain, model: str) -> Observations:
        """The measurements.

        Raises:
            InputError: If a file is not one of measurements.
        """
        paths = [data / self.folder / name for name in self.files]
        rows = calib_pin.read_measurements(paths, chain, model=model)
        if self.only is None:
            return rows
        return Observations.of(rows.only.rows(self.only(rows.only)))


@dataclass(frozen=True)
class DataSet:
    """A robot that was measured.

    Attributes:
        key: Its name in options.
        name: Its name in a table.
        instrument: What measured.
        robot: URDF, or the name of an example.
        base: Start of the chain; None for the root.
        tip: Its end.
        model: Measurement model.
        fitted: The measurements that are fitted.
        near: Held-out measurements near these; None for a cross-validation.
        away: Other motions, places and days.
        by_place: Whether a cross-validation holds out whole places, and so asks what
            holds away from the fitted ones.
        statistic: The error that others tell, `mean` or `rms`.
    """

    key: str
    name: str
    instrument: str
    robot: str | Path
    base: str | None
    tip: str
    model: str
    fitted: Term
    near: Term | None = None
    away: tuple[Term, ...] = ()
    by_place: bool = False
    statistic: str = "mean"

    def chain(self) -> calib_pin.Chain:
        """The nominal robot."""
        return calib_pin.load_chain(self.robot, base=self.base, tip=self.tip)

    def setup(self, rows: Observations) -> Setup:
        """What is known of the measurements."""
        if self.model == "fixed-point":
            return known_distances(rows.only)
        return Setup()


def _place(name: str, *, elsewhere: bool = False) -> Choice:
    """Measurements at one place of the sockets, or at all others."""

    def chosen(rows: Measurements) -> NDArray[np.bool_]:
        there = np.array([target.startswith(f"{name}/") for target in rows.target])
        return ~there if elsewhere else there

    return chosen


def _series(letter: str) -> Term:
    """A series of the UR10, as one that was not fitted."""
    ending = "" if letter == "A" else f"_{letter.lower()}"
    name = f"series {letter}"
    return Term(name, f"ur10_tmac{ending}", BOTH, registered=True)


def _ur10(letter: str, folder: str, others: str) -> DataSet:
    return DataSet(
        f"ur10-{letter.lower()}",
        f"UR10, series {letter}",
        "laser tracker, T-Mac",
        *("example:ur10_robot", "base_link", "tool0", "position"),
        Term("train", folder, BOTH[:1]),
        Term("held out", folder, BOTH[1:]),
        tuple(map(_series, others)),
    )


def _tracked(key: str, name: str, robot: str | Path, base: str, tip: str) -> DataSet:
    folder = f"{key}_tracker"
    return DataSet(
        *(key, name, "laser tracker", robot, base, tip, "position"),
        Term("grid", folder, BOTH[:1]),
        Term("random poses", folder, BOTH[1:]),
    )


PANDA = ("ball in sockets", "example:panda", None, "panda_link8", "fixed-point")
ONE, TWO = ("panda_1.csv",), ("panda_2.csv",)
MARKER = "motion capture, one marker"

DATA_SETS: tuple[DataSet, ...] = (
    _ur10("A", "ur10_tmac", "BCD"),
    _ur10("B", "ur10_tmac_b", "ACD"),
    _tracked("ur5", "UR5", "example:ur5_robot", "base_link", "tool0"),
    _tracked("wam", "Barrett WAM", WAM, "base", "tool_plate"),
    DataSet(
        *("panda-1", "Panda 1, front", *PANDA),
        Term("front", "mukca_panda", ONE, _place("front")),
        away=(
            Term("other places", "mukca_panda", ONE, _place("front", elsewhere=True)),
        ),
    ),
    DataSet(
        *("panda-2", "Panda 2", *PANDA),
        Term("all places", "mukca_panda", TWO),
        by_place=True,
    ),
    DataSet(
        *("talos", "TALOS torso, left arm", MARKER, "example:talos_reduced", None),
        *("gripper_left_base_link", "position"),
        Term("all", "talos_left_arm", ("measurements.csv",)),
        statistic="rms",
    ),
    DataSet(
        *("tiago", "TIAGo torso, arm", MARKER, "example:tiago_no_hand", None),
        *("wrist_ft_tool_link", "position"),
        Term("first day", "tiago", BOTH[:1]),
        away=(Term("another day", "tiago", BOTH[1:]),),
        statistic="rms",
    ),
)
