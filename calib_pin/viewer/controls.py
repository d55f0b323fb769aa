"""Controls that do something, the text between them, and the colors of the scene."""

from __future__ import annotations

import html
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import colormaps
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats

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
