"""Is the calibrated robot better than the nominal one? A paired test decides.

Two numbers always differ. The difference of both errors at one held-out configuration
has far less scatter than either, and its mean over independent configurations a
standard error.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from calib_pin.estimation.evidence import Gain
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.statistics.distributions import student_tail
from calib_pin.kinematics.spatial import Floats
from calib_pin.validation.model_errors import ModelErrors

ALL = "all"
"""Name of the quantity that stands for all of them, whitened."""

PRESS = "press"
"""Name of the check by the hat matrix."""


def gains(
    method: str,
    problem: Problem,
    checks: Sequence[ModelErrors],
    labels: NDArray[np.int64],
) -> tuple[Gain, ...]:
    """Test held-out errors before and after, of all quantities and of each.

    Measurements that are set aside do not count.

    Args:
        method: How they were held out.
        problem: The problem of the N measurements that the positions belong to, in the
            units of the fit; its standard deviations whiten.
        checks: Errors of held-out measurements, part by part.
        labels: Label of each in the test, shape (N,); those of one label are one
            observation.
    """
    weight, layout = problem.data.weight, problem.layout
    checks = [check.counted(weight) for check in checks]
    checks = [check for check in checks if (weight[check.positions] > 0.0).all()]
    if not checks:
        return ()
    joined = ModelErrors.joined(checks)
    positions, before, after = joined.positions, joined.before, joined.after
    variance = joined.variance
    sigma = layout.table(problem.sigma, len(problem.data))[positions]
    label = np.unique(labels[positions], return_inverse=True)[1].reshape(-1)
    present = np.isfinite(sigma)
    unit = np.where(present, sigma, 1.0)
    # By what the fit predicts of each: a point near the plane of a camera moves by
    # hundreds of pixels for nothing, and would outweigh all others.
    spread = np.where(np.isfinite(variance) & present, variance, unit**2) / unit**2
    unit = unit * np.sqrt(np.maximum(spread, 1.0))
    whitened = before / unit, after / unit, variance / unit**2
    return tuple(_gains(method, problem, (before, after), whitened, present, label))


def _gains(
    method: str,
    problem: Problem,
    parts: tuple[Floats, Floats],
    whitened: tuple[Floats, Floats, Floats],
    present: NDArray[np.bool_],
    label: NDArray[np.int64],
) -> Iterator[Gain]:
    """The test of all quantities, then of each that any measurement has."""
    every = slice(None)
    # Root mean square over the components of each: one for noise alone.
    count = np.maximum(present.sum(axis=1), 1)
    before, after = (
        _size(errors, every, present) / np.sqrt(count) for errors in whitened[:2]
    )
    ratio = _ratio(whitened[1], whitened[2], present)
    yield _gain(method, ALL, before, after, label, ratio)
    for quantity in problem.layout.quantities:
        columns = quantity.columns
        here = present[:, columns]
        rows = here.any(axis=1)
        if rows.any():
            before, after = (_size(errors, columns, present)[rows] for errors in parts)
            ratio = _ratio(whitened[1][:, columns], whitened[2][:, columns], here)
            yield _gain(method, quantity.name, before, after, label[rows], ratio)


def _size(errors: Floats, columns: slice, present: NDArray[np.bool_]) -> Floats:
    """Lengths of errors in some columns, shape (N,)."""
    part = np.where(present, errors, 0.0)[:, columns]
    return np.asarray(np.linalg.norm(part, axis=1))


def _ratio(after: Floats, variance: Floats, present: NDArray[np.bool_]) -> float:
    """Found by predicted root mean square of whitened errors."""
    predicted = float(np.sum(variance[present]))
    if predicted <= 0.0:  # All values were needed to fit, but for rounding.
        return float("nan")
    return float(np.sqrt(np.sum(after[present] ** 2) / predicted))


def _gain(
    method: str,
    quantity: str,
    before: Floats,
    after: Floats,
    label: NDArray[np.int64],
    ratio: float,
) -> Gain:
    """Student's t of the mean over the labels.

    Where neither robot predicts a row, nothing is gained there; where only one does,
    the mean is infinite and settles it.
    """
    rows = np.bincount(label)
    with np.errstate(invalid="ignore"):
        gain = np.nan_to_num(before - after, posinf=np.inf, neginf=-np.inf)
        means = (np.bincount(label, gain) / np.maximum(rows, 1))[rows > 0]
        mean, count = float(means.mean()), len(means)
        deviation = float("nan")
        if count > 1 and np.isfinite(mean):
            deviation = float(means.std(ddof=1) / np.sqrt(count))
    better = worse = 0.5
    if not np.isfinite(mean):
        better, worse = (0.0, 1.0) if mean > 0.0 else (1.0, 0.0)
    elif count > 1 and mean != 0.0:
        t = mean / deviation if deviation > 0.0 else float(np.copysign(np.inf, mean))
        better, worse = student_tail(t, count - 1), student_tail(-t, count - 1)
    return Gain(method, quantity, count, mean, deviation, better, worse, ratio)
