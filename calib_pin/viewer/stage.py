"""The three-dimensional part of the window: camera, lights, floor, drawings."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from calib_pin.kinematics.spatial import Floats
from calib_pin.viewer.drawings import RobotDrawing, RowsDrawing, draw_path
from calib_pin.viewer.scene import Scene, floor_height

if TYPE_CHECKING:
    import viser

CORNER = np.array([0.80, -0.52, 0.30])
"""Direction from the robot to the camera: from its front, its right and above."""

ANGLE = 0.7
"""Vertical angle of view [rad]."""

ASPECT = 1.1
"""Width of the view by its height; a window is mostly wider."""


class Stage:
    """The drawn scene, and what can be changed of it.

    Args:
        server: The window's server.
        scene: What to draw.

    Attributes:
        robots: The robots by name.
        rows: Measurements, if there are any.
        path: The path of the tip, if there is a plan.
    """

    def __init__(self, server: viser.ViserServer, scene: Scene) -> None:
        """Draw everything."""
        self._server = server
        api, floor = server.scene, floor_height(scene)
        corners = scene.corners(scene.start)
        size = float(np.ptp(corners, axis=0).max())
        _light(api, size, floor)
        seen = [corners, np.array([[*corners.mean(axis=0)[:2], floor]])]
        if scene.rows is not None:
            seen += [errors.points for errors in scene.rows.stages.values()]
        _aim(server.initial_camera, np.concatenate(seen))
        self.robots = {
            body.name: RobotDrawing(api, body, scene.shapes) for body in scene.bodies
        }
        self.rows = None if scene.rows is None else RowsDrawing(api, scene.rows, size)
        self.path = (
            None if scene.plan is None else draw_path(api, scene.plan.path, size)
        )

    def pose(self, q: Floats, payload: str) -> None:
        """Put all robots where their joints are commanded to be.

        Args:
            q: Positions of the skeleton's joints, shape (K,) [rad, m].
            payload: Name of what is carried.
        """
        with self._server.atomic():
            for robot in self.robots.values():
                robot.pose(q, payload)


def sight(points: Floats) -> tuple[Floats, Floats]:
    """The position and target of a camera that sees all points.

    Args:
        points: The points, shape (N, 3) [m].

    Returns:
        Two points, shape (3,) each [m].
    """
    center = 0.5 * (points.min(axis=0) + points.max(axis=0))
    ahead = CORNER / np.linalg.norm(CORNER)
    right = np.cross([0.0, 0.0, 1.0], ahead)
    right /= np.linalg.norm(right)
    x, y, z = ((points - center) @ np.stack([right, np.cross(ahead, right), ahead]).T).T
    slope = np.tan(0.5 * ANGLE)
    distance = np.max(z + np.maximum(np.abs(x) / ASPECT, np.abs(y)) / slope)
    return center + 1.05 * distance * ahead, center


def _aim(camera: viser.InitialCameraConfig, points: Floats) -> None:
    camera.fov = ANGLE
    camera.up = (0.0, 0.0, 1.0)
    camera.position, camera.look_at = sight(points)


def _light(api: viser.SceneApi, size: float, floor: float) -> None:
    """Lights and a floor for a robot of some size [m]."""
    api.set_up_direction("+z")
    # Its reflections take long where there is no graphics card.
    api.configure_environment_map(None)
    api.configure_default_lights(True, cast_shadow=True)
    api.add_light_hemisphere("/sky", ground_color=(190, 185, 180), intensity=1.0)
    api.add_light_point(
        "/lamp",
        intensity=7.0 * size**2,
        position=(2.0 * size, -2.5 * size, floor + 1.5 * size),
    )
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
