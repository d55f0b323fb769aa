"""The public repositories of measurements, each into measurement files.

A converter takes a repository as `git clone` leaves it. What a repository lacks is
left out: its data sets are told as missing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from benchmarks.accuracy.public_files import read_columns, write_rows
from calib_pin.errors import InputError
from calib_pin.kinematics.spatial import Floats

UR = tuple(
    f"{name}_joint"
    for name in (
        *("shoulder_pan", "shoulder_lift", "elbow"),
        *("wrist_1", "wrist_2", "wrist_3"),
    )
)
TALOS = (
    *("torso_1_joint", "torso_2_joint"),
    *(f"arm_left_{k}_joint" for k in range(1, 8)),
)
TIAGO = ("torso_lift_joint", *(f"arm_{k}_joint" for k in range(1, 8)))
PANDA = tuple(f"panda_joint{k}" for k in range(1, 8))
WAM = tuple(f"joint_{k}" for k in range(1, 8))

FITTED, UNSEEN = 500, 2000
"""Measurements of a series of the UR10 that are fitted, and the most that are not."""

SERIES = {
    "ur10_tmac": "Series_A/measurements_grid.csv",
    "ur10_tmac_b": "Series_B/measurements_joint_configurations.csv",
    "ur10_tmac_c": "Series_C/measurements_random_poses.csv",
    "ur10_tmac_d": "Series_D/measurements_iso_cubes.csv",
}
"""Series of the UR10 by the folder of their measurement files."""


def ipa_robot_accuracy(clone: Path, into: Path) -> None:
    """UR10 with a laser tracker and a T-Mac, four series: positions of the T-Mac.

    Semicolons, decimal commas; angles in radians, lengths in millimeters. Of each
    series 500 measurements drawn at random are fitted.
    """
    measured = [f"measurement_{axis}" for axis in "xyz"]
    for folder, name in SERIES.items():
        if not (file := clone / name).exists():
            continue
        rows = read_columns(file, (*UR, *measured), separator=";", decimal=",")
        order = np.random.default_rng(0).permutation(len(rows))
        cut = {"train": order[:FITTED], "validate": order[FITTED : FITTED + UNSEEN]}
        headers = (*UR, *(f"{axis} [mm]" for axis in "xyz"))
        for part, chosen in cut.items():
            if len(chosen):
                columns = dict(zip(headers, rows[np.sort(chosen)].T, strict=True))
                write_rows(into / folder / f"{part}.csv", columns)


def serial_robots_datasets(clone: Path, into: Path) -> None:
    """UR5 and Barrett WAM with a laser tracker: a grid, and configurations at random.

    Commas, degrees, millimeters. The position is the target and the difference that
    was measured; its sign is not documented. As here, the arm of the WAM hangs below
    its targets.
    """
    files = {
        "ur5_tracker": ("3D_UR5_uncalibrated_{}_cleaned.csv", UR),
        "wam_tracker": ("WAM/3D_WAM_uncalibrated_{}_cleaned.csv", WAM),
    }
    for folder, (pattern, joints) in files.items():
        for part, word in {"train": "grid", "validate": "random"}.items():
            if not (file := clone / pattern.format(word)).exists():
                continue
            theirs = [f"joint_{k}" for k in range(1, len(joints) + 1)]
            names = [
                *theirs,
                *(f"{axis}_{of}" for of in ("t", "dif") for axis in "xyz"),
            ]
            rows = read_columns(file, names)
            count = len(joints)
            columns = dict(zip((f"{j} [deg]" for j in joints), rows.T, strict=False))
            for k, axis in enumerate("xyz"):
                columns[f"{axis} [mm]"] = rows[:, count + k] + rows[:, count + 3 + k]
            write_rows(into / folder / f"{part}.csv", columns)


def kinematics_calibration(clone: Path, into: Path) -> None:
    """Franka Pandas with a ball in one of two sockets, at several places.

    A folder for every place, a file for every socket, without header: seven joint
    angles in radians.
    """
    for robot in ("panda_1", "panda_2"):
        found: list[Floats] = []
        targets: list[str] = []
        for file in sorted((clone / "data" / robot).glob("*/hole_[01].csv")):
            rows = read_columns(file, PANDA, header=False)
            found.append(rows)
            targets += [f"{file.parent.name}/{file.stem[-1]}"] * len(rows)
        if found:
            columns = dict(zip(PANDA, np.concatenate(found).T, strict=True))
            write_rows(into / "mukca_panda" / f"{robot}.csv", columns, targets)


def figaroh_examples(clone: Path, into: Path) -> None:
    """TALOS and TIAGo with motion capture: the first marker, in meters and radians."""
    talos = clone / "examples/talos/data/talos_left_arm_02_10_contact.csv"
    mocap = clone / "examples/tiago/data/calibration/mocap"
    days = {"train": "2021-11-30", "validate": "2021-11-26"}
    files = {"talos_left_arm/measurements.csv": (talos, TALOS)} | {
        f"tiago/{part}.csv": (mocap / f"qualisys_{day}_static_postures.csv", TIAGO)
        for part, day in days.items()
    }
    for name, (file, joints) in files.items():
        if file.exists():
            rows = read_columns(file, (*joints, "x1", "y1", "z1"))
            headers = (*joints, *"xyz")
            write_rows(into / name, dict(zip(headers, rows.T, strict=True)))


CONVERTERS: Mapping[str, Callable[[Path, Path], None]] = {
    "ipa-robot-accuracy": ipa_robot_accuracy,
    "serial_robots_datasets": serial_robots_datasets,
    "kinematics_calibration": kinematics_calibration,
    "figaroh-examples": figaroh_examples,
}
"""Converters by the folder of a repository."""


def converted(data: Path, into: Path) -> list[str]:
    """Convert every repository in a folder.

    Returns:
        What is wrong with those that could not be read, one line each.
    """
    faults = []
    for name, convert in CONVERTERS.items():
        if (data / name).is_dir():
            try:
                convert(data / name, into)
            except InputError as error:
                faults.append(str(error))
    return faults
