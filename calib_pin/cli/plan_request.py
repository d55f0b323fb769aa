"""A plan as it is asked for on a command line."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import calib_pin.cli.options as options
from calib_pin.cli.collisions import Untouched
from calib_pin.cli.request import SEED, Told, number
from calib_pin.cli.results import FigureFormat, Figures
from calib_pin.cli.workforce import ClusterAddress, WorkerCount
from calib_pin.errors import OptionError, require_known

COUNT = number(int, "--count", "1 to 1000", 1, 1000)
CYCLES = number(int, "--cycles", "3 to 1000", 3, 1000)
CANDIDATES = number(int, "--candidates", "1 to 100000", 1, 1e5)
DISTANCE = number(float, "--distance", "0 to 10", 0.0, 10.0)


def added(text: str) -> int:
    """The value of `--add`; zero where that leaves the number to `--count`."""
    return number(int, "--add", "1 to 1000", 1, 1000)(text) if text else 0


@dataclass(frozen=True, kw_only=True)
class Search:
    """The configurations of a plan, and how they are looked for.

    Attributes:
        count: Number of configurations.
        add: Number of configurations to add to the measurements of --to.
        to: Measurements that exist already; may be repeated.
        criterion: prediction (default; the predicted tool-point uncertainty),
            condition, or O1 to O5.
        method: auto (default; exchange, then gradient), exchange, greedy, pso, ga or
            gradient.
        candidates: Quasi-random configurations to choose from.
        seed: Random seed.
        distance: Least distance between configurations, as the largest movement of a
            joint [rad, m].
    """

    count: Annotated[int | None, Told("N", "Plan", COUNT)] = None
    add: Annotated[int | None, Told("[N]", "Plan", added)] = None
    to: Annotated[list[Path] | None, Told("CSV", "Plan")] = None
    criterion: Annotated[str, Told("NAME", "Plan")] = "prediction"
    method: Annotated[str, Told("NAME", "Plan")] = "auto"
    candidates: Annotated[int, Told("N", "Plan", CANDIDATES)] = 1000
    seed: Annotated[int, Told("N", "Plan", SEED)] = 0
    distance: Annotated[float, Told("D", "Constraints", DISTANCE)] = 0.0

    def wanted(self) -> int:
        """Number of configurations: `--count N`, or `--add N --to CSV`."""
        if self.add is not None and not self.to:
            raise OptionError("--add needs the measurements to add to: --to CSV")
        if self.to and self.add is None:
            reason = "--to names measurements; say how many to add with --add N"
            raise OptionError(reason)
        if self.add and self.count not in (None, self.add):
            reason = f"--add {self.add} and --count {self.count} contradict each other"
            raise OptionError(reason)
        if not (self.add or self.count):
            raise OptionError("say how many configurations to plan with --count N")
        return self.add or self.count or 0


@dataclass(frozen=True, kw_only=True)
class PlanRequest(Search, Untouched, options.OfRobot):
    """A plan as it is asked for.

    Attributes:
        output: File of configurations to write.
        start: Plan for a calibration that goes on from this older one.
        accept: Plan an acceptance test instead: five poses of a cube, and its schedule.
        cycles: Visits of each pose of an acceptance test; default 30.
        tests: Configurations where the robot is to be accurate; by default everywhere.
        limits: Narrower joint limits, such as 'joint_*=-2:2' or
            'elbow=-120:120 [deg]'; may be repeated.
        ignore_collisions: Check no collisions.
        motion: File of the whole motion to write: the configurations, with via
            configurations where the straight way collides.
    """

    output: Annotated[Path, Told("CSV", "Output")]
    chain: options.ChainName = None
    parameters: options.Parameters = None
    start: Annotated[Path | None, Told("CALIBRATION", "Plan")] = None
    accept: Annotated[bool, Told("", "Plan")] = False
    cycles: Annotated[int | None, Told("N", "Plan", CYCLES)] = None
    tests: Annotated[Path | None, Told("CSV", "Plan")] = None
    workers: WorkerCount = None
    cluster: ClusterAddress = None
    limits: Annotated[list[str] | None, Told("JOINT=A:B", "Constraints")] = None
    ignore_collisions: Annotated[bool, Told("", "Constraints")] = False
    motion: Annotated[Path | None, Told("CSV", "Output")] = None
    figures: Figures = None
    figure_format: FigureFormat = "png"
    degrees: options.Degrees = False

    def check(self) -> None:
        """Refuse options that exclude one another, and names that do not exist."""
        from calib_pin.planning.plan import CRITERION_NAMES
        from calib_pin.planning.search import METHODS

        require_known("criterion", self.criterion, CRITERION_NAMES)
        require_known("method", self.method, METHODS)
        if self.accept:
            for name in ALONE:
                if getattr(self, name) != getattr(PlanRequest, name):
                    option = name.replace("_", "-")
                    reason = f"--accept plans an acceptance test, without --{option}"
                    raise OptionError(reason)
        elif self.cycles is not None:
            raise OptionError("--cycles belongs to --accept")
        else:
            self.wanted()
        if self.ignore_collisions and self.motion is not None:
            raise OptionError("--ignore-collisions contradicts --motion")
        if self.ignore_collisions:
            self.refuse_unused("--ignore-collisions contradicts")


ALONE = (
    *("model", "count", "add", "to", "criterion", "method", "candidates", "tests"),
    *("seed", "distance", "motion", "parameters", "figures", "figure_format", "json"),
)
"""Options of plans that an acceptance test has no use for."""
