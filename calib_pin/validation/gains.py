"""Is the calibrated robot better than the nominal one? A paired test decides.

Two numbers always differ. The difference of both errors at one held-out configuration
has far less scatter than either, and its mean over independent configurations a
standard error.
"""

from __future__ import annotations

from collections.abc import Sequence

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
    sigma = layout.table(problem.sigma, len(problem.data))[joined.positions]
    label = np.unique(labels[joined.positions], return_inverse=True)[1].reshape(-1)
    present = np.isfinite(sigma)
    # By what the fit predicts of each: a point near the plane of a camera moves by
    # hundreds of pixels for nothing, and would outweigh all others.
    larger = np.maximum(np.nan_to_num(joined.variance, posinf=0.0), sigma**2)
    unit = np.sqrt(larger, where=present, out=np.ones(sigma.shape))
    whitened, expected = joined.after / unit, joined.variance / unit**2
    found = []
    every = (ALL, slice(None)), *((q.name, q.columns) for q in layout.quantities)
    for name, columns in every:
        here = present[:, columns]
        rows = here.any(axis=1)
        if not rows.any():
            continue
        # Lengths; of all, root mean square over the components: one for noise alone.
        scale = unit * np.sqrt(present.sum(axis=1))[:, None] if name == ALL else 1.0
        old, new = (
            np.linalg.norm(np.where(here, (e / scale)[:, columns], 0.0), axis=1)[rows]
            for e in (joined.before, joined.after)
        )
        predicted, ratio = float(np.sum(expected[:, columns][here])), float("nan")
        if predicted > 0.0:  # Otherwise all values were needed to fit.
            square = np.sum(whitened[:, columns][here] ** 2)
            ratio = float(np.sqrt(square / predicted))
        found.append(Gain(method, name, *paired(old, new, label[rows]), ratio))
    return tuple(found)


def paired(
    before: Floats, after: Floats, label: NDArray[np.int64]
) -> tuple[int, float, float, float, float]:
    """Number, mean and deviation of gains, and the chances that it is none, or no loss.

    Student's t of the mean over the labels. Where neither robot predicts a row, nothing
    is gained there; where only one does, the mean is infinite and settles it.
    """
    rows = np.bincount(label)
    with np.errstate(invalid="ignore"):
        gain = np.nan_to_num(before - after, posinf=np.inf, neginf=-np.inf)
        means = (np.bincount(label, gain) / np.maximum(rows, 1))[rows > 0]
        mean, count = float(means.mean()), len(means)
        deviation, t = float("nan"), 0.0
        if count > 1 and np.isfinite(mean):
            deviation = float(means.std(ddof=1) / np.sqrt(count))
    if mean != 0.0 and (count > 1 or np.isinf(mean)):
        t = np.inf if mean > 0.0 else -np.inf
        if deviation > 0.0:
            t = mean / deviation
    dof = max(count - 1, 1)
    return count, mean, deviation, student_tail(t, dof), student_tail(-t, dof)
