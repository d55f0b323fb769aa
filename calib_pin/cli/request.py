"""A calibration as it is asked for: on a command line, and by a job of a fleet."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar

from calib_pin.errors import OptionError
from calib_pin.units import as_number

_Number = TypeVar("_Number", int, float)


def number(
    kind: type[_Number],
    option: str,
    allowed: str,
    least: float = -math.inf,
    most: float = math.inf,
) -> Callable[[str], _Number]:
    """A parser of a number whose errors name the option, the value and the range."""

    def parse(text: str | _Number) -> _Number:
        try:
            value = None if as_number(str(text)) is None else kind(text)
        except ValueError:
            value = None
        # Not-a-number lies in no interval.
        inside = value is not None and least <= value <= most
        if value is None or not inside or value in (-math.inf, math.inf):
            raise OptionError(f"{option} cannot be {text!r}", allowed=allowed)
        return value

    return parse


class Told(NamedTuple):
    """How a user states a field.

    Attributes:
        word: Stands for its value in a help text.
        heading: Heading of the option there.
        parse: Makes the value of a text, where that is more than its type.
    """

    word: str = ""
    heading: str = "Fit"
    parse: Callable[[str], Any] | None = None


PART = number(float, "--holdout", "a number between 0 and 1", 0, 1)
NOISE = number(float, "--process-noise", "1e-9 to 0.01 [m, rad]", 1e-9, 1e-2)
SEED = number(int, "--seed", "0, 1, 2, ...", 0)


@dataclass(frozen=True)
class Request:
    """A calibration as it is asked for.

    A field is an argument or option of `calibrate`, whose help is the text here, and a
    key of a job of `fleet`.

    Attributes:
        robot: URDF or xacro file (with its arguments, name:=value), name of a bundled
            robot, or example:NAME if example-robot-data is installed.
        measurements: CSV or Parquet files with one row per measurement.
        package_dir: Folder of the ROS packages that the robot names; may be repeated.
        setup: Setup file (YAML); options override it.
        model: Measurement model, or several joined by +; by default inferred from the
            columns. 'list' prints all.
        base: First link of the chain; by default the root.
        tip: Last link of the chain; by default the only leaf.
        parameters: placement (default), link-transform, dh, dh-full, joint-offset{};
            beyond geometry transmission, compliance, hysteresis, motor-ripple,
            cross-compliance, thermal, warm-up{}; of the instrument instrument-drift;
            several may be combined.
        station_per_file: Every file is from another station of the instrument.
        solver: gauss-newton (default), two-step (alternating: frames and instrument,
            then the robot), de (differential evolution), or hybrid: de, then
            gauss-newton, for errors of centimeters and degrees.
        loss: auto (default) sets outliers aside where there are any; gnc always
            searches for them; huber gives them less weight; squared weights all
            measurements equally.
        learned: Learn the errors that no parameter describes: network or
            gaussian-process; with --model-ladder the only one that is tried.
        model_ladder: Select the model: try joint offsets, geometry, transmission,
            compliance and learned corrections on held-out measurements, and take the
            simplest of the best.
        use: Select the model that holds near the measured configurations, away from
            them, or both (default); implies --model-ladder.
        validation: Check the fit on the measurements of this file.
        holdout: Hold out this part of the measurements, such as 0.2, for the check.
        start: Go on from an older calibration of the robot, a folder or its
            calibration.json: few measurements are enough, and sudden changes of the
            robot are told.
        process_noise: With --start: how far each error of the geometry may have
            drifted since then, standard deviation in m and rad; by default as the
            measurements show.
        seed: Random seed.
    """

    robot: Annotated[str, Told("ROBOT")]
    measurements: Annotated[list[Path], Told("MEASUREMENTS...")]
    package_dir: Annotated[list[Path] | None, Told("DIR", "Robot")] = None
    setup: Annotated[Path | None, Told("FILE", "Robot")] = None
    model: Annotated[str | None, Told("NAME", "Robot")] = None
    base: Annotated[str | None, Told("LINK", "Robot")] = None
    tip: Annotated[str | None, Told("LINK", "Robot")] = None
    parameters: Annotated[str | None, Told("P,...", "Robot")] = None
    station_per_file: Annotated[bool, Told("", "Robot")] = False
    solver: Annotated[str | None, Told("NAME")] = None
    loss: Annotated[str | None, Told("NAME")] = None
    learned: Annotated[str | None, Told("NAME")] = None
    model_ladder: Annotated[bool, Told()] = False
    use: Annotated[str | None, Told("WHERE")] = None
    validation: Annotated[Path | None, Told("FILE")] = None
    holdout: Annotated[float | None, Told("PART", parse=PART)] = None
    start: Annotated[Path | None, Told("CALIBRATION")] = None
    process_noise: Annotated[float | None, Told("S", parse=NOISE)] = None
    seed: Annotated[int, Told("N", parse=SEED)] = 0

    def words(self, output: Path) -> tuple[str, ...]:
        """The command line of `calibrate` that asks for the same."""
        words = ["calibrate", self.robot, *map(str, self.measurements)]
        for asked in fields(Request)[2:]:
            value = getattr(self, asked.name)
            option = f"--{asked.name.replace('_', '-')}"
            if value is True:
                words.append(option)
            elif value != asked.default:
                for one in value if isinstance(value, list) else [value]:
                    words += [option, str(one)]
        return ("calib-pin", *words, "-o", str(output))
