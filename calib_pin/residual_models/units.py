"""The functions a network is made of, and their derivatives by its weights.

The network gives joint corrections from joint angles q:

    p_h = prod_k (a_hk + b_hk sin q_k + c_hk cos q_k)
    f_j = sum_h (u_hj p_h + v_hj dp_h/dq_j)
          + sum_m (s_jm sin(m q_j) + t_jm cos(m q_j))

All that gravity and the links of a serial chain do is a sum of products with at most
one sine or cosine of each joint, and the torque of gravity at a joint is the slope of
such a sum, the potential energy. A few product units describe what many sigmoid ones
only approach. The series is for gears and encoders, whose errors repeat many times in
a turn of their own joint.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats

BANDS = ((1, 1), (2, 2), (3, 4), (5, 8), (9, 14), (15, 20), (21, 30), (31, 40))
"""Harmonics with a decay in common, the first and the last of each."""

PER_HARMONIC = 3
"""Training configurations for each harmonic that a series may have."""

Circle = tuple[Floats, Floats]


@dataclass(frozen=True)
class Weights:
    """The weights of one network with H units and M harmonics.

    Attributes:
        factors: Weights of 1, sine and cosine in each unit, shape (H, n, 3).
        outputs: Weights of each unit and its slope in the corrections, (H, n, 2).
        series: Weights of sines and cosines of a joint's own multiples, (n, 2, M).
    """

    factors: Floats
    outputs: Floats
    series: Floats


@dataclass(frozen=True)
class Inputs:
    """Inputs of a network.

    Attributes:
        circle: Sines and cosines of the joint angles, shape (N, n) each.
        waves: Sines and cosines of their multiples, shape (n, N, 2 M).
        bands: Band of each of the 2 M, shape (2 M,).
    """

    circle: Circle
    waves: Floats
    bands: NDArray[np.int64]

    @staticmethod
    def of(angle: Floats, configurations: int) -> Inputs:
        """Inputs at joint angles.

        Args:
            angle: Angles, shape (N, n) [rad].
            configurations: How many of them differ: they limit the harmonics.
        """
        used = [k for k, b in enumerate(BANDS) if b[1] * PER_HARMONIC <= configurations]
        band = [k for k in used for _ in range(BANDS[k][0], BANDS[k][1] + 1)]
        multiple = angle.T[:, :, None] * np.arange(1, len(band) + 1)
        return Inputs(
            circle=(np.sin(angle), np.cos(angle)),
            waves=np.concatenate([np.sin(multiple), np.cos(multiple)], axis=2),
            bands=np.array(2 * band, np.int64),
        )


def combined(circle: Circle, weights: Weights) -> Floats:
    """Contribution of the units to the corrections, shape (N, n).

    Args:
        circle: Sines and cosines of the joint angles, shape (N, n) each.
        weights: The weights; their series does not count.
    """
    terms, turned = _terms(circle, weights.factors)
    others = _others(terms)
    units, slopes = others[-1] * terms[-1], others * turned
    along = slopes @ weights.outputs[:, :, 1].T[:, :, None]
    return np.asarray(units @ weights.outputs[:, :, 0] + along[:, :, 0].T)


def unit_columns(A: Floats, circle: Circle, weights: Weights) -> Floats:
    """Derivatives of A f by the outputs and the factors of the units.

    Args:
        A: Derivative of the residuals by the corrections, shape (N, d, n).
        circle: Sines and cosines of the joint angles, shape (N, n) each.
        weights: The weights.

    Returns:
        Columns in the order of `outputs` and `factors`, shape (N d, 5 H n).
    """
    rows, d, joints = A.shape
    terms, turned = _terms(circle, weights.factors)
    # The last of these functions is the unit, the others are its slopes: there the term
    # of the joint is replaced by its own slope.
    table = np.repeat(terms[:, None], joints + 1, axis=1)
    own = np.arange(joints)
    table[own, own] = turned
    others = _others(table)
    units, slopes = others[-1, -1] * terms[-1], others[own, own] * turned
    both = np.stack([np.broadcast_to(units, slopes.shape), slopes], axis=3)
    by_output = A[:, :, None, :, None] * both.transpose(1, 2, 0, 3)[:, None]
    u, v = weights.outputs[:, :, 0], weights.outputs[:, :, 1]
    gain = np.concatenate(
        [A.transpose(2, 0, 1)[..., None] * v.T[:, None, None], (A @ u.T)[None]]
    )
    turns = gain[:-1] * others[own, own][:, :, None]
    others[own, own] = 0.0
    sums = np.einsum("jndh,kjnh->kndh", gain, others)
    sine, cosine = (part.T[:, :, None, None] for part in circle)
    by_factor = np.stack(
        [sums, sums * sine + turns * cosine, sums * cosine - turns * sine]
    )
    return np.concatenate(
        [
            by_output.reshape(rows * d, -1),
            by_factor.transpose(2, 3, 4, 1, 0).reshape(rows * d, -1),
        ],
        axis=1,
    )


def series(angle: Floats, amplitudes: Floats) -> Floats:
    """Fourier series of each joint's own angle, shape (N, n).

    Args:
        angle: Angles, shape (N, n) [rad].
        amplitudes: Of sines and cosines, shape (n, 2, M).
    """
    z = np.exp(1j * angle)
    total = np.zeros_like(z)
    # Horner's rule: s sin x + t cos x is the real part of (t - i s) exp(i x).
    for term in (amplitudes[:, 1] - 1j * amplitudes[:, 0]).T[::-1]:
        total = (total + term) * z
    return np.asarray(total.real)


def _terms(circle: Circle, factors: Floats) -> tuple[Floats, Floats]:
    """Terms of the products and their slopes, shape (n, N, H) each."""
    sine, cosine = (part.T[:, :, None] for part in circle)
    a, b, c = factors.transpose(2, 1, 0)[:, :, None]
    return a + b * sine + c * cosine, b * cosine - c * sine


def _others(terms: Floats) -> Floats:
    """Products of all terms but one, along the first axis."""
    result = np.empty_like(terms)
    result[0] = 1.0
    for k in range(1, len(terms)):
        result[k] = result[k - 1] * terms[k - 1]
    after = terms[-1]
    for k in reversed(range(len(terms) - 1)):
        result[k] *= after
        after = after * terms[k]
    return result
