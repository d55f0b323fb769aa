"""Corrections that residual models learn from what a fit leaves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import OptionError, require_known
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.identifiability import visible_nuisances
from calib_pin.estimation.problem import SAMPLE, Problem
from calib_pin.estimation.terms import Term, Terms
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import declared
from calib_pin.observations import Observations
from calib_pin.progress import Progress
from calib_pin.residual_models import (
    RESIDUAL_MODELS,
    LearnedCorrection,
    Linearized,
    Shifts,
    Space,
    TrainingRows,
)
from calib_pin.setup import Setup

_Terms = TypeVar("_Terms", bound=Terms)


def require_learnable(name: str, setup: Setup, measurements: Observations) -> None:
    """Refuse a residual model that does not exist or has nothing to learn from.

    Raises:
        OptionError: If there is no such model, or the measurements are relative or of
            several chains.
    """
    require_known("residual model", name, RESIDUAL_MODELS)
    relative = any(declared(model).relative for model in measurements.models)
    source, other = "distances between two configurations", "another model"
    if not relative:
        source, other = "measurements of several chains", "one chain"
    if relative or len({key.chain for key in measurements.keys}) > 1:
        raise OptionError(
            f"nothing can be learned from {source}",
            file=setup.file or None,
            value=name,
            allowed=f"measurements of {other}",
        )


def with_learned(problem: _Terms, learned: LearnedCorrection) -> _Terms:
    """A problem or a model about its solution, with a learned correction.

    Args:
        problem: The problem.
        learned: The correction, with a shift of all parameters, shape (P,); a motion
            of the tool is one of the first tool.
    """
    terms = {}
    for key, term in problem.terms.items():
        shift = learned.shift[term.of_error]
        own = replace(learned, shift=shift, carried=_carried(problem, term))
        terms[key] = replace(term, error=replace(term.error, learned=own))
    return problem.with_terms(terms)


def _carried(problem: Terms, term: Term) -> Floats | None:
    """Adjoint from the first tool to that of a term; None where it is the same."""
    first, tool = problem.only.error.tool, term.error.tool
    if tool == first:
        return None
    return np.asarray((tool.inverse() * first).toActionMatrix())


def learned_correction(
    name: str,
    fitted: Fit,
    problem: Problem,
    theta: Floats,
    rng: np.random.Generator,
    progress: Progress | None = None,
) -> LearnedCorrection | None:
    """The correction that a residual model learns; None without a gain.

    Args:
        name: Name of the residual model.
        fitted: The fit.
        problem: Its problem, about the solution.
        theta: Parameter values about that, shape (P,).
        rng: Random generator of the residual model.
        progress: Told how much is done, 0 to 1.

    Raises:
        InputError: If the measurements are too few to learn from.
    """
    directions, rows = _learnable(fitted, problem, theta)
    found = RESIDUAL_MODELS[name](rows, rng, progress=progress)
    if not (found.shift.any() or found(rows.q[:SAMPLE]).any()):
        # Nothing held on the validation measurements.
        return None
    return LearnedCorrection(found, directions @ found.shift)


def left_out(
    learned: LearnedCorrection,
    fitted: Fit,
    problem: Problem,
    theta: Floats,
    masks: Sequence[NDArray[np.bool_]],
    rng: np.random.Generator,
) -> list[LearnedCorrection]:
    """A correction without some of the measurements, the fit as it is.

    The geometry moves with it, as far as its shift goes; see
    `ResidualModel.left_out`.

    Args:
        learned: The correction.
        fitted: The fit.
        problem: Its problem, about the solution.
        theta: Parameter values about that, shape (P,).
        masks: Those to leave out, shape (N,) each.
        rng: Random generator of the residual model.
    """
    directions, rows = _learnable(fitted, problem, theta)
    found = learned.model.left_out(rows, masks, rng)
    return [LearnedCorrection(one, directions @ one.shift) for one in found]


def training_rows(
    problem: Problem, theta: Floats, directions: Floats, known: Shifts | None = None
) -> TrainingRows:
    """Residuals as functions of a correction, for a residual model to learn.

    Args:
        problem: The problem about the solution of a fit.
        theta: Parameter values there, shape (P,).
        directions: Directions of the parameters that may shift along with the
            correction, shape (P, k).
        known: What is known of these; default nothing.
    """
    layout = problem.layout
    shape = len(problem.data), layout.width
    basis = [b.term.error.basis(b.data.q, b.data.conditions) for b in problem.blocks]

    def linearize(space: Space, values: Floats, shift: Floats) -> Linearized:
        widths = values.shape[1], len(shift)
        by = (np.zeros((*shape, width)) for width in widths)
        result = Linearized(np.zeros(shape), *by)
        moved = directions @ shift
        for known_basis, block in zip(basis, problem.blocks, strict=True):
            term, data, rows, flat = block
            own, error = term.index, term.error
            of_robot, instrument = term.values(theta)
            count, corrections = len(of_robot), values[rows]
            carried = _carried(problem, term) if space == "tip" else None
            if carried is not None:
                corrections = corrections @ carried.T
            given = _Given(space, corrections, moved[own[:count]])
            corrected = replace(error, learned=given)
            poses = corrected.linearize(data.q, of_robot, known_basis)
            linear = term.measurement.linearize(poses.T, instrument, data)
            sigma = block.table(problem.sigma)
            J_pose = linear.J_pose / sigma[:, :, None]
            columns = layout.column[flat][: sigma.shape[1]]
            result.residual[rows, columns] = linear.residual / sigma
            by_correction = J_pose if carried is None else J_pose @ carried
            if space == "joint":
                by_correction = J_pose @ poses.joint_twists()
            result.by_correction[rows, columns] = by_correction
            by_shift = poses.derivative(J_pose) @ directions[own[:count]]
            result.by_shift[rows, columns] = by_shift
        return result

    def some(index: NDArray[np.int64]) -> TrainingRows:
        few = replace(problem, data=problem.data.rows(index))
        return training_rows(few, theta, directions, known)

    return TrainingRows(
        q=np.concatenate([block.data.q for block in problem.blocks]),
        groups=problem.data.groups(),
        revolute=problem.only.error.chain.revolute,
        by_joint=partial(linearize, "joint"),
        by_tip=partial(linearize, "tip"),
        values=layout.width,
        some=some,
        shift=Shifts.free(directions.shape[1]) if known is None else known,
    )


@dataclass(frozen=True)
class _Given:
    """Corrections of certain rows, in the place of those a model predicts."""

    space: Space
    values: Floats
    shift: Floats

    def __call__(self, q: Floats) -> Floats:
        return self.values

    def weight(self, q: Floats) -> Floats:
        return np.ones(len(q))


def _learnable(
    fitted: Fit, problem: Problem, theta: Floats
) -> tuple[Floats, TrainingRows]:
    """Directions that the fit could tell, (P, k), and the rows to learn from.

    Those of the robot, in the scales of parameters, and free ones of the frames; the
    instruments stay as they were fitted.

    Args:
        fitted: The fit.
        problem: Its problem, about any reference.
        theta: Parameter values of the solution about that, shape (P,).
    """
    parameters, robot = problem.parameters, fitted.directions.robot
    frames = visible_nuisances(problem.linearize(theta)[1], parameters)
    for term in problem.terms.values():
        frames[term.of_instrument] = 0.0
    frames = frames[:, frames.any(axis=0)]
    shown, free = robot.any(axis=1), frames.shape[1]
    kinds = tuple(
        np.vstack([np.zeros((free, own.sum())), robot[own].T])
        for kind in dict.fromkeys(parameters.kinds[shown].tolist())
        for own in (shown & (parameters.kinds == kind),)
    )
    values = robot.T @ (fitted.theta / parameters.scales)
    known = Shifts(np.concatenate([np.zeros(free), values]), kinds)
    directions = parameters.scales[:, None] * np.column_stack([frames, robot])
    return directions, training_rows(problem, theta, directions, known)
