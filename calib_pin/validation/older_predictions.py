"""New measurements beside what an older calibration predicts of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib_pin.estimation.problem import Problem
from calib_pin.estimation.robot_rows import RobotRows, robot_rows
from calib_pin.estimation.statistics.innovations import (
    Cause,
    Explanation,
    Sparse,
    explained,
)
from calib_pin.kinematics.spatial import Floats
from calib_pin.setup import JointPrior
from calib_pin.validation.joint_changes import Change, changes, drifts
from calib_pin.validation.older_calibration import EXPECTED, NOISE, wider
from calib_pin.validation.summaries import DriftSize, Jump, NoiseSize

REMEMBERED = 50.0
"""Errors that a drift is worth at most: in a year it may be another one."""

BEYOND = 4.0
"""Drift, in expected sizes, from which it is none: the robot has been changed."""

SURE = 30.0
"""Evidence for a sudden change by that for none from which it is told.

By chance as much comes about in at most one of 30 calibrations (Markov's inequality,
which is wide: of 704 simulated weeks without a change one was told to have one)."""

CHANCES = {"offset": 1.0, "placement": 0.05, "robot": 0.05}
"""How likely kinds of sudden changes are beside each other: a joint that was hit slips
on its axis first of all."""

JUMPS = 4
"""Most causes beside drift and noise that are told, sudden changes and wrong
measurements."""

SIZES = np.geomspace(0.03, 10.0, 16)
"""Sizes of sudden changes, in expected sizes of errors: from 30 um and 90 urad on."""

WRONG = np.geomspace(3.0, 1e4, 16)
"""Errors of measurements that are wrong, in standard deviations."""

NOISIER = np.geomspace(1.0, 30.0, 8)
"""Further noise of another instrument, by what is known of the older one."""


@dataclass(frozen=True)
class Found:
    """Causes of the differences from a prediction.

    Attributes:
        drifts: How far the robot drifts, as far as is known now.
        jumps: Sudden changes by name, the surest first.
        sizes: Their sizes, in expected sizes of errors, and those of joints that may
            have been hit instead.
    """

    drifts: tuple[DriftSize, ...]
    jumps: Mapping[str, Jump]
    sizes: Mapping[str, float]


@dataclass(frozen=True)
class Comparison:
    """New measurements beside what an older calibration predicts.

    Attributes:
        older: The older calibration.
        scales: Scales of its parameters, shape (K,).
        told: What the measurements tell of these.
        covariance: Of the scaled parameters, shape (K, K).
        noise: Values that tell the noise.
        drifting: How the scaled parameters drift, shape (K, k), by the names of drifts.
        sudden: What may have changed at once, by name.
        wrong: What may be wrong of the measurements.
    """

    older: JointPrior
    scales: Floats
    told: RobotRows
    covariance: Floats
    noise: float
    drifting: Mapping[str, Floats]
    sudden: Mapping[str, Change]
    wrong: tuple[Sparse, ...]

    @staticmethod
    def of(
        problem: Problem,
        theta: Floats,
        older: JointPrior,
        noise: Sequence[NoiseSize],
    ) -> Comparison:
        """The comparison of the measurements of a problem, robot and frames at theta.

        Args:
            problem: The problem, without a prior.
            theta: Parameter values, shape (P,).
            older: The errors of the robot as the older calibration knew them.
            noise: The noise as it is known.
        """
        problem = replace(problem, units=_factors(problem, noise))
        told = robot_rows(problem, theta, ())
        parameters = problem.parameters
        scales = parameters.scales[told.robot]
        rows, groups = problem.layout.row, problem.data.groups()
        labels = np.unique(groups)
        return Comparison(
            older=older,
            scales=scales,
            told=told,
            covariance=np.array(older.covariance) / np.outer(scales, scales),
            noise=min(max(sum(one.worth for one in noise), 1.0), NOISE),
            drifting=drifts(problem, told.robot),
            sudden=changes(problem, told.robot),
            wrong=tuple(
                Sparse(
                    f"measurement {k}",
                    told.along[:, groups[rows] == k],
                    WRONG,
                    1.0 / len(labels),
                )
                for k in labels.tolist()
            ),
        )

    @property
    def sparse(self) -> tuple[Sparse, ...]:
        """Causes that are there or not: of the robot, and of the measurements."""
        kinds = Counter(change.kind for change in self.sudden.values())
        of_robot = (
            Sparse(
                name,
                self.told.rows @ change.directions,
                SIZES,
                CHANCES[change.kind] / kinds[change.kind],
            )
            for name, change in self.sudden.items()
        )
        noisier = Sparse("noisier", np.eye(len(self.told.values)), NOISIER)
        return (*of_robot, *self.wrong, noisier)

    def explanation(self, expected: Sequence[DriftSize]) -> Explanation:
        """The innovations, with drift and noise as they are expected."""
        W, K = self.told.rows, len(self.told.values)
        usual = {drift.name: drift.size for drift in EXPECTED}
        mean = np.array([p.mean for p in self.older.parameters]) / self.scales
        return Explanation(
            self.told.values - W @ mean,
            W @ self.covariance @ W.T,
            (
                *(
                    Cause(
                        d.name,
                        W @ self.drifting[d.name],
                        d.size,
                        d.worth,
                        max(BEYOND * usual.get(d.name, 0.0), d.size),
                    )
                    for d in expected
                ),
                Cause("noise", np.eye(K), 1.0, self.noise, np.inf),
            ),
        )

    def explained(self, first: Explanation, expected: Sequence[DriftSize]) -> Found:
        """Drift, noise, sudden changes and wrong measurements that explain it best.

        Args:
            first: The innovations, see `explanation`.
            expected: The drift that it expects.
        """
        found, sparse, rivals = explained(first, self.sparse, SURE, JUMPS)
        _, told = found.fitted()
        drifts = tuple(
            replace(drift, size=cause.size, worth=min(drift.worth + count, REMEMBERED))
            if np.isfinite(drift.worth)
            else drift
            for drift, cause, count in zip(expected, found.causes, told, strict=False)
        )
        jumps = [cause for cause in sparse if cause.name in self.sudden]
        offsets = {name for name, c in self.sudden.items() if c.kind == "offset"}
        instead = [cause for cause in rivals if cause.name in offsets]
        return Found(
            drifts,
            {cause.name: self._jump(found, cause) for cause in jumps},
            {cause.name: cause.size for cause in (*jumps, *instead)},
        )

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
        lengths = np.array([p.unit == "m" for p in self.older.parameters])
        angles = np.array([p.unit == "rad" for p in self.older.parameters])
        shift, turn = (float(np.linalg.norm(moved[of])) for of in (lengths, angles))
        return Jump(change.joint, change.kind, "m", shift, np.nan, turn)

    def prior(self, found: Found) -> JointPrior:
        """The prior of the new calibration, wider by drift and sudden changes."""
        # A single change tells little of the size that such changes have.
        sudden = (
            (max(size, 1.0), self.sudden[name].directions)
            for name, size in found.sizes.items()
        )
        drifted = ((drift.size, self.drifting[drift.name]) for drift in found.drifts)
        return wider(self.older, self.scales, [*drifted, *sudden])


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
