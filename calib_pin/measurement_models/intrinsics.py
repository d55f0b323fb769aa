"""A camera and the points it looks at, as reference objects with parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from calib_pin.errors import OptionError
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.pinhole import undistort
from calib_pin.measurement_models.references import Point
from calib_pin.parameters import Parameter
from calib_pin.setup import CameraSetup, Setup

INTRINSICS = (
    *(("fx", "px", 100.0), ("fy", "px", 100.0), ("cx", "px", 100.0)),
    *(("cy", "px", 100.0), ("k1", "", 0.1), ("k2", "", 0.1)),
    *(("p1", "", 0.01), ("p2", "", 0.01), ("k3", "", 0.1)),
)
"""Name, unit and scale of the parameters of a camera."""


@dataclass(frozen=True)
class Camera:
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
        return tuple(
            Parameter(
                f"{self.name}.intrinsics.{name}",
                unit,
                scale,
                nuisance=True,
                free=self.estimate,
            )
            for name, unit, scale in INTRINSICS
        )

    def rebased(self, values: Floats) -> Camera:
        """With other intrinsics."""
        return replace(self, intrinsics=self.intrinsics + values)

    def stated(self) -> CameraSetup:
        """Its intrinsics."""
        f_x, f_y, c_x, c_y, k_1, k_2, p_1, p_2, k_3 = map(float, self.intrinsics)
        return CameraSetup(
            self.mount,
            (f_x, f_y),
            (c_x, c_y),
            (k_1, k_2, p_1, p_2, k_3),
            self.size,
            self.estimate,
        )

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
