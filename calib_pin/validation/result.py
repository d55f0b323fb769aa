"""What a calibration found, as plain data that reports and files are made from."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.compiled.threads import serial_blas
from calib_pin.estimation.evidence import (
    ExpectedAccuracy,
    Finding,
    Gain,
    Outlier,
    VarianceComponent,
)
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.tip_accuracy import TipAccuracy
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import MeasurementModel
from calib_pin.observations import Measurements
from calib_pin.parameterizations.error_model import ErrorModel
from calib_pin.residual_models import LearnedCorrection
from calib_pin.setup import Setup
from calib_pin.solvers import Status
from calib_pin.validation.row_errors import RowErrors

__all__ = [
    "Accuracy",
    "CalibratedModel",
    "CalibrationResult",
    "CoupledGroup",
    "Evaluation",
    "FoundDistance",
    "Identifiability",
    "Identification",
    "Ladder",
    "Outlier",
    "ParameterEstimate",
    "QuantityErrors",
    "Rung",
    "UrdfResult",
]


@dataclass(frozen=True)
class Accuracy:
    """Size of the errors of one quantity over rows, in the quantity's unit.

    Attributes:
        mean: Mean size.
        rms: Root-mean-square.
        p95: What 95 % of the rows stay below.
        max: Largest size.
    """

    mean: float
    rms: float
    p95: float
    max: float

    @staticmethod
    def of(sizes: Floats) -> Accuracy:
        """Accuracy of the error sizes of rows, shape (N,)."""
        return Accuracy(
            float(sizes.mean()),
            float(np.sqrt(np.mean(sizes**2))),
            # No interpolation: where a row cannot be predicted its size is infinite.
            float(np.quantile(sizes, 0.95, method="inverted_cdf")),
            float(sizes.max()),
        )


@dataclass(frozen=True)
class QuantityErrors:
    """Errors of one quantity before and after, on fitted and on unseen rows.

    *Before* is registration only: base, tool and instrument fitted to the training
    rows, the robot nominal.
    """

    name: str
    unit: str
    before: Accuracy
    after: Accuracy
    validation_before: Accuracy | None
    validation_after: Accuracy | None


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


@dataclass(frozen=True)
class CoupledGroup:
    """A sum of parameters that is known although its terms are not."""

    number: int
    expression: str
    unit: str
    value: float
    sigma: float | None
    terms: tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class FoundDistance:
    """A known distance beside what the calibration finds.

    Attributes:
        between: Names of both ends.
        value: The known distance [m].
        sigma: Its standard deviation [m].
        nominal: The distance that the nominal robot finds [m].
        found: The distance that the calibrated robot finds [m].
        fitted: Whether it was fitted; otherwise its ends were not among the fitted
            rows, and what the robot finds there is a check.
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
        weak: Number of structural directions that these rows cannot tell.
        revealed: Number of directions that nominal geometry hides, estimated because
            the errors are so large that they show.
        correlated: Pairs of estimates with a correlation above 0.95.
        scale_observable: Whether measurements tell how large the robot is.
    """

    parameters: int
    rank: int
    structural_rank: int
    robot_rank: int
    gap: float
    everett: int
    condition: float
    singular_values: tuple[float, ...]
    structural_values: tuple[float, ...]
    observability: dict[str, float]
    weak: int
    revealed: int
    correlated: tuple[tuple[str, str, float], ...]
    scale_observable: bool = True


@dataclass(frozen=True)
class Identification:
    """What can be known of a robot.

    Attributes:
        parameters: Every parameter with its status and, after a fit, its estimate.
        groups: Coupled groups.
        identifiability: Ranks and observability.
    """

    parameters: tuple[ParameterEstimate, ...]
    groups: tuple[CoupledGroup, ...]
    identifiability: Identifiability


@dataclass(frozen=True)
class Rung:
    """One step of the model ladder, judged by cross-validation.

    Attributes:
        name: What it adds.
        parameters: Names of its parameterizations.
        learned: Its residual model, None for none.
        rank: Practical rank of its fit; 0 where it could not be tried.
        errors: Name, unit and mean error on unseen rows of every quantity.
        score: Mean error on unseen rows, root mean square of the components in standard
            deviations; NaN where it could not be tried.
        deviation: Standard error of the score.
        helps: Whether it lowers the errors of the rungs that it stands on by more than
            the standard error of the difference.
        reason: Why it could not be tried; empty where it was.
    """

    name: str
    parameters: tuple[str, ...]
    learned: str | None
    rank: int = 0
    errors: tuple[tuple[str, str, float], ...] = ()
    score: float = float("nan")
    deviation: float = float("nan")
    helps: bool = False
    reason: str = ""


@dataclass(frozen=True)
class Ladder:
    """The model ladder.

    Attributes:
        rungs: All of them, simplest first.
        chosen: Position of the one that is kept.
    """

    rungs: tuple[Rung, ...]
    chosen: int


@dataclass(frozen=True)
class CalibratedModel:
    """A robot with its calibration: what predicts measurements and corrects commands.

    Attributes:
        error: Error model about the fitted base and tool frame.
        measurement: Measurement model about the fitted instrument.
        theta: Values of the error model's parameters, shape (P,), frames at zero.
        setup: The setup it was fitted with.
    """

    error: ErrorModel
    measurement: MeasurementModel
    theta: Floats
    setup: Setup

    @staticmethod
    def create(problem: Problem, theta: Floats) -> CalibratedModel:
        """The model of a problem at parameter values, shape (P,).

        Frames and instrument move into their references; the robot keeps its values.
        """
        moved, values = problem.rebased(theta)
        return CalibratedModel(
            error=moved.error,
            measurement=moved.measurement,
            theta=moved.split(values)[0],
            setup=moved.setup,
        )

    @property
    def chain(self) -> Chain:
        """The nominal chain."""
        return self.error.chain

    @serial_blas
    def poses(self, q: Floats) -> Floats:
        """Predicted tool poses in the measuring frame, shape (N, n) -> (N, 4, 4)."""
        return self.error.poses(q, self.theta)

    def outside(self, q: Floats) -> NDArray[np.bool_]:
        """Where a learned correction fades, being far from its training, shape (N,).

        Args:
            q: Commanded joint positions, shape (N, n) [rad, m].
        """
        learned = self.error.learned
        if not isinstance(learned, LearnedCorrection):
            return np.zeros(len(q), bool)
        return ~learned.model.region.inside(q)

    @property
    def geometric(self) -> bool:
        """Whether there is nothing but geometry, which a URDF can hold."""
        moved = self.theta[self.error.joint_corrections].any()
        return self.error.learned is None and not moved

    @property
    def without_corrections(self) -> CalibratedModel:
        """The model without what a URDF cannot hold: of a true robot, its geometry.

        Of a fit that is no use, see `CalibrationResult.geometry`.
        """
        theta = self.theta.copy()
        theta[self.error.joint_corrections] = 0.0
        return replace(self, error=replace(self.error, learned=None), theta=theta)

    def urdf_corrections(self) -> dict[str, pin.SE3]:
        """Right-multiplied corrections of the URDF's joint origins, by joint name."""
        products = self.error.corrections(self.theta)
        names = [*self.chain.joints, self.chain.tip_joint]
        return {
            name: product
            for name, product in zip(names, products[1:-1], strict=True)
            if name is not None and product != pin.SE3.Identity()
        }

    @property
    def tool_carries_tip(self) -> bool:
        """Whether the tool frame holds an error that the URDF has no place for."""
        tip = self.error.corrections(self.theta)[-2]
        return self.chain.tip_joint is None and tip != pin.SE3.Identity()

    @property
    def tool(self) -> pin.SE3:
        """The tool in the tip frame of the corrected URDF.

        An error behind the last joint has no place in a URDF whose tip is that
        joint's own link; the tool frame carries it.
        """
        if self.chain.tip_joint is not None:
            return self.error.tool
        return self.error.corrections(self.theta)[-2] * self.error.tool

    def problem(self, data: Measurements) -> Problem:
        """The problem of other rows about this calibration."""
        return Problem(self.error, self.measurement, data, self.setup)


@dataclass(frozen=True)
class UrdfResult:
    """The geometry alone, of a calibration that is more than a URDF can hold.

    Attributes:
        model: The robot calibrated by its geometry; None without parameters of it.
        errors: Accuracy by quantity, judged like that of the calibration.
        reason: Why there must be no URDF; empty where it is good.
    """

    model: CalibratedModel | None
    errors: tuple[QuantityErrors, ...]
    reason: str


@dataclass(frozen=True)
class CalibrationResult(Identification):
    """Everything a calibration found.

    Attributes:
        model: The calibrated robot.
        reference: The nominal robot about the registered frames and instrument that
            the values of their parameters deviate from.
        verdict: `good`, `no-gain`, `unchecked` or `untrusted`.
        reason: Why, in one sentence with numbers.
        errors: Accuracy by quantity.
        validation: `set`, `file`, `holdout`, `5-fold by stretch`, ..., or `none`.
        training: Number of fitted rows.
        validated: Number of rows of the validation.
        chi2: Sum of squared whitened residuals.
        dof: Residual components minus rank.
        sigma0: Standard deviation of unit weight.
        stated_sigma: Whether the rows state their standard deviations.
        outliers: Rows that do not fit.
        solver: Name of the solver.
        evaluator: What evaluated the rows, see `solve.Solved`.
        history: Best cost of every generation, if it searched by evolution: half the
            sum of squared whitened residuals of the rows that the search looks at, a
            sample with `hybrid` and thousands of rows.
        status: How the solver ended.
        at_bounds: Names of the parameters that stand at a bound.
        iterations: Steps of the solver.
        evaluations: Evaluations of the cost; an evolution counts its members.
        seed: Seed of configurations and splits.
        covariance: Of the parameters, shape (P, P).
        fitted: Errors of the fitted rows.
        unseen: Errors of the rows of the validation; None without one.
        tip: How well the fit knows where the tip is; None where it has no redundancy.
        files: Measurement files.
        ladder: The model ladder, if one was climbed.
        urdf: The geometry alone, where the model is more than that.
        rejected: Name of the residual model that found nothing to correct, if one did.
        distances: Known distances beside those that were found.
        placed: Names of places that only the rows of the validation name: they stand
            where these rows put them.
        skipped: Why parts of a cross-validation were left out: what was fitted without
            them says nothing of the robot.
        noise: Variance components.
        gains: Paired tests on held-out configurations, the first of all quantities.
        measured: Accuracy to expect where it was measured.
        workspace: Accuracy to expect over the workspace.
        findings: What is wrong with the data or the result.
        displaced: How far the tool would be off from here, root mean square over the
            workspace, with what was set aside fitted like the rest [m]; None where
            nothing was.
    """

    model: CalibratedModel
    reference: CalibratedModel
    verdict: str
    reason: str
    errors: tuple[QuantityErrors, ...]
    validation: str
    training: int
    validated: int
    chi2: float
    dof: int
    sigma0: float
    stated_sigma: bool
    outliers: tuple[Outlier, ...]
    solver: str
    evaluator: str
    history: tuple[float, ...]
    status: Status
    at_bounds: tuple[str, ...]
    iterations: int
    evaluations: int
    seed: int
    covariance: Floats = field(repr=False)
    fitted: RowErrors = field(repr=False)
    unseen: RowErrors | None = field(repr=False)
    tip: TipAccuracy | None = field(repr=False)
    files: tuple[str, ...] = ()
    ladder: Ladder | None = None
    urdf: UrdfResult | None = None
    rejected: str = ""
    distances: tuple[FoundDistance, ...] = ()
    placed: tuple[str, ...] = ()
    skipped: tuple[str, ...] = ()
    noise: tuple[VarianceComponent, ...] = ()
    gains: tuple[Gain, ...] = ()
    measured: ExpectedAccuracy | None = None
    workspace: ExpectedAccuracy | None = None
    findings: tuple[Finding, ...] = ()
    displaced: float | None = None

    @property
    def geometry(self) -> CalibratedModel | None:
        """What a corrected URDF gets: the best geometry; None where there is none.

        Without a gain the URDF stays as it is.
        """
        if self.verdict != "good":
            return None
        if self.urdf is None:
            return self.model
        return None if self.urdf.reason else self.urdf.model


@dataclass(frozen=True)
class Evaluation:
    """Accuracy on rows that were not fitted.

    Attributes:
        errors: Accuracy by quantity name and unit.
        rows: Number of rows.
        counts: Number of rows that have each quantity.
        registered: Whether what is unknown of base, tool and instrument was fitted to
            these rows.
        verdict: `good` or `untrusted`.
        reason: Why it must not be trusted; empty where it is good.
        outside: Number of rows that lie outside the region of a learned correction.
        placed: Names of places, such as sockets, that were not there before and stand
            where these rows put them.
    """

    errors: tuple[tuple[str, str, Accuracy], ...]
    rows: int
    registered: bool
    verdict: str = "good"
    reason: str = ""
    outside: int = 0
    placed: tuple[str, ...] = ()
    counts: tuple[int, ...] = ()
