"""A pinhole camera with the distortion of Brown and Conrady, and images of points.

A point (X, Y, Z) in the camera's optical frame (z forward, x to the right of the image,
y down) is x = X / Z, y = Y / Z in the plane at depth 1, and there

    r^2 = x^2 + y^2,  s = 1 + k_1 r^2 + k_2 r^4 + k_3 r^6
    x' = x s + 2 p_1 x y + p_2 (r^2 + 2 x^2),  u = f_x x' + c_x
    y' = y s + p_1 (r^2 + 2 y^2) + 2 p_2 x y,  v = f_y y' + c_y

(D. C. Brown, "Close-range camera calibration", 1971; signs and order of OpenCV). The
image (x', y') is the gradient of a potential, so that its derivative is symmetric.

Coefficients are k_1, k_2, p_1, p_2, k_3; intrinsics are f_x, f_y, c_x, c_y before them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from calib_pin.errors import OptionError
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.references import Point, ReferenceObject
from calib_pin.parameters import Parameter
from calib_pin.setup import CameraSetup, Setup

NEAR = 1e-3
"""Depth up to which a point counts as behind the camera [m]."""

ITERATIONS = 50
"""Newton steps after which a point is given up."""

EXACT = 1e-12
"""Largest error of a point whose distortion was undone, at depth 1."""

INTRINSICS = (
    *(("fx", "px", 100.0), ("fy", "px", 100.0), ("cx", "px", 100.0)),
    *(("cy", "px", 100.0), ("k1", "", 0.1), ("k2", "", 0.1)),
    *(("p1", "", 0.01), ("p2", "", 0.01), ("k3", "", 0.1)),
)
"""Name, unit and scale of the parameters of a camera."""


@dataclass(frozen=True)
class Camera(ReferenceObject):
    """A pinhole camera with Brown-Conrady distortion.

    Attributes:
        mount: `hand` if it is the tool, `world` if it stands still.
        intrinsics: f_x, f_y, c_x, c_y [px], k_1, k_2, p_1, p_2, k_3, shape (9,).
        size: Width and height of the image [px]; None where it has no edge.
        estimate: Whether the intrinsics are estimated.
    """

    mount: Literal["hand", "world"]
    intrinsics: Floats
    size: tuple[float, float] | None = None
    estimate: bool = False

    name = "camera"
    kind = "intrinsics"
    section = "camera"

    @staticmethod
    def from_setup(setup: Setup) -> Camera:
        """The camera of a setup.

        Raises:
            OptionError: If there is none, or one without a focal length.
        """
        given = setup.camera
        if given is None:
            raise OptionError(
                "the model 'camera' needs 'camera' in a setup file (--setup): its "
                "mount, focal and center",
                file=setup.file or None,
            )
        if not all(0.0 < focal < np.inf for focal in given.focal):
            raise OptionError(
                "the focal lengths of the camera are positive numbers",
                value=list(given.focal),
            )
        intrinsics = np.array([*given.focal, *given.center, *given.distortion], float)
        return Camera(given.mount, intrinsics, given.size, given.estimate)

    @property
    def located(self) -> bool:
        """Always: a camera is given."""
        return True

    @property
    def parameters(self) -> Sequence[Parameter]:
        """`camera.intrinsics.fx|fy|cx|cy|k1|k2|p1|p2|k3`."""
        stem, free = f"{self.name}.{self.kind}", self.estimate
        return tuple(
            Parameter(f"{stem}.{name}", unit, scale, nuisance=True, free=free)
            for name, unit, scale in INTRINSICS
        )

    def rebased(self, values: Floats) -> Camera:
        """With other intrinsics."""
        return replace(self, intrinsics=self.intrinsics + values)

    @property
    def plain(self) -> Camera:
        """The same without a distortion."""
        return replace(self, intrinsics=np.append(self.intrinsics[:4], np.zeros(5)))

    def with_focal(self, focal: Floats) -> Camera:
        """With other focal lengths, shape (2,) [px]."""
        return replace(self, intrinsics=np.append(focal, self.intrinsics[2:]))

    def stated(self) -> CameraSetup:
        """Its intrinsics."""
        f_x, f_y, c_x, c_y, k_1, k_2, p_1, p_2, k_3 = map(float, self.intrinsics)
        lens, size, free = (k_1, k_2, p_1, p_2, k_3), self.size, self.estimate
        return CameraSetup(self.mount, (f_x, f_y), (c_x, c_y), lens, size, free)

    def rays(self, pixels: Floats) -> Floats:
        """Where pixels look, at depth 1, shape (N, 2); NaN where no point is seen."""
        focal, center = self.intrinsics[:2], self.intrinsics[2:4]
        return undistort((pixels - center) / focal, self.intrinsics[4:])


@dataclass(frozen=True)
class Marker(Point):
    """A point that a camera looks at; one that is known has no parameters.

    Boards have many points. Columns of zeros for all of them would take most of the
    time of a fit.
    """

    kind: str = "target"
    estimate: bool = False

    @property
    def parameters(self) -> Sequence[Parameter]:
        """`<name>.target.x|y|z` where it is estimated."""
        return super().parameters if self.estimate else ()

    def at(self, values: Floats) -> Floats:
        """Its place, shape (3,) [m]."""
        assert self.xyz is not None
        return super().at(values) if len(values) else self.xyz


@dataclass(frozen=True)
class Image:
    """Pixels of points and their derivatives.

    Attributes:
        intrinsics: Intrinsics, shape (9,).
        points: Points in the camera by components, so that those of many points lie
            side by side, shape (3, N) [m].
    """

    intrinsics: Floats
    points: Floats

    @cached_property
    def depth(self) -> Floats:
        """Depth of the point, shape (N,) [m]; NaN behind the camera."""
        return np.where(self.points[2] > NEAR, self.points[2], np.nan)

    @cached_property
    def x(self) -> Floats:
        """To the right, at depth 1, shape (N,)."""
        return np.asarray(self.points[0] / self.depth)

    @cached_property
    def y(self) -> Floats:
        """Down, at depth 1, shape (N,)."""
        return np.asarray(self.points[1] / self.depth)

    @property
    def pixels(self) -> Floats:
        """Pixels, shape (N, 2)."""
        f_x, f_y, c_x, c_y = self.intrinsics[:4]
        x, y = self._distorted
        return np.column_stack([f_x * x + c_x, f_y * y + c_y])

    @cached_property
    def gradient(self) -> Floats:
        """Derivative of the pixel by the point in the camera, shape (2, 3, N)."""
        (f_x, f_y), (xx, xy, yy) = self.intrinsics[:2], self._slope
        result = np.empty((2, 3, len(self.depth)))
        for row, focal, x, y in ((result[0], f_x, xx, xy), (result[1], f_y, xy, yy)):
            scale = focal / self.depth
            row[0], row[1] = scale * x, scale * y
        result[:, 2] = -(self.x * result[:, 0] + self.y * result[:, 1])
        return result

    @property
    def by_intrinsics(self) -> Floats:
        """Derivative of the pixel by the intrinsics, shape (2, 9, N)."""
        result = np.zeros((2, 9, len(self.x)))
        result[0, 0], result[1, 1] = self._distorted
        result[0, 2] = result[1, 3] = 1.0
        xx, yy = self.x * self.x, self.y * self.y
        rr = xx + yy
        for row, value, focal in zip(
            result, (self.x, self.y), self.intrinsics[:2], strict=True
        ):
            np.multiply(focal * value, rr, out=row[4])
            np.multiply(row[4], rr, out=row[5])
            np.multiply(row[5], rr, out=row[8])
        f_x, f_y = self.intrinsics[:2]
        xy = 2.0 * self.x * self.y
        result[0, 6], result[0, 7] = f_x * xy, f_x * (rr + 2.0 * xx)
        result[1, 6], result[1, 7] = f_y * (rr + 2.0 * yy), f_y * xy
        return result

    @cached_property
    def _distorted(self) -> tuple[Floats, Floats]:
        return distort(self.x, self.y, self.intrinsics[4:])

    @cached_property
    def _slope(self) -> tuple[Floats, Floats, Floats]:
        return _slope(self.x, self.y, self.intrinsics[4:])


def distort(x: Floats, y: Floats, coefficients: Floats) -> tuple[Floats, Floats]:
    """Distorted coordinates (x', y'), each of the shape of x and y."""
    k_1, k_2, p_1, p_2, k_3 = coefficients
    xx, yy, xy = x * x, y * y, 2.0 * x * y
    rr = xx + yy
    s = 1.0 + rr * (k_1 + rr * (k_2 + rr * k_3))
    return (
        x * s + p_1 * xy + p_2 * (rr + 2.0 * xx),
        y * s + p_1 * (rr + 2.0 * yy) + p_2 * xy,
    )


def _slope(x: Floats, y: Floats, coefficients: Floats) -> tuple[Floats, Floats, Floats]:
    """Derivatives: of x' by x, of x' by y, which is that of y' by x, and of y' by y."""
    k_1, k_2, p_1, p_2, k_3 = coefficients
    rr = x * x + y * y
    s = 1.0 + rr * (k_1 + rr * (k_2 + rr * k_3))
    ds = 2.0 * (k_1 + rr * (2.0 * k_2 + rr * (3.0 * k_3)))
    return (
        s + x * x * ds + 2.0 * p_1 * y + 6.0 * p_2 * x,
        x * y * ds + 2.0 * p_1 * x + 2.0 * p_2 * y,
        s + y * y * ds + 6.0 * p_1 * y + 2.0 * p_2 * x,
    )


def turning_radius(coefficients: Floats) -> float:
    """Radius r at which `r s` first stops to grow; infinite where it never does.

    Beyond, the image folds back over itself: no lens does that.
    """
    k_1, k_2, _, _, k_3 = coefficients
    # Derivative of r s by r, as a polynomial in 1 / r^2: no number is too small for it.
    roots = np.roots([1.0, 3.0 * k_1, 5.0 * k_2, 7.0 * k_3])
    real = roots.real[np.abs(roots.imag) < 1e-9 * np.abs(roots)]
    largest = np.sqrt(real.max(initial=0.0))
    return float(1.0 / largest) if largest > 0.0 else np.inf


def undistort(points: Floats, coefficients: Floats) -> Floats:
    """Points whose distorted image is given, shape (N, 2); NaN where there is none.

    Newton's method from the distorted points: of radial distortion it approaches the
    solution from one side.
    """
    goal_x, goal_y = points.T
    x, y = goal_x.copy(), goal_y.copy()
    with np.errstate(all="ignore"):
        for _ in range(ITERATIONS):
            at_x, at_y = distort(x, y, coefficients)
            miss_x, miss_y = at_x - goal_x, at_y - goal_y
            xx, xy, yy = _slope(x, y, coefficients)
            scale = 1.0 / (xx * yy - xy * xy)
            step_x = scale * (yy * miss_x - xy * miss_y)
            step_y = scale * (xx * miss_y - xy * miss_x)
            x, y = x - step_x, y - step_y
            if not (np.abs([step_x, step_y]) > 1e-15).any():
                break
        at = np.column_stack(distort(x, y, coefficients))
        missed = np.abs(at - points).max(axis=1, initial=0.0)
        within = np.hypot(x, y) < turning_radius(coefficients)
    valid = (missed < EXACT) & within
    return np.where(valid[:, None], np.column_stack([x, y]), np.nan)
