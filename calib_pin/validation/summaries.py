"""The parts of a result: solver, statistics, validation, accuracy, model selection."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from calib_pin.estimation.evidence import (
    ExpectedAccuracy,
    Gain,
    Outlier,
    TipAccuracy,
    VarianceComponent,
)
from calib_pin.validation.accuracy import Accuracy


class NamedArray(np.ndarray):
    """A numpy array with names of its rows and columns; what is made of it has none.

    Attributes:
        rows: Names of the rows.
        columns: Names of the columns.

    Examples:
        >>> found = NamedArray.of(np.eye(2), ("a", "b"), ("x", "y"))
        >>> found.columns, found[1].columns, float(found[found.rows.index("b"), 1])
        (('x', 'y'), (), 1.0)
    """

    rows: tuple[str, ...]
    columns: tuple[str, ...]

    @staticmethod
    def of(values: Any, rows: Sequence[str], columns: Sequence[str]) -> NamedArray:
        """A view of an array of shape (len(rows), len(columns)) with names."""
        result = np.asarray(values, float).view(NamedArray)
        result.rows, result.columns = tuple(rows), tuple(columns)
        return result

    def __array_finalize__(self, array: object) -> None:
        """Leave the names behind: a part or a product has others."""
        self.rows, self.columns = (), ()


class MeanError(NamedTuple):
    """Mean error of one quantity of held-out measurements, in its unit."""

    name: str
    unit: str
    mean: float


class QuantityError(NamedTuple):
    """Errors of one quantity of held-out measurements, in its unit."""

    name: str
    unit: str
    mean: float
    rms: float


@dataclass(frozen=True)
class HeldOutErrors:
    """Errors of a candidate on measurements that were held out.

    Attributes:
        errors: Those of every quantity.
        score: Their mean, as that of a candidate.
        deviation: Standard error of the score.
    """

    errors: tuple[QuantityError, ...] = field(metadata={"by": "name"})
    score: float
    deviation: float


@dataclass(frozen=True)
class Candidate:
    """A candidate of the model selection, judged by cross-validation.

    Attributes:
        name: Name of the effect that it adds.
        parameters: Names of its parameterizations.
        learned: Its residual model, None for none.
        rank: Practical rank of its fit; 0 where it could not be tried.
        errors: Mean error on held-out measurements of every quantity.
        score: Mean error on held-out measurements, root mean square of the components
            in standard deviations; NaN where it could not be tried.
        deviation: Standard error of the score.
        helps: Whether it lowers the errors of the candidates that it extends by more
            than the standard error of the difference, and does not raise them where
            the model is used.
        reason: Why it could not be tried; empty where it was.
        away: Its errors away from the fitted configurations, in regions of joint space
            that were held out whole (`splits.regions`); None where measurements do
            not suffice for that.
    """

    name: str
    parameters: tuple[str, ...]
    learned: str | None
    rank: int = 0
    errors: tuple[MeanError, ...] = field(default=(), metadata={"by": "name"})
    score: float = float("nan")
    deviation: float = float("nan")
    helps: bool = False
    reason: str = ""
    away: HeldOutErrors | None = None


@dataclass(frozen=True)
class ModelSelection:
    """The model selection.

    Attributes:
        selected: Name of the candidate that is kept.
        use: Where it must hold: `near` the fitted configurations, `away` from them, or
            `both`.
        near: Least and largest fitted position of every joint, by name [rad, m].
        candidates: All of them, simplest first.

    Raises:
        ValueError: If no candidate has the name.
    """

    selected: str = field(metadata={"key": "chosen"})
    use: str
    near: Mapping[str, tuple[float, float]]
    candidates: tuple[Candidate, ...] = field(metadata={"key": "rungs"})

    def __post_init__(self) -> None:
        """Refuse a selection of none of the candidates."""
        _ = self.chosen

    @property
    def chosen(self) -> int:
        """Position of the candidate that is kept."""
        return [candidate.name for candidate in self.candidates].index(self.selected)


@dataclass(frozen=True)
class SolverSummary:
    """How the solver ended.

    Attributes:
        name: Name of the solver.
        evaluator: Evaluator of the residuals, see `solve.Solution`.
        status: One of `solvers.Status`, in words.
        iterations: Steps of the solver.
        evaluations: Evaluations of the cost; an evolution counts its members.
        history: Best cost of every generation, if it searched by evolution: half the
            sum of squared whitened residuals of the measurements that the search
            looks at, a sample with `hybrid` and thousands of measurements.
        at_bounds: Names of the parameters that stand at a bound.
        seed: Seed of configurations and splits.
    """

    name: str
    evaluator: str
    status: str
    iterations: int
    evaluations: int
    history: tuple[float, ...]
    at_bounds: tuple[str, ...]
    seed: int


@dataclass(frozen=True)
class Statistics:
    """The statistics of the residuals.

    Attributes:
        chi2: Sum of squared whitened residuals.
        dof: Residual components minus rank.
        sigma0: Standard deviation of unit weight.
        stated_sigma: Whether the measurements state their standard deviations.
        noise: Variance components.
        outliers: Measurements with residuals too large to be chance, worst first.
        displaced: How far the tool would be off from here, root mean square over the
            workspace, with the rejected measurements fitted like the rest [m]; None
            where none was rejected.
        gains: Paired tests on held-out configurations, the first of all quantities.
    """

    chi2: float
    dof: int
    sigma0: float
    stated_sigma: bool
    noise: tuple[VarianceComponent, ...] = ()
    outliers: tuple[Outlier, ...] = ()
    displaced: float | None = None
    gains: tuple[Gain, ...] = ()


@dataclass(frozen=True)
class Validation:
    """How the fit was checked on held-out measurements.

    Attributes:
        method: `set`, `file`, `holdout`, `5-fold by stretch`, ..., or `none`.
        count: Number of validation measurements.
        located: Names of references and stations (`station day2`) that only validation
            measurements name, and that were estimated from these.
        skipped: Why folds of a cross-validation were skipped: a fit without them
            says nothing of the robot.
    """

    method: str
    count: int
    located: tuple[str, ...] = field(default=(), metadata={"key": "placed"})
    skipped: tuple[str, ...] = ()


@dataclass(frozen=True)
class ToolAccuracy:
    """The expected errors of the tool.

    Attributes:
        tip: The predicted tool-point uncertainty over the workspace; None for a fit
            without redundancy.
        measured: The accuracy to expect where it was measured.
        workspace: The accuracy to expect over the workspace.
    """

    tip: TipAccuracy | None = None
    measured: ExpectedAccuracy | None = None
    workspace: ExpectedAccuracy | None = None


@dataclass(frozen=True)
class Provenance:
    """How a result came about.

    Attributes:
        command: The command line.
        created: Time of writing, ISO 8601; empty where it is unknown.
        seconds: Time the solver took.
        versions: Version of each package by name.
        file: The `calibration.json` that a result was read from.
        hashes: SHA-256 of the measurement files; of a pipe there is none.
    """

    command: tuple[str, ...] = ()
    created: str = ""
    seconds: float = math.nan
    versions: Mapping[str, str] = field(default_factory=dict)
    file: str = ""
    hashes: tuple[str, ...] = ()


@dataclass(frozen=True)
class DriftSize:
    """How far errors of a robot drift from one calibration to the next.

    Attributes:
        name: The errors: `geometry` for each of them, `joint offsets`.
        size: Standard deviation of one, of an angle as of a length [rad, m].
        worth: Number of errors that have told it, or that it was given the weight of;
            infinite where the user states it.
    """

    name: str
    size: float
    worth: float


@dataclass(frozen=True)
class NoiseSize:
    """The noise of a quantity, as several calibrations have shown it.

    Attributes:
        quantity: Name of the quantity.
        sigma: Standard deviation of a component [unit of the quantity].
        worth: Number of redundant values that have told it.
    """

    quantity: str
    sigma: float
    worth: float


@dataclass(frozen=True)
class Jump:
    """A sudden change since the older calibration.

    Attributes:
        name: The joint, station or tool; empty for the whole robot or the only one.
        kind: `offset` of the joint, `placement` for all of its errors, `robot`, or the
            frame, `base` or `tool`.
        unit: Unit of the offset, rad or m; of others m.
        change: The offset, or how far the origin of the joint or frame has moved.
        sigma: Standard deviation of the offset; NaN for others.
        turn: How far the joint has turned beside [rad]; zero for an offset.
        instead: Changes that may have come about instead, which nothing separates.
        beside: Joints whose offset may have changed as well: nothing would show.
    """

    name: str
    kind: str
    unit: str
    change: float
    sigma: float
    turn: float = 0.0
    instead: tuple[str, ...] = ()
    beside: tuple[str, ...] = ()


@dataclass(frozen=True)
class RecalibrationStep:
    """A calibration that began with an older one.

    Attributes:
        start: File of the older one; empty for one in memory.
        created: When that was made, ISO 8601; empty where nobody knows.
        measurements: Number of new measurements.
        chi2: Chi-square of the differences from what the older one predicted, with the
            drift that was expected.
        dof: Its degrees of freedom.
        noise: The noise of every quantity, as far as it was known before.
        drifts: How far the robot drifts, as far as is known now.
        jumps: Sudden changes, the surest first.
        still: Logarithm of the evidence, by all such calibrations, that it does not
            drift; where it is positive no drift is expected.
    """

    start: str
    created: str
    measurements: int
    chi2: float
    dof: int
    noise: tuple[NoiseSize, ...]
    drifts: tuple[DriftSize, ...]
    jumps: tuple[Jump, ...]
    still: float = 0.0


@dataclass(frozen=True)
class Recalibration:
    """How a calibration went on from an older one.

    Attributes:
        errors: Name, unit and accuracy of every quantity of the new measurements by the
            older calibration, base, tool and instrument registered.
        steps: All such calibrations since the first one, the last is this one.
    """

    errors: tuple[tuple[str, str, Accuracy], ...]
    steps: tuple[RecalibrationStep, ...]

    @property
    def last(self) -> RecalibrationStep:
        """This calibration."""
        return self.steps[-1]
