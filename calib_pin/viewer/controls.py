"""Controls that do something, and the text between them."""

from __future__ import annotations

import html
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from calib_pin.kinematics.spatial import Floats
from calib_pin.viewer.colors import RGB, css, gradient

if TYPE_CHECKING:
    import viser


class Controls:
    """The controls of a window.

    Args:
        gui: Where they are added.

    Attributes:
        gui: The same.
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
        """A checkbox that shows or hides something.

        Args:
            label: What it is.
            of: What is drawn of it.
            on: Whether it is shown at first.
            instead: What is shown where it is not, if anything.
        """

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
        return text("no row has it")
    ends = f"<span>{sizes.min():.3g} {unit}</span><span>{sizes.max():.3g} {unit}</span>"
    bar = f'<div style="height: 0.8em; background: {gradient()}"></div>'
    return text(
        f'{bar}<div style="display: flex; justify-content: space-between">{ends}</div>'
    )
