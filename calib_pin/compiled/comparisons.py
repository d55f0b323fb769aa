"""Compiled comparisons of what a kernel has carried to the base with measured values.

Each gives the sum of squared whitened residuals of one block; vectors stand by
components, BLOCK apart. A sum of squares is called a cost here, without the half.
"""

from __future__ import annotations

from math import atan2, nan, sqrt

import numpy as np

from calib_pin.compiled.blocks import BLOCK, compiled
from calib_pin.kinematics.spatial import Floats


@compiled
def position_cost(p: Floats, centers: Floats, values: Floats, weights: Floats) -> float:
    """Sum of squares of points against centers (x, y, z)."""
    total = 0.0
    for i in range(3):
        value, weight = values[i], weights[i]
        for k in range(len(value)):
            at = i * BLOCK + k
            residual = (p[at] - centers[at] - value[k]) * weight[k]
            total += residual * residual
    return total


@compiled
def distance_cost(p: Floats, centers: Floats, value: Floats, weight: Floats) -> float:
    """Sum of squares of distances from centers (x, y, z, bias)."""
    total = 0.0
    for k in range(len(value)):
        x, y = p[k] - centers[k], p[k + BLOCK] - centers[k + BLOCK]
        z = p[k + 2 * BLOCK] - centers[k + 2 * BLOCK]
        length = sqrt(x * x + y * y + z * z) + centers[k + 3 * BLOCK]
        residual = (length - value[k]) * weight[k]
        total += residual * residual
    return total


@compiled
def height_cost(p: Floats, planes: Floats, value: Floats, weight: Floats) -> float:
    """Sum of squares of heights above planes (normal, offset)."""
    total = 0.0
    for k in range(len(value)):
        height = planes[k + 3 * BLOCK] + planes[k] * p[k]
        height += planes[k + BLOCK] * p[k + BLOCK]
        height += planes[k + 2 * BLOCK] * p[k + 2 * BLOCK]
        residual = (height - value[k]) * weight[k]
        total += residual * residual
    return total


@compiled
def beam_cost(p: Floats, planes: Floats, value: Floats, weight: Floats) -> float:
    """Sum of squares of distances along the tool's z axis to planes."""
    total = 0.0
    for k in range(len(value)):
        nx, ny, nz = planes[k], planes[k + BLOCK], planes[k + 2 * BLOCK]
        height = planes[k + 3 * BLOCK] + nx * p[k]
        height += ny * p[k + BLOCK] + nz * p[k + 2 * BLOCK]
        fall = nx * p[k + 3 * BLOCK]
        fall += ny * p[k + 4 * BLOCK] + nz * p[k + 5 * BLOCK]
        residual = (-height / fall - value[k]) * weight[k]
        total += residual * residual
    return total


@compiled
def pixel_cost(p: Floats, camera: Floats, values: Floats, weights: Floats) -> float:
    """Sum of squares of pixels, see `measurement_models.pinhole`.

    Args:
        p: Points in the camera by components.
        camera: Intrinsics, and the depth from which on a point is seen, shape (10,).
        values: Measured pixels, shape (2, rows).
        weights: Reciprocal standard deviations, shape (2, rows).
    """
    f_x, f_y, c_x, c_y, k_1, k_2, p_1, p_2, k_3, near = camera
    total = 0.0
    for k in range(values.shape[1]):
        depth = p[k + 2 * BLOCK]
        depth = depth if depth > near else nan
        x, y = p[k] / depth, p[k + BLOCK] / depth
        xx, yy, xy = x * x, y * y, 2.0 * x * y
        rr = xx + yy
        s = 1.0 + rr * (k_1 + rr * (k_2 + rr * k_3))
        u = f_x * (x * s + p_1 * xy + p_2 * (rr + 2.0 * xx)) + c_x
        v = f_y * (y * s + p_1 * (rr + 2.0 * yy) + p_2 * xy) + c_y
        u = (u - values[0, k]) * weights[0, k]
        v = (v - values[1, k]) * weights[1, k]
        total += u * u + v * v
    return total


@compiled
def pose_cost(p: Floats, values: Floats, weights: Floats) -> float:
    """Sum of squares of poses: measured x, y, z and rotation matrix by rows."""
    total, least = 0.0, 3.0
    turned = np.empty(9 * BLOCK)
    for i in range(3):
        value, weight = values[i], weights[i]
        for k in range(len(value)):
            residual = (p[i * BLOCK + k] - value[k]) * weight[k]
            total += residual * residual
        # Measured axis i against predicted axes, R_y^T R.
        a, b, c = values[3 + i], values[6 + i], values[9 + i]
        for axis in range(3):
            at = p[3 * (3 - axis) * BLOCK : 3 * (4 - axis) * BLOCK]
            result = turned[(3 * i + axis) * BLOCK : (3 * i + axis + 1) * BLOCK]
            for k in range(len(a)):
                result[k] = a[k] * at[k] + b[k] * at[k + BLOCK]
                result[k] += c[k] * at[k + 2 * BLOCK]
    for k in range(values.shape[1]):
        trace = turned[k] + turned[k + 4 * BLOCK] + turned[k + 8 * BLOCK]
        least = min(least, trace)
    if least > 2.0:
        return total + little_turned(turned, weights[3:])
    for k in range(values.shape[1]):
        x, y, z = rotation_vector(turned[k::BLOCK].copy().reshape(3, 3))
        total += (x * weights[3, k]) ** 2
        total += (y * weights[4, k]) ** 2
        total += (z * weights[5, k]) ** 2
    return total


@compiled
def little_turned(R: Floats, weights: Floats) -> float:
    """Sum of squares of rotation vectors below 60 degrees, by vector instructions.

    With the quaternion (w, v) the angle is 4 atan(x), x^2 = (1 - w) / (1 + w), and the
    first term of the series left out is below rounding.
    """
    total = 0.0
    one, two, three = weights[0], weights[1], weights[2]
    for k in range(len(one)):
        w = 0.5 * sqrt(1.0 + R[k] + R[k + 4 * BLOCK] + R[k + 8 * BLOCK])
        s = -(1.0 - w) / (1.0 + w)
        series = 1.0 / 25.0 + s * (1.0 / 27.0)
        series = 1.0 / 19.0 + s * (1.0 / 21.0 + s * (1.0 / 23.0 + s * series))
        series = 1.0 / 13.0 + s * (1.0 / 15.0 + s * (1.0 / 17.0 + s * series))
        series = 1.0 / 7.0 + s * (1.0 / 9.0 + s * (1.0 / 11.0 + s * series))
        series = 1.0 + s * (1.0 / 3.0 + s * (1.0 / 5.0 + s * series))
        factor = series / (w * (1.0 + w))
        x = factor * (R[k + 7 * BLOCK] - R[k + 5 * BLOCK]) * one[k]
        y = factor * (R[k + 2 * BLOCK] - R[k + 6 * BLOCK]) * two[k]
        z = factor * (R[k + 3 * BLOCK] - R[k + BLOCK]) * three[k]
        total += x * x + y * y + z * z
    return total


@compiled
def rotation_vector(R: Floats) -> tuple[float, float, float]:
    """Logarithm of a rotation matrix, by its quaternion as in `spatial.so3_log`."""
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    largest = max(trace, R[0, 0], R[1, 1], R[2, 2])
    if largest == trace:
        w = 1.0 + trace
        x, y, z = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    elif largest == R[0, 0]:
        w, x = R[2, 1] - R[1, 2], 1.0 + 2.0 * R[0, 0] - trace
        y, z = R[0, 1] + R[1, 0], R[0, 2] + R[2, 0]
    elif largest == R[1, 1]:
        w, y = R[0, 2] - R[2, 0], 1.0 + 2.0 * R[1, 1] - trace
        x, z = R[0, 1] + R[1, 0], R[1, 2] + R[2, 1]
    else:
        w, z = R[1, 0] - R[0, 1], 1.0 + 2.0 * R[2, 2] - trace
        x, y = R[0, 2] + R[2, 0], R[1, 2] + R[2, 1]
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    sine = sqrt(x * x + y * y + z * z)
    factor = 2.0 * atan2(sine, w) / sine if sine > 1e-12 * w else 2.0 / w
    return factor * x, factor * y, factor * z
