"""Standard deviations of corners that were found in images."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

ROUNDING = 0.02
"""Error of a corner that is no noise: cells of the sensor, interpolation [px]."""

NEIGHBORS = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]])
"""Second difference both ways: zero on planes and straight edges along an axis."""

LARGEST = 5.0
"""Largest standard deviation that is stated [px]: the window of the corner."""


def noise_of(image: Floats) -> float:
    """Standard deviation of a pixel.

    From second differences, most of which see no edge (after J. Immerkaer, "Fast noise
    variance estimation", 1996); their median does not see those that do.

    Args:
        image: Gray levels, shape (height, width).
    """
    total = np.zeros((image.shape[0] - 2, image.shape[1] - 2))
    height, width = total.shape
    for i, row in enumerate(NEIGHBORS):
        for j, factor in enumerate(row):
            total += factor * image[i : i + height, j : j + width]
    # Black and white that are cut off have no noise, and tell none.
    inner = image[1:-1, 1:-1]
    inside = (inner > image.min()) & (inner < image.max())
    spread = np.abs(total[inside] if inside.any() else total)
    # 1.4826 times the median is the deviation of a normal distribution. Rounding to
    # whole levels alone is 0.3.
    gain = float(np.linalg.norm(NEIGHBORS))
    return max(1.4826 * float(np.median(spread)) / gain, 0.3)


def corner_sigmas(image: Floats, corners: Floats, half: int, noise: float) -> Floats:
    """Standard deviations of corners at which gradients are orthogonal to the radii.

    Such a corner q solves `sum w g g^T (q - p) = 0` over pixels p with gradients g (W.
    Foerstner and E. Guelch, "A fast operator", 1987; OpenCV's cornerSubPix). The noise
    of the pixels is carried through these equations to first order.

    Args:
        image: Gray levels, shape (height, width).
        corners: Corners (u, v), pixel centers at whole numbers, shape (N, 2) [px].
        half: Half the width of the window of the corner [px].
        noise: Standard deviation of a pixel.

    Returns:
        Standard deviations of u and v, shape (N, 2) [px].
    """
    reach = np.arange(-half - 1, half + 2)
    dv, du = np.meshgrid(reach, reach, indexing="ij")
    window = _sampled(image, corners[:, :1, None] + du, corners[:, 1:, None] + dv)
    g = np.stack(
        [
            0.5 * (window[:, 1:-1, 2:] - window[:, 1:-1, :-2]),
            0.5 * (window[:, 2:, 1:-1] - window[:, :-2, 1:-1]),
        ],
        axis=1,
    )
    d = np.stack([du[1:-1, 1:-1], dv[1:-1, 1:-1]]).astype(float)
    weight = np.exp(-np.sum((d / half) ** 2, axis=0))
    along = np.einsum("nivu,ivu->nvu", g, d)
    A = np.einsum("vu,nivu,njvu->nij", weight, g, g)
    # Influence of every pixel on the right side, through both of its gradients.
    influence = np.zeros((len(corners), 2, *window.shape[1:]))
    for i in range(2):
        by = weight * g[:, i, None] * d
        by[:, i] += weight * along
        influence[:, i, 1:-1, 2:] += 0.5 * by[:, 0]
        influence[:, i, 1:-1, :-2] -= 0.5 * by[:, 0]
        influence[:, i, 2:, 1:-1] += 0.5 * by[:, 1]
        influence[:, i, :-2, 1:-1] -= 0.5 * by[:, 1]
    spread = np.einsum("nivu,njvu->nij", influence, influence)
    inverse = np.linalg.pinv(A)
    variance = noise**2 * np.einsum("nij,njk,nik->ni", inverse, spread, inverse)
    return np.asarray(np.clip(np.sqrt(variance + ROUNDING**2), None, LARGEST))


def _sampled(image: Floats, u: Floats, v: Floats) -> Floats:
    """Gray levels between pixels, bilinear; those outside are those of the edge."""
    height, width = image.shape
    u, v = np.clip(u, 0.0, width - 1.0), np.clip(v, 0.0, height - 1.0)
    i = np.minimum(v.astype(int), height - 2)
    j = np.minimum(u.astype(int), width - 2)
    s, t = v - i, u - j
    upper = (1.0 - t) * image[i, j] + t * image[i, j + 1]
    lower = (1.0 - t) * image[i + 1, j] + t * image[i + 1, j + 1]
    return np.asarray((1.0 - s) * upper + s * lower)
