"""The three-dimensional part of the window: camera, lights, floor, drawings."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import colormaps
from numpy.typing import NDArray

from calib_pin.kinematics.shapes import Shape, creased
from calib_pin.kinematics.skeleton import corners, floor_height
from calib_pin.kinematics.spatial import Floats, to_quaternion
from calib_pin.viewer.scene import Body, ErrorSizes, Rows, Scene, StageErrors

if TYPE_CHECKING:
    import viser

RGB = tuple[int, int, int]

STAGES: dict[str, RGB] = {"before": (213, 94, 0), "after": (0, 114, 178)}
"""Of errors, after Okabe and Ito."""

MARK: RGB = (204, 121, 167)
"""Of the measurement that is looked at."""

MEASURED: RGB = (40, 40, 40)
PATH: RGB = (0, 158, 115)
ROBOT: RGB = (225, 222, 214)
"""Of a robot whose URDF states none."""

BODIES: dict[str, RGB] = {"nominal": (213, 94, 0), "corrected": (70, 150, 205)}
"""Of robots beside each other, those of their errors; the second one in more light."""

MAP = "viridis"
"""Colormap of sizes: perceptually uniform, and of growing lightness."""


def scaled(sizes: Floats) -> NDArray[np.uint8]:
    """Colors of sizes between the least and the largest, shape (N,) -> (N, 3)."""
    parts = np.zeros(len(sizes))
    if len(sizes) and np.ptp(sizes) > 0.0:
        parts = (sizes - sizes.min()) / np.ptp(sizes)
    return np.asarray(colormaps[MAP](parts, bytes=True)[:, :3])


def pale(color: RGB) -> RGB:
    """A color of a link that is not measured."""
    red, green, blue = ((part + 2 * 255) // 3 for part in color)
    return red, green, blue


OPACITY, FAINT = 0.35, 0.1
"""Of the nominal robot beside the corrected one, and of what was not measured of it."""


class Group:
    """Shapes that hang on links of a robot, and move with them.

    Attributes:
        root: Carries all of them.
        frames: The frame of each link that carries something, by its number.
        placements: Poses of all links as they are drawn, shape (L, 4, 4).
    """

    def __init__(self, api: viser.SceneApi, name: str, links: Iterable[int]) -> None:
        """Nothing hangs on the links yet, and they are not in place."""
        self._api, self.root = api, api.add_frame(name, show_axes=False)
        # Names of links may hold slashes, which mean something here.
        self.frames = {
            k: api.add_frame(f"{name}/{k}", show_axes=False) for k in {*links}
        }
        self.placements: Floats = np.zeros((1 + max(self.frames, default=0), 4, 4))

    def add(self, name: str, link: int, shape: Shape, color: RGB, **more: Any) -> None:
        """Hang a shape on a link."""
        sharp = creased(shape.surface)
        self._api.add_mesh_simple(
            f"{self.root.name}/{link}/{name}",
            sharp.vertices.astype(np.float32),
            sharp.triangles.astype(np.uint32),
            color=color,
            position=shape.placement[:3, 3],
            wxyz=_wxyz(shape.placement),
            **more,
        )

    def put(self, placements: Floats) -> None:
        """Put the links in place, which have the poses (L, 4, 4)."""
        for k, frame in self.frames.items():
            T = placements[k]
            # To tell a browser takes longer than to compute it.
            if (self.placements[k] != T).any():
                frame.position, frame.wxyz = T[:3, 3], _wxyz(T)
        self.placements = placements

    def hide_equal(self, others: Floats, size: float) -> None:
        """Show only links that another robot has elsewhere, as far as one can see.

        Two surfaces in one place would be drawn as a mixture of both.

        Args:
            others: Poses of the links of the other robot, shape (L, 4, 4).
            size: Size of the robot [m].
        """
        away = np.linalg.norm((others - self.placements)[:, :3, 3], axis=1)
        turns = np.linalg.norm((others - self.placements)[:, :3, :3], axis=(1, 2))
        for k, frame in self.frames.items():
            frame.visible = bool(away[k] + LEVER * size * turns[k] > SEEN * size)


def draw_robot(api: viser.SceneApi, body: Body, scene: Scene) -> Group:
    """The links of a robot; beside the corrected one the nominal one is a ghost."""
    number = {link: k for k, link in enumerate(body.skeleton.links)}
    ghost = body.name == "nominal"
    group = Group(api, f"/{body.name}", (number[shape.link] for shape in scene.shapes))
    for k, shape in enumerate(scene.shapes):
        color, opacity = pale(_color(shape)), FAINT
        if shape.link in scene.highlighted:
            color, opacity = BODIES.get(body.name, _color(shape)), OPACITY
        group.add(
            str(k),
            number[shape.link],
            shape,
            color,
            opacity=opacity if ghost else None,
            cast_shadow=not ghost,
            receive_shadow=not ghost,
        )
    return group


def draw_things(api: viser.SceneApi, scene: Scene) -> tuple[Group, Group]:
    """Instruments and targets, and their names, where the last robot carries them."""
    links = scene.bodies[-1].skeleton.links
    places = [links.index(thing.link) for thing in scene.things]
    things, names = (Group(api, name, places) for name in ("/things", "/names"))
    for n, (k, thing) in enumerate(zip(places, scene.things, strict=True)):
        label = thing.name.rpartition("/")[2] or thing.kind
        label = thing.kind if thing.kind in NAMED else label
        api.add_label(f"/names/{k}/{n}", label, position=thing.origin)
        for j, shape in enumerate(thing.shapes):
            opacity = None if shape.opacity == 1.0 else shape.opacity
            color = _color(shape)
            things.add(f"{n}-{j}", k, shape, color, opacity=opacity, side="double")
    return things, names


class RowsDrawing:
    """Measured points, error vectors, and the residual map.

    Attributes:
        rows: The measurements.
        behind: Carries the measured points.
        measured: The measured points.
        map: Carries the residual map.
        vectors: Error vectors by stage; none where nothing is measured as a position.
    """

    def __init__(self, api: viser.SceneApi, rows: Rows, size: float) -> None:
        """Draw them; vectors as long as they are, and a map without points."""
        self._api, self.rows, self._size = api, rows, size
        self._last = list(rows.stages.values())[-1]
        measured = self._last.measured
        self.behind = api.add_frame("/behind", show_axes=False)
        self.measured = api.add_point_cloud(
            "/behind/measured",
            measured[np.isfinite(measured).all(axis=1)].astype(np.float32),
            MEASURED,
            point_size=0.005 * size,
            point_shape="circle",
            precision="float32",
        )
        self.map = api.add_frame("/map", show_axes=False)
        self._mark = api.add_icosphere(
            "/row", radius=0.012 * size, color=MARK, cast_shadow=False
        )
        # Lines have no shades: they keep the colors of the legend.
        self.vectors = {
            name: api.add_line_segments(
                f"/{name}",
                lines(errors, 1.0),
                np.array(STAGES[name]),
                thickness=0.004 * size,
            )
            for name, errors in rows.stages.items()
            if np.isfinite(errors.vectors).any()
        }

    def magnify(self, factor: float) -> None:
        """Draw the error vectors magnified by a factor."""
        for name, handle in self.vectors.items():
            handle.points = lines(self.rows.stages[name], factor)

    def color_map(self, stage: str, quantity: str, block: str) -> ErrorSizes:
        """Color the tool points of a stage by the error of a quantity.

        Returns:
            The sizes of the measurements that are shown, those of a block.
        """
        errors = self.rows.stages[stage]
        found = errors.quantities[quantity]
        shown = found.shown & self.rows.blocks[block]
        sizes = found.sizes[shown]
        # Points and colors in one: a browser may draw between two messages.
        self._api.add_point_cloud(
            "/map/points",
            errors.points[shown].astype(np.float32),
            scaled(sizes) if len(sizes) else MEASURED,
            point_size=0.014 * self._size,
            point_shape="circle",
            precision="float32",
        )
        return ErrorSizes(found.unit, sizes)

    def mark(self, row: int) -> None:
        """Mark the tool point of a measurement."""
        self._mark.position = self._last.points[row]


def lines(errors: StageErrors, factor: float) -> NDArray[np.float32]:
    """Magnified error vectors from the measured points, shape (n, 2, 3) [m].

    Where no position is measured, there is none.
    """
    measured = errors.measured
    ends = np.stack([measured, measured + factor * errors.vectors], axis=1)
    return ends[np.isfinite(ends).all(axis=(1, 2))].astype(np.float32)


def _color(shape: Shape) -> RGB:
    if shape.color is None:
        return ROBOT
    red, green, blue = (round(255 * part) for part in shape.color)
    return red, green, blue


def _wxyz(T: Floats) -> Floats:
    return np.roll(to_quaternion(T[:3, :3]), 1)


SEEN, LEVER = 0.004, 0.15
"""Distance of links that is seen, and a lever for turns, by the size of the robot."""

NAMED = ("station", "camera", "board")
"""Things whose kind tells more than their name."""

CLOSE = 3.0
"""Distance of things that are seen at first, by the size of the robot."""

CORNER = np.array([0.80, -0.52, 0.30])
"""Direction from the robot to the camera: from its front, its right and above."""

ANGLE = 0.7
"""Vertical angle of view [rad]."""

ASPECT = 0.95
"""Width of the view by its height, beside the panel of a usual window."""


class Stage:
    """The drawn scene, and what can be changed of it.

    Attributes:
        size: Size of the robot [m].
        robots: The robots by name.
        things: Instruments and targets.
        names: Their names.
        rows: Measurements, if there are any.
        path: The paths of all tips, if there is a plan.
    """

    def __init__(
        self,
        viewer: viser.ViserServer | viser.ClientHandle,
        scene: Scene,
    ) -> None:
        """Draw everything for all tabs, or for one."""
        self._viewer, self._bodies = viewer, scene.bodies
        skeleton = scene.bodies[0].skeleton
        api, floor = viewer.scene, floor_height(skeleton, scene.shapes)
        robot = corners(skeleton, scene.shapes, scene.start)
        self.size = size = float(np.ptp(robot, axis=0).max())
        _light(api, size, floor)
        seen = [robot, np.array([[*robot.mean(axis=0)[:2], floor]])]
        if scene.rows is not None:
            seen += [errors.points for errors in scene.rows.stages.values()]
        # A tracker may stand far away.
        spots = [thing.origin for thing in scene.things]
        seen += [spot[None] for spot in spots if np.linalg.norm(spot) < CLOSE * size]
        self._seen = np.concatenate(seen)
        self.robots = {body.name: draw_robot(api, body, scene) for body in self._bodies}
        self.things, self.names = draw_things(api, scene)
        self._posture = scene.start, ""
        self.rows = None if scene.rows is None else RowsDrawing(api, scene.rows, size)
        self.path = None
        if scene.plan is not None:
            ways = scene.plan.paths
            self.path = api.add_line_segments(
                "/path",
                np.concatenate([np.stack([w[:-1], w[1:]], axis=1) for w in ways]),
                np.array(PATH),
                thickness=0.002 * size,
            )

    def see(self, camera: viser.InitialCameraConfig | viser.CameraHandle) -> None:
        """Have a camera see everything, but what is far away."""
        camera.fov, camera.up = ANGLE, (0.0, 0.0, 1.0)
        camera.position, camera.look_at = sight(self._seen)

    def pose(self, q: Floats, payload: str) -> None:
        """Put all robots where their joints are commanded to be.

        Args:
            q: Positions of the skeleton's joints, shape (K,) [rad, m].
            payload: Name of what is carried.
        """
        self._posture = q.copy(), payload
        placements = [body.placements(q, payload) for body in self._bodies]
        with self._viewer.atomic():
            *others, last = self.robots.values()
            for ghost, T in zip(others, placements, strict=False):
                ghost.put(T)
                ghost.hide_equal(placements[-1], self.size)
            for group in (last, self.things, self.names):
                group.put(placements[-1])

    def magnify(self, factor: float) -> None:
        """Magnify error vectors and all corrections of the robot by a factor."""
        self._bodies = tuple(body.magnified(factor) for body in self._bodies)
        self.pose(*self._posture)
        if self.rows is not None:
            self.rows.magnify(factor)


def sight(points: Floats) -> tuple[Floats, Floats]:
    """The position and target (3,) [m] of a camera that sees all points (N, 3) [m]."""
    center = 0.5 * (points.min(axis=0) + points.max(axis=0))
    ahead = CORNER / np.linalg.norm(CORNER)
    right = np.cross([0.0, 0.0, 1.0], ahead)
    right /= np.linalg.norm(right)
    x, y, z = ((points - center) @ np.stack([right, np.cross(ahead, right), ahead]).T).T
    slope = np.tan(0.5 * ANGLE)
    distance = np.max(z + np.maximum(np.abs(x) / ASPECT, np.abs(y)) / slope)
    return center + 1.05 * distance * ahead, center


def _light(api: viser.SceneApi, size: float, floor: float) -> None:
    """Lights and a floor for a robot of some size [m]."""
    api.set_up_direction("+z")
    # Its reflections take long where there is no graphics card.
    api.configure_environment_map(None)
    api.configure_default_lights(True, cast_shadow=True)
    api.add_light_hemisphere("/sky", ground_color=(190, 185, 180), intensity=2.5)
    api.add_grid(
        "/floor",
        width=4.0 * size,
        height=4.0 * size,
        cell_size=0.1,
        section_size=1.0,
        cell_color=(225, 225, 228),
        section_color=(190, 190, 195),
        shadow_opacity=0.18,
        fade_distance=10.0 * size,
        position=(0.0, 0.0, floor),
    )
