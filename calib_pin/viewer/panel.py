"""The controls of the window, from the robots to the joints."""

from __future__ import annotations

import html
from pathlib import Path

import numpy as np

from calib_pin.units import DISPLAY
from calib_pin.viewer.controls import STAGES, Controls, scale, swatch, text
from calib_pin.viewer.errors import StageErrors
from calib_pin.viewer.motion import Joints, Player
from calib_pin.viewer.scene import Rows, Scene
from calib_pin.viewer.stage import RowsDrawing, Stage

MAGNIFICATIONS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
"""Magnifications of the error vectors."""

VISIBLE = 0.2
"""Length that the largest vector gets at first [m]."""


def add_panel(controls: Controls, scene: Scene, stage: Stage) -> Player | None:
    """Add all controls.

    Args:
        controls: The window's controls.
        scene: What is drawn.
        stage: Where it is drawn.

    Returns:
        What plays the plan, if there is one.
    """
    with controls.gui.add_folder("Robot"):
        for name, robot in stage.robots.items():
            controls.switch(name, robot.root)
    joints = Joints(controls, scene, stage)
    if scene.rows is not None and stage.rows is not None:
        _add_rows(controls, scene.rows, stage.rows, joints)
        if stage.rows.vectors:
            _add_vectors(controls, scene.rows, stage.rows)
        _add_map(controls, scene.rows, stage.rows)
    if scene.plan is None or stage.path is None:
        return None
    return Player(controls, scene.plan, joints, stage.path)


def first_magnification(largest: float) -> int:
    """The magnification that makes the largest vector just not too long.

    Args:
        largest: Its length [m].
    """
    fitting = [step for step in MAGNIFICATIONS if step * largest <= VISIBLE]
    return fitting[-1] if fitting else MAGNIFICATIONS[0]


def _add_rows(
    controls: Controls, rows: Rows, drawing: RowsDrawing, joints: Joints
) -> None:
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


def _add_vectors(controls: Controls, rows: Rows, drawing: RowsDrawing) -> None:
    lengths = [np.linalg.norm(e.vectors, axis=1) for e in rows.stages.values()]
    first = MAGNIFICATIONS.index(first_magnification(float(np.nanmax(lengths))))
    marks = tuple((k, str(MAGNIFICATIONS[k])) for k in (0, 3, 6, 9))
    with controls.gui.add_folder("Errors, predicted minus measured"):
        for name, handle in drawing.vectors.items():
            controls.switch(name, handle)
        # Of one value: the plain slider would write the number of the step beside it.
        slider = controls.gui.add_multi_slider(
            "magnified", 0, len(MAGNIFICATIONS) - 1, 1, (first,), marks=marks
        )
        legend = controls.gui.add_html("")

    def magnify(value: tuple[int, ...]) -> None:
        factor = MAGNIFICATIONS[value[0]]
        drawing.magnify(factor)
        swatches = "".join(swatch(STAGES[name], name) for name in drawing.vectors)
        legend.content = text(
            f"{swatches}<br>magnified {factor} times, from the measured point"
        )

    controls.on(slider, magnify)
    magnify((first,))


def _add_map(controls: Controls, rows: Rows, drawing: RowsDrawing) -> None:
    stages = tuple(rows.stages)
    quantities = tuple(rows.stages[stages[-1]].quantities)
    with controls.gui.add_folder("Residual map"):
        # Without vectors it is the only view of the errors.
        on = not drawing.vectors
        # Measured points would look like holes in those of the map.
        controls.switch("tool points by size", drawing.map, on, instead=drawing.behind)
        quantity = controls.gui.add_dropdown("error of", quantities)
        stage = controls.gui.add_dropdown("robot", stages, initial_value=stages[-1])
        legend = controls.gui.add_html("")

    def color() -> None:
        drawing.color_map(stage.value, quantity.value)
        found = rows.stages[stage.value].quantities[quantity.value]
        unit, factor = DISPLAY[found.unit]
        legend.content = scale(factor * found.sizes[found.shown], unit)

    for choice in (quantity, stage):
        controls.on(choice, lambda _: color())
    color()


def _about(rows: Rows, row: int) -> str:
    """The source of a measurement, its target, and its errors."""
    lines = [html.escape(Path(rows.data.source(row)).name)]
    if rows.data.target[row]:
        lines.append(f"target {html.escape(rows.data.target[row])}")
    for name in next(iter(rows.stages.values())).quantities:
        found = [
            f"{stage} {size}"
            for stage, errors in rows.stages.items()
            if (size := _size(errors, name, row))
        ]
        if found:
            lines.append(f"{html.escape(name)}: {', '.join(found)}")
    return "<br>".join(lines)


def _size(errors: StageErrors, name: str, row: int) -> str:
    quantity = errors.quantities[name]
    if not quantity.shown[row]:
        return ""
    unit, factor = DISPLAY[quantity.unit]
    return f"{factor * quantity.sizes[row]:.3g} {unit}"
