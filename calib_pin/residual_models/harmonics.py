"""Functions of joint angles in which the covariance is a diagonal one.

On the circle the Gaussian kernel of the points (sin, cos) is a Fourier series,

    exp((cos d - 1) / s^2) = sum_k c_k v_k cos(k d),  v_k = exp(-z) I_k(z),  z = 1 / s^2

with c_0 = 1, all others 2, and the modified Bessel functions I_k (Abramowitz and Stegun
1964, 9.6.34). The kernel of all angles is the product of such series. So a function
that has this covariance is a sum of products of harmonics with independent amplitudes.
Some of them say nearly all of it, whatever the number of measurements (Solin and
Särkkä 2020, doi 10.1007/s11222-019-09886-w).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.special import ive

from calib_pin.kinematics.spatial import Floats
from calib_pin.residual_models.covariance import Form
from calib_pin.residual_models.documents import checked, numbers

HIGHEST = 64
"""Highest harmonic of a joint's own angle: half a wave is 3 degrees."""

ORDER = 5
"""Largest sum of the orders of a product."""

CANDIDATES = 4000
"""Most products to choose from; robots of more joints get a smaller sum of orders."""


@dataclass(frozen=True)
class Spectrum:
    """Variances v_k of the harmonics 0 to K of a kernel of length s.

    Attributes:
        value: The variances, shape (K + 1,).
        slope: Derivative of their logarithms by that of the length, shape (K + 1,).
    """

    value: Floats
    slope: Floats

    @staticmethod
    def of(length: float, highest: int) -> Spectrum:
        """The spectrum of a length, up to a harmonic."""
        z = float(length) ** -2
        # I_k / I_(k-1), by the continued fraction from far above: I_k itself would
        # underflow.
        ratio, above = np.zeros(highest + 2), 0.0
        for order in range(highest + 21 + int(2.0 * z), 0, -1):
            above = z / (2.0 * order + z * above)
            if order <= highest + 1:
                ratio[order] = above
        value = float(ive(0, z)) * np.cumprod([1.0, *ratio[1:-1]])
        return Spectrum(value, -2.0 * (z * ratio[1:] + np.arange(highest + 1) - z))


@dataclass(frozen=True)
class Harmonics:
    """Products of harmonics, each a function in one component of a correction.

    Attributes:
        modes: For each joint 0 for none, 2 k - 1 for the cosine and 2 k for the sine of
            k times its angle, shape (D, n); all phases of a product are there.
        component: Component of each, ascending, shape (D,).
    """

    modes: NDArray[np.int64]
    component: NDArray[np.int64]

    def __len__(self) -> int:
        """Number of functions."""
        return len(self.modes)

    @property
    def orders(self) -> NDArray[np.int64]:
        """Multiple k of each angle, shape (D, n)."""
        return (self.modes + 1) // 2

    @property
    def alone(self) -> NDArray[np.bool_]:
        """Whether each is a function of its own joint's angle, shape (D,)."""
        others = self.modes.copy()
        own = self.component < others.shape[1]
        others[own, self.component[own]] = 0
        return np.asarray(~others.any(axis=1))

    def at(self, index: NDArray[np.int64] | NDArray[np.bool_]) -> Harmonics:
        """Some of them."""
        return Harmonics(self.modes[index], self.component[index])

    def of_components(self, count: int) -> list[slice]:
        """The functions of each of so many components."""
        cuts = np.searchsorted(self.component, np.arange(count + 1))
        return [slice(*cuts[j : j + 2].tolist()) for j in range(count)]

    @cached_property
    def distinct(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Modes without regard to components, (U, n), and that of each function, (D,).

        Most components have the same ones.
        """
        modes, place = np.unique(self.modes, axis=0, return_inverse=True)
        return modes, place.reshape(-1)

    def values(self, angle: Floats) -> Floats:
        """The functions, of unit mean square, shape (N, n) -> (N, D)."""
        modes, place = self.distinct
        return products(modes, angle).T[place].T

    def combined(self, angle: Floats, amplitudes: Floats, count: int) -> Floats:
        """Sums of the functions of so many components, shape (N, n) -> (N, m)."""
        values, columns = self.values(angle), self.of_components(count)
        return np.column_stack([values[:, own] @ amplitudes[own] for own in columns])

    @staticmethod
    def restore(document: object, joints: int, components: int) -> Harmonics:
        """The harmonics of a document.

        Raises:
            ValueError: If they are none.
        """
        parts = checked(document, "harmonics")
        modes = numbers(parts, "modes", (None, joints))
        component = numbers(parts, "component", (len(modes),))
        for name, found, most in (
            ("modes", modes, 2 * HIGHEST),
            ("component", component, components - 1),
        ):
            if not ((found >= 0) & (found <= most) & (found == found.round())).all():
                raise ValueError(f"'{name}' holds other numbers than 0 to {most}")
        if (np.diff(component) < 0).any():
            raise ValueError("'component' is not in ascending order")
        return Harmonics(modes.astype(np.int64), component.astype(np.int64))


def candidates(joints: int, components: int, form: Form) -> Harmonics:
    """All functions from which some are chosen.

    Args:
        joints: Number n of joints.
        components: Number m of components.
        form: Functions that the process is made of.
    """
    orders = _orders(joints) if form.smooth else [(0,) * joints]
    modes, component = list[tuple[int, ...]](), list[int]()
    for j in range(components):
        found = dict.fromkeys(orders)
        if form.own:
            alone = np.zeros((HIGHEST, joints), np.int64)
            alone[:, j] = np.arange(1, HIGHEST + 1)
            found |= dict.fromkeys(map(tuple, alone.tolist()))
        for each in found:
            phases = list(product(*((2 * k - 1, 2 * k) if k else (0,) for k in each)))
            modes += phases
            component += [j] * len(phases)
    return Harmonics(np.array(modes, np.int64), np.array(component, np.int64))


def products(modes: NDArray[np.int64], angle: Floats) -> Floats:
    """The products of some modes, (U, n), at angles, shape (N, n) -> (N, U)."""
    # One function after another in memory: so they are copied and multiplied quickly.
    result = np.ones((len(modes), len(angle)))
    for j, column in enumerate(modes.T):
        used = np.flatnonzero(column)
        waves = _waves(angle[:, j], (int(column.max(initial=0)) + 1) // 2)
        result[used] *= waves[column[used]]
    return result.T


def _orders(joints: int) -> list[tuple[int, ...]]:
    """Orders of the products, the constant first."""
    result = [(0,) * joints]
    for _ in range(ORDER):
        larger = dict.fromkeys(result)
        for each in result:
            for j in range(joints):
                larger[(*each[:j], each[j] + 1, *each[j + 1 :])] = None
        if sum(2 ** sum(k > 0 for k in each) for each in larger) > CANDIDATES:
            break
        result = [*larger]
    return result


def _waves(angle: Floats, highest: int) -> Floats:
    """1, and cosine and sine of each multiple of unit mean square, (2 K + 1, N)."""
    result = np.ones((2 * highest + 1, len(angle)))
    multiple = np.multiply.outer(np.arange(1, highest + 1), angle)
    result[1::2] = np.sqrt(2.0) * np.cos(multiple)
    result[2::2] = np.sqrt(2.0) * np.sin(multiple)
    return result
