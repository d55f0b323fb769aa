"""How far the tool of a robot is off at configurations, as a fit knows it.

By the noise of the measurements alone, and by all that is known of the errors.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import starmap
from math import erf

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.estimation.evidence import ExpectedAccuracy, PoseErrors, TipAccuracy, rms
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.terms import Term
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations
from calib_pin.setup import JointPrior
from calib_pin.setup.population import PoseSizes
from calib_pin.validation.result import ToolAccuracy

SAMPLES, MEASURED = 300, 100
"""Configurations that stand for the workspace, and most measured ones."""

FRAMES = np.r_[0:6, -6:0]
"""Columns of base and tool in an error model."""

LEVER = 1e-4
"""Weight of a radian where frames are fitted to poses [m].

So little that positions decide, and orientations only what positions leave open: where
only positions were measured, orientations are known poorly or not at all.
"""

LIKELY, DRAWS = 0.95, 400
"""Probability of a bound, and from which a configuration counts as better; and draws of
an error by which a bound is found, for each size of errors."""


@serial_blas
def tool_accuracy(fitted: Fit, expecting: Fit, term: Term, seed: int) -> ToolAccuracy:
    """The accuracy to expect of a chain where it was measured and elsewhere.

    Args:
        fitted: The fit.
        expecting: It with all that is known to move the tool. What models of two
            calibrations both lack is no part of the noise that sets them apart.
        term: A term of the chain about the solution.
        seed: Seed of configurations and errors.
    """
    rng, data = np.random.default_rng(seed), fitted.problem.data
    term = replace(term, error=term.error.carrying(fitted.problem.setup.heaviest))
    spread = term.error.chain.random_configurations(SAMPLES, rng)
    tip, measured = ToolErrors.of(fitted, term, spread).by_noise(), None
    if not expecting.noise:
        return ToolAccuracy(tip)
    prior, known = expecting.problem.setup.prior, ((0.0, 0.0), (0.0, 0.0))
    if isinstance(prior, JointPrior):
        known = prior.unmodeled.get(term.key.chain, known)
    counting = data.rows(data.weight > 0.0).blocks
    if blocks := tuple(block for block in counting if block.chain == term.key.chain):
        # Of an image, whose rows follow one another, one stands for the configuration.
        rows = Observations(blocks)
        again = np.append(False, (rows.q[1:] == rows.q[:-1]).all(axis=1))
        q = rows.rows(~again).sample(MEASURED).q[:, term.columns]
        measured = ToolErrors.of(expecting, term, q).expected(rng, known[0])
    everywhere = ToolErrors.of(expecting, term, spread).expected(rng, known[1])
    return ToolAccuracy(tip, measured, everywhere)


@dataclass(frozen=True)
class ToolErrors:
    """Errors of a tool at configurations, to first order in those of the parameters.

    About the references of a fit, to which its deviations belong.

    Attributes:
        fit: The fit.
        term: A term about the solution of the fit, of the chain.
        q: Configurations of the chain, shape (N, n) [rad, m].
        poses: Tool in the measurement frame, shape (N, 4, 4).
        J: Body twists there by the parameters of the term's error model, the first six
            of the base and the last six of the tool, shape (N, 6, p).
    """

    fit: Fit
    term: Term
    q: Floats
    poses: Floats
    J: Floats

    @classmethod
    def of(cls, fit: Fit, term: Term, q: Floats) -> ToolErrors:
        """Those of a chain by a fit; arguments as the attributes."""
        reference = fit.problem.terms[term.key].error
        error = term.error.with_frames(reference.base, reference.tool)
        return cls(fit, term, q, *error.jacobian(q, fit.theta[term.of_error]))

    def by_noise(self) -> TipAccuracy | None:
        """The error that the noise leaves; None for a fit without redundancy."""
        fit, T = self.fit, self.poses
        known = np.isfinite(fit.covariance).all() and fit.dof > 0
        if not known or fit.directions.count == 0:
            return None
        twists = fit.posterior.twists(self.term, self.q, self.J)
        position, orientation = errors = _deviations(twists)
        alone = _deviations(without_frames(twists, self.J))
        sizes = (PoseErrors(*map(rms, each)) for each in (errors, alone))
        to_base = self.term.error.base.inverse().homogeneous
        points = T[:, :3, 3] @ to_base[:3, :3].T + to_base[:3, 3]
        return TipAccuracy(self.q, points, position, orientation, *sizes)

    def expected(
        self, rng: np.random.Generator, known: PoseSizes = (0.0, 0.0)
    ) -> ExpectedAccuracy:
        """Accuracy of the nominal and the corrected robot by all that is known.

        With the mean mu and the covariance C of the errors, and G the mean of `J^T J`,
        the nominal robot's expected square is `mu^T G mu + tr(G C)` and that of the
        corrected one `tr(G C)`. Their difference for the true errors, `mu^T G mu + 2
        mu^T G z` with `z ~ N(0, C)`, is normal, and so is the probability that the
        corrected robot is the better one. All is averaged over the likely sizes of
        errors.

        Args:
            rng: Draws the errors by which the bound is found.
            known: Errors that an older calibration knows and no parameter describes,
                which a few new measurements hardly show.
        """
        fit, J, index = self.fit, self.J, self.term.of_error
        parameters = fit.problem.parameters
        scales, nuisance = parameters.scales[index], parameters.nuisance[index]
        robot = parameters.free[index] & ~nuisance
        J_robot = without_frames(J * scales, J)[:, :, robot]
        effects = np.zeros((*J.shape[:2], 0))
        if fit.effects is not None:
            absorbed = fit.posterior.by_effects[index]
            absorbed = J @ np.where(nuisance[:, None], 0.0, absorbed)
            twists = fit.effects.twists(self.term, self.q)
            effects = without_frames(absorbed - twists, J)
        mean, robot_scales = (fit.theta[index] / scales)[robot], scales[robot, None]
        likely = (p.by_noise[index[robot]] for p in fit.likely_posteriors)
        C = np.array([half @ half.T for half in (by / robot_scales for by in likely)])
        pair, parts = [], (slice(0, 3), slice(3, 6))
        for k, unit, before in zip(parts, ("m", "rad"), known, strict=True):
            square = float(np.sum(effects[:, k] ** 2)) / len(J)
            scatter = max(_scatter(fit, self.term, unit), (before**2 - square) / 3.0)
            pair.append(_sizes(mean, J_robot[:, k], effects[:, k], scatter, C, rng))
        nominal, calibrated, bound, unmodeled = starmap(
            PoseErrors, zip(*pair, strict=True)
        )
        better, share = _odds(mean, J_robot[:, :3], effects[:, :3], C)
        return ExpectedAccuracy(nominal, calibrated, bound, unmodeled, better, share)


def _sizes(
    mean: Floats,
    J: Floats,
    effects: Floats,
    scatter: float,
    C: Floats,
    rng: np.random.Generator,
) -> list[float]:
    """Errors of position or orientation: nominal, calibrated, bound, and unmodeled.

    Args:
        mean: The estimated errors, shape (p,).
        J: Derivative by the scaled errors of the robot, shape (N, 3, p).
        effects: Errors by independent effects that the model lacks, beyond the part
            that the fit has absorbed, shape (N, 3, S).
        scatter: Variance of each component that is left beside these.
        C: Covariances of the errors for several sizes of them, shape (S, p, p).
        rng: Random generator of the bound.
    """
    G = np.einsum("ndi,ndj->ij", J, J, optimize=True) / len(J)
    # In an order that no rounding changes, as each meets draws of its own.
    squares = [np.sort(np.maximum(np.linalg.eigvals(G @ c).real, 0.0)) for c in C]
    residual = float(np.mean([s.sum() for s in squares]))
    by_effects = np.einsum("ndi,ndj->ij", effects, effects, optimize=True) / len(J)
    lacking = np.maximum(np.linalg.eigvalsh(by_effects), 0.0)
    variances = (np.concatenate([s, lacking]) for s in squares)
    draws = [s @ rng.chisquare(1.0, (len(s), DRAWS)) for s in variances]
    # At so many configurations, what scatters is about its mean.
    others = float(lacking.sum()) + 3.0 * scatter
    gain = np.sum((J @ mean) ** 2, axis=1).mean()
    bound = np.quantile(np.concatenate(draws), LIKELY) + 3.0 * scatter
    sizes = np.sqrt([gain + residual + others, residual + others, bound, others])
    return [float(size) for size in sizes]


def _odds(mean: Floats, J: Floats, effects: Floats, C: Floats) -> tuple[float, float]:
    """Probability of the corrected robot to be better, and share where it surely is.

    The differences of single configurations, and of the whole, are normal along one
    direction of the errors each: `gain + 2 (along^T z + beside^T g)`, errors `z ~ N(0,
    C)` with all C equally likely, effects `g ~ N(0, I)`.
    """
    moved = J @ mean
    slopes = (np.einsum("nd,ndi->ni", moved, A) for A in (J, effects))
    parts = np.sum(moved**2, axis=1), *slopes
    # The last one is the whole.
    gain, along, beside = (np.concatenate([p, p.mean(axis=0)[None]]) for p in parts)
    variances = np.sum((along @ C) * along, axis=2) + np.sum(beside**2, axis=1)
    ratios = gain / np.sqrt(np.maximum(8.0 * variances, 1e-300))
    chances = 0.5 + 0.5 * np.vectorize(erf)(ratios).mean(axis=0)
    return float(chances[-1]), float(np.mean(chances[:-1] >= LIKELY))


def _scatter(fitted: Fit, term: Term, unit: str) -> float:
    """Variance of a component that neither noise nor the known effects explain.

    Of the first quantity in a unit that the chain of a part is measured by; zero where
    noise is neither stated nor repeated, so that nothing tells both apart.
    """
    of_keys = fitted.problem.layout.of_keys.items()
    own = np.concatenate([ks for key, ks in of_keys if key.chain == term.key.chain])
    for k in np.unique(own).tolist():
        if (noise := fitted.noise[k]).unit == unit:
            variance = (noise.unmodeled or 0.0) ** 2
            if fitted.effects is not None:
                explained = max(1.0 - float(fitted.effects.noise[k]), 0.0)
                variance -= explained * (noise.factor * noise.given) ** 2
            return max(variance, 0.0)
    return 0.0


def _deviations(twists: Floats) -> tuple[Floats, Floats]:
    """Of position and orientation, by independent twists, shape (N, 6, k)."""
    squares = np.sum(twists**2, axis=2)
    position, orientation = np.split(squares, [3], axis=1)
    return np.sqrt(position.sum(axis=1)), np.sqrt(orientation.sum(axis=1))


def without_frames(twists: Floats, J: Floats) -> Floats:
    """Twists of the tool without what base and tool could absorb of each.

    Args:
        twists: Body twists of the tool, shape (N, 6, k).
        J: Those by the parameters of an error model, the first six of the base and the
            last six of the tool, shape (N, 6, P).
    """
    return np.asarray(twists - J[:, :, FRAMES] @ frame_motions(twists, J))


def frame_motions(twists: Floats, J: Floats) -> Floats:
    """The motions of base and tool that come closest to twists of the tool, (12, k).

    Arguments as for `without_frames`.
    """
    lever = np.repeat([1.0, LEVER], 3)[:, None]
    rows = (twists * lever).reshape(-1, twists.shape[2])
    F = (J[:, :, FRAMES] * lever).reshape(-1, 12)
    # Of thousands of rows the normal equations take a tenth of the time, and a lever of
    # 1e-4 leaves them digits enough.
    inverse = np.linalg.pinv(F.T @ F, rcond=1e-13, hermitian=True)
    return np.asarray(inverse @ (F.T @ rows))
