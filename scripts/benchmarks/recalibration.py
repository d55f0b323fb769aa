"""Ten measurements a week: accuracy of a robot that drifts, and jumps once.

Beside it a month after a calibration, see `months`.

    scripts/benchmark recalibration                      # a tenth of the runs
    scripts/benchmark recalibration --full               # all of them
    scripts/benchmark recalibration --job 4 --tell       # one run, told in full

A run is a UR10 that was calibrated with 100 positions or poses, and then twelve weeks
with ten each. Every week all its errors take a step of a random walk, and in
one week a joint is hit, so that its offset changes by 1 to 2 mrad. Kinds of runs take
turns; they differ in what drifts how much, and in what is measured how well. Each
calibration is compared with a full one, of 100 measurements in that week, and with the
best that ten of them allow: a Kalman filter that knows how the robot drifts, and what
the jump has moved.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

import calib_pin
from benchmarks import months
from benchmarks.criteria import run_criteria
from benchmarks.criterion import Criterion, Line, at_most, between
from benchmarks.verdict.jobs import SEED, Job, draw, stream
from benchmarks.verdict.truth import WORKSPACE, position_error
from calib_pin.estimation.evidence import TRUSTED
from calib_pin.estimation.fitted import robot_rows
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations
from calib_pin.setup import Setup
from calib_pin.validation.robot_state import expected_setup
from calib_pin.validation.tool_accuracy import without_frames

WEEKS, FEW, FULL = 12, 10, 100
"""Weeks of a run, measurements of each, and those of a full calibration."""

FULLS = 3
"""Weeks in which a full calibration is made as well."""

JUMP = (1e-3, 2e-3)
"""Smallest and largest jump of a joint offset [rad]."""

JOINTS = (1, 2, 3, 4)
"""Joints that are hit: of the first and the last nobody can tell it from base and tool.
"""

LIMIT = 1.3
"""Error by that of a full calibration that ten measurements may leave."""


@dataclass(frozen=True)
class Kind:
    """A kind of runs.

    Attributes:
        offsets: Step of every joint offset in a week [rad].
        geometry: Step of every other error [m, rad].
        noise: Standard deviation of a coordinate [m], and of a pose's turn [rad].
        model: Way of measuring, positions or poses.
        planned: Whether each week's configurations are planned, else random.
    """

    offsets: float
    geometry: float
    noise: float
    model: str = "position"
    planned: bool = False

    def __str__(self) -> str:
        """The kind in a few words."""
        return (
            f"offsets {1e6 * self.offsets:.0f} urad, others {1e6 * self.geometry:.0f} "
            f"um, noise {1e3 * self.noise:g} mm, {self.model}s"
            f"{', planned' if self.planned else ''}"
        )


KINDS = (
    Kind(20e-6, 2e-6, 2e-4),
    Kind(20e-6, 2e-6, 1e-4),
    Kind(50e-6, 5e-6, 2e-4),
    Kind(20e-6, 20e-6, 2e-4),
    Kind(20e-6, 20e-6, 1e-4),
    Kind(20e-6, 20e-6, 2e-4, planned=True),
    Kind(20e-6, 2e-6, 2e-4, "pose"),
    Kind(50e-6, 5e-6, 2e-4, "pose"),
)
"""Kinds of runs."""

SHOWN = 5.0
"""Size of a jump in standard deviations of what ten measurements show of it, beside the
drift, from which it is visible: with six joints, smaller ones come about by chance."""


@dataclass(frozen=True)
class Week:
    """A week of a run.

    Attributes:
        error: Error of the tool over the workspace [m].
        older: That of the calibration of the week before [m].
        optimal: The expected one of the best filter [m].
        predicted: The one that the result expects [m].
        told: Whether a jump was told.
        status: The verdict.
    """

    error: float
    older: float
    optimal: float
    predicted: float
    told: bool
    status: str


@dataclass(frozen=True)
class Outcome:
    """Outcome of a run.

    Attributes:
        number: Number of the run.
        kind: Its kind.
        jump: Week of the jump.
        visible: Size of the jump in standard deviations of what is measured of it.
        weeks: Its weeks.
        full: Errors of full calibrations [m].
    """

    number: int
    kind: Kind
    jump: int
    visible: float = 0.0
    weeks: Sequence[Week] = field(default_factory=list)
    full: Sequence[float] = ()

    @property
    def announced(self) -> bool:
        """Whether the jump was told in its week."""
        return self.weeks[self.jump].told

    @property
    def alarms(self) -> int:
        """Weeks in which a jump was told that was none."""
        return sum(w.told for k, w in enumerate(self.weeks) if k != self.jump)

    def __str__(self) -> str:
        """The outcome in one line."""
        told = " ".join(f"{1e3 * week.error:.3f}" for week in self.weeks)
        return (
            f"run {self.number}: {self.kind}; jump in week {self.jump + 1} "
            f"({self.visible:.1f} sigma) {'told' if self.announced else 'missed'}, "
            f"{self.alarms} false alarms; "
            f"full {1e3 * _rms(self.full):.3f} mm, weeks {told}"
        )


def run(number: int, weeks: int = WEEKS) -> Outcome:
    """The weeks of a run."""
    kind, rng = KINDS[number % len(KINDS)], stream(number, 9)
    job = draw(0, robot="example:ur10_robot", model=kind.model, noise=kind.noise)
    parameters = job.problem.parameters
    robot = parameters.free & ~parameters.nuisance
    theta = np.where(robot, parameters.scales * rng.normal(size=len(robot)), 0.0)
    job = replace(job, theta=theta, stated=False)
    offsets = _offsets(job)
    steps = np.where(robot, kind.geometry, 0.0)
    steps[offsets] = kind.offsets
    jump = int(rng.integers(1, weeks - 1))
    q = job.chain.random_configurations(WORKSPACE, stream(number, 8))
    data = job.measured(rng, count=FULL)
    result = calib_pin.calibrate(job.chain, data, validate=False)
    # The filter knows what the robot was drawn from.
    covariance = np.diag((parameters.scales**2)[robot])
    covariance = _better(job, data, covariance, robot)
    found, full, visible = [], [], 0.0
    for week in range(weeks):
        step = steps * rng.normal(size=len(steps))
        covariance = covariance + np.diag(steps[robot] ** 2)
        if week == jump:
            hit = offsets[int(rng.choice(JOINTS))]
            size = rng.choice([-1, 1]) * rng.uniform(*JUMP)
            step[hit] += size
            place = int(np.cumsum(robot)[hit]) - 1
        job = replace(job, theta=job.theta + step)
        at = _planned(job, result, week) if kind.planned else None
        data = job.measured(rng, count=FEW, q=at)
        older = position_error(job, result.model, q)
        anew = calib_pin.calibrate(job.chain, data, start=result)
        # A user goes on with the older one where the new one must not be trusted.
        result = anew if anew.verdict in TRUSTED else result
        if week == jump:
            visible = size * _shown(job, data, covariance)[place]
            covariance[place, place] += size**2
        covariance = _better(job, data, covariance, robot)
        assert anew.recalibration is not None
        workspace = result.accuracy.workspace
        found.append(
            Week(
                error=position_error(job, result.model, q),
                older=older,
                optimal=_expected(job, covariance, robot, q),
                predicted=np.nan if workspace is None else workspace.calibrated[0],
                told=bool(anew.recalibration.last.jumps),
                status=anew.verdict,
            )
        )
        if week % (weeks // FULLS or 1) == 0:
            data = job.measured(rng, count=FULL)
            whole = calib_pin.calibrate(job.chain, data, validate=False)
            full.append(position_error(job, whole.model, q))
    return Outcome(number, kind, jump, abs(float(visible)), found, full)


def _planned(job: Job, result: calib_pin.CalibrationResult, seed: int) -> Floats:
    """Configurations that tell most beside what is known already, shape (FEW, n)."""
    stated = job.problem.setup
    frames = Setup(base_frame=stated.base_frame, tool_frame=stated.tool_frame)
    setup = expected_setup(Chains.of(job.chain), frames, result)
    return calib_pin.plan(job.chain, job.model, FEW, setup, seed=seed).q


def _offsets(job: Job) -> list[int]:
    """Positions of the offsets of all joints."""
    names, chain = job.problem.parameters.names, job.chain
    return [
        names.index(f"{joint}.placement.r{'xyz'[int(np.argmax(np.abs(axis)))]}")
        for joint, axis in zip(chain.joints, chain.axes, strict=True)
    ]


def _better(job: Job, data: object, covariance: Floats, robot: Floats) -> Floats:
    """Covariance of the errors of a filter behind further measurements."""
    problem = replace(job.problem, data=Observations.of(data))
    told = robot_rows(problem, job.theta, ())
    W = told.rows / problem.parameters.scales[told.robot]
    gain = covariance @ W.T @ np.linalg.inv(W @ covariance @ W.T + np.eye(len(W)))
    result = covariance - gain @ W @ covariance
    return np.asarray(0.5 * (result + result.T))


def _shown(job: Job, data: object, covariance: Floats) -> Floats:
    """Standard deviations that measurements show of an error of one, shape (K,)."""
    problem = replace(job.problem, data=Observations.of(data))
    told = robot_rows(problem, job.theta, ())
    W = told.rows / problem.parameters.scales[told.robot]
    V = W @ covariance @ W.T + np.eye(len(W))
    return np.asarray(np.sqrt(np.sum(W * np.linalg.solve(V, W), axis=0)))


def _expected(job: Job, covariance: Floats, robot: Floats, q: Floats) -> float:
    """Expected error of the tool, root mean square over configurations [m]."""
    error = job.problem.only.error
    _, J = error.jacobian(q, job.theta[: len(error.screws)])
    own = without_frames(J, J)[:, :3, robot[: J.shape[2]]]
    squares = np.einsum("ndi,ij,ndj->n", own, covariance, own, optimize=True)
    return float(np.sqrt(squares.mean()))


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def judge(found: Sequence[Outcome]) -> Iterator[Line]:
    """Accuracy week by week, jumps and false alarms."""
    for kind in KINDS:
        some = [outcome for outcome in found if outcome.kind == kind]
        if not some:
            continue
        full = _rms([error for outcome in some for error in outcome.full])
        ratios, best = [], []
        for week in zip(*(outcome.weeks for outcome in some), strict=True):
            ratios.append(_rms([w.error for w in week]) / full)
            best.append(_rms([w.optimal for w in week]) / full)
        weeks = [week for outcome in some for week in outcome.weeks]
        yield Line(
            f"{kind}: error by that of a full calibration, worst week",
            f"{max(ratios):.2f}",
            f"at most {LIMIT}; all weeks {_rms(ratios):.2f}, the best filter "
            f"{max(best):.2f}, {_rms(best):.2f}, full {1e3 * full:.3f} mm, "
            f"without refitting {_rms([w.older for w in weeks]) / full:.2f}",
            max(ratios) <= LIMIT if max(best) <= LIMIT else None,
        )
        yield between(
            f"{kind}: error by that of the best filter",
            _rms(ratios) / _rms(best),
            -np.inf,
            1.15,
            1.0 / np.sqrt(2.0 * len(weeks)),
        )
        squares = [(week.error / week.predicted) ** 2 for week in weeks]
        yield between(
            f"{kind}: mean square of actual by predicted error",
            float(np.mean(squares)),
            0.8,
            1.2,
            1.0 / len(weeks) ** 0.5,
        )
        good = np.mean([week.status == "good" for week in weeks])
        yield Line(f"{kind}: verdict 'good'", f"{100.0 * good:.0f} % of the weeks")
    shown = [outcome for outcome in found if outcome.visible > SHOWN]
    hidden = [outcome for outcome in found if outcome not in shown]
    poses = [outcome for outcome in found if outcome.kind.model == "pose"]
    for text, some in (
        ("jumps that measurements show", shown),
        ("other jumps", hidden),
        ("jumps where poses are measured", poses),
    ):
        if not some:
            continue
        told = [outcome.number for outcome in some if outcome.announced]
        line = at_most(f"{text}, told in their week", told, len(some), 95.0, least=True)
        # What measurements do not show, nobody can tell.
        yield line if some is not hidden else replace(line, passed=None)
    alarms = sum(outcome.alarms for outcome in found)
    weeks_ = sum(len(outcome.weeks) - 1 for outcome in found)
    yield Line(
        "false alarms",
        f"{alarms} in {weeks_} weeks",
        "at most 1 in 100 weeks",
        alarms <= max(weeks_ // 100, 1),
    )


CRITERIA = {
    "weeks": Criterion(1, "Continuous recalibration", 100, run, judge, least=4),
    "months": Criterion(2, "A month after", 300, months.run, months.judge, least=12),
}


def main() -> None:
    """Run what the options name; exit status 1 if a criterion fails."""
    run_criteria("recalibration", CRITERIA, SEED)
