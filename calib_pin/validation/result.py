"""The result of a calibration, as plain data for reports and files."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import Annotated, Any, NamedTuple

import numpy as np
import pinocchio as pin

from calib_pin import __version__
from calib_pin.errors import OptionError
from calib_pin.estimation.evidence import (
    ExpectedAccuracy,
    Finding,
    Gain,
    Outlier,
    TipAccuracy,
    VarianceComponent,
)
from calib_pin.estimation.problem import side_by_side
from calib_pin.estimation.terms import FRAME, Term
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import Quantity
from calib_pin.observations import BlockKey, Indices, Measurements, Observations
from calib_pin.observations.labels import Labels
from calib_pin.plugins import upper
from calib_pin.setup.arguments import as_array
from calib_pin.setup.values import OneOf
from calib_pin.units import DISPLAY
from calib_pin.validation.calibrated_model import CalibratedModel


@dataclass(frozen=True)
class Accuracy:
    """Size of the errors of one quantity over measurements, in the quantity's unit.

    Attributes:
        mean: Mean size.
        rms: Root-mean-square.
        p95: 95th percentile of the sizes.
        max: Largest size.
    """

    mean: float
    rms: float
    p95: float
    max: float

    @staticmethod
    def of(sizes: Floats) -> Accuracy:
        """Accuracy of the error sizes of measurements, shape (N,)."""
        # No interpolation: where a row cannot be predicted its size is infinite.
        p95 = np.quantile(sizes, 0.95, method="inverted_cdf")
        figures = sizes.mean(), np.sqrt(np.mean(sizes**2)), p95, sizes.max()
        return Accuracy(*map(float, figures))


@dataclass(frozen=True)
class QuantityErrors:
    """Errors of one quantity before and after, on fitted and on held-out ones.

    *Before* is registration only: base, tool and instrument fitted to the training
    measurements, the robot nominal.
    """

    name: str
    unit: Annotated[str, OneOf(tuple(DISPLAY))]
    before: Accuracy = field(metadata={"key": "training.before"})
    after: Accuracy = field(metadata={"key": "training.after"})
    validation_before: Accuracy | None = field(metadata={"key": "validation.before"})
    validation_after: Accuracy | None = field(metadata={"key": "validation.after"})

    @property
    def stages(self) -> Mapping[str, tuple[Accuracy, Accuracy]]:
        """Before and after by the measurements: `fitted`, and `validation` if any."""
        errors = {"fitted": (self.before, self.after)}
        if self.validation_before and self.validation_after:
            errors["validation"] = self.validation_before, self.validation_after
        return errors

    @property
    def shown(self) -> tuple[Accuracy, Accuracy]:
        """Before and after, of held-out measurements where there are any."""
        return [*self.stages.values()][-1]


VERDICTS = ("good", "no-gain", "unchecked", "untrusted")
"""Verdicts on a calibration."""

AXES = ("x", "y", "z")
"""Names of the components of a vector."""


def columns_of(
    model: CalibratedModel,
) -> tuple[tuple[Quantity, ...], Mapping[str, int]]:
    """Error columns of a robot's measurements, and the first of each model."""
    terms = model.terms.items()
    return side_by_side({key.model: term.measurement.quantities for key, term in terms})


@dataclass(frozen=True)
class MeasurementErrors:
    """Errors of N measurements, predicted minus measured.

    Attributes:
        rows: The measurements.
        quantities: Quantities of the D error columns, those of all models side by side.
        before: With base, tool and instrument fitted and the robot nominal, shape
            (N, D); NaN for what one does not have, infinite where nothing can be
            predicted.
        after: Those of the calibrated robot, shape (N, D).
        sigma: Standard deviations, shape (N, D); NaN for what one lacks, infinite for
            what is set aside.
        points: Where the calibrated robot has its tool, in the base link of the chain,
            shape (N, 3) [m].
        leverage: Leverage in the fit, 0 to d, shape (N,); NaN where it was not fitted.
    """

    rows: Observations
    quantities: tuple[Quantity, ...]
    before: Floats
    after: Floats
    sigma: Floats
    points: Floats
    leverage: Floats

    @staticmethod
    def unknown(model: CalibratedModel, count: int) -> MeasurementErrors:
        """Errors of a number of measurements of which nothing else is known.

        Args:
            model: The calibrated robot.
            count: Number of measurements.
        """
        term, (quantities, _) = model.only, columns_of(model)
        q = np.zeros((count, len(model.chains.joints)))
        values = np.zeros((count, term.measurement.width))
        key = term.key._asdict()
        rows = Measurements(model.chains.joints, q, values=values, **key)
        nothing = np.full((count, max(quantities[-1].columns.stop, 3)), np.nan)
        errors = nothing[:, : quantities[-1].columns.stop]
        points, leverage = nothing[:, :3], nothing[:, 0]
        every = errors, errors, errors, points, leverage
        return MeasurementErrors(Observations.of(rows), quantities, *every)

    def __len__(self) -> int:
        """Number of measurements."""
        return len(self.rows)

    @property
    def components(self) -> tuple[str, ...]:
        """Names of the residual components, such as `position.x`."""
        return tuple(
            f"{quantity.name}.{axis}" if quantity.dimension > 1 else quantity.name
            for quantity in self.quantities
            for axis in AXES[: quantity.dimension]
        )

    def table(self, name: str, directions: bool = False) -> dict[str, Sequence[Any]]:
        """Cells of the columns of `measurements.csv`, SI units; NaN where none is.

        Args:
            name: The set, `train` or `validate`.
            directions: Whether directions of approach are told that no file states.
        """
        rows, held = self.rows, self.rows.conditions
        names = map(Labels.of, zip(*rows.keys, strict=True))
        columns: dict[str, Sequence[Any]] = {
            "set": [name] * len(self),
            "file": rows.files,
            "line": rows.lines.tolist(),
            "target": rows.target,
            "payload": rows.payload,
            **{
                field: labels[rows.block_of]
                for field, labels in zip(BlockKey._fields, names, strict=True)
            },
        }

        def add(form: str, names: Iterable[object], values: Floats) -> None:
            columns.update(zip(map(form.format, names), values.T, strict=True))

        width = max(block.values.shape[1] for block in rows.blocks)
        widths = len(rows.joints), width, self.sigma.shape[1]
        start, values, given = (np.full((len(self), n), np.nan) for n in widths)
        for block, part in zip(rows.blocks, rows.slices, strict=True):
            values[part, : block.values.shape[1]] = block.values
            if block.start.size:
                start[part] = block.start
            if block.sigma is not None:
                mask = ~np.isnan(self.sigma[part.start])
                given[part, mask] = block.sigma
        add("joint.{}", rows.joints, rows.q)
        if not np.isnan(start).all():
            add("start.{}", rows.joints, start)
        if held.direction.size and (directions or held.source == "columns"):
            add("direction.{}", rows.joints, held.direction.astype(float))
        for column in ("temperature", "time"):
            if len(getattr(held, column)):
                columns[column] = getattr(held, column)
        add("measured.{}", range(1, width + 1), values)
        add("{}", ("weight", "leverage"), np.array([rows.weight, self.leverage]).T)
        add("tool.{}", AXES, self.points)
        stages = {"before": self.before, "after": self.after, "sigma": self.sigma}
        if not np.isnan(given).all():
            stages["stated"] = given
        for stage, values in stages.items():
            add(f"{{}}.{stage}", self.components, values)
        return columns

    def sizes(self, quantity: Quantity) -> tuple[Floats, Floats]:
        """Sizes of the errors of a quantity before and after, shape (N,) each.

        NaN for rows that do not have it.
        """
        parts = (errors[:, quantity.columns] for errors in (self.before, self.after))
        before, after = (np.linalg.norm(part, axis=1) for part in parts)
        return before, after


REMEDY = (
    "measure it otherwise and hold it in the setup file: 'estimate: false', or "
    "'fixed: [tool.frame.z]' for one value of a stated frame"
)
"""Advice on values that measurements leave open."""


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
        """A copy of an array of shape (len(rows), len(columns)) with names."""
        result = np.array(values, float).view(NamedArray)
        result.rows, result.columns = tuple(rows), tuple(columns)
        return result

    def __array_finalize__(self, array: object) -> None:
        """Leave the names behind: a part or a product has others."""
        self.rows, self.columns = (), ()

    def __reduce__(self) -> Any:
        """Take the names along to another process, or into a file."""
        return NamedArray.of, (np.asarray(self), self.rows, self.columns)

    def __deepcopy__(self, memo: object) -> NamedArray:
        """A copy with the names, unlike that of a plain array."""
        return NamedArray.of(self, self.rows, self.columns)


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
        errors: Errors on held-out measurements of every quantity.
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
    errors: tuple[QuantityError, ...] = field(default=(), metadata={"by": "name"})
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
        gains: Paired tests on held-out configurations, the first of all quantities.
    """

    chi2: float
    dof: int
    sigma0: float
    stated_sigma: bool
    noise: tuple[VarianceComponent, ...] = ()
    outliers: tuple[Outlier, ...] = ()
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
        calib_pin: Version of this package; empty where it is unknown.
        pinocchio: Version of Pinocchio.
        numpy: Version of numpy.
        file: The `calibration.json` that a result was read from.
        hashes: SHA-256 of the measurement files; of a pipe there is none.
    """

    command: tuple[str, ...] = field(default=(), metadata={"key": "provenance.command"})
    created: str = field(default="", metadata={"key": "provenance.created"})
    seconds: float = field(default=math.nan, metadata={"key": "solver.seconds"})
    calib_pin: str = field(default="", metadata={"key": "provenance.calib_pin"})
    pinocchio: str = field(default="", metadata={"key": "provenance.pinocchio"})
    numpy: str = field(default="", metadata={"key": "provenance.numpy"})
    file: str = field(default="", metadata={"key": None})
    hashes: tuple[str, ...] = field(default=(), metadata={"key": None})

    @staticmethod
    def at(
        created: str, command: tuple[str, ...] = (), seconds: float = math.nan
    ) -> Provenance:
        """How a result comes about that is written by these versions.

        Args:
            created: When, ISO 8601.
            command: The command line; none for a program of its own.
            seconds: Time the solver took; NaN where nobody looked.
        """
        versions = __version__, pin.__version__, np.__version__
        return Provenance(command, created, seconds, *versions)


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


@dataclass(frozen=True)
class FrameSummary:
    """A station or a tool, and where the calibration puts it.

    Attributes:
        name: Its name among the parameters; `base` or `tool` for the only one.
        link: The link that a station stands before, or that a tool is mounted on.
        measurements: Number of fitted measurements.
        errors: Accuracy of these by quantity.
        noise: Their variance components.
        xyz: Of a station where the link is in its measurement frame, of a tool where it
            is in the link [m].
        rpy: The orientation that belongs to it [rad].
        sigma: Standard deviations of the position along, and of the orientation about,
            the axes of the frame that `xyz` is in, shape (6,) [m, rad]: zero for what
            is known, NaN for what measurements leave open. Empty without redundancy.
        estimated: Whether anything of it was estimated.
    """

    name: str
    link: str
    measurements: int
    errors: tuple[QuantityErrors, ...]
    noise: tuple[VarianceComponent, ...]
    xyz: tuple[float, float, float]
    rpy: tuple[float, float, float]
    sigma: tuple[float, ...]
    estimated: bool

    @property
    def unknown(self) -> tuple[str, ...]:
        """Names of what measurements leave open: x, y, z, and rx, ry, rz about them."""
        names = ("x", "y", "z", "rx", "ry", "rz")
        return tuple(names[k] for k, s in enumerate(self.sigma) if math.isnan(s))


@dataclass(frozen=True)
class ChainSummary:
    """A chain, and the errors of its measurements.

    Attributes:
        name: Its name in the measurements; empty for the only one.
        base: The link that it starts at.
        tip: The link that it ends at.
        joints: Names of its moving joints.
        measurements: Number of fitted measurements.
        errors: Accuracy of these by quantity.
        still: Those of its joints that no measurement moves; they stay at nominal.
    """

    name: str
    base: str
    tip: str
    joints: tuple[str, ...]
    measurements: int
    errors: tuple[QuantityErrors, ...]
    still: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Breakdown:
    """The findings of a calibration, part by part.

    Attributes:
        accuracies: The expected errors of the tool by the name of the chain; the first
            chain that moves is the first.
        stations: The stations.
        tools: The tools.
        chains: The chains that were measured.
        unknown: Names of parameters of frames and instruments whose values the
            measurements leave open; of a frame along its own axes.
    """

    accuracies: Mapping[str, ToolAccuracy] = field(
        default_factory=dict, metadata={"key": "predicted"}
    )
    stations: tuple[FrameSummary, ...] = ()
    tools: tuple[FrameSummary, ...] = ()
    chains: tuple[ChainSummary, ...] = ()
    unknown: tuple[str, ...] = ()

    def unknown_of(self, kind: str, name: str) -> tuple[str, ...]:
        """Unknown parts of a `station` or a `tool`, see `FrameSummary.unknown`."""
        frames = self.tools if kind == "tool" else self.stations
        return next((f.unknown for f in frames if f.name == name), ())

    @property
    def accuracy(self) -> ToolAccuracy:
        """The expected errors of the tool of the first chain that moves."""
        return next(iter(self.accuracies.values()), ToolAccuracy())


class Frame(NamedTuple):
    """A frame of a part, or something else that several parts may have.

    Attributes:
        kind: `station`, `tool`, or the section of a reference object.
        name: Name among the parameters; `base` or `tool` for the only one.
    """

    kind: str
    name: str

    @property
    def label(self) -> str:
        """Name in a sentence."""
        alone = self.name in ("base", "tool")
        return f"the {self.name}" if alone else f"the {self.kind} '{self.name}'"


def frames_of(term: Term) -> tuple[tuple[Frame, Indices], tuple[Frame, Indices]]:
    """Station and tool of a part, with the positions of their parameters, (6,)."""
    frames, count = term.frames, len(term.error.screws)
    tool = frames.tool.rpartition(".")[0]
    if not frames.offset.isIdentity():
        tool = term.key.tool
    return (
        (Frame("station", frames.station.rpartition(".")[0]), term.index[:FRAME]),
        (Frame("tool", tool), term.index[count - FRAME : count]),
    )


@dataclass(frozen=True)
class ParameterEstimate:
    """One parameter of the result.

    Attributes:
        name: Name of the parameter.
        unit: Its unit.
        value: Estimate.
        sigma: Standard deviation, for identifiable parameters only.
        status: `identifiable`, `coupled`, `weak`, `unidentifiable` or `fixed`.
        groups: Numbers of the coupled groups it stands in, from 1.
    """

    name: str
    unit: str
    value: float
    sigma: float | None
    status: str
    groups: tuple[int, ...]


class Coefficient(NamedTuple):
    """A parameter of a linear combination, and its coefficient in it."""

    parameter: str
    coefficient: float


@dataclass(frozen=True)
class CoupledGroup:
    """An identifiable linear combination of parameters, whose terms are not."""

    number: int = field(metadata={"key": "group"})
    expression: str
    unit: str
    value: float
    sigma: float | None
    terms: tuple[Coefficient, ...]


@dataclass(frozen=True)
class RobotError:
    """An error of the robot as a person names it.

    Attributes:
        kind: Such as `joint offset`, `link length`, `link offset`, `link twist`, `axis
            tilt`, `axis shift`, or the kind of a joint correction.
        of: Names of the joints, of the link for its length and twist; of several only
            the sum is known, of those with a minus sign subtracted.
        unit: Its unit.
        value: Estimate.
        sigma: Standard deviation; None where it is not known.
        status: `identifiable`; `weak` where it is held at nominal; `absorbed` where a
            frame or the instrument takes it along, so that nothing is known of it.
        within: Owner and kind of those, such as `tool.frame`.
        expression: The linear combination of parameters, without the terms that matter
            less than its standard deviation; empty where it is absorbed.
        terms: The same as terms.
    """

    kind: str
    of: tuple[str, ...]
    unit: str
    value: float
    sigma: float | None
    status: str
    within: tuple[str, ...] = ()
    expression: str = ""
    terms: tuple[Coefficient, ...] = ()


@dataclass(frozen=True)
class DistanceCheck:
    """A known distance beside what the calibration finds.

    Attributes:
        between: Names of both ends.
        value: The known distance [m].
        sigma: Its standard deviation.
        nominal: The distance that the nominal robot finds.
        found: The distance that the calibrated robot finds.
        fitted: Whether it was fitted; otherwise no fitted measurement names its ends,
            and what the robot finds there is a check.
    """

    between: tuple[str, str]
    value: float
    sigma: float
    nominal: float
    found: float
    fitted: bool


@dataclass(frozen=True)
class Identifiability:
    """Ranks and observability.

    Attributes:
        parameters: Number of free parameters.
        rank: Practical rank used by the fit; the structural one without measurements.
        structural_rank: Rank of the robot and the way it is measured.
        robot_rank: Number of independent errors of the robot in that; the rest are
            errors of base, tool and instrument.
        gap: Ratio of the last structural singular value kept to the first dropped.
        everett: Everett's count 4 R + 2 P + 6.
        condition: s_1 / s_r of the robot's directions, nuisances projected out.
        singular_values: Of the whitened, scaled Jacobian of those directions.
        structural_values: All singular values of the scaled structural Jacobian,
            descending; those from `structural_rank` on are rounding.
        observability: O1 to O5 of these singular values.
        weak: Number of structural directions that the measurements cannot tell.
        revealed: Number of directions that nominal geometry hides, estimated because
            the errors are so large that they show.
        scale_observable: Whether measurements tell how large the robot is.
    """

    parameters: int
    rank: int
    structural_rank: int
    robot_rank: int
    gap: float = field(metadata={"key": "structural_gap"})
    everett: int
    condition: float
    singular_values: tuple[float, ...]
    structural_values: tuple[float, ...] = field(
        metadata={"key": "structural_singular_values"}
    )
    observability: Mapping[str, float]
    weak: int = 0
    revealed: int = 0
    scale_observable: bool = True


class Printed:
    """A result that is shown by the first lines of its report."""

    def __repr__(self) -> str:
        """The first lines of the report."""
        return str(upper("report.text", "brief", self))


@dataclass(frozen=True, repr=False)
class Identification(Printed):
    """The identifiability of a robot.

    Attributes:
        parameters: Every parameter with its status and, after a fit, its estimate.
        groups: Coupled groups.
        identifiability: Ranks and observability.
        robot_errors: The same for people: each independent error of the robot once.
        suggestions: Suggested measurements; none before they were sought.
    """

    parameters: tuple[ParameterEstimate, ...]
    groups: tuple[CoupledGroup, ...] = field(
        metadata={"key": "identifiability.coupled"}
    )
    identifiability: Identifiability
    robot_errors: tuple[RobotError, ...] = field(
        default=(), kw_only=True, metadata={"key": "identifiability.robot_errors"}
    )
    suggestions: tuple[Suggestion, ...] = field(
        default=(), kw_only=True, metadata={"key": "identifiability.remedies"}
    )


@dataclass(frozen=True)
class Suggestion:
    """A change of what is measured or known, and what it would identify.

    Attributes:
        change: Suggested change, in the imperative.
        count: Number of independent errors of the robot that can be known then.
        parameters: Names of those of its parameters that become identifiable.
        complete: Whether no measurement of the tool tells more: what is in sums then
            moves it only together.
    """

    change: str
    count: int
    parameters: tuple[str, ...]
    complete: bool


@dataclass(frozen=True)
class UrdfResult:
    """The part of a calibration that a URDF holds, where it is more or shows no gain.

    The geometry alone; without a gain the nominal robot about its registered frames.

    Attributes:
        errors: Accuracy by quantity, judged like that of the calibration; empty without
            a model.
        reason: Why there must be no URDF; empty where it is good.
        model: The robot as it is in a URDF; None without parameters of its geometry,
            and where the whole calibration is untrusted.
    """

    errors: tuple[QuantityErrors, ...] = field(metadata={"by": "name"})
    reason: str
    model: CalibratedModel | None = field(default=None, metadata={"key": None})


class Prediction(NamedTuple):
    """Tool poses with their uncertainty.

    Attributes:
        poses: Tool in the measurement frame, shape (N, 4, 4).
        covariance: Of the error of each along the axes of the measurement frame [m] and
            about them [rad], shape (N, 6, 6).
    """

    poses: Floats
    covariance: Floats


@dataclass(frozen=True, repr=False)
class Tables(Identification, Breakdown):
    """A result as arrays with names and as tables, see `CalibrationResult`."""

    model: CalibratedModel = field(metadata={"key": None})
    reference: CalibratedModel = field(metadata={"key": None})
    verdict: Annotated[str, OneOf(VERDICTS)] = field(metadata={"key": "verdict.status"})
    reason: str = field(metadata={"key": "verdict.reason"})
    errors: tuple[QuantityErrors, ...] = field(metadata={"by": "name"})
    covariance: NamedArray
    fitted: MeasurementErrors = field(metadata={"key": None})
    held_out: MeasurementErrors | None = field(metadata={"key": None})

    @property
    def residuals(self) -> NamedArray:
        """Predicted minus measured by the calibrated robot, shape (N, d), SI units.

        A row for each fitted measurement, by its file and line; NaN for a component
        that a measurement does not have.
        """
        places = [self.fitted.rows.source(k) for k in range(len(self.fitted))]
        return NamedArray.of(self.fitted.after, places, self.fitted.components)

    @property
    def jacobian(self) -> NamedArray:
        """The derivative of `residuals` by the parameters, shape (N d, P), SI units.

        It is taken at the calibrated robot, about its own frames and instrument. A row
        for each component of a measurement; zero for a component that it does not have.
        """
        rows, components = self.fitted.rows, self.fitted.components
        problem = self.model.problem(rows)
        layout, sigma = problem.layout, problem.sigma
        _, J = problem.linearize_rows(self.model.theta)
        derivative = np.zeros((len(rows) * layout.width, J.shape[1]))
        used = np.isfinite(sigma)
        place = (layout.row * layout.width + layout.column)[used]
        derivative[place] = J[: len(sigma)][used] * sigma[used, None]
        names = [f"{rows.source(k)} {c}" for k in range(len(rows)) for c in components]
        return NamedArray.of(derivative, names, [p.name for p in self.parameters])

    def to_frame(self) -> Any:
        """The measurements as a pandas data frame, with the columns of the file.

        Raises:
            OptionError: If pandas is not installed.
        """
        try:
            pandas = import_module("pandas")
        except ImportError as error:
            raise OptionError("to_frame needs pandas: pip install pandas") from error
        parts = {"train": self.fitted, "validate": self.held_out}
        frames = [
            pandas.DataFrame(p.table(n)) for n, p in parts.items() if p is not None
        ]
        return pandas.concat(frames, ignore_index=True)

    def predict(
        self, q: Floats, chain: str | None = None, payload: str = ""
    ) -> Prediction:
        """Tool poses of the calibrated robot, and how far the real one may be off.

        By the covariance of the parameters and the unmodeled error as it is expected
        over the workspace; not by the noise of an instrument that looks.

        Args:
            q: Joint positions, shape (N, n) [rad, m].
            chain: Name of the chain; default the first that moves.
            payload: Name of what is carried, which several payloads need.

        Raises:
            InputError: If q has another shape, or nothing says what is carried.
        """
        calibrated, term = self.model.of(chain), self.reference.of_chain(chain)
        if payload:
            calibrated = calibrated.carrying(payload)
        q = as_array("q", q, "N", len(calibrated.chain.joints))
        T, J, C = self.linearized(term, q, payload)
        J = np.kron(np.eye(2), T[:, :3, :3]) @ J
        C = J @ C @ J.transpose(0, 2, 1)
        expected = self.accuracies[term.key.chain].workspace
        if expected is not None:
            C += np.diag(np.repeat(np.square(expected.unmodeled) / 3.0, 3))
        return Prediction(calibrated.poses(q), C)

    def linearized(
        self, term: Term, q: Floats, payload: str = ""
    ) -> tuple[Floats, Floats, Floats]:
        """Tool poses of a part, and the errors that they depend on.

        Args:
            term: A term of `reference`.
            q: Positions of its joints, shape (N, n) [rad, m].
            payload: Name of what it carries, which several payloads need.

        Returns:
            Poses, shape (N, 4, 4), their body twists by the p parameters of its error
            model, (N, 6, p), and the covariance of these, (p, p).
        """
        index, values = term.of_error, np.array([p.value for p in self.parameters])
        T, J = term.error.carrying(payload).jacobian(q, values[index])
        return T, J, np.asarray(self.covariance)[np.ix_(index, index)]

    def figures(self) -> dict[str, Any]:
        """The figures of the report by name, as matplotlib figures."""
        result: dict[str, Any] = upper("report.figures", "figures", self)
        return result


@dataclass(frozen=True, repr=False)
class CalibrationResult(Tables):
    """Everything a calibration found, made by a fit or read from a file.

    Attributes:
        model: The calibrated robot.
        reference: The nominal robot about the registered frames and instrument that
            the values of their parameters deviate from.
        verdict: `good`, `no-gain`, `unchecked` or `untrusted`.
        reason: Why, in one sentence with numbers.
        errors: Accuracy by quantity.
        validation: How the fit was checked.
        solver: How the solver ended.
        statistics: The statistics of the residuals.
        covariance: Of the parameters, shape (P, P), with their names.
        fitted: Errors of the fitted measurements.
        held_out: Errors of the validation measurements; None without a validation.
        files: Measurement files.
        model_selection: The model selection, if there was one.
        urdf: What a URDF holds, where the model is more than that.
        rejected: Name of the residual model that found nothing to correct, if one did.
        distances: Known distances beside those that were found.
        findings: Defects of the data or the result.
        provenance: How it came about.
        recalibration: How it went on from an older calibration; None where it did not.
    """

    validation: Validation
    solver: SolverSummary
    statistics: Statistics
    files: tuple[str, ...] = field(default=(), metadata={"key": None})
    model_selection: ModelSelection | None = field(
        default=None, metadata={"key": "model_ladder"}
    )
    urdf: UrdfResult | None = None
    rejected: str = field(default="", metadata={"key": "rejected_residual_model"})
    distances: tuple[DistanceCheck, ...] = ()
    findings: tuple[Finding, ...] = ()
    provenance: Provenance = field(default_factory=Provenance, metadata={"key": ""})
    recalibration: Recalibration | None = None

    @property
    def geometry(self) -> CalibratedModel | None:
        """The geometry that a corrected URDF gets; None where there is none.

        Without a gain the URDF stays as it is.
        """
        return self._in_urdf if self.verdict == "good" else None

    @property
    def described(self) -> CalibratedModel:
        """The robot as its URDF has it, about the frames that belong to that.

        Those of the whole calibration are others: base and tool take up what a URDF
        does not hold.
        """
        return self.model if self._in_urdf is None else self._in_urdf

    @property
    def _in_urdf(self) -> CalibratedModel | None:
        """The robot that a URDF can hold; None where there must be none."""
        if self.urdf is None:
            return self.model
        return None if self.urdf.reason else self.urdf.model

    @property
    def applied(self) -> CalibratedModel:
        """The robot that commands are for: without a gain the nominal one."""
        return self.described if self.verdict == "no-gain" else self.model


@dataclass(frozen=True, repr=False)
class Evaluation(Printed):
    """Accuracy on measurements that were not fitted.

    Attributes:
        errors: Accuracy by quantity name and unit.
        rows: Number of measurements.
        counts: Number of measurements that have each quantity.
        registered: Whether what is unknown of base, tool and instrument was fitted to
            them.
        verdict: `good`, `unchecked` or `untrusted`.
        reason: Why it must not be trusted; empty where it is good.
        outside: Number of them outside the region of a learned correction.
        located: Names of references, such as sockets, that were not there before and
            stand where the measurements put them.
        findings: Defects of the measurements.
    """

    errors: tuple[tuple[str, str, Accuracy], ...]
    rows: int
    registered: bool
    verdict: str = field(default="good", metadata={"key": "verdict.status"})
    reason: str = field(default="", metadata={"key": "verdict.reason"})
    outside: int = field(default=0, metadata={"key": "outside_trained_region"})
    located: tuple[str, ...] = field(default=(), metadata={"key": "placed"})
    counts: tuple[int, ...] = ()
    findings: tuple[Finding, ...] = ()
