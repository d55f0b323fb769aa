"""The window: camera, lights, floor and robots, and the controls of all that is shown.

Controls move robots and joints, go to measurements and configurations of a plan, and
magnify errors.
"""

from __future__ import annotations

import html
import math
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import Normalize, to_hex
from numpy.typing import NDArray

from calib_pin.kinematics.shapes import Shape
from calib_pin.kinematics.skeleton import corners, floor_height
from calib_pin.kinematics.spatial import Floats, to_quaternion
from calib_pin.units import DISPLAY
from calib_pin.viewer.scene import Body, Rows, Scene, StageErrors

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

STAGES: dict[str, RGB] = {"before": (213, 94, 0), "after": (0, 114, 178)}
"""Of errors, after Okabe and Ito."""

MARK: RGB = (204, 121, 167)
"""Of the measurement that is looked at."""

UNKNOWN: RGB = (40, 40, 40)

MAP = colormaps["viridis"]
"""Colormap of sizes: perceptually uniform, and of growing lightness."""

STEPS = ", ".join(map(to_hex, MAP(np.linspace(0.0, 1.0, 9))))
BAR = f"height: 0.8em; background: linear-gradient(to right, {STEPS})"
"""Style of a bar with its colors."""

LAST = 1e9
"""Place of the sliders in the panel: there may be many."""

MAGNIFICATIONS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
"""Magnifications of the error vectors."""

VISIBLE = 0.2
"""Length that the largest vector gets at first, by the size of the robot."""


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


class Controls:
    """The controls of a window.

    Attributes:
        gui: Where they are added.
        lock: Held while something is done: callbacks come from several threads, and
            a robot's kinematics have one memory.
    """

    def __init__(self, gui: viser.GuiApi) -> None:
        """Start without controls."""
        self.gui = gui
        self.lock = threading.RLock()

    def on(self, control: Any, do: Callable[[Any], None]) -> None:
        """Do something with the value of a control when a person changes it."""

        def updated(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:  # Values that are put there have none.
                with self.lock:
                    do(control.value)

        control.on_update(updated)

    def switch(self, label: str, of: Any) -> None:
        """A checkbox that shows or hides a drawing, which is seen at first."""

        def show(visible: bool) -> None:
            of.visible = visible

        self.on(self.gui.add_checkbox(label, True), show)


def text(content: str) -> str:
    """HTML as it stands between controls."""
    return f'<div style="font-size: 0.8em; padding: 0 0.8em 0.5em">{content}</div>'


def swatch(color: RGB, label: str) -> str:
    """A colored square with its meaning."""
    square = f'<span style="color: rgb{color}">&#9632;</span>'
    return f'<span style="margin-right: 1em">{square} {html.escape(label)}</span>'


class Joints:
    """A slider for every joint, in degrees or millimeters."""

    def __init__(self, controls: Controls, scene: Scene, stage: Stage) -> None:
        """Add the sliders and take the first posture."""
        skeleton = scene.bodies[0].skeleton
        self._stage, (self._columns, self._places) = stage, scene.moved
        self._q, self._payload = scene.start, ""
        self._factors = np.where(skeleton.revolute, 180.0 / math.pi, 1e3)
        lower, upper = (self._factors * end for end in _range(scene))
        units = ["" if turns else " [mm]" for turns in skeleton.revolute]
        alone = scene.rows is None and scene.plan is None
        folder = {"order": LAST, "expand_by_default": alone}
        self._sliders = list[Any]()
        with controls.gui.add_folder("Joints [deg]", **folder):
            for k, name in enumerate(skeleton.joints):
                ends = math.floor(lower[k]), math.ceil(upper[k])
                about = name + units[k], *ends, 0.1, self._displayed(k)
                self._sliders.append(controls.gui.add_slider(*about))
                controls.on(self._sliders[k], lambda _: self._read_value())
        stage.pose(self._q, self._payload)

    def move(self, q: Floats, payload: str) -> None:
        """Move the chains to q (n,) [rad, m]; other joints stay where they are."""
        self._q[self._places] = q[self._columns]
        self._payload = payload
        self._stage.pose(self._q, payload)
        for place in self._places:
            self._sliders[place].value = self._displayed(place)

    def _displayed(self, place: int) -> float:
        return round(float(self._factors[place] * self._q[place]), 2)

    def _read_value(self) -> None:
        values = np.array([slider.value for slider in self._sliders])
        self._q = values / self._factors
        self._stage.pose(self._q, self._payload)


def _range(scene: Scene) -> tuple[Floats, Floats]:
    """Limits of all joints: those of the URDF, and what was measured or planned."""
    skeleton, (columns, places) = scene.bodies[0].skeleton, scene.moved
    ends = np.array([skeleton.lower, skeleton.upper])
    shown = [] if scene.rows is None else [scene.rows.data.q]
    shown += [] if scene.plan is None else [scene.plan]
    every = np.concatenate([ends[:, places], *(q[:, columns] for q in shown)])
    ends[:, places] = every.min(axis=0), every.max(axis=0)
    return ends[0], ends[1]


def draw_scene(viewer: viser.ViserServer | viser.ClientHandle, scene: Scene) -> Stage:
    """Draw a scene for all tabs or for one, and add all controls."""
    stage, controls = Stage(viewer, scene), Controls(viewer.gui)
    with controls.gui.add_folder("Robot"):
        for name, robot in stage.robots.items():
            controls.switch(name, robot.root)
        if len(stage.robots) > 1:
            swatches = (swatch(BODIES[name], name) for name in stage.robots)
            controls.gui.add_html(text("".join(swatches)))
    joints, q = Joints(controls, scene, stage), scene.plan
    if scene.rows is not None:
        _add_rows(controls, stage, scene.rows, joints)
        _add_map(controls, stage, scene.rows)
    _add_magnifier(controls, scene, stage)
    if q is not None:
        with controls.gui.add_folder("Plan"):
            slider = controls.gui.add_slider("configuration", 1, max(len(q), 2), 1, 1)
        controls.on(slider, lambda value: joints.move(q[min(value, len(q)) - 1], ""))
    return stage


def _add_rows(controls: Controls, stage: Stage, rows: Rows, joints: Joints) -> None:
    """A slider that goes to a measurement and marks it."""
    count, last = len(rows.data), list(rows.stages.values())[-1]
    mark = stage.api.add_icosphere(
        "/row", radius=0.012 * stage.size, color=MARK, cast_shadow=False
    )
    with controls.gui.add_folder("Measurements"):
        slider = controls.gui.add_slider("measurement", 1, max(count, 2), 1, 1)
        about = controls.gui.add_html("")

    def show(value: int) -> None:
        row = min(value, count) - 1
        about.content = text(_facts(rows, row))
        mark.position = last.points[row]
        joints.move(rows.data.q[row], rows.data.payload[row])

    controls.on(slider, show)
    show(1)


def _add_magnifier(controls: Controls, scene: Scene, stage: Stage) -> None:
    """One slider for error vectors and the geometry, if there are any of these."""
    stages = {} if scene.rows is None else scene.rows.stages
    # Of the stages at which something is measured as a position.
    positions = {n: e for n, e in stages.items() if np.isfinite(e.vectors).any()}
    if not positions and len(scene.bodies) == 1:
        return
    # How far corrections move the origins of links, and the errors of the rows.
    first, last = (scene.bodies[k].placements(scene.start)[:, :3, 3] for k in (0, -1))
    moves = last - first, *(errors.vectors for errors in positions.values())
    largest = max(float(np.nanmax(np.linalg.norm(move, axis=1))) for move in moves)
    # Lines have no shades: they keep the colors of the legend.
    vectors = {
        name: stage.api.add_line_segments(
            f"/{name}",
            lines(errors, 1.0),
            np.array(STAGES[name]),
            thickness=0.004 * stage.size,
        )
        for name, errors in positions.items()
    }
    # The one that makes the largest vector just not too long.
    fitting = (m for m in MAGNIFICATIONS if m * largest <= VISIBLE * stage.size)
    chosen, factors = str(max(fitting, default=1)), tuple(map(str, MAGNIFICATIONS))
    with controls.gui.add_folder("Errors and corrections"):
        for name, handle in vectors.items():
            controls.switch(name, handle)
        choice = controls.gui.add_dropdown("magnified", factors, initial_value=chosen)
        legend = controls.gui.add_html("")
    swatches = "".join(swatch(STAGES[name], name) for name in vectors)

    def magnify(factor: str) -> None:
        stage.magnify(float(factor))
        for name, handle in vectors.items():
            handle.points = lines(positions[name], float(factor))
        caption = "errors (predicted minus measured) and corrections of the robot"
        legend.content = text(f"{swatches}<br>{caption}, magnified {factor} times")

    controls.on(choice, magnify)
    magnify(chosen)


def lines(errors: StageErrors, factor: float) -> NDArray[np.float32]:
    """Magnified error vectors from the measured points, shape (n, 2, 3) [m].

    Where no position is measured, there is none.
    """
    measured = errors.points - errors.vectors
    ends = np.stack([measured, measured + factor * errors.vectors], axis=1)
    return ends[np.isfinite(ends).all(axis=(1, 2))].astype(np.float32)


def _add_map(controls: Controls, stage: Stage, rows: Rows) -> None:
    """Tool points in colors of their errors."""
    stages = tuple(rows.stages)
    quantities = tuple(rows.stages[stages[-1]].sizes)
    with controls.gui.add_folder("Residual map"):
        points = stage.api.add_frame("/map", show_axes=False)
        controls.switch("tool points by size", points)
        quantity = controls.gui.add_dropdown("error of", quantities)
        robot = controls.gui.add_dropdown("robot", stages, initial_value=stages[-1])
        legend = controls.gui.add_html("")

    def color() -> None:
        errors = rows.stages[robot.value]
        every = errors.sizes[quantity.value]
        shown = np.isfinite(every)
        sizes, colors, caption = every[shown], UNKNOWN, "no measurement has it"
        unit, factor = DISPLAY[errors.units[quantity.value]]
        if len(sizes):
            colors = MAP(Normalize()(sizes), bytes=True)[:, :3]
            least, most = factor * sizes.min(), factor * sizes.max()
            caption = f'<div style="{BAR}"></div>{least:.3g} to {most:.3g} {unit}'
        # Points and colors in one: a browser may draw between two messages.
        stage.api.add_point_cloud(
            "/map/points",
            errors.points[shown].astype(np.float32),
            colors,
            point_size=0.014 * stage.size,
            point_shape="circle",
            precision="float32",
        )
        legend.content = text(caption)

    for choice in (quantity, robot):
        controls.on(choice, lambda _: color())
    color()


def _facts(rows: Rows, row: int) -> str:
    """The source of a measurement, its target, and its errors."""
    lines = [Path(rows.data.source(row)).name]
    if len(rows.data.blocks) > 1:
        key = rows.data.keys[int(rows.data.block_of[row])]
        lines.append(", ".join(filter(None, key)))
    if rows.data.target[row]:
        lines.append(f"target {rows.data.target[row]}")
    for name, quantity in next(iter(rows.stages.values())).units.items():
        unit, factor = DISPLAY[quantity]
        sizes = {stage: e.sizes[name][row] for stage, e in rows.stages.items()}
        parts = [f"{s} {factor * x:.3g} {unit}" for s, x in sizes.items() if x < np.inf]
        if parts:
            lines.append(f"{name}: {', '.join(parts)}")
    return "<br>".join(map(html.escape, lines))
