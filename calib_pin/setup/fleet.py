"""Statements about many robots: the jobs of a fleet, and studies by simulation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

from calib_pin.setup.constraints import Checked, Distinct, Registered, Section
from calib_pin.setup.printing import Date, Entry
from calib_pin.setup.values import Flag, Number, Positive, Text, number

MANY = 10_000_000
"""Most robots, configurations or repetitions that can be meant."""

SEPARATORS = '/\\:*?"<>|'
"""Letters that no folder of a job may have in its name, on any system."""


def _folder(value: object) -> str:
    name = value.strip() if isinstance(value, str) else ""
    usable = name.isprintable() and not set(SEPARATORS) & set(name)
    if not name or not usable or name.startswith(".") or len(name) > 100:
        raise ValueError(
            f"a name for a folder, of at most 100 letters, without {SEPARATORS} and no "
            "point in front"
        )
    return name


def _whole(least: int) -> Checked:
    def check(value: object) -> int:
        plain = number(value)
        if not (least <= plain <= MANY and plain.is_integer()):
            raise ValueError(f"a whole number from {least} to {MANY}")
        return int(plain)

    return Checked(check, {"type": "integer", "minimum": least, "maximum": MANY})


@dataclass(frozen=True)
class FitOfJob(Section):
    """The options of a calibration of a fleet.

    Attributes:
        start: An older calibration to go on from, a folder or its `calibration.json`;
            `previous` for the one before of the same serial number, in the table or in
            the folder of the results.
        process_noise: Drift of each error since then, standard deviation [m, rad].
        validation: File of validation measurements.
        holdout: Part of the measurements that is held out.
        base: First link of the chain.
        tip: Last link of the chain.
        model: Measurement model.
        parameters: Parameterizations, with commas between them.
        solver: Solver of the fit.
        loss: Loss function.
        learned: Residual model.
        model_ladder: Whether to select the model.
        use: Where the selected model must hold: near, away or both.
        seed: Random seed.
    """

    start: Text | None = None
    process_noise: Annotated[float, Positive("m, rad")] | None = None
    validation: Text | None = None
    holdout: (
        Annotated[float, Number(above=0.0, below=1.0, words="a number between 0 and 1")]
        | None
    ) = None
    base: Text | None = None
    tip: Text | None = None
    model: Text | None = None
    parameters: Text | None = None
    solver: Text | None = None
    loss: Text | None = None
    learned: Text | None = None
    model_ladder: Flag = False
    use: Text | None = None
    seed: Annotated[int, _whole(0)] = 0


@dataclass(frozen=True, kw_only=True)
class JobSetup(FitOfJob):
    """A calibration of a fleet. Its files are named from the folder of the table.

    Attributes:
        robot: URDF or xacro file, bundled robot, or example:NAME.
        measurements: Measurement files; a name may hold * for any letters. In a CSV
            table semicolons separate them.
        name: Name of its folder; None for the serial number with the date.
        serial_number: Serial number of the robot.
        date: Day of the measurements; of one serial number, the drift is told from
            the day before, or from the line before.
        previous: An earlier calibration of this robot, from which drift is told; None
            for the one before in the table.
        setup: Setup file.
        package_dir: Folders of the ROS packages that the robot names; in a CSV table
            semicolons separate them.
        station_per_file: Whether every file has a station of its own.
    """

    robot: Text
    measurements: Annotated[tuple[Text, ...], Distinct()]
    name: Annotated[str, Checked(_folder, {"type": "string"})] | None = None
    serial_number: Entry = ""
    date: Date | None = None
    previous: Text | None = None
    setup: Text | None = None
    package_dir: Annotated[tuple[Text, ...], Distinct()] = ()
    station_per_file: Flag = False


@dataclass(frozen=True)
class MonteCarloSetup(Section):
    """A study of simulated robots, whose instruments stand where the setup says.

    Attributes:
        robot: URDF or xacro file, bundled robot, or example:NAME.
        robots: Number of simulated robots.
        configurations: Numbers of configurations that are measured of each.
        plan: CSV file with configurations, of which the first ones are measured; None
            for random ones.
        parameters: Parameterizations of the errors that the robots have; empty for
            those that are fitted.
        errors: Glob to the standard deviation of true errors [SI]; where none applies
            it is the expected size, 1 mm and 1 mrad.
        repeats: Readings per configuration.
    """

    robot: Text | None = None
    robots: Annotated[int, _whole(1)] = 200
    configurations: Annotated[tuple[Annotated[int, _whole(1)], ...], Distinct()] = (
        12,
        20,
        30,
        50,
    )
    plan: Text | None = None
    parameters: tuple[Annotated[str, Registered("parameters")], ...] = ()
    errors: Mapping[str, Annotated[float, Positive("SI")]] = field(default_factory=dict)
    repeats: Annotated[int, _whole(1)] = 1
