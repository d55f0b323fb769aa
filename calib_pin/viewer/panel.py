"""The controls of the window: robots, joints, measurements, and a plan."""

from __future__ import annotations

import html
import io
import math
import re
import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import colormaps
from PIL import Image

from calib_pin.kinematics.spatial import Floats
from calib_pin.report.breakdown import block_names
from calib_pin.units import DISPLAY
from calib_pin.viewer.scene import Plan, Rows, Scene
from calib_pin.viewer.stage import BODIES, MAP, RGB, STAGES, RowsDrawing, Stage

if TYPE_CHECKING:
    import viser

LAST = 1e9
"""Place of the sliders in the panel: there may be many."""


def css(color: tuple[int, ...]) -> str:
    """A color as style sheets write it."""
    return f"rgb({', '.join(map(str, color))})"


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

    def switch(
        self, label: str, of: Any, on: bool = True, *, instead: Any = None
    ) -> None:
        """A checkbox that shows or hides a drawing, and another one instead of it."""

        def show(visible: bool) -> None:
            of.visible = visible
            if instead is not None:
                instead.visible = not visible

        self.on(self.gui.add_checkbox(label, on), show)
        show(on)


def put(control: Any, value: float) -> None:
    """Set the value of a control, which viser lets nobody see."""
    control.value = value


def text(content: str) -> str:
    """HTML as it stands between controls."""
    return f'<div style="font-size: 0.8em; padding: 0 0.8em 0.5em">{content}</div>'


def swatch(color: RGB, label: str) -> str:
    """A colored square with its meaning."""
    square = f'<span style="color: {css(color)}">&#9632;</span>'
    return f'<span style="margin-right: 1em">{square} {html.escape(label)}</span>'


def scale(sizes: Floats, unit: str) -> str:
    """The colormap with the least and the largest size at its ends."""
    if len(sizes) == 0:
        return text("no measurement has it")
    ends = f"<span>{sizes.min():.3g} {unit}</span><span>{sizes.max():.3g} {unit}</span>"
    steps = colormaps[MAP](np.linspace(0.0, 1.0, 9), bytes=True)[:, :3].tolist()
    gradient = f"linear-gradient(to right, {', '.join(map(css, steps))})"
    bar = f'<div style="height: 0.8em; background: {gradient}"></div>'
    return text(
        f'{bar}<div style="display: flex; justify-content: space-between">{ends}</div>'
    )


class Joints:
    """A slider for every joint, in degrees or millimeters.

    Attributes:
        mover: Control that moved the robots last; None for a person at these sliders.
    """

    def __init__(self, controls: Controls, scene: Scene, stage: Stage) -> None:
        """Add the sliders and take the first posture."""
        skeleton = scene.bodies[0].skeleton
        self._stage, (self._columns, self._places) = stage, scene.moved
        self._q, self._payload = scene.start, ""
        self._factors = np.where(skeleton.revolute, 180.0 / math.pi, 1e3)
        self.mover: object | None = None
        lower, upper = (self._factors * end for end in _range(scene))
        units = ["" if turns else " [mm]" for turns in skeleton.revolute]
        alone = scene.rows is None and scene.plan is None
        with controls.gui.add_folder(
            "Joints [deg]", order=LAST, expand_by_default=alone
        ):
            self._sliders = [
                controls.gui.add_slider(
                    name + units[k],
                    math.floor(lower[k]),
                    math.ceil(upper[k]),
                    0.1,
                    self._displayed(k),
                )
                for k, name in enumerate(skeleton.joints)
            ]
        for slider in self._sliders:
            controls.on(slider, lambda _: self._read())
        stage.pose(self._q, self._payload)

    def move(self, q: Floats, payload: str, mover: object) -> None:
        """Move the chains to q (n,) [rad, m]; other joints stay where they are."""
        self._q[self._places] = q[self._columns]
        self._payload, self.mover = payload, mover
        self._stage.pose(self._q, payload)
        for place in self._places:
            put(self._sliders[place], self._displayed(place))

    def _displayed(self, place: int) -> float:
        return round(float(self._factors[place] * self._q[place]), 2)

    def _read(self) -> None:
        values = np.array([slider.value for slider in self._sliders])
        self._q, self.mover = values / self._factors, None
        self._stage.pose(self._q, self._payload)


def _range(scene: Scene) -> tuple[Floats, Floats]:
    """Limits of all joints: those of the URDF, and what was measured or planned."""
    skeleton, (columns, places) = scene.bodies[0].skeleton, scene.moved
    ends = np.array([skeleton.lower, skeleton.upper])
    shown = [] if scene.rows is None else [scene.rows.data.q]
    shown += [] if scene.plan is None else [scene.plan.q]
    every = np.concatenate([ends[:, places], *(q[:, columns] for q in shown)])
    ends[:, places] = every.min(axis=0), every.max(axis=0)
    return ends[0], ends[1]


class Player:
    """The controls of a plan, which play its configurations in their order."""

    def __init__(
        self,
        controls: Controls,
        plan: Plan,
        joints: Joints,
        path: viser.LineSegmentsHandle,
    ) -> None:
        """Add the controls; nothing is played yet."""
        self._lock, self._plan, self._joints = controls.lock, plan, joints
        self._number, self._playing = 0.0, False
        count = len(plan.q)
        with controls.gui.add_folder("Plan"):
            self._slider = controls.gui.add_slider("number", 1, max(count, 2), 1, 1)
            self._button = controls.gui.add_button("play", disabled=count < 2)
            self._speed = controls.gui.add_slider("per second", 0.1, 5.0, 0.1, 1.0)
            controls.switch(
                "paths of the tips" if len(plan.paths) > 1 else "path of the tip", path
            )
        controls.on(self._slider, lambda value: self._show(min(value, count) - 1.0))
        self._button.on_click(lambda _: self.play(not self._playing))

    def play(self, playing: bool) -> None:
        """Go on from where it stands, or pause."""
        with self._lock:
            self._playing = playing
            self._button.label = "pause" if playing else "play"
            if playing:
                self._show(self._number)

    def tick(self, seconds: float) -> None:
        """Go on by some seconds while the plan is played; it begins again."""
        if not self._playing:
            return
        with self._lock:
            if self._joints.mover is not self:  # Somebody looks at something else.
                self.play(False)
                return
            number = self._number + seconds * self._speed.value
            self._show(number if number <= len(self._plan.q) - 1 else 0.0)
            put(self._slider, int(self._number) + 1)

    def _show(self, number: float) -> None:
        self._number = number
        self._joints.move(self._plan.at(number), "", self)


MAGNIFICATIONS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
"""Magnifications of the error vectors."""

WAIT = 60.0
"""Time for a browser to draw a picture, also without a graphics card [s]."""

VISIBLE = 0.2
"""Length that the largest vector gets at first, by the size of the robot."""


def add_panel(controls: Controls, scene: Scene, stage: Stage) -> Player | None:
    """Add all controls; returns what plays the plan, if there is one."""
    with controls.gui.add_folder("Robot"):
        for name, robot in stage.robots.items():
            controls.switch(name, robot.root)
        if len(stage.robots) > 1:
            swatches = (swatch(BODIES[name], name) for name in stage.robots)
            controls.gui.add_html(text("".join(swatches)))
        if scene.things:
            controls.switch("instruments and targets", stage.things.root)
            controls.switch("their names", stage.names.root, False)
        button = controls.gui.add_button("save picture")
        button.on_click(lambda event: save_picture(event.client, scene.title))
    joints = Joints(controls, scene, stage)
    if stage.rows is not None:
        _add_rows(controls, stage.rows, joints)
    _add_magnifier(controls, scene, stage)
    if stage.rows is not None:
        _add_map(controls, stage.rows)
    if scene.plan is None or stage.path is None:
        return None
    return Player(controls, scene.plan, joints, stage.path)


def _add_rows(controls: Controls, drawing: RowsDrawing, joints: Joints) -> None:
    rows = drawing.rows
    count = len(rows.data)
    with controls.gui.add_folder("Measurements"):
        slider = controls.gui.add_slider("measurement", 1, max(count, 2), 1, 1)
        about = controls.gui.add_html("")
        if drawing.vectors:
            controls.switch("measured points", drawing.measured)

    def show(value: int) -> None:
        row = min(value, count) - 1
        about.content = text(_about(rows, row))
        drawing.mark(row)
        joints.move(rows.data.q[row], rows.data.payload[row], rows)

    controls.on(slider, show)
    show(1)


def _add_magnifier(controls: Controls, scene: Scene, stage: Stage) -> None:
    """One slider for error vectors and the geometry, if there are any of these."""
    vectors, moving = dict[str, Any](), len(scene.bodies) > 1
    largest = scene.largest_move
    if stage.rows is not None and (vectors := stage.rows.vectors):
        errors = stage.rows.rows.stages.values()
        lengths = [np.linalg.norm(e.vectors, axis=1) for e in errors]
        largest = max(largest, float(np.nanmax(lengths)))
    if not (vectors or moving):
        return
    # The one that makes the largest vector just not too long.
    fitting = [m * largest <= VISIBLE * stage.size for m in MAGNIFICATIONS]
    first = str(MAGNIFICATIONS[max(sum(fitting) - 1, 0)])
    factors = tuple(map(str, MAGNIFICATIONS))
    with controls.gui.add_folder(
        "Errors, predicted minus measured" if vectors else "Corrections"
    ):
        for name, handle in vectors.items():
            controls.switch(name, handle)
        choice = controls.gui.add_dropdown("magnified", factors, initial_value=first)
        legend = controls.gui.add_html("")
    what = ["errors, from the measured point"] * bool(vectors)
    what += ["corrections of the robot"] * moving

    def magnify(factor: str) -> None:
        stage.magnify(float(factor))
        swatches = "".join(swatch(STAGES[name], name) for name in vectors)
        told = f"magnified {factor} times: {'; '.join(what)}"
        legend.content = text(f"{swatches}<br>{told}" if swatches else told)

    controls.on(choice, magnify)
    magnify(first)


def save_picture(client: viser.ClientHandle | None, title: str) -> None:
    """Have the browser of whoever asked draw its view once more, as a PNG file.

    Nothing is drawn behind the scene, so that the picture fits on any page.
    """
    if client is None:
        return
    width, height = client.camera.image_width, client.camera.image_height
    image = client.get_render(height, width, transport_format="png", timeout=WAIT)
    stream = io.BytesIO()
    Image.fromarray(image).save(stream, format="png")
    name = re.sub(r"[^\w.-]+", "_", title) or "robot"
    client.send_file_download(f"{name}.png", stream.getvalue(), save_immediately=True)


def _add_map(controls: Controls, drawing: RowsDrawing) -> None:
    rows, stages = drawing.rows, tuple(drawing.rows.stages)
    quantities = tuple(rows.stages[stages[-1]].quantities)
    with controls.gui.add_folder("Residual map"):
        # Without vectors it is the only view of the errors.
        on = not drawing.vectors
        # Measured points would look like holes in those of the map.
        controls.switch("tool points by size", drawing.map, on, instead=drawing.behind)
        quantity = controls.gui.add_dropdown("error of", quantities)
        stage = controls.gui.add_dropdown("robot", stages, initial_value=stages[-1])
        block = controls.gui.add_dropdown(
            "measurements", tuple(rows.blocks), visible=len(rows.blocks) > 1
        )
        legend = controls.gui.add_html("")

    def color() -> None:
        found = drawing.color_map(stage.value, quantity.value, block.value)
        unit, factor = DISPLAY[found.unit]
        legend.content = scale(factor * found.sizes, unit)

    for choice in (quantity, stage, block):
        controls.on(choice, lambda _: color())
    color()


def _about(rows: Rows, row: int) -> str:
    """The source of a measurement, its target, and its errors."""
    lines = [Path(rows.data.source(row)).name]
    if len(rows.data.blocks) > 1:
        lines.append(block_names(rows.data.keys)[int(rows.data.block_of[row])])
    if rows.data.target[row]:
        lines.append(f"target {rows.data.target[row]}")
    for name in next(iter(rows.stages.values())).quantities:
        found = []
        for stage, errors in rows.stages.items():
            quantity = errors.quantities[name]
            unit, factor = DISPLAY[quantity.unit]
            if quantity.shown[row]:
                found.append(f"{stage} {factor * quantity.sizes[row]:.3g} {unit}")
        if found:
            lines.append(f"{name}: {', '.join(found)}")
    return "<br>".join(map(html.escape, lines))
