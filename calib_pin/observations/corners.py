"""Standard deviations of corners that were found in images."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from calib_pin.observations.labels import Floats

ENDS = 0.12
"""Part of an edge of a marker at its ends that its corners may have rounded."""

ACROSS = 0.6
"""How far an edge is looked for on both sides, in cells of the marker."""

NARROWEST, STEP = 2.0, 0.25
"""The least of that, and the step across [px]."""

STRAIGHT = 80.0
"""Length up to which the bend by a lens is less than the noise of a parabola [px]."""

FEWEST = 8
"""Least number of places along an edge."""

FLOOR = 0.2
"""Part of the steepest slope below which a slope is noise."""

FAR = 3.0
"""Median distances from a line from which a place is not of it."""

ALIKE = 2.0
"""Places along an edge, a pixel apart, for one that is independent: a bilinear sample
has two pixels along, and blur makes them more."""

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
    total = ndimage.convolve(image, NEIGHBORS)[1:-1, 1:-1]
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
    window = sampled(image, corners[:, :1, None] + du, corners[:, 1:, None] + dv)
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


def marker_corners(image: Floats, corners: Floats, cells: int) -> tuple[Floats, Floats]:
    """Corners of a marker, where its four edges meet.

    Blur rounds a corner and draws it inwards; it leaves edges where they are. Where an
    edge is the steepest is found across it, from end to end; a line goes through these
    places, or a parabola through those of a long edge, which a lens bends.

    Args:
        image: Gray levels, shape (height, width).
        corners: About where the corners are, in their order around, shape (4, 2) [px].
        cells: Cells along an edge, border included.

    Returns:
        Corners and their standard deviations, shape (4, 2) each [px].
    """
    ends = []
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        length = float(np.hypot(*(b - a)))
        along = (b - a) / length
        normal = np.array([-along[1], along[0]])
        x = np.linspace(ENDS, 1.0 - ENDS, max(FEWEST, int(length)))
        # A lens bends the long ones.
        degree = 1 if length < STRAIGHT else 2
        edge = np.zeros(1)
        for reach in (max(NARROWEST, ACROSS * length / cells), NARROWEST):
            y = np.polyval(edge, x)[:, None] + np.arange(-reach, reach + STEP, STEP)
            at = a + length * x[:, None, None] * along + y[..., None] * normal
            edge, covariance = _curve(x, _steepest(image, at, y), degree)
        slope = np.polyval(np.polyder(edge), [0.0, 1.0]) / length
        for k in range(2):
            place = a + k * length * along + np.polyval(edge, k) * normal
            across = normal - slope[k] * along
            powers = float(k) ** np.arange(degree, -1, -1)
            ends.append((across, across @ place, powers @ covariance @ powers))
    points, sigma = np.empty((4, 2)), np.empty((4, 2))
    for k in range(4):
        # The end of the edge before, and the start of its own.
        two = ends[2 * k - 1], ends[2 * k]
        inverse = np.linalg.pinv(np.array([across for across, _, _ in two]))
        points[k] = inverse @ [offset for _, offset, _ in two]
        variances = inverse**2 @ [variance for _, _, variance in two]
        sigma[k] = np.sqrt(variances + ROUNDING**2)
    return points, np.clip(sigma, None, LARGEST)


def _steepest(image: Floats, at: Floats, y: Floats) -> Floats:
    """Where across an edge it is the steepest, shape (K,), of places (K, M, 2)."""
    slope = np.abs(np.diff(sampled(image, at[..., 0], at[..., 1]), axis=1))
    # Noise far from the edge would draw its place to the middle.
    slope = np.maximum(slope - FLOOR * slope.max(axis=1, keepdims=True), 0.0)
    middle = 0.5 * (y[:, 1:] + y[:, :-1])
    return np.asarray(
        (slope * middle).sum(axis=1) / np.maximum(slope.sum(axis=1), 1e-9)
    )


def _curve(x: Floats, y: Floats, degree: int) -> tuple[Floats, Floats]:
    """A polynomial without what is far off, and the covariance of its coefficients.

    Neighbors see the same pixels: their scatter is that of fewer places.
    """
    kept = np.ones(len(x), bool)
    for _ in range(3):
        curve, inverse = np.polyfit(x[kept], y[kept], degree, cov="unscaled")
        residual = np.abs(np.polyval(curve, x) - y)
        kept = residual <= max(FAR * float(np.median(residual)), 1e-3)
    r = y[kept] - np.polyval(curve, x[kept])
    dof = max(int(kept.sum()) - degree - 1, 1)
    return curve, ALIKE * float(r @ r) / dof * inverse


def sampled(image: Floats, u: Floats, v: Floats) -> Floats:
    """Gray levels between pixels, bilinear; those outside are those of the edge."""
    return np.asarray(ndimage.map_coordinates(image, [v, u], order=1, mode="nearest"))


def first_is_dark(levels: Floats, grid: Floats) -> bool:
    """Whether the square outside the first corner is darker than its neighbors.

    Args:
        levels: Gray levels of an image, shape (H, W).
        grid: Corners of a board in it, shape (n, m, 2) [px].
    """
    x, y = grid[0, 1] - grid[0, 0], grid[1, 0] - grid[0, 0]
    at = grid[0, 0] + 0.5 * np.array([-x - y, x - y, x + y, y - x])
    a, b, c, d = sampled(levels, *at.T)
    return bool(a + c < b + d)
