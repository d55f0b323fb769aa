"""Compiled kernel: the links of a chain for many parameter values."""

from __future__ import annotations

from math import sin, sqrt
from typing import TypeAlias

from numba import njit

from calib_pin.compiled.blocks import Indices, compiled
from calib_pin.kinematics.spatial import Floats


@compiled
def links(
    constants: Floats,
    segment: Indices,
    parameter: Indices,
    twists: Floats,
    theta: Floats,
    result: Floats,
) -> None:
    """Links of a population: constants times the screws of their segment in order.

    Args:
        constants: Nominal links as rows of (R | p), shape (n + 1, 12).
        segment: Link of each screw, shape (K,).
        parameter: Parameter of each screw, shape (K,).
        twists: Unit twists (linear, angular), shape (K, 6).
        theta: Parameter values, shape (S, P).
        result: Filled with the links, shape (S, n + 1, 12).
    """
    for member in range(theta.shape[0]):
        result[member] = constants
        for k in range(len(segment)):
            amount = theta[member, parameter[k]]
            if amount == 0.0:
                continue
            link = result[member, segment[k]]
            x, y, z, px, py, pz = _exponential(twists[k], amount)
            (r00, r10, r20), (r01, r11, r21), (r02, r12, r22) = x, y, z
            for i in range(0, 12, 4):
                a, b, c = link[i], link[i + 1], link[i + 2]
                link[i] = a * r00 + b * r10 + c * r20
                link[i + 1] = a * r01 + b * r11 + c * r21
                link[i + 2] = a * r02 + b * r12 + c * r22
                link[i + 3] += a * px + b * py + c * pz


_Column: TypeAlias = tuple[float, float, float]


# Within the loop over screws a call would cost as much as the work.
@njit(inline="always")
def _exponential(
    twist: Floats, amount: float
) -> tuple[_Column, _Column, _Column, float, float, float]:
    """Exp(twist amount): the columns of its rotation, and its translation."""
    vx, vy, vz = twist[0], twist[1], twist[2]
    x, y, z = twist[3], twist[4], twist[5]
    square = x * x + y * y + z * z
    angle = sqrt(square) * amount
    if abs(angle) < 1e-2:
        # Series: the closed forms below cancel at small angles.
        a2 = angle * angle
        first = amount * (1.0 - a2 / 6.0 * (1.0 - a2 / 20.0 * (1.0 - a2 / 42.0)))
        second = 0.5 * amount**2 * (1.0 - a2 / 12.0 * (1.0 - a2 / 30.0))
        third = amount**3 / 6.0 * (1.0 - a2 / 20.0 * (1.0 - a2 / 42.0))
    else:
        first = amount * sin(angle) / angle
        second = 2.0 * (sin(0.5 * angle) / angle * amount) ** 2
        third = (amount - first) / square
    # R = I + first W + second W^2, p = (amount + second W + third W^2) v.
    cx, cy, cz = y * vz - z * vy, z * vx - x * vz, x * vy - y * vx
    return (
        (
            1.0 + second * (x * x - square),
            second * x * y + first * z,
            second * x * z - first * y,
        ),
        (
            second * x * y - first * z,
            1.0 + second * (y * y - square),
            second * y * z + first * x,
        ),
        (
            second * x * z + first * y,
            second * y * z - first * x,
            1.0 + second * (z * z - square),
        ),
        amount * vx + second * cx + third * (y * cz - z * cy),
        amount * vy + second * cy + third * (z * cx - x * cz),
        amount * vz + second * cz + third * (x * cy - y * cx),
    )
