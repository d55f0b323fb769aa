"""Predicted tool-point uncertainty over the workspace."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.estimation.evidence import PoseErrors, TipAccuracy, rms
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.spatial import Floats

if TYPE_CHECKING:
    from calib_pin.estimation.fitted import Fit

SAMPLES = 300
"""Configurations that stand for the workspace."""

FRAMES = np.r_[0:6, -6:0]
"""Columns of base and tool in an error model."""

LEVER = 1e-4
"""Weight of a radian where frames are fitted to poses [m].

So little that positions decide, and orientations only what positions leave open: where
only positions were measured, orientations are known poorly or not at all.
"""


@serial_blas
def tip_accuracy(
    fitted: Fit, problem: Problem, seed: int, chain: str | None = None
) -> TipAccuracy | None:
    """Predict the accuracy of a tip; None for a fit without redundancy.

    Args:
        fitted: The fit.
        problem: The problem about its solution, with the rows that were fitted.
        seed: Seed of the configurations.
        chain: Name of the chain; default the first that moves.
    """
    known = np.isfinite(fitted.covariance).all() and fitted.dof > 0
    if not known or fitted.directions.count == 0:
        return None
    rng = np.random.default_rng(seed)
    term = problem.of_chain(chain)
    error, own = term.error, term.of_error
    if len(problem.setup.payloads) > 1 and not error.payload:
        error = error.carrying(next(iter(problem.setup.payloads)))
    q = error.chain.random_configurations(SAMPLES, rng)
    # Parameters are deviations from references, and so is their covariance.
    about = fitted.problem.terms[term.key].error
    T, J = error.with_frames(about.base, about.tool).jacobian(q, fitted.theta[own])
    twists = fitted.posterior.twists(replace(term, error=error), q, J)
    position, orientation = _deviations(twists)
    alone = map(rms, _deviations(without_frames(twists, J)))
    to_base = error.base.inverse().homogeneous
    return TipAccuracy(
        q=q,
        points=T[:, :3, 3] @ to_base[:3, :3].T + to_base[:3, 3],
        position=position,
        orientation=orientation,
        rms=PoseErrors(rms(position), rms(orientation)),
        of_robot=PoseErrors(*alone),
    )


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
