"""Pixels of known points in the image of a camera (reprojection).

The camera is the tool and looks at points of the measurement frame, that of a board,
or it is the measurement frame and looks at points of the tool. Its frame is the optical
one: z forward, x to the right of the image, y down. So where it stands, or where it
sits on the robot, are the base and the tool frame of the error model.

A measurement is one point in one image; those of one configuration are one image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from calib_pin.errors import InputError
from calib_pin.kinematics.spatial import Floats, invert
from calib_pin.measurement_models.base import (
    Batch,
    Geometry,
    Linearization,
    MeasurementModel,
)
from calib_pin.measurement_models.camera_start import Rays
from calib_pin.measurement_models.declaration import (
    Declaration,
    Naming,
    Quantity,
)
from calib_pin.measurement_models.named_points import xyz_or_none
from calib_pin.measurement_models.pinhole import (
    INTRINSICS,
    NEAR,
    Camera,
    Image,
    Marker,
    turning_radius,
)
from calib_pin.measurement_models.references import (
    Point,
    ReferenceObject,
    locate,
    slices,
)
from calib_pin.observations import Booleans, Indices, Measurements, Targets
from calib_pin.setup import PointSetup, Setup

OBLIQUE = 0.25
"""Cosine of the angle to the normal of a board from which corners are not found."""


@dataclass(frozen=True)
class CameraModel(MeasurementModel):
    """Predicted minus measured pixel.

    Attributes:
        camera: The camera.
        points: The points that it looks at: of a camera on the hand in the
            measurement frame, of a camera in the world in the tool frame.
        spare: Other points of a known place, which measurements to come may name.
        printed: Whether they are of a board, which is seen from before its plane.
    """

    camera: Camera
    points: tuple[Point, ...]
    spare: tuple[Point, ...] = ()
    printed: bool = False

    declaration = Declaration(
        name="camera",
        help="pixels of known points in images, of a board or on the tool",
        components=("u", "v"),
        quantities=(Quantity("pixel", "px", slice(0, 2), 0.5),),
        external=True,
        at_once=True,
        separable=True,
        naming=Naming("point", "every"),
        inferred="all",
        yardstick="the size of the board's squares ('board' or 'targets')",
        unmeasurable="the point is behind the camera or outside its image",
    )

    @classmethod
    def from_setup(cls, setup: Setup, targets: Sequence[str]) -> CameraModel:
        """The camera of a setup and the points that it looks at.

        Args:
            setup: The setup of the user; points are known unless it says otherwise.
            targets: The targets that measurements name, for where the setup has none.

        Raises:
            OptionError: If there is no camera, or one without a focal length.
        """
        camera = Camera.from_setup(setup)
        given = setup.board.points if setup.board else setup.targets
        setups = given or dict.fromkeys(filter(None, targets), PointSetup())
        points = [
            Marker(name, xyz=xyz_or_none(point.xyz), estimate=bool(point.estimate))
            for name, point in setups.items()
        ]
        named, printed = set(targets), setup.board is not None
        # All of them count without measurements, or where one names what is not stated.
        if not named or not named <= set(setups):
            return cls(camera, tuple(points), (), printed)
        seen = tuple(p for p in points if p.name in named)
        spare = tuple(p for p in points if p.located and p.name not in named)
        return cls(camera, seen, spare, printed)

    @property
    def missing(self) -> str:
        """Points that nobody has given."""
        lacking = [f"'{point.name}'" for point in self.points if not point.located]
        if self.points and not lacking:
            return ""
        first = f" of {lacking[0]}" if len(lacking) == 1 else ""
        if len(lacking) > 1:
            first = f" of {lacking[0]} and {len(lacking) - 1} more"
        advice = f"give the xyz{first} under 'targets', or a 'board',"
        return f"{advice} in a setup file (--setup)"

    @property
    def targets(self) -> Sequence[str]:
        """Names of the points."""
        return tuple(point.name for point in self.points)

    @property
    def references(self) -> Sequence[ReferenceObject]:
        """The camera, then the points."""
        return (self.camera, *self.points)

    def with_references(self, references: Sequence[ReferenceObject]) -> CameraModel:
        """The same about another camera and other points."""
        camera, *points = references
        assert isinstance(camera, Camera)
        kept = tuple(point for point in points if isinstance(point, Point))
        return replace(self, camera=camera, points=kept)

    def extended(self, T: Floats, data: Measurements) -> CameraModel:
        """With the spare points that the measurements name."""
        named = set(data.target.distinct)
        more = tuple(point for point in self.spare if point.name in named)
        return replace(self, points=(*self.points, *more)) if more else self

    def predict(self, T: Floats, instrument: Floats, target: Targets) -> Floats:
        """Pixels (u, v), shape (N, 2) [px]; NaN behind the camera."""
        return self._look(T, instrument, self._index(target)).image.pixels

    def observable(self, T: Floats, instrument: Floats, target: Targets) -> Booleans:
        """Where the point is in front of the camera and within its image.

        Beyond the radius at which the distortion folds back there is no image. An
        image without a size reaches as far behind its principal point as before it.
        Of a board neither the back is seen nor what is too oblique.
        """
        view = self._look(T, instrument, self._index(target))
        radius = turning_radius((image := view.image).intrinsics[4:])
        seen = (image.points[2] > NEAR) & (np.hypot(image.x, image.y) < radius)
        size = self.camera.size
        edge = 2.0 * image.intrinsics[2:4] if size is None else np.array(size)
        seen &= ((image.pixels >= 0.0) & (image.pixels <= edge)).all(axis=1)
        if self.printed:
            away = view.R[2] if self.camera.mount == "hand" else view.R[:, 2]
            along = np.einsum("in,in->n", away, image.points)
            seen &= along > OBLIQUE * np.linalg.norm(image.points, axis=0)
        return np.asarray(seen)

    def linearize(
        self, T: Floats, instrument: Floats, data: Measurements
    ) -> Linearization:
        """Derivatives by the point in the camera, carried to the tool.

        With g the derivative by the point X in the camera, and a body twist (v, w): on
        the hand `dX = -v + X x w`, in the world `dX = R (v + w x P)` of a point P of
        the tool. Either way the derivative is `(h, L x h)`: h that by a shift of the
        tool, `-g` or `R^T g`, and L the point in the tool frame, X or P.
        """
        index = self._index(data.target)
        view = self._look(T, instrument, index)
        g = view.image.gradient
        hand = self.camera.mount == "hand"
        h = -g if hand else np.einsum("din,ijn->djn", g, view.R)
        lever = view.image.points if hand else view.site
        J_pose = np.empty((len(T), 2, 6))
        J_pose[:, :, :3] = h.transpose(2, 0, 1)
        for k in range(3):
            i, j = (k + 1) % 3, (k + 2) % 3
            J_pose[:, :, 3 + k] = (lever[i] * h[:, j] - lever[j] * h[:, i]).T
        J_instrument = np.zeros((len(T), 2, len(instrument)))
        J_instrument[:, :, : len(INTRINSICS)] = view.image.by_intrinsics.transpose(
            2, 0, 1
        )
        column = self._columns[index]
        rows = np.flatnonzero(column >= 0)
        if len(rows):
            by_point = np.einsum("djn,ijn->din", g, view.R) if hand else h
            for k in range(3):
                J_instrument[rows, :, column[rows] + k] = by_point[:, k, rows].T
        return Linearization(view.image.pixels - data.values, J_pose, J_instrument)

    def batches(self, data: Measurements, weights: Floats) -> Sequence[Batch]:
        """Carries the points into the camera; none for one on the hand."""
        if self.camera.mount == "hand":
            return []
        rows, point = np.arange(len(data)), self._index(data.target)
        known = np.array([p.xyz for p in self.points], float)
        column = self._columns
        moving = column >= 0
        columns = column[moving, None] + np.arange(3)
        intrinsics, count = self.camera.intrinsics, len(INTRINSICS)

        def geometry(instrument: Floats) -> Geometry:
            points = np.tile(known, (len(instrument), 1, 1))
            points[:, moving] += instrument[:, columns]
            sites = np.full((len(instrument), 1, count + 1), NEAR)
            sites[:, 0, :count] = intrinsics + instrument[:, :count]
            return Geometry(points, sites)

        camera = np.zeros_like(point)
        return [Batch("pixel", rows, point, camera, data.values, weights, geometry)]

    def register(
        self, F: Floats, data: Measurements, base: pin.SE3 | None, tool: pin.SE3 | None
    ) -> tuple[CameraModel, pin.SE3, pin.SE3]:
        """Frames from all images in closed form, see `camera_start`.

        So are focal lengths that are estimated, if those that are stated are farther
        from what the images show; other references stay.

        Raises:
            InputError: If points are not given, measurements are too few for a start,
                or a point is behind the camera there.
        """
        if self.missing:
            raise InputError(f"the model 'camera' needs known points: {self.missing}")
        index = self._index(data.target, data)
        starts = [self._start(self.camera, F, data, index, base, tool)]
        if self.camera.estimate:
            others = self._cameras(F, data, index)
            starts += [self._start(c, F, data, index, base, tool) for c in others]
        _, camera, outer, inner = min(starts, key=lambda start: start[0])
        if outer is None or inner is None:
            raise InputError(
                "the camera cannot be located from the measurements of the model "
                f"'camera' ({len(data)}); give 'frames' in a setup file (--setup)"
            )
        T = outer.homogeneous @ F @ inner.homogeneous
        model = self if camera is self.camera else replace(self, camera=camera)
        instrument = np.zeros(len(self.parameters))
        seen = model._look(T, instrument, index).image.points[2] > NEAR
        if not seen.all():
            row = int(np.argmin(seen))
            raise data.error(
                row,
                f"the point '{self.points[index[row]].name}' is behind the camera in "
                "the frames that the fit starts from; give 'frames' in a setup file "
                "(--setup)",
            )
        return model, outer, inner

    def _cameras(self, F: Floats, data: Measurements, index: Indices) -> list[Camera]:
        """The camera with focal lengths that the images tell."""
        focal, cameras = self.camera.intrinsics[:2], list[Camera]()
        # With a wrong focal length a distortion is undone in the wrong places.
        for distorted in (False, True, True):
            camera = self.camera.with_focal(focal)
            rays = self._rays(camera if distorted else camera.plain, F, data, index)
            factors = rays.focal_factors()
            if factors is None:
                break
            focal = focal * factors
            cameras.append(self.camera.with_focal(focal))
        return cameras

    def _rays(
        self, camera: Camera, F: Floats, data: Measurements, index: Indices
    ) -> Rays:
        """The rays of a camera; on the hand the chain runs from the tip to the base."""
        rays = camera.rays(data.values)
        seen = np.isfinite(rays[:, 0])
        sites = np.array([point.xyz for point in self.points])
        chain = F if camera.mount == "world" else invert(F)
        return Rays(chain[seen], sites, index[seen], rays[seen], data.groups()[seen])

    def _start(
        self,
        camera: Camera,
        F: Floats,
        data: Measurements,
        index: Indices,
        base: pin.SE3 | None,
        tool: pin.SE3 | None,
    ) -> tuple[float, Camera, pin.SE3 | None, pin.SE3 | None]:
        """Error [px] with a camera, the base and the tool frame; None if not found."""
        rays = self._rays(camera, F, data, index)
        if camera.mount == "world":
            outer, inner, guess = base, tool, (False, True)
        else:
            outer, inner = tool and tool.inverse(), base and base.inverse()
            guess = True, False
        ends = rays.ends(_matrix(outer), _matrix(inner), guess)
        if ends is None:
            return np.inf, camera, None, None
        error = rays.error(ends) * float(camera.intrinsics[:2].mean())
        if camera.mount == "hand":
            ends = invert(ends[1]), invert(ends[0])
        return error, camera, base or pin.SE3(ends[0]), tool or pin.SE3(ends[1])

    @property
    def _columns(self) -> Indices:
        """First column of each point among the parameters, -1 for a known one."""
        parts = slices(self.references)[1:]
        return np.array([p.start if p.stop > p.start else -1 for p in parts], np.int64)

    def _index(self, target: Targets, data: Measurements | None = None) -> Indices:
        """Position of each measurement's point; data tell where a wrong name stands."""
        return locate(target, self.points, "target", data)

    def _look(self, T: Floats, instrument: Floats, index: Indices) -> _View:
        camera, *parts = slices(self.references)
        sites = np.array(
            [
                # Points that are not estimated have no parameters.
                point.at(instrument[part]) if part.stop > part.start else point.xyz
                for point, part in zip(self.points, parts, strict=True)
            ],
            float,
        )
        # By components: sums over rows that lie side by side.
        pose = np.ascontiguousarray(T[:, :3].transpose(1, 2, 0))
        site = np.take(sites.T, index, axis=1)
        R, p = pose[:, :3], pose[:, 3]
        if self.camera.mount == "hand":
            point = np.einsum("ijn,in->jn", R, site - p)
        else:
            point = np.einsum("ijn,jn->in", R, site) + p
        return _View(R, site, Image(self.camera.intrinsics + instrument[camera], point))


@dataclass(frozen=True)
class _View:
    """The points as they are seen, by components.

    Attributes:
        R: Rotations of the tool, shape (3, 3, N).
        site: The points where they are given, shape (3, N) [m].
        image: The points in the camera.
    """

    R: Floats
    site: Floats
    image: Image


def _matrix(frame: pin.SE3 | None) -> Floats | None:
    return None if frame is None else np.asarray(frame.homogeneous)
