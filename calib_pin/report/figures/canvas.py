"""The canvas of all figures: style, colors, panels, axes, and how they become bytes."""

from __future__ import annotations

import base64
import io
import math
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from textwrap import fill
from typing import Any, Literal

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_mixed import MixedModeRenderer
from matplotlib.backends.backend_svg import RendererSVG
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator
from numpy.typing import NDArray
from PIL import Image

from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations

STYLE = mpl.rc_params_from_file(
    Path(str(files("calib_pin.report"))) / "page" / "figures.mplstyle",
    use_default_template=False,
)
"""The style of all figures."""

INK = str(STYLE["text.color"])
MUTED = str(STYLE["axes.edgecolor"])
PAPER = str(STYLE["figure.facecolor"])
BEFORE = "#d55e00"
AFTER = "#0072b2"
"""Colors on white; the style sheet of a page gives each another one in the dark."""

STAGES = {"before (nominal robot)": BEFORE, "after (calibrated)": AFTER}

GROUPS = (AFTER, "#e69f00", "#009e73", "#cc79a7", "#56b4e9")
"""Colors of things side by side, of the palette of Okabe and Ito."""

OF_STATIONS = (GROUPS[0], *GROUPS[2:])
"""Colors of errors after by station; orange is that of errors before."""

SCALE = "viridis"
"""Color map of sizes."""

WIDTH = 7.2
"""Width of every figure [inch]."""

LINE = 100
"""Letters in a line below a picture."""

VECTORS = 200
"""Points of one kind that are drawn as paths; more are an image."""

LARGEST = 100
"""Largest errors of every kind that are always drawn."""

POINT = 72
"""Points of an inch."""

KINDS: Mapping[str, tuple[dict[str, Any], int]] = {
    "png": ({"Software": None}, 200),
    "pdf": ({"CreationDate": None}, 150),
    "svg": (dict.fromkeys(("Date", "Creator", "Format", "Type")), 200),
}
"""Metadata and resolution of files, the latter that of what would be too many paths.

Without dates and versions, the same numbers give the same bytes [dots per inch].
"""

NUMBERED = re.compile(r' id="[\w.]+_\d+"')
"""Names of groups, which would be those of other figures of a page as well."""


@contextmanager
def drawing() -> Iterator[None]:
    """The style of all figures, and no complaint about what a font lacks.

    Names may be written in any script. A page has more fonts than matplotlib, which
    draws a box for a character that it does not know.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from")
        with mpl.rc_context(STYLE):
            yield


@dataclass(frozen=True)
class Drawn:
    """A figure with its name, title and caption.

    Attributes:
        title: Its heading.
        reading: The caption: what to look for, and the numbers, in one line.
        figure: The figure.
        name: Stem of its file and id in a page.
    """

    title: str
    reading: str
    figure: Figure
    name: str = ""

    def svg(self) -> str:
        """Part of an HTML page, whose style sheet gives it font and colors."""
        text = self._svg("none", "none")
        return NUMBERED.sub("", text[text.index("<svg") :])

    def picture(self, kind: str) -> bytes:
        """A file of its own, one of `KINDS`, on white, with its heading and caption."""
        figure, apart = self.figure, 0.12 / self.figure.get_figheight()
        (metadata, dpi), stream = KINDS[kind], io.BytesIO()
        with drawing():
            below = fill(self.reading, LINE)
            words = [
                figure.text(0.01, 1.0 + apart, self.title, va="bottom", size=11),
                figure.text(0.01, -apart, below, va="top", color=MUTED),
            ]
            # Cut to what is there: the words stand outside of the figure.
            about: dict[str, Any] = {"format": kind, "metadata": metadata, "dpi": dpi}
            about |= {"bbox_inches": "tight", "pad_inches": 0.12}
            figure.savefig(stream, facecolor=PAPER, **about)
        for text in words:
            text.remove()
        return stream.getvalue()

    def bare(self) -> bytes:
        """An SVG file without heading and caption, its letters as outlines.

        Whoever places it writes the words, and need not have the font.
        """
        return self._svg("path", PAPER).encode()

    def _svg(self, letters: str, paper: str) -> str:
        metadata, dpi = KINDS["svg"]
        figure, stream = self.figure, io.StringIO()
        width, height = figure.get_size_inches()
        figure.dpi = POINT
        figure.set_facecolor(paper)
        with drawing(), mpl.rc_context({"svg.fonttype": letters}):
            size, about = (POINT * width, POINT * height), {"metadata": metadata}
            paths = _Paths(*size, stream, image_dpi=dpi, **about)  # type: ignore[no-untyped-call]
            mixed: Any = MixedModeRenderer(figure, width, height, dpi, paths)  # type: ignore[no-untyped-call]
            figure.draw(mixed)
            mixed.finalize()
        return stream.getvalue()


class _Paths(RendererSVG):
    """That of matplotlib; its images have few colors: a third of the bytes."""

    def draw_image(
        self, gc: object, x: float, y: float, im: Any, transform: object = None
    ) -> None:
        """Write an image (H, W, 4), its lowest row first, with its corner at x, y."""
        stream = io.BytesIO()
        few = Image.fromarray(im[::-1]).quantize(256, Image.Quantize.FASTOCTREE)
        few.save(stream, format="png")
        data = base64.b64encode(stream.getvalue()).decode()
        width, height = (POINT / self.image_dpi * size for size in few.size)
        box = {"x": x, "y": self.height - y - height, "width": width, "height": height}
        about = {name: f"{value:.6g}" for name, value in box.items()}
        about["xlink:href"] = f"data:image/png;base64,{data}"
        self.writer.element("image", attrib=about)  # type: ignore[no-untyped-call]


# --- panels and axes ---------------------------------------------------------------


def panels(
    rows: int,
    columns: int,
    height: float,
    *,
    left: float = 0.75,
    right: float = 0.2,
    top: float = 0.5,
    foot: float = 0.55,
    gap: float = 0.75,
    apart: float = 0.75,
    **share: Any,
) -> tuple[Figure, Any]:
    """A figure with its axes, shape (rows, columns); all lengths in inches.

    Args:
        rows: Panels below each other.
        columns: Panels side by side.
        height: Height of a panel.
        left: Room at the left, for the labels of the axis.
        right: Room at the right.
        top: Room for key and titles.
        foot: Room for labels at the bottom.
        gap: Distance of panels side by side.
        apart: Distance of panels below each other.
        **share: Whether they share axes, `sharex` and `sharey` of `Figure.subplots`.
    """
    whole = top + rows * height + (rows - 1) * apart + foot
    width = (WIDTH - left - right - (columns - 1) * gap) / columns
    figure = Figure(figsize=(WIDTH, whole))
    places = {"wspace": gap / width, "hspace": apart / height}
    places |= {"left": left / WIDTH, "right": 1.0 - right / WIDTH}
    places |= {"bottom": foot / whole, "top": 1.0 - top / whole}
    axes = figure.subplots(rows, columns, squeeze=False, gridspec_kw=places, **share)
    return figure, axes


def marks(
    color: str, marker: str, size: float = 4.0, *, hollow: bool = False
) -> dict[str, Any]:
    """Properties of a line that is nothing but its marks."""
    face = {"markerfacecolor": "none"} if hollow else {"markeredgewidth": 0.0}
    style = {"color": color, "marker": marker, "markersize": size, **face}
    return {**style, "linestyle": "none"}


def points(axes: Axes, x: Any, y: Floats, style: Mapping[str, Any]) -> None:
    """Marks at all places that are known; thousands of them are an image."""
    known = np.isfinite(y)
    axes.plot(x[known], y[known], **style, rasterized=bool(known.sum() > VECTORS))


def key(figure: Figure, entries: Mapping[str, Mapping[str, Any]]) -> None:
    """The legend, in one line at the upper edge; properties of a `Line2D` by name."""
    figure.legend(
        [Line2D([], [], **properties) for properties in entries.values()],
        list(entries),
        loc="upper left",
        bbox_to_anchor=(0.04, 1.0 - 0.06 / figure.get_figheight()),
        ncols=len(entries),
        columnspacing=1.2,
    )


def log_axis(axes: Axes, which: Literal["x", "y"], *values: Floats) -> bool:
    """Make an axis logarithmic, with numbers as people write them.

    Returns:
        Whether any of the values is positive, or else there is no such axis.
    """
    numbers = np.concatenate([np.ravel(part) for part in values])
    numbers = numbers[np.isfinite(numbers) & (numbers > 0.0)]
    if numbers.size == 0:
        return False
    low, high = float(numbers.min()), float(numbers.max())
    room = max((high / low) ** 0.06, 1.15)
    axes.set(**{f"{which}scale": "log", f"{which}lim": (low / room, high * room)})
    axis = axes.xaxis if which == "x" else axes.yaxis
    decades = math.log10(high / low * room**2)
    axis.set_major_locator(
        LogLocator(subs=(1.0, 2.0, 5.0) if decades < 2.5 else (1.0,), numticks=8)
        if decades > 0.7
        else MaxNLocator(5, steps=[1, 2, 5, 10])
    )
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter("{x:g}")
    return True


# --- words and choices -------------------------------------------------------------


def shortened(name: str, length: int = 40) -> str:
    """A name of at most so many characters, shortened in the middle.

    A character that does not print, breaks the line or turns the text direction is
    replaced: not even all of it may stand in XML.

    Examples:
        >>> shortened("left_arm_shoulder_lift_joint.placement.rx", 20)
        'left_arm_…acement.rx'
    """
    name = "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in name)
    if len(name) <= length:
        return name
    end = length // 2
    return f"{name[: length - end - 1]}…{name[-end:]}"


def stations_of(rows: Observations) -> tuple[list[str], NDArray[np.intp]]:
    """Names of the stations that colors tell apart, and that of each row, (N,).

    One without a name where there is one, or more than there are colors.
    """
    names = [key.station for key in rows.keys]
    distinct = list(dict.fromkeys(names))
    if not 1 < len(distinct) <= len(OF_STATIONS):
        return [""], np.zeros(len(rows), np.intp)
    places = np.array([distinct.index(name) for name in names], np.intp)
    return [name or "-" for name in distinct], places[rows.block_of]


def thinned(
    count: int, limit: int, sizes: Sequence[Floats], always: Sequence[int] = ()
) -> NDArray[np.intp]:
    """Positions of the measurements that are drawn, ascending, shape (M,).

    Args:
        count: Number N of measurements.
        limit: Number that is drawn at most.
        sizes: Sizes of errors, shape (N,) each, NaN where there is none; the largest
            are drawn.
        always: Positions that are drawn as well, the most important ones first; they
            may take half of all.
    """
    if count <= limit:
        return np.arange(count)
    largest = min(LARGEST, max(1, limit // (4 * max(len(sizes), 1))))
    parts = [np.asarray(always[: limit // 2], np.intp)]
    for size in sizes:
        filled = np.where(np.isnan(size), -np.inf, size)
        parts.append(np.argpartition(filled, -largest)[-largest:])
    kept = np.unique(np.concatenate(parts))
    rest = np.setdiff1d(np.arange(count), kept)
    evenly = np.linspace(0, len(rest) - 1, limit - len(kept)).round().astype(np.intp)
    return np.sort(np.concatenate([kept, rest[evenly]]))


def thinning(shown: int, count: int) -> str:
    """A sentence where measurements are left out; empty where none is."""
    if shown == count:
        return ""
    return f" {shown} of {count} measurements are drawn, including the largest errors."


def top_of(sizes: Floats) -> float:
    """End of the color scale: few large errors must not make all others look alike."""
    finite = sizes[np.isfinite(sizes)]
    high = float(np.quantile(finite, 0.97)) if finite.size else 0.0
    most = float(finite.max(initial=0.0))
    return max(most if most < 1.3 * high else high, 1e-12)
