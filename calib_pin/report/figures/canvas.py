"""The canvas of all figures: style, colors, panels, and how they become bytes."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from textwrap import fill
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from calib_pin.report.figures.svg import inlined

INK = "#1f2328"
MUTED = "#646c75"
GRID = "#dde1e6"
PAPER = "#ffffff"
BEFORE = "#d55e00"
AFTER = "#0072b2"

COLORS: Mapping[str, str] = {
    "ink": INK,
    "muted": MUTED,
    "grid": GRID,
    "paper": PAPER,
    "before": BEFORE,
    "after": AFTER,
}
"""Colors on white by the name of the variable that stands for them in a page."""

GROUPS = (AFTER, "#e69f00", "#009e73", "#cc79a7", "#56b4e9")
"""Colors of things side by side, of the palette of Okabe and Ito."""

LINE = 100
"""Letters in a line below a picture."""

WIDTH = 7.2
"""Width of every figure [inch]."""

KINDS: Mapping[str, tuple[dict[str, Any], int]] = {
    "png": ({"Software": None}, 200),
    "pdf": ({"CreationDate": None}, 150),
    "svg": ({"Date": None}, 150),
}
"""Metadata and resolution of files, the latter that of what would be too many paths.

Without dates and versions, the same numbers give the same bytes [dots per inch].
"""

STYLE: dict[str, Any] = {
    "axes.axisbelow": True,
    "axes.edgecolor": MUTED,
    "axes.facecolor": "none",
    "axes.formatter.useoffset": False,
    "axes.grid": True,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.8,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titlesize": 10,
    "axes.titley": 1.0,
    "figure.facecolor": PAPER,
    "font.family": "sans-serif",
    "font.size": 9.5,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "legend.borderaxespad": 0.0,
    "legend.frameon": False,
    "legend.handletextpad": 0.4,
    "pdf.fonttype": 42,
    "svg.fonttype": "none",
    "svg.hashsalt": "calib-pin",
    "text.color": INK,
    # A name may hold any character: none of them is a formula.
    "text.parse_math": False,
    "text.usetex": False,
    "xtick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.color": MUTED,
    "ytick.labelcolor": INK,
}


@contextmanager
def drawing() -> Iterator[None]:
    """The style of all figures, and no complaint about what a font lacks.

    Names may be written in any script. A page has more fonts than matplotlib, which
    draws a box for a character that it does not know.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from")
        with mpl.rc_context(STYLE):  # type: ignore[arg-type]
            yield


@dataclass(frozen=True)
class Drawn:
    """A figure with its name, title and caption.

    Attributes:
        name: Stem of its file and id in a page.
        title: Its heading.
        reading: The caption: what to look for, and the numbers, in one line.
        figure: The figure.
    """

    name: str
    title: str
    reading: str
    figure: Figure

    def svg(self) -> str:
        """Part of an HTML page whose style sheet has the variables `COLORS`."""
        names = {color: name for name, color in COLORS.items()}
        return inlined(self._saved("svg", "none"), self.name, self.title, names)

    def picture(self, kind: str) -> bytes:
        """A file of its own, on white, with its heading and what to look for.

        Args:
            kind: One of `KINDS`.
        """
        figure, apart = self.figure, 0.12 / self.figure.get_figheight()
        with drawing():
            title = figure.text(0.01, 1.0 + apart, self.title, va="bottom", size=11)
            below = fill(self.reading, LINE)
            reading = figure.text(0.01, -apart, below, va="top", color=MUTED)
            try:
                # Cut to what is there: the words stand outside of the figure.
                return self._saved(kind, PAPER, bbox_inches="tight", pad_inches=0.12)
            finally:
                title.remove()
                reading.remove()

    def _saved(self, kind: str, paper: str, **more: Any) -> bytes:
        metadata, dpi = KINDS[kind]
        stream = io.BytesIO()
        with drawing():
            self.figure.savefig(
                stream, format=kind, dpi=dpi, metadata=metadata, facecolor=paper, **more
            )
        return stream.getvalue()


def panel(figure: Figure, left: float, top: float, width: float, height: float) -> Axes:
    """Axes at a place that is measured from the upper left corner [inch]."""
    across, down = figure.get_size_inches()
    bottom = down - top - height
    return figure.add_axes(
        (left / across, bottom / down, width / across, height / down)
    )


def marks(
    color: str, marker: str, size: float = 4.0, *, hollow: bool = False
) -> dict[str, Any]:
    """Properties of a line that is nothing but its marks."""
    face = {"markerfacecolor": "none"} if hollow else {"markeredgewidth": 0.0}
    style = {"color": color, "marker": marker, "markersize": size, **face}
    return {**style, "linestyle": "none"}


def note(figure: Figure, left: float, top: float, text: str, **more: Any) -> None:
    """Text at a place that is measured from the upper left corner [inch]."""
    place = (left, figure.get_figheight() - top)
    figure.text(*place, text, transform=figure.dpi_scale_trans, **more)


def panels(
    figure: Figure,
    count: int,
    top: float,
    height: float,
    *,
    left: float = 0.75,
    right: float = 0.15,
    gap: float = 0.75,
) -> list[Axes]:
    """Axes of equal width side by side; all lengths in inches.

    Args:
        figure: The figure.
        count: Number of them.
        top: Distance from the upper edge of the figure.
        height: Height.
        left: Distance of the first from the left edge.
        right: Distance of the last from the right edge.
        gap: Distance between two.
    """
    width = (WIDTH - left - right - (count - 1) * gap) / count
    return [
        panel(figure, left + k * (width + gap), top, width, height)
        for k in range(count)
    ]


def key(figure: Figure, entries: Mapping[str, Mapping[str, Any]], left: float) -> None:
    """The legend, in one line at the upper edge.

    Args:
        figure: The figure.
        entries: Properties of a `Line2D` by what it stands for.
        left: Distance from the left edge [inch].
    """
    figure.legend(
        [Line2D([], [], **properties) for properties in entries.values()],
        list(entries),
        loc="upper left",
        bbox_to_anchor=(left / WIDTH, 1.0 - 0.06 / figure.get_figheight()),
        ncols=len(entries),
        columnspacing=1.6,
    )
