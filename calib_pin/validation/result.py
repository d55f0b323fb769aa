"""The result of a calibration, as plain data for reports and files."""

from __future__ import annotations

from dataclasses import dataclass, field
from html import escape
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from calib_pin.errors import OptionError
from calib_pin.estimation.evidence import Finding
from calib_pin.estimation.system import Part
from calib_pin.kinematics.spatial import Floats
from calib_pin.plugins import upper
from calib_pin.setup.arguments import as_array
from calib_pin.units import DISPLAY
from calib_pin.validation.accuracy import Accuracy, QuantityErrors
from calib_pin.validation.breakdown import Breakdown
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.measurement_errors import MeasurementErrors
from calib_pin.validation.summaries import (
    ModelSelection,
    NamedArray,
    Provenance,
    Recalibration,
    SolverSummary,
    Statistics,
    Validation,
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


class Term(NamedTuple):
    """A term of a linear combination of parameters."""

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
    terms: tuple[Term, ...]


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
    terms: tuple[Term, ...] = ()


class Correlation(NamedTuple):
    """Two estimates that move together; a combination is named by its formula."""

    first: str
    second: str
    correlation: float


@dataclass(frozen=True)
class FoundDistance:
    """A known distance or angle beside what the calibration finds.

    Attributes:
        between: Names of both ends.
        value: The known distance [m], or the angle [rad].
        sigma: Its standard deviation.
        nominal: The distance that the nominal robot finds.
        found: The distance that the calibrated robot finds.
        fitted: Whether it was fitted; otherwise no fitted measurement names its ends,
            and what the robot finds there is a check.
        unit: `m`, or `rad` of an angle between planes.
    """

    between: tuple[str, str]
    value: float
    sigma: float
    nominal: float
    found: float
    fitted: bool
    unit: str = "m"


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
        correlated: Pairs of estimates with a correlation above 0.95.
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
    observability: dict[str, float]
    weak: int
    revealed: int
    correlated: tuple[Correlation, ...]
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
    """

    parameters: tuple[ParameterEstimate, ...]
    groups: tuple[CoupledGroup, ...]
    identifiability: Identifiability
    robot_errors: tuple[RobotError, ...] = field(default=(), kw_only=True)


@dataclass(frozen=True)
class UrdfResult:
    """The geometry alone, of a calibration that is more than a URDF can hold.

    Attributes:
        model: The robot calibrated by its geometry; None without parameters of it, and
            where the whole calibration is untrusted.
        errors: Accuracy by quantity, judged like that of the calibration; empty then.
        reason: Why there must be no URDF; empty where it is good.
    """

    model: CalibratedModel | None
    errors: tuple[QuantityErrors, ...]
    reason: str


class Prediction(NamedTuple):
    """Tool poses with their uncertainty.

    Attributes:
        poses: Tool in the measurement frame, shape (N, 4, 4).
        covariance: Of the error of each along the axes of the measurement frame [m] and
            about them [rad], shape (N, 6, 6).
    """

    poses: Floats
    covariance: Floats


class Tables(Identification, Breakdown):
    """A result as arrays with names and as tables."""

    model: CalibratedModel
    reference: CalibratedModel
    covariance: NamedArray
    verdict: str
    reason: str
    errors: tuple[QuantityErrors, ...]
    fitted: MeasurementErrors
    held_out: MeasurementErrors | None

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
        found = np.zeros((len(rows) * layout.width, J.shape[1]))
        used = np.isfinite(sigma)
        place = (layout.row * layout.width + layout.column)[used]
        found[place] = J[: len(sigma)][used] * sigma[used, None]
        names = [f"{rows.source(k)} {c}" for k in range(len(rows)) for c in components]
        return NamedArray.of(found, names, [p.name for p in self.parameters])

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

    def predict(self, q: Floats, chain: str | None = None) -> Prediction:
        """Tool poses of the calibrated robot, and how far the real one may be off.

        By the covariance of the parameters and the unmodeled error as it is expected
        over the workspace; not by the noise of an instrument that looks.

        Args:
            q: Joint positions, shape (N, n) [rad, m].
            chain: Name of the chain; default the first that moves.

        Raises:
            OptionError: If q has another shape.
        """
        there, part = self.model.of(chain), self.reference.moving
        if chain is not None:
            part = self.reference.of_chain(chain)
        q = as_array("q", q, "N", len(there.chain.joints))
        T, J, C = self.linearized(part, q)
        J = np.kron(np.eye(2), T[:, :3, :3]) @ J
        C = J @ C @ J.transpose(0, 2, 1)
        expected = self.accuracies[part.key.chain].workspace
        if expected is not None:
            C += np.diag(np.repeat(np.square(expected.unmodeled) / 3.0, 3))
        return Prediction(there.poses(q), C)

    def linearized(self, part: Part, q: Floats) -> tuple[Floats, Floats, Floats]:
        """Tool poses of a part, and the errors that they depend on.

        Args:
            part: A part of `reference`.
            q: Positions of its joints, shape (N, n) [rad, m].

        Returns:
            Poses, shape (N, 4, 4), their body twists by the p parameters of its error
            model, (N, 6, p), and the covariance of these, (p, p).
        """
        own, values = part.of_error, np.array([p.value for p in self.parameters])
        T, J = part.error.jacobian(q, values[own])
        return T, J, np.asarray(self.covariance)[np.ix_(own, own)]

    def figures(self) -> dict[str, Any]:
        """The figures of the report by name, as matplotlib figures."""
        found: dict[str, Any] = upper("report.figures", "figures", self)
        return found

    def _repr_html_(self) -> str:
        """Verdict, accuracy and identifiable parameters, for notebooks."""
        rows: list[tuple[str, ...]] = [("mean error", "nominal", "calibrated", "")]
        for error in self.errors:
            unit, factor = DISPLAY[error.unit]
            before = error.validation_before or error.before
            after = error.validation_after or error.after
            sizes = (f"{factor * accuracy.mean:.4g}" for accuracy in (before, after))
            rows.append((error.name, *sizes, unit))
        rows.append(("parameter", "value", "std. dev.", ""))
        for p in self.parameters:
            if p.sigma is not None:
                unit, factor = DISPLAY.get(p.unit, (p.unit, 1.0))
                value, sigma = f"{factor * p.value:+.4f}", f"{factor * p.sigma:.2g}"
                rows.append((p.name, value, sigma, unit))
        table = "".join(f"<tr><td>{'<td>'.join(map(escape, row))}" for row in rows)
        said = f"<b>{self.verdict.upper()}</b>: {escape(self.reason)}"
        return f"<p>{said}</p><table>{table}</table>"


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
        urdf: The geometry alone, where the model is more than that.
        rejected: Name of the residual model that found nothing to correct, if one did.
        distances: Known distances beside those that were found.
        findings: Defects of the data or the result.
        provenance: How it came about.
        recalibration: How it went on from an older calibration; None where it did not.
    """

    model: CalibratedModel
    reference: CalibratedModel
    verdict: str
    reason: str
    errors: tuple[QuantityErrors, ...]
    validation: Validation
    solver: SolverSummary
    statistics: Statistics
    covariance: NamedArray = field(repr=False)
    fitted: MeasurementErrors = field(repr=False)
    held_out: MeasurementErrors | None = field(repr=False)
    files: tuple[str, ...] = ()
    model_selection: ModelSelection | None = None
    urdf: UrdfResult | None = None
    rejected: str = ""
    distances: tuple[FoundDistance, ...] = ()
    findings: tuple[Finding, ...] = ()
    provenance: Provenance = field(default_factory=Provenance)
    recalibration: Recalibration | None = None

    @property
    def geometry(self) -> CalibratedModel | None:
        """The geometry that a corrected URDF gets; None where there is none.

        Without a gain the URDF stays as it is.
        """
        if self.verdict != "good":
            return None
        if self.urdf is None:
            return self.model
        return None if self.urdf.reason else self.urdf.model


@dataclass(frozen=True, repr=False)
class Evaluation(Printed):
    """Accuracy on measurements that were not fitted.

    Attributes:
        errors: Accuracy by quantity name and unit.
        rows: Number of measurements.
        counts: Number of measurements that have each quantity.
        registered: Whether what is unknown of base, tool and instrument was fitted to
            them.
        verdict: `good` or `untrusted`.
        reason: Why it must not be trusted; empty where it is good.
        outside: Number of them outside the region of a learned correction.
        located: Names of references, such as sockets, that were not there before and
            stand where the measurements put them.
        findings: Defects of the measurements.
    """

    errors: tuple[tuple[str, str, Accuracy], ...]
    rows: int
    registered: bool
    verdict: str = "good"
    reason: str = ""
    outside: int = 0
    located: tuple[str, ...] = ()
    counts: tuple[int, ...] = ()
    findings: tuple[Finding, ...] = ()
