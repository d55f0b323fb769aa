"""A page for one tab: what it says and asks as plain data, drawn as viser's widgets."""

from __future__ import annotations

import html
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from calib_pin.viewer.panel import draw_scene, text
from calib_pin.viewer.scene import Scene

if TYPE_CHECKING:
    import viser

DROP = """
<div ondragover="event.preventDefault()" ondrop="event.preventDefault();
const input = document.querySelector('input[type=file]');
[...event.dataTransfer.files].forEach((file, k) => setTimeout(() => {{
  const one = new DataTransfer(); one.items.add(file); input.files = one.files;
  input.dispatchEvent(new Event('change', {{bubbles: true}}));
}}, 500 * k))" style="border: 2px dashed #8aa; border-radius: 8px; text-align: center;
margin: 0.2em 0.9em 0.6em; padding: 1.1em 0.8em; font-size: 0.9em">{}</div>"""
"""Where files may be dropped; the button for the choice of one takes them in.

It knows the last one only: several follow one another.
"""

TONES = {
    **{"plain": "", "note": "opacity: 0.75", "strong": "font-weight: 600"},
    "error": "color: #d6336c; font-weight: 600",
    "head": "font-size: 1.05em; font-weight: 600",
    "good": "padding: 0.6em; border-radius: 6px; background: #1b7f3b; color: white",
    "bad": "padding: 0.6em; border-radius: 6px; background: #b3261e; color: white",
    "code": "font: 0.85em monospace; white-space: pre-wrap; padding: 0.5em; "
    "border: 1px solid #8886; border-radius: 6px",
}
"""How words are shown."""

LINK = "display: inline-block; margin: 0.2em 0.6em 0.2em 0; padding: 0.3em 0.7em; "
LINK += "border: 1px solid #228be6; border-radius: 6px; text-decoration: none; "
PRIMARY = "color: white; background: #228be6; font-weight: 600"
"""How links to files look, and to those that matter most."""


@dataclass(frozen=True)
class Widget:
    """A widget as plain data.

    Attributes:
        kind: `words`; `links` to files; `choice` of one of several; `entry` and `lines`
            of a person, each with a button; `button`; `upload` of files; `progress`;
            `scene` for the controls of a `Scene`, which is drawn.
        label: What stands beside it or on its button.
        value: What it shows: words, addresses by their labels, the choice, a part.
        choices: What can be chosen.
        tone: How words are shown, `TONES`.
        do: Told what a person chooses or writes, or the name and bytes of a file.
    """

    kind: str
    label: str = ""
    value: Any = ""
    choices: tuple[str, ...] = ()
    tone: str = "plain"
    do: Callable[..., None] = field(default=lambda: None, compare=False)


def words(text: str, tone: str = "plain") -> Widget:
    """Words alone."""
    return Widget("words", value=text, tone=tone)


@dataclass(frozen=True)
class Section:
    """Widgets below a heading.

    Attributes:
        title: The heading.
        widgets: Its widgets; a section without any is not shown.
        expanded: Whether they are seen at first.
    """

    title: str
    widgets: Sequence[Widget]
    expanded: bool = True


class Page:
    """The page of one tab, drawn again where what it shows has changed.

    Args:
        viewer: Where widgets and the scene of the tab are added.
        camera: Its camera.
        sections: All sections in their order.
    """

    def __init__(
        self,
        viewer: viser.ViserServer | viser.ClientHandle,
        camera: viser.InitialCameraConfig | viser.CameraHandle,
        sections: Callable[[], Iterable[Section]],
    ) -> None:
        """Nothing is drawn before the first tick."""
        self._viewer, self._camera, self._sections = viewer, camera, sections
        self._drawn = dict[str, tuple[Section, Any]]()
        self._seen: tuple[str, bool] | None = None

    def tick(self) -> None:
        """Draw what has changed."""
        with self._viewer.atomic():
            for order, section in enumerate(self._sections()):
                before, folder = self._drawn.get(section.title, (None, None))
                if section != before:
                    if folder is not None:
                        folder.remove()
                    self._drawn[section.title] = section, self._show(section, order)

    def _show(self, section: Section, order: int) -> Any:
        """The folder of a section, with its widgets; None without any."""
        if not section.widgets:
            return None
        about = {"order": order, "expand_by_default": section.expanded}
        with (folder := self._viewer.gui.add_folder(section.title, **about)):
            for widget in section.widgets:
                if widget.kind == "scene":
                    self._view(widget.value)
                else:
                    draw(self._viewer.gui, widget)
        return folder

    def _view(self, scene: Scene) -> None:
        """Draw another scene, with its controls."""
        self._viewer.scene.reset()
        stage = draw_scene(self._viewer, scene)
        # While rows come in, and after the calibration, nobody's view is moved.
        kind = scene.title, scene.rows is None
        if kind != self._seen:
            stage.see(self._camera)
        self._seen = kind


def draw(gui: viser.GuiApi, widget: Widget) -> None:
    """Add a widget."""
    label, value, do = widget.label, widget.value, widget.do
    match widget.kind:
        case "words":
            style = TONES[widget.tone]
            shown = f'<div style="white-space: pre-wrap; {style}">{html.escape(value)}'
            gui.add_html(text(f"{shown}</div>"))
        case "links":
            style = LINK + PRIMARY * (widget.tone == "good")
            links = (
                f'<a style="{style}" target="_blank" href="{html.escape(to)}"'
                f"{'' if to.partition('?')[0].endswith('.html') else ' download'}>"
                f"{html.escape(name)}</a>"
                for name, to in value.items()
            )
            gui.add_html(text("".join(links)))
        case "progress":
            gui.add_html(text(html.escape(label)))
            part = 100.0 if value is None else 100.0 * value
            gui.add_progress_bar(part, animated=True)
        case "choice":
            choice = gui.add_dropdown(label, widget.choices, initial_value=value)
            choice.on_update(lambda _: do(choice.value))
        case "entry" | "lines":
            (name,) = widget.choices or ("",)
            entry = gui.add_text(name, value, multiline=widget.kind == "lines")
            gui.add_button(label, color="gray").on_click(lambda _: do(entry.value))
        case "button":
            color = "green" if widget.tone == "good" else "gray"
            gui.add_button(label, color=color).on_click(lambda _: do())
        case "upload":
            gui.add_html(DROP.format(html.escape(value)))
            upload = gui.add_upload_button(label)

            # Where uploads come in, so that the next one cannot take its place.
            @upload.on_upload
            async def take(_: object) -> None:
                do(upload.value.name, upload.value.content)
