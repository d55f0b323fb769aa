"""New measurements beside what an older calibration predicts of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib_pin.estimation.problem import Problem
from calib_pin.estimation.robot_rows import robot_rows
from calib_pin.estimation.statistics.innovations import (
    Cause,
    Explanation,
    Sparse,
    explained,
)
from calib_pin.kinematics.spatial import Floats
from calib_pin.parameterizations.base import expected_size
from calib_pin.parameters import ParameterSet
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

SAME = 0.01
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
        drifted: How far it has drifted since, by how likely it is that it does.
        jumps: Sudden changes by name, the surest first.
        sizes: Their sizes, in expected sizes of errors, and those of changes that may
            have come about instead.
        still: Logarithm of the evidence that the robot does not drift.
        noise: The noise by what was known of it.
        square: Chi-square of the prediction, beside frames that have moved.
    """

    explanation: Explanation
    drifts: tuple[DriftSize, ...]
    drifted: Mapping[str, float]
    jumps: Mapping[str, Jump]
    sizes: Mapping[str, float]
    still: float
    noise: float
    square: float


class Comparison:
    """New measurements beside what an older calibration predicts.

    That is of the errors of the robot, and of the frames of stations and tools that
    both have: they are as they were, unless something was moved.

    Attributes:
        older: The older calibration.
        parameters: All P parameters, frames among the errors of the robot.
        robot: The errors of the robot among them, shape (P,).
        mean: What the older calibration knew, in scales, shape (P,).
        covariance: Of that, shape (P, P).
        rows: W, what measurements see of the parameters in scales, and below that the
            frames which are known now and were not, shape (r, P).
        values: Their values, shape (r,).
        measured: Noise of the measurements in the rows, shape (r, m).
        noise: Values that tell the noise.
        drifting: How the parameters drift, shape (P, k), by the names of drifts.
        sudden: What may have changed at once, by name.
        wrong: What may be wrong of the measurements.
    """

    def __init__(
        self,
        problem: Problem,
        theta: Floats,
        older: JointPrior,
        start: CalibrationResult,
        noise: Sequence[NoiseSize],
    ) -> None:
        """Compare the measurements of a problem, robot and frames at theta.

        Args:
            problem: The problem, without a prior.
            theta: Parameter values, shape (P,).
            older: The errors of the robot as the older calibration knew them.
            start: The older calibration.
            noise: The noise as it is known.
        """
        problem, theta = problem.rebased(theta)
        self.robot = problem.parameters.free & ~problem.parameters.nuisance
        frames = shared_frames(start.model, problem)
        place = {name: k for k, name in enumerate(problem.given.names)}
        moved = {name: x for frame in frames.values() for name, x in frame.items()}
        given = list(problem.given)
        for k in map(place.__getitem__, moved):
            scale = expected_size(given[k].unit)
            given[k] = replace(given[k], nuisance=False, scale=scale)
        units = _factors(problem, noise)
        problem = replace(problem, given=ParameterSet(tuple(given)), units=units)
        self.older, self.parameters = older, problem.parameters
        scales = self.parameters.scales
        known = {p.name: p.mean for p in older.parameters} | moved
        self.mean = np.array([known.get(name, 0.0) for name in place]) / scales
        here = [place[p.name] for p in start.parameters if p.name in known]
        there = [k for k, p in enumerate(start.parameters) if p.name in known]
        C = np.zeros((len(scales), len(scales)))
        C[np.ix_(here, here)] = np.asarray(start.covariance)[np.ix_(there, there)]
        self.covariance = C / np.outer(scales, scales)
        told = robot_rows(problem, theta, ())
        count = len(told.values)
        stated = ~self.parameters.free & (np.diag(C) > 0.0)
        below = np.diag(scales / KNOWN)[stated]
        self.rows = np.vstack([np.zeros((count, len(scales))), below])
        self.rows[:count, told.robot] = told.rows
        self.measured = np.eye(len(self.rows))[:, :count]
        self.values = self.measured @ told.values
        self.noise = min(max(sum(one.worth for one in noise), 1.0), NOISE)
        self.drifting = drifts(problem, self.robot)
        self.sudden = dict(changes(problem, self.robot))
        for (kind, name), frame in frames.items():
            effects = np.eye(len(scales))[:, [place[n] for n in frame]]
            self.sudden[f"{kind} {name}"] = Change(name, kind, effects)
        of_rows = problem.data.groups()[problem.layout.row]
        labels = np.unique(problem.data.groups()).tolist()
        along = [self.measured @ told.along[:, of_rows == k] for k in labels]
        self.wrong = tuple(
            Sparse(f"measurement {k}", effects, WRONG, 1.0 / len(labels))
            for k, effects in zip(labels, along, strict=True)
        )

    def sparse(self, kinds: Collection[str]) -> tuple[Sparse, ...]:
        """Causes of some kinds that are there or not, and wrong measurements."""
        counts = Counter(change.kind for change in self.sudden.values())
        of_robot = (
            Sparse(
                name,
                self.rows @ change.directions,
                FAR if change.kind in FRAMES else SIZES,
                CHANCES[change.kind] / counts[change.kind],
            )
            for name, change in self.sudden.items()
            if change.kind in kinds
        )
        noisier = Sparse(NOISE_GREW, self.measured, NOISIER)
        return (*of_robot, *self.wrong, *([noisier] if NOISE_GREW in kinds else []))

    def explanation(self, expected: Sequence[DriftSize]) -> Explanation:
        """The innovations, with drift and noise as they are expected."""
        W, M = self.rows, self.measured
        known = W @ self.covariance @ W.T + np.eye(len(W)) - M @ M.T
        drifting = (
            Cause(d.name, W @ self.drifting[d.name], d.size, d.worth, max(most, d.size))
            for d in expected
            for most in [MOST.get(d.name, 0.0)]
        )
        noise = Cause(NOISE_NAME, M, 1.0, self.noise, np.inf)
        return Explanation(self.values - W @ self.mean, known, (*drifting, noise))

    def explained(self, expected: Sequence[DriftSize], still: float) -> Found:
        """Drift, noise, sudden changes and wrong measurements that explain it best.

        All of a joint or of the robot explains nearly everything, and so does noise:
        what has been found with them is compared with the best of few simple changes.

        Args:
            expected: The drift that is expected.
            still: Logarithm of the evidence so far that the robot does not drift.
        """
        first = self.explanation(expected)
        families = SIMPLE, (*SIMPLE, NOISE_GREW), (*CHANCES, NOISE_GREW)
        tried = (explained(first, self.sparse(f), SURE, JUMPS) for f in families)
        found, sparse, _ = max(tried, key=lambda one: one[2])
        names = {drift.name for drift in expected}
        calm, _ = found.without(names).fitted()
        still += calm.likelihood + first.without(names).expected(calm)
        still -= found.likelihood + first.expected(found)
        _, told = found.fitted()
        drifts = tuple(
            replace(drift, size=cause.size, worth=min(drift.worth + count, REMEMBERED))
            if np.isfinite(drift.worth)
            else drift
            for drift, cause, count in zip(expected, found.causes, told, strict=False)
        )
        drifted = {drift.name: drift.size for drift in drifts}
        if np.isfinite(expected[0].worth):
            # A robot that may drift is as uncertain as that is likely; and squares of
            # sizes that few errors tell are larger in the mean than their likeliest.
            part = float(np.exp(-np.logaddexp(0.0, still)))
            for d in drifts:
                drifted[d.name] *= (part * d.worth / max(d.worth - 2.0, 1.0)) ** 0.5
            found = calm if still > 0.0 else found
        sudden = [cause for cause in sparse if cause.name in self.sudden]
        others = {c.name: self._others(found, c, sudden) for c in sudden}
        sizes = {name: c.size for c in sudden for name in (c.name, *others[c.name][0])}
        jumps = {c.name: self._jump(found, c, *others[c.name]) for c in sudden}
        # Beside what all have shown, as much more as these show by chance.
        more = max(found.square / len(self.values), 1.0) ** 0.5
        noise = more * next(c.size for c in found.causes if c.name == NOISE_NAME)
        # A tracker that was set up anew is no error of the prediction.
        moved = (c for c in sudden if self.sudden[c.name].kind in FRAMES)
        square = replace(first, causes=(*first.causes, *moved)).square
        return Found(found, drifts, drifted, jumps, sizes, float(still), noise, square)

    def _others(
        self, found: Explanation, cause: Cause, sudden: Sequence[Cause]
    ) -> tuple[list[str], list[str]]:
        """Simple changes that may have come about in place of a simple one.

        And offsets of joints that would not show beside a frame that has moved.
        """
        kind, E = self.sudden[cause.name].kind, cause.effects
        instead, beside = list[str](), list[str]()
        without = found.without({cause.name})
        limit = without.misfit(E) + CLOSE
        taken = {other.name for other in sudden}
        for name, change in self.sudden.items():
            moved = self.rows @ change.directions
            # Nothing that is measured now depends on where a known frame has stood.
            seen = (self.measured.T @ moved).any()
            if name in taken or not (seen and {kind, change.kind} <= set(SIMPLE)):
                continue
            rest = moved - E @ np.linalg.lstsq(E, moved, rcond=None)[0]
            if without.misfit(moved) <= limit:
                instead.append(name)
            elif np.linalg.norm(rest) < SAME * np.linalg.norm(moved):
                beside.append(name)
        return instead, beside

    def _label(self, name: str) -> str:
        """A change in words."""
        change = self.sudden[name]
        word = change.kind if change.kind in FRAMES else "joint"
        return f"{word} '{change.joint}'" if change.joint else word

    def _jump(self, found: Explanation, cause: Cause, *others: Sequence[str]) -> Jump:
        """A sudden change as the innovations tell it, and what it may be instead."""
        change, parameters = self.sudden[cause.name], self.parameters
        effects, covariance = found.effects(cause)
        moved = change.directions @ effects * parameters.scales
        shift, turn = (
            float(np.linalg.norm(moved[[p.unit == unit for p in parameters]]))
            for unit in ("m", "rad")
        )
        unit, sigma = "m", np.nan
        if change.kind == "offset":
            unit, sigma = change.unit, change.size * float(covariance[0, 0]) ** 0.5
            shift, turn = change.size * float(effects[0]), 0.0
        words = (tuple(map(self._label, names)) for names in others)
        return Jump(change.joint, change.kind, unit, shift, sigma, turn, *words)

    def prior(self, found: Found) -> JointPrior:
        """The prior of the new calibration, wider by drift and sudden changes."""
        # A single change tells little of the size that such changes have.
        sudden = (
            (max(size, 1.0), self.sudden[name].directions)
            for name, size in found.sizes.items()
        )
        drifted = ((size, self.drifting[n]) for n, size in found.drifted.items())
        effects = [(size, way[self.robot]) for size, way in (*drifted, *sudden)]
        noise = {n: found.noise * sigma for n, sigma in self.older.noise.items()}
        scales = self.parameters.scales[self.robot]
        return wider(replace(self.older, noise=noise), scales, effects)


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
