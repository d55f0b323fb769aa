"""New measurements beside what an older calibration predicts of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.estimation.problem import Problem
from calib_pin.estimation.robot_rows import RobotRows, robot_rows
from calib_pin.estimation.statistics.innovations import (
    Cause,
    Explanation,
    Sparse,
    explained,
)
from calib_pin.estimation.tip_accuracy import SAMPLES, without_frames
from calib_pin.kinematics.spatial import Floats
from calib_pin.parameterizations.base import expected_size
from calib_pin.parameters import Parameter, ParameterSet
from calib_pin.setup import JointPrior
from calib_pin.validation.joint_changes import Change, changes, drifts
from calib_pin.validation.older_calibration import NOISE, wider
from calib_pin.validation.older_frames import shared_frames
from calib_pin.validation.result import CalibrationResult
from calib_pin.validation.summaries import DriftSize, Jump, NoiseSize

REMEMBERED = 50.0
"""Errors that a drift is worth at most: in a year it may be another one."""

MOST = {"geometry": 4e-5, "joint offsets": 1.2e-4}
"""Drift from which it is none: the robot has been changed."""

KNOWN = 1e-5
"""Standard deviation of a frame that is known [m, rad]."""

SURE = 30.0
"""Evidence for a sudden change by that for none from which it is told.

By chance as much comes about in at most one of 30 calibrations (Markov's inequality,
which is wide: of 704 simulated weeks without a change one was told to have one)."""

CLOSE = 9.0
"""Chi-square by which one simple change may explain less than another, and is not told
from it: three standard deviations."""

CHANCES = {"offset": 1.0, "base": 1.0, "tool": 1.0, "placement": 0.05, "robot": 0.05}
"""How likely kinds of sudden changes are beside each other: a joint that was hit slips
on its axis first of all, and instruments and tools are set up anew."""

FRAMES = ("base", "tool")
"""Changes of frames."""

SAME = 1e-4
"""Part of what a change does by which another one differs at least."""

SIMPLE = ("offset", *FRAMES)
"""Changes of one thing, which few measurements tell from each other."""

NOISE_NAME, NOISE_GREW = "noise", "noisier"
"""Causes: the noise as it is known, and more of it by another instrument."""

JUMPS = 4
"""Most causes beside drift and noise that are told, sudden changes and wrong
measurements."""

SIZES = np.geomspace(0.03, 10.0, 16)
"""Sizes of sudden changes, in expected sizes of errors: from 30 um and 90 urad on."""

FAR = np.geomspace(0.03, 1e4, 24)
"""The same of frames, which may be anywhere."""

GROWN = 2.0
"""Noise by what was known of it beyond which a part of it is something else."""

WRONG = np.geomspace(3.0, 1e4, 16)
"""Errors of measurements that are wrong, in standard deviations."""

NOISIER = np.geomspace(1.0, 30.0, 8)
"""Further noise of another instrument, by what is known of the older one."""


@dataclass(frozen=True)
class Found:
    """Causes of the differences from a prediction.

    Attributes:
        explanation: The innovations with these causes.
        drifts: How far the robot drifts, as far as is known now.
        jumps: Sudden changes by name, the surest first.
        sizes: Their sizes, in expected sizes of errors, and those of changes that may
            have come about instead.
    """

    explanation: Explanation
    drifts: tuple[DriftSize, ...]
    jumps: Mapping[str, Jump]
    sizes: Mapping[str, float]
    still: float
    noise: float

    def beside(self, first: Explanation, kinds: Collection[str]) -> Explanation:
        """The first explanation, with the sudden changes of some kinds beside it."""
        names = {name for name, jump in self.jumps.items() if jump.kind in kinds}
        causes = (c for c in self.explanation.causes if c.name in names)
        return replace(first, causes=(*first.causes, *causes))


@dataclass(frozen=True)
class Comparison:
    """New measurements beside what an older calibration predicts.

    Its state are the errors of the robot, and the frames of stations and tools that
    both have, as they are unless something was moved.

    Attributes:
        problem: The problem of the new measurements.
        theta: Parameter values about which it is linearized, shape (P,).
        older: The older calibration.
        state: The S parameters of the state.
        robot: Those of them that are errors of the robot, shape (S,).
        mean: Their values by the older calibration, in scales, shape (S,).
        covariance: Of these, shape (S, S).
        told: What the measurements tell of the state, with a row for each part of a
            frame that is known now and was not: W, shape (r, S), and values, (r,).
        measured: Number of the rows that are of measurements; they come first.
        noise: The noise by what was known of it, and the values that tell it.
        redundancy: Those of them that are of the new measurements.
        drifting: How the state drifts, shape (S, k), by the names of drifts.
        sudden: What may have changed at once, by name.
        wrong: What may be wrong of the measurements.
    """

    problem: Problem
    theta: Floats
    older: JointPrior
    state: tuple[Parameter, ...]
    robot: NDArray[np.bool_]
    mean: Floats
    covariance: Floats
    told: tuple[Floats, Floats]
    measured: int
    noise: tuple[float, float]
    redundancy: int
    drifting: Mapping[str, Floats]
    sudden: Mapping[str, Change]
    wrong: tuple[Sparse, ...]

    @staticmethod
    def of(
        problem: Problem,
        theta: Floats,
        older: JointPrior,
        start: CalibrationResult,
        noise: Sequence[NoiseSize],
    ) -> Comparison:
        """The comparison of the measurements of a problem, robot and frames at theta.

        Args:
            problem: The problem, without a prior.
            theta: Parameter values, shape (P,).
            older: The errors of the robot as the older calibration knew them.
            start: The older calibration.
            noise: The noise as it is known.
        """
        problem, theta = problem.rebased(theta)
        of_robot = problem.parameters.free & ~problem.parameters.nuisance
        frames = shared_frames(start.model, problem)
        values = {p.name: p.mean for p in older.parameters}
        values |= {name: value for frame in frames for name, value in frame.values}
        given = ParameterSet(
            tuple(
                replace(p, nuisance=False, scale=expected_size(p.unit))
                if p.nuisance and p.name in values
                else p
                for p in problem.given
            )
        )
        problem = replace(problem, given=given, units=_factors(problem, noise))
        rows = robot_rows(problem, theta, ())
        place = {p.name: k for k, p in enumerate(start.parameters)}
        sure = np.diag(start.covariance) == 0.0
        own = [p for p, of in zip(problem.parameters, rows.robot, strict=True) if of]
        known = [
            p
            for p in problem.parameters
            if p.name in values and not p.free and not sure[place[p.name]]
        ]
        state, index = (*own, *known), [place[p.name] for p in (*own, *known)]
        scales = np.array([p.scale for p in state])
        names = {p.name for p, of in zip(given, of_robot, strict=True) if of}
        robot = np.array([p.name in names for p in state])
        told, count, extra = rows.values, len(rows.values), len(known)
        W = np.zeros((count + extra, len(state)))
        W[:count, : len(own)] = rows.rows
        W[count:, len(own) :] = np.diag(scales[len(own) :] / KNOWN)
        groups = problem.data.groups()
        labels = np.unique(groups)

        def whole(directions: Floats) -> Floats:
            result = np.zeros((len(state), directions.shape[1]))
            result[robot] = directions
            return result

        sudden = {
            name: replace(change, directions=whole(change.directions))
            for name, change in changes(problem, of_robot).items()
        }
        every = np.eye(len(state))
        for frame in frames:
            named = {name for name, _ in frame.values}
            moved = [k for k, p in enumerate(state) if p.name in named]
            if moved:
                change = Change(frame.owner, frame.kind, every[:, moved])
                sudden[f"{frame.kind} {frame.owner}"] = change
        along = np.vstack([rows.along, np.zeros((extra, rows.along.shape[1]))])
        return Comparison(
            problem=problem,
            theta=theta,
            older=older,
            state=state,
            robot=robot,
            mean=np.array([values[p.name] for p in state]) / scales,
            covariance=np.asarray(start.covariance)[np.ix_(index, index)]
            / np.outer(scales, scales),
            told=(W, np.append(told, np.zeros(extra))),
            measured=count,
            noise=_noise(noise, rows),
            redundancy=rows.redundancy,
            drifting={n: whole(d) for n, d in drifts(problem, of_robot).items()},
            sudden=sudden,
            wrong=tuple(
                Sparse(
                    f"measurement {k}",
                    along[:, groups[problem.layout.row] == k],
                    WRONG,
                    1.0 / len(labels),
                )
                for k in labels.tolist()
            ),
        )

    @property
    def scales(self) -> Floats:
        """Scales of the state, shape (S,)."""
        return np.array([p.scale for p in self.state])

    def sparse(self, kinds: Collection[str]) -> tuple[Sparse, ...]:
        """Causes of some kinds that are there or not, and wrong measurements."""
        counts = Counter(change.kind for change in self.sudden.values())
        of_robot = (
            Sparse(
                name,
                self.told[0] @ change.directions,
                FAR if change.kind in FRAMES else SIZES,
                CHANCES[change.kind] / counts[change.kind],
            )
            for name, change in self.sudden.items()
            if change.kind in kinds
        )
        noisier = Sparse(NOISE_GREW, self._noise, NOISIER)
        return (*of_robot, *self.wrong, *([noisier] if NOISE_GREW in kinds else []))

    @property
    def _noise(self) -> Floats:
        """The noise of the measurements, shape (r, measured)."""
        return np.eye(len(self.told[1]))[:, : self.measured]

    def explanation(self, expected: Sequence[DriftSize]) -> Explanation:
        """The innovations, with drift and noise as they are expected."""
        W, values = self.told
        known = W @ self.covariance @ W.T
        known += np.eye(len(W)) - self._noise @ self._noise.T
        drifting = (
            Cause(
                d.name,
                W @ self.drifting[d.name],
                d.size,
                d.worth,
                max(MOST.get(d.name, 0.0), d.size),
            )
            for d in expected
        )
        noise = Cause(NOISE_NAME, self._noise, *self.noise, np.inf)
        return Explanation(values - W @ self.mean, known, (*drifting, noise))

    def explained(
        self, first: Explanation, expected: Sequence[DriftSize], still: float
    ) -> Found:
        """Drift, noise, sudden changes and wrong measurements that explain it best.

        All of a joint or of the robot explains nearly everything, and so does noise:
        what has been found with them is compared with the best of few simple changes.

        Args:
            first: The innovations, see `explanation`.
            expected: The drift that it expects.
            still: Logarithm of the evidence so far that the robot does not drift.
        """
        best = explained(first, self.sparse(SIMPLE), SURE, JUMPS)
        for kinds in ((*SIMPLE, NOISE_GREW), (*CHANCES, NOISE_GREW)):
            tried = explained(first, self.sparse(kinds), SURE, JUMPS)
            best = max(best, tried, key=lambda found: found.evidence)
        found = best.explanation
        names = {drift.name for drift in expected}
        alone = first.without(names)
        quiet, _ = found.without(names).fitted()
        still += quiet.likelihood + alone.expected(quiet)
        still -= found.likelihood + first.expected(found)
        drifting = still <= 0.0 or not np.isfinite(expected[0].worth)
        _, told = found.fitted()
        drifts = tuple(
            replace(drift, size=cause.size, worth=min(drift.worth + count, REMEMBERED))
            if np.isfinite(drift.worth)
            else drift
            for drift, cause, count in zip(expected, found.causes, told, strict=False)
        )
        found = found if drifting else quiet
        jumps = [cause for cause in best.causes if cause.name in self.sudden]
        taken = {cause.name for cause in jumps}
        sizes = {cause.name: cause.size for cause in jumps}
        named = {}
        for cause in jumps:
            rivals = {
                c.name: c
                for c in (*best.rivals[cause.name], *self._inseparable(found, cause))
                if c.name not in taken and self._simple(c.name)
            }
            sizes = {name: c.size for name, c in rivals.items()} | sizes
            instead = tuple(map(self._label, rivals))
            beside = tuple(self._hidden(cause.name, {*taken, *rivals}))
            jump = self._jump(found, cause)
            named[cause.name] = replace(jump, instead=instead, beside=beside)
        return Found(found, drifts, named, sizes, still, self._grown(found))

    def _grown(self, found: Explanation) -> float:
        """The noise by what was known: as all show it, or more as these do by chance."""
        k = [cause.name for cause in found.causes].index(NOISE_NAME)
        size, told = found.causes[k].size, max(found.fitted()[1][k], 1.0)
        _, worth = self.noise
        alone = ((worth + told) * size**2 - worth + self.redundancy) / (
            told + self.redundancy
        )
        return float(np.sqrt(max(size**2, alone)))

    def _simple(self, name: str) -> bool:
        return name in self.sudden and self.sudden[name].kind in SIMPLE

    def _label(self, name: str) -> str:
        """A change in words."""
        change = self.sudden[name]
        if change.kind in FRAMES:
            return f"{change.kind} '{change.joint}'" if change.joint else change.kind
        return f"joint '{change.joint}'"

    def _inseparable(self, found: Explanation, cause: Cause) -> Iterator[Cause]:
        """Changes that explain a simple one as well, if they may have any size."""
        if not self._simple(cause.name):
            return
        without = found.without({cause.name})
        limit = without.misfit(cause.effects) + CLOSE
        for name, change in self.sudden.items():
            effects = self.told[0] @ change.directions
            if self._simple(name) and without.misfit(effects) <= limit:
                yield Cause(name, effects, cause.size, np.inf)

    def _hidden(self, name: str, others: Collection[str]) -> Iterator[str]:
        """Joints whose offset moves the tool as a frame that has moved does."""
        if self.sudden[name].kind not in FRAMES:
            return
        E = self.told[0] @ self.sudden[name].directions
        for other, change in self.sudden.items():
            if change.kind == "offset" and other not in others:
                moved = self.told[0] @ change.directions
                rest = moved - E @ np.linalg.lstsq(E, moved, rcond=None)[0]
                if np.linalg.norm(rest) <= SAME * np.linalg.norm(moved):
                    yield self._label(other)

    def _jump(self, found: Explanation, cause: Cause) -> Jump:
        """A sudden change as the innovations tell it."""
        change = self.sudden[cause.name]
        effects, covariance = found.effects(cause)
        if change.kind == "offset":
            size = float(change.size)
            sigma = size * float(covariance[0, 0]) ** 0.5
            return Jump(
                change.joint, "offset", change.unit, size * float(effects[0]), sigma
            )
        moved = change.directions @ effects * self.scales
        shift, turn = (
            float(np.linalg.norm([x for x, p in pairs if p.unit == unit]))
            for unit in ("m", "rad")
            for pairs in [list(zip(moved, self.state, strict=True))]
        )
        return Jump(change.joint, change.kind, "m", shift, np.nan, turn)

    def after(self, found: Found) -> tuple[Floats, Floats]:
        """The state in scales by these measurements as well, and its covariance."""
        W, causes = self.told[0], found.explanation
        ways = {**self.drifting, **{n: c.directions for n, c in self.sudden.items()}}
        C = self.covariance.copy()
        for cause in causes.causes:
            if cause.name in ways:
                half = cause.size * ways[cause.name]
                C += half @ half.T
        gain = np.linalg.solve(causes.covariance, W @ C).T
        return self.mean + gain @ causes.values, C - gain @ W @ C

    def robot_after(self, found: Found) -> Floats:
        """The errors of the robot by these measurements as well, shape (K,)."""
        return np.asarray((self.after(found)[0] * self.scales)[self.robot])

    def tool_error(self, found: Found, seed: int = 0) -> float:
        """Expected error of the tool by the older calibration now, rms [m].

        Over the workspace, displacements of base and tool left aside.
        """
        part = self.problem.moving
        q = part.error.chain.random_configurations(SAMPLES, np.random.default_rng(seed))
        _, J = part.error.jacobian(q, self.theta[part.of_error])
        place = {p.name: k for k, p in enumerate(self.problem.given)}
        column = {k: i for i, k in enumerate(part.of_error)}
        mean, covariance = self.after(found)
        squares, vectors = np.linalg.eigh(covariance)
        half = vectors * np.sqrt(np.maximum(squares, 0.0))
        moved = np.column_stack([mean - self.mean, half]) * self.scales[:, None]
        own = np.zeros((J.shape[2], moved.shape[1]))
        for k in np.flatnonzero(self.robot):
            if (at := column.get(place[self.state[k].name])) is not None:
                own[at] = moved[k]
        twists = without_frames(J @ own, J)[:, :3]
        return float(np.sqrt(np.sum(twists**2) / len(q)))

    def prior(self, found: Found) -> JointPrior:
        """The prior of the new calibration, wider by drift and sudden changes."""
        # A single change tells little of the size that such changes have.
        sudden = (
            (max(size, 1.0), self.sudden[name].directions)
            for name, size in found.sizes.items()
        )
        drifted = (
            (cause.size, self.drifting[cause.name])
            for cause in found.explanation.causes
            if cause.name in self.drifting
        )
        effects = [(size, way[self.robot]) for size, way in (*drifted, *sudden)]
        noise = {n: found.noise * sigma for n, sigma in self.older.noise.items()}
        older = replace(self.older, noise=noise)
        return wider(older, self.scales[self.robot], effects)


def _noise(noise: Sequence[NoiseSize], rows: RobotRows) -> tuple[float, float]:
    """The noise by what was known of it, and the values that tell it."""
    worth, count = sum(one.worth for one in noise), rows.redundancy
    worth = min(max(worth, 1.0), NOISE)
    # Wrong measurements are sought by themselves.
    rest = min(rows.rest, GROWN**2 * count)
    return float(np.sqrt((worth + rest) / (worth + count))), worth + count


def _factors(problem: Problem, noise: Sequence[NoiseSize]) -> Floats:
    """Noise of every quantity by what is stated now, where it is known to be larger.

    What a robot does that no parameter describes is there whatever the instrument
    states.
    """
    sigmas = {one.quantity: one.sigma for one in noise}
    found = np.ones(len(problem.layout.components))
    for k, component in enumerate(problem.layout.components):
        own = problem.given_sigma[problem.layout.of_components[k]]
        sigma = sigmas.get(component.quantity.name, 0.0)
        given = float(np.sqrt(np.mean(own**2))) if len(own) else sigma
        found[k] = max(sigma / given, 1.0) if sigma > 0.0 else 1.0
    return found
