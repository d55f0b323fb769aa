"""The true error of a calibration, known from simulation.

Tool positions of the true, the calibrated and the nominal robot are compared with the
displacements of base and tool fitted away, since users register these anew: they are
no property of the robot, and `ExpectedAccuracy` leaves them aside as well.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.verdict.jobs import Job, stream
from calib_pin.kinematics.spatial import Floats
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.result import CalibrationResult
from calib_pin.validation.tip_drift import absorbed

WORKSPACE = 300
"""Number of configurations at which errors are evaluated."""


@dataclass(frozen=True)
class Outcome:
    """The outcome of a job; errors are rms tool positions [m].

    Attributes:
        number: Number of the job.
        kind: Its subject, such as a defect.
        label: The job in a few words.
        group: Names by which outcomes are counted.
        verdict: The verdict; `refused` where the input was, `crash` for a traceback.
        reason: Its reason.
        actual: Error of the calibrated robot over the workspace.
        nominal: That of the nominal one.
        predicted: Predicted error of the calibrated one; NaN without a prediction.
        better: Probability that the calibrated robot is better, as the result says.
        there: Actual error where it was measured, on new configurations.
        expected: Predicted error there.
    """

    number: int
    kind: str
    label: str
    group: tuple[str, ...]
    verdict: str
    reason: str
    actual: float = np.nan
    nominal: float = np.nan
    predicted: float = np.nan
    better: float = np.nan
    there: float = np.nan
    expected: float = np.nan

    @property
    def false(self) -> bool:
        """Whether it was trusted although it is twice as far off as predicted."""
        over = not self.actual <= 2.0 * self.predicted  # Also without a prediction.
        there = self.there > 2.0 * self.expected
        return self.verdict == "good" and (over or there)

    @property
    def worse(self) -> bool:
        """Whether a URDF was written that is worse than the nominal one."""
        return self.verdict == "good" and self.actual > self.nominal

    def __str__(self) -> str:
        """The outcome in one line."""
        errors = ", ".join(
            f"{name} {1e3 * value:.3f}"
            for name, value in (
                ("actual", self.actual),
                ("predicted", self.predicted),
                ("nominal", self.nominal),
                ("measured there", self.there),
                ("expected there", self.expected),
            )
            if np.isfinite(value)
        )
        what = " ".join(filter(None, (self.kind, f"[{self.label}]")))
        return f"job {self.number}: {what} {self.verdict}: {errors} mm; {self.reason}"


def judged(
    job: Job,
    result: CalibrationResult,
    kind: str = "",
    group: tuple[str, ...] = (),
    there: Floats | None = None,
    read: Callable[[Floats], Floats] = lambda q: q,
) -> Outcome:
    """The outcome of a job.

    Args:
        job: The job.
        result: The result.
        kind: Its subject.
        group: Names by which outcomes are counted.
        there: New configurations like those that were measured, shape (N, n).
        read: Joint positions of the calibrated robot by true ones.
    """
    q = job.chain.random_configurations(WORKSPACE, stream(job.number, 99))
    actual, nominal = (
        position_error(job, result.model, q, read),
        position_error(job, None, q),
    )
    predicted, better = np.nan, np.nan
    if result.accuracy.workspace is not None:
        predicted, better = (
            result.accuracy.workspace.calibrated[0],
            result.accuracy.workspace.better,
        )
    elif result.accuracy.tip is not None:
        predicted = result.accuracy.tip.of_robot[0]
    measured, expected = np.nan, np.nan
    if there is not None and result.accuracy.measured is not None:
        measured = position_error(job, result.model, there)
        expected = result.accuracy.measured.calibrated[0]
    return Outcome(
        number=job.number,
        kind=kind,
        label=job.label,
        group=group,
        verdict=result.verdict,
        reason=result.reason,
        actual=actual,
        nominal=nominal,
        predicted=predicted,
        better=better,
        there=measured,
        expected=expected,
    )


def refused(
    job: Job, error: Exception, kind: str = "", group: tuple[str, ...] = ()
) -> Outcome:
    """The outcome of a job that ended in an error."""
    from calib_pin.errors import CalibPinError

    verdict = "refused" if isinstance(error, CalibPinError) else "crash"
    reason = f"{type(error).__name__}: {error}"
    return Outcome(job.number, kind, job.label, group, verdict, reason)


def position_error(
    job: Job,
    model: CalibratedModel | None,
    q: Floats,
    read: Callable[[Floats], Floats] = lambda q: q,
) -> float:
    """Error of the tool position, root mean square over configurations [m].

    Args:
        job: The job, with the true robot.
        model: The calibrated robot; None for the nominal one.
        q: Configurations, shape (N, n).
        read: Joint positions of the model by true ones.

    Raises:
        ValueError: If the model has joints that the job does not have.
    """
    part = job.problem.only
    error, (truth, _) = part.error, part.values(job.theta)
    A = error.poses(q, truth)
    if model is None:
        B = error.poses(q, 0.0 * truth)
    else:
        own = model.of()
        # A wrong tip leaves joints out.
        joints = [job.chain.joints.index(name) for name in own.error.chain.joints]
        B = own.poses(read(q)[:, joints])
    B = absorbed(A, B)
    squares = np.sum((B[:, :3, 3] - A[:, :3, 3]) ** 2, axis=1)
    return float(np.sqrt(squares.mean()))
