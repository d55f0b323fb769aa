"""Values of few digits: steps that make more noise than the instrument does."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib_pin.estimation.evidence import Finding
from calib_pin.estimation.problem import measured_count
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import declared
from calib_pin.measurement_models.declaration import Quantity
from calib_pin.measurement_models.orientations import numbers_of
from calib_pin.units import DISPLAY
from calib_pin.validation.findings.case import Case


@dataclass(frozen=True)
class CoarseOptions:
    """From when on steps are told.

    Attributes:
        values: Least number of different values from which a step is no chance.
        told: Part of the remaining errors that steps make.
        doubtful: Part from which there is a warning.
        most: Part beyond which values cannot have been rounded: the errors would be
            larger, but for what was set aside. Joints are often commanded to round
            numbers and reach them.
    """

    values: int = 20
    told: float = 0.3
    doubtful: float = 0.7
    most: float = 2.0


OPTIONS = CoarseOptions()

ROUNDED = 1.0 / np.sqrt(12.0)
"""Standard deviation of what rounding adds, in steps."""

ANGLES = ("rotation-vector", "roll-pitch-yaw")
"""Ways to state orientations whose numbers can be had from quaternions."""

STEPS = {
    "m": (1.0, 0.0254),
    "rad": (1.0, np.pi / 180.0),
    "px": (1.0,),
    "": (1.0,),
}
"""Units in which a file may count decimal steps, by the one of the values."""


def coarse_values(case: Case) -> Iterator[Finding]:
    """Steps of measured values, and of joint positions, that show in the errors."""
    problem = case.fit.problem
    used = np.sqrt(max(case.fit.left, 1) / max(measured_count(problem), 1))
    errors = case.fit.table
    for quantity in problem.layout.quantities:
        own = errors[:, quantity.columns]
        own = own[np.isfinite(own)]
        step = _step_of(case, quantity)
        if step and len(own):
            left = float(np.sqrt(np.mean(own**2))) / used
            told = f"the measured {quantity.name}s are"
            yield from _finding(told, step, quantity.unit, quantity, step, left)
    yield from _joint_steps(case)


def _finding(
    told: str, step: float, unit: str, quantity: Quantity, noise: float, left: float
) -> Iterator[Finding]:
    """The finding of a step, if it makes a good part of the errors.

    Args:
        told: Beginning of the sentence.
        step: The step [unit].
        unit: Its unit.
        quantity: The quantity whose errors it makes.
        noise: Errors of a whole step [unit of the quantity].
        left: Errors that are left, standard deviation of a component.
    """
    noise *= ROUNDED
    if not OPTIONS.told * left <= noise <= OPTIONS.most * left:
        return
    (of_step, factor), (of_error, size) = DISPLAY[unit], DISPLAY[quantity.unit]
    yield Finding(
        "coarse-steps",
        "warning" if noise >= OPTIONS.doubtful * left else "info",
        f"{told} written in steps of {factor * step:.3g} {of_step}, which makes "
        f"{size * noise:.2g} {of_error} of the {size * left:.2g} {of_error} of "
        f"{quantity.name} errors that are left",
        {"step": step, "noise": noise, "left": left},
        "write them with more digits",
    )


def _step_of(case: Case, quantity: Quantity) -> float:
    """The step of the values of a quantity, the same in all files; zero for none."""
    found = []
    for block in case.fit.problem.data.blocks:
        model = declared(block.model)
        if quantity not in model.quantities or not block.values.shape[1]:
            continue
        ways = [block.values[:, quantity.columns]]
        if model.oriented and quantity.unit == "rad":
            turned = block.values[:, 3:]
            ways = [numbers_of(turned, way)[0] for way in ANGLES]
        found.append(max(coarse_step(way.ravel(), quantity.unit) for way in ways))
    return min(found, default=0.0)


def _joint_steps(case: Case) -> Iterator[Finding]:
    """Steps of joint positions, by the errors of the first quantity that they make."""
    problem, data = case.fit.problem, case.fit.problem.data
    revolute = dict(zip(case.chains.joints, case.chains.revolute, strict=True))
    units = ["rad" if revolute.get(name, True) else "m" for name in data.joints]
    pairs = zip(data.q.T, units, strict=True)
    steps = np.array([coarse_step(column, unit) for column, unit in pairs])
    turning = steps[np.array(units) == "rad"]
    if not turning.any():
        return
    quantity = problem.layout.quantities[0]
    of_quantity = [c.quantity == quantity for c in problem.layout.components]
    own = np.array(of_quantity)[problem.layout.component]
    own &= data.weight[problem.layout.row] > 0.0
    sigma = problem.sigma[own, None]
    moved = case.fit.by_joints[own] * sigma * steps
    r = case.fit.linear[0][own] * sigma[:, 0]
    # A fit follows what has leverage, such as grazing beams.
    Q, _ = case.fit.unexplained
    free = 1.0 - np.sum(Q[: len(own)][own] ** 2, axis=1)
    if not free.sum() > 0.0:
        return
    left = float(np.sqrt(np.sum(r**2) / free.sum()))
    noise = float(np.sqrt(np.sum(free[:, None] * moved**2) / free.sum()))
    step = float(turning.max())
    yield from _finding("the joint positions are", step, "rad", quantity, noise, left)


def coarse_step(values: Floats, unit: str) -> float:
    """The largest step of 1, 2 or 5 times a power of ten that all values are on.

    Zero where there is none, or too few values differ to tell.

    Args:
        values: Values, shape (N,) [unit].
        unit: SI unit of the values.
    """
    some = values[:: max(1, len(values) // 50)]
    steps = np.array(
        [
            digit * 10.0**power * factor
            for factor in STEPS[unit]
            for power in range(0, -7, -1)
            for digit in (5.0, 2.0, 1.0)
        ]
    )
    steps = -np.sort(-steps[_on_grid(some, steps)])
    for step in steps[_on_grid(values, steps)][:1].tolist():
        if len(np.unique(np.round(values / step))) >= OPTIONS.values:
            return float(step)
    return 0.0


def _on_grid(values: Floats, steps: Floats) -> NDArray[np.bool_]:
    """Whether all values are multiples of each step, shape (K,)."""
    parts = values / steps[:, None]
    return np.asarray(np.all(np.abs(parts - np.round(parts)) < 1e-6, axis=1))
