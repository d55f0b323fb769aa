"""The three-dimensional part of the window: camera, lights, floor, robots."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from calib_pin.kinematics.shapes import Shape
from calib_pin.kinematics.skeleton import corners, floor_height
from calib_pin.kinematics.spatial import Floats, to_quaternion
from calib_pin.viewer.scene import Body, Scene

if TYPE_CHECKING:
    import viser

RGB = tuple[int, int, int]

ROBOT: RGB = (225, 222, 214)
"""Of a robot whose URDF states none."""

BODIES: dict[str, RGB] = {"nominal": (213, 94, 0), "corrected": (70, 150, 205)}
"""Of robots beside each other, those of their errors; the second one in more light."""

OPACITY = 0.35
"""Of the nominal robot beside the corrected one."""

SEEN, LEVER = 0.004, 0.15
"""Distance of links that is seen, and a lever for turns, by the size of the robot."""

CORNER = np.array([0.80, -0.52, 0.30])
"""Direction from the robot to the camera: from its front, its right and above."""

ANGLE = 0.7
"""Vertical angle of view [rad]."""

ASPECT = 0.95
"""Width of the view by its height, beside the panel of a usual window."""


class Group:
    """The shapes of a robot, which hang on its links and move with them.

    Attributes:
        root: Carries all of them.
        frames: The frame of each link that carries something, by its number.
    """

    def __init__(
        self, api: viser.SceneApi, body: Body, shapes: Sequence[Shape]
    ) -> None:
        """Draw them; beside the corrected robot the nominal one is a ghost."""
        links, ghost = body.skeleton.links, body.name == "nominal"
        self.root = api.add_frame(f"/{body.name}", show_axes=False)
        self.frames = dict[int, Any]()
        for k, shape in enumerate(shapes):
            link = links.index(shape.link)
            # Names of links may hold slashes, which mean something here.
            name = f"/{body.name}/{link}"
            if link not in self.frames:
                self.frames[link] = api.add_frame(name, show_axes=False)
            api.add_mesh_simple(
                f"{name}/{k}",
                shape.surface.vertices.astype(np.float32),
                shape.surface.triangles.astype(np.uint32),
                color=BODIES.get(body.name, _color(shape)),
                opacity=OPACITY if ghost else None,
                flat_shading=True,
                cast_shadow=not ghost,
                receive_shadow=not ghost,
                position=shape.placement[:3, 3],
                wxyz=_wxyz(shape.placement),
            )

    def put(self, placements: Floats) -> None:
        """Put the links in place, which have the poses (L, 4, 4)."""
        for k, frame in self.frames.items():
            frame.position, frame.wxyz = placements[k, :3, 3], _wxyz(placements[k])


class Stage:
    """The drawn scene, and what can be changed of it.

    Attributes:
        api: Where it is drawn.
        size: Size of the robot [m].
        robots: The robots by name.
    """

    def __init__(
        self, viewer: viser.ViserServer | viser.ClientHandle, scene: Scene
    ) -> None:
        """Draw everything but errors and plans for all tabs, or for one."""
        self._viewer, self.api, self._bodies = viewer, viewer.scene, scene.bodies
        skeleton, self._posture = scene.bodies[0].skeleton, (scene.start, "")
        floor = floor_height(skeleton, scene.shapes)
        robot = corners(skeleton, scene.shapes, scene.start)
        self.size = float(np.ptp(robot, axis=0).max())
        _light(self.api, self.size, floor)
        seen = [robot, np.array([[*robot.mean(axis=0)[:2], floor]])]
        if scene.rows is not None:
            seen += [errors.points for errors in scene.rows.stages.values()]
        self._seen = np.concatenate(seen)
        self.robots = {b.name: Group(self.api, b, scene.shapes) for b in self._bodies}

    def see(self, camera: viser.InitialCameraConfig | viser.CameraHandle) -> None:
        """Have a camera see everything, but what is far away."""
        camera.fov, camera.up = ANGLE, (0.0, 0.0, 1.0)
        camera.position, camera.look_at = sight(self._seen)

    def pose(self, q: Floats, payload: str) -> None:
        """Put all robots where their joints are commanded to be.

        Two surfaces in one place would be drawn as a mixture of both: of the nominal
        robot only links are shown that the corrected one has elsewhere, as far as one
        can see.

        Args:
            q: Positions of the skeleton's joints, shape (K,) [rad, m].
            payload: Name of what is carried.
        """
        self._posture = q.copy(), payload
        *others, last = (body.placements(q, payload) for body in self._bodies)
        *ghosts, robot = self.robots.values()
        weight = np.array([LEVER * self.size] * 3 + [1.0])
        with self._viewer.atomic():
            for ghost, T in zip(ghosts, others, strict=True):
                ghost.put(T)
                away = np.linalg.norm((last - T) * weight, axis=(1, 2))
                for k, frame in ghost.frames.items():
                    frame.visible = bool(away[k] > SEEN * self.size)
            robot.put(last)

    def magnify(self, factor: float) -> None:
        """Magnify all corrections of the robot by a factor."""
        self._bodies = tuple(body.magnified(factor) for body in self._bodies)
        self.pose(*self._posture)


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


def _color(shape: Shape) -> RGB:
    if shape.color is None:
        return ROBOT
    red, green, blue = (round(255 * part) for part in shape.color)
    return red, green, blue


def _wxyz(T: Floats) -> Floats:
    return np.roll(to_quaternion(T[:3, :3]), 1)


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
