"""Facts that decide how far a calibration can be trusted, as plain data.

The modules that find these facts stand on their own; the verdict, the report and the
files read them from here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np

from calib_pin.kinematics.spatial import Floats

TRUSTED = ("good", "no-gain")
"""Verdicts on a result that may be used: as it is, or to leave the robot as it is."""

Severity = Literal["info", "warning", "error"]

ADDING = "calib-pin plan ROBOT --count 10 --add --to FILE"
"""The command that proposes further measurements, for advice."""


@dataclass(frozen=True)
class Finding:
    """A defect of the data or the result, with the numbers that show it.

    Attributes:
        code: Its identifier for programs, such as `known-distance`.
        severity: `error` takes the trust; `warning` and `info` do not.
        message: One sentence with numbers.
        evidence: The numbers by name, SI units.
        remedy: Advice on how to correct it; empty if there is none.
        setup: Lines of a setup file that correct it, as plain data.
        figure: Name of a figure that shows it; empty if none does.
    """

    code: str
    severity: Severity
    message: str
    evidence: Mapping[str, float | str] = field(default_factory=dict)
    remedy: str = ""
    setup: Mapping[str, Any] = field(default_factory=dict)
    figure: str = ""


@dataclass(frozen=True)
class Outlier:
    """A measurement whose residual is too large to be chance.

    Attributes:
        place: Where it stands, `file:line`.
        row: Its position among the training rows.
        size: Size of its residual in standard deviations.
        weight: Its weight after robust estimation, 0 to 1; 0 is rejected.
        cause: What is wrong of it, `exchanged with` another one; empty if unknown.
    """

    place: str
    row: int
    size: float
    weight: float = 1.0
    cause: str = ""


@dataclass(frozen=True)
class VarianceComponent:
    """The noise of one quantity of one instrument, as the measurements show it.

    Attributes:
        quantity: Name of the quantity.
        unit: Its unit.
        given: Standard deviation of a component that the rows state, or that is
            assumed, root mean square over the rows [unit].
        stated: Whether the rows or the setup state it.
        factor: Estimated by given standard deviation (unit weight); 1 where the given
            one was not contradicted and is used.
        estimate: Estimated standard deviation of a component [unit]; NaN where there
            is no redundancy.
        interval: Its 95 % confidence interval [unit].
        redundancy: Share of the measured values that is left over to estimate it.
        values: Number of measured values.
        contradicted: Whether the test at 5 % rejects the given one; of few values less
            readily as too large.
        pure: Standard deviation among repetitions of a configuration [unit]; None
            where too few are repeated.
        unmodeled: Unmodeled error, standard deviation of a component [unit];
            None where nothing tells it from noise.
        lack_of_fit: Probability that noise alone leaves more than this between
            configurations; None without repetitions.
        pure_test: Probability that chance alone sets the pure error as far apart from
            the given standard deviation; None without repetitions.
    """

    quantity: str
    unit: str
    given: float
    stated: bool
    factor: float
    estimate: float
    interval: tuple[float, float]
    redundancy: float
    values: float
    contradicted: bool
    pure: float | None = None
    unmodeled: float | None = None
    lack_of_fit: float | None = None
    pure_test: float | None = None

    @property
    def as_stated(self) -> bool:
        """Whether it is stated, and the measurements do not contradict that."""
        return self.stated and not self.contradicted


@dataclass(frozen=True)
class Gain:
    """A paired test on held-out configurations: nominal against calibrated robot.

    Attributes:
        method: `set`, `file`, `holdout`, `5-fold`, ..., or `press`.
        quantity: Name of the quantity, or `all` for all of them, in the standard
            deviations that the fit predicts.
        configurations: Number of independent held-out configurations (clusters).
        mean: Mean of nominal minus calibrated error size [unit, or deviations].
        deviation: Its standard error.
        better: Probability of so large a mean by chance if there were no gain.
        worse: Probability of so small a mean by chance if there were no loss.
        ratio: Found by predicted error of the calibrated robot, root mean square.
    """

    method: str
    quantity: str
    configurations: int
    mean: float
    deviation: float
    better: float
    worse: float
    ratio: float


class PoseErrors(NamedTuple):
    """Sizes of the errors of a pose: of position [m] and of orientation [rad]."""

    position: float
    orientation: float


@dataclass(frozen=True)
class ExpectedAccuracy:
    """How far the tool is expected to be off, over a set of configurations.

    Of position [m] and of orientation [rad], root mean square over configurations and
    over what the measurements leave open, displacements of base and tool left aside.

    Attributes:
        nominal: Of the nominal robot.
        calibrated: Of the corrected robot.
        bound: Upper bound of `calibrated` with 95 % confidence.
        unmodeled: The part of both that no parameter describes.
        better: Probability that the corrected robot is better over all of them.
        share: Part of the configurations at which it is better with a probability of
            95 %.
    """

    nominal: PoseErrors
    calibrated: PoseErrors
    bound: PoseErrors
    unmodeled: PoseErrors
    better: float
    share: float


@dataclass(frozen=True)
class TipAccuracy:
    """The error of the tip that the noise of the measurements leaves.

    It is the standard deviation of the tool in the measurement frame by the covariance
    of what was estimated; what stayed at nominal is not in it, nor what no parameter
    of the model describes.

    Attributes:
        q: Random configurations within the joint limits, shape (N, n) [rad, m].
        points: Tool positions in the base link, shape (N, 3) [m].
        position: Standard deviation of these, the root of the sum over the axes,
            shape (N,) [m].
        orientation: That of the rotation vectors, shape (N,) [rad].
        rms: Root-mean-square of both over the workspace.
        of_robot: The same with what a displacement of base and tool can absorb taken
            away.

    Raises:
        ValueError: If the arrays are not of one length.
    """

    q: Floats = field(metadata={"key": "samples.configurations"})
    points: Floats = field(metadata={"key": "samples.points"})
    position: Floats = field(metadata={"key": "samples.position"})
    orientation: Floats = field(metadata={"key": "samples.orientation"})
    rms: PoseErrors = field(metadata={"key": ""})
    of_robot: PoseErrors = field(metadata={"key": "robot"})

    def __post_init__(self) -> None:
        """Refuse arrays that do not belong together."""
        samples = self.points, self.position, self.orientation
        if any(len(values) != len(self.q) for values in samples):
            raise ValueError("the lists of 'samples' are not of one length")


def rms(sizes: Floats) -> float:
    """The root-mean-square of sizes, shape (N,)."""
    return float(np.sqrt(np.mean(sizes**2)))
