"""The canvas of all figures: style, colors, panels, and how they become bytes."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from textwrap import fill
from typing import Any
from xml.etree import ElementTree

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.transforms import Affine2D, Transform

from calib_pin.report.figures.palettes import with_palette

SVG = "http://www.w3.org/2000/svg"

ROUNDED = re.compile(r"-?\d+\.\d{3,}")
"""Coordinates with more than two decimals of a point."""

REFERENCE = re.compile(r"url\(#")

FONT = re.compile(r"(?P<before>[^;]*?)(?P<size>[\d.]+px)")
"""The font in one word, as older versions write it: weight, size and family."""


def inlined(svg: bytes, name: str, title: str, colors: Mapping[str, str]) -> str:
    """The SVG that matplotlib writes, made part of an HTML page.

    The page scales it and sets its font. Colors that have a name become variables of
    the page, so that it can be light or dark.

    Args:
        svg: The file.
        name: Prefix of its ids.
        title: Text for screen readers.
        colors: Names of colors by their hexadecimal code.
    """
    root = ElementTree.fromstring(svg)
    for parent in [root, *root.iter(f"{{{SVG}}}defs")]:
        for child in list(parent):
            # A style sheet would hold for the whole page.
            if _local(child.tag) in ("metadata", "style"):
                parent.remove(child)
    for element in root.iter():
        element.tag = _local(element.tag)
        element.attrib = dict(
            _changed(_local(key), value, element.tag, name, colors)
            for key, value in element.items()
        )
        element.tail = None
        if element.tag != "text":
            element.text = None
    root.attrib = {
        "xmlns": SVG,
        "viewBox": root.attrib["viewBox"],
        "role": "img",
        "aria-label": title,
        "style": "stroke-linejoin: round; stroke-linecap: butt",
    }
    heading = ElementTree.Element("title")
    heading.text = title
    root.insert(0, heading)
    return ElementTree.tostring(root, encoding="unicode")


def _local(name: str) -> str:
    """A name without its namespace."""
    return name.rpartition("}")[2]


def _changed(
    key: str, value: str, tag: str, name: str, colors: Mapping[str, str]
) -> tuple[str, str]:
    """An attribute as it stands in the page."""
    if key == "id":
        return key, f"{name}-{value}"
    if key == "href":
        embedded = with_palette(value.replace("\n", ""))
        return key, f"#{name}-{value[1:]}" if value.startswith("#") else embedded
    if key == "clip-path":
        return key, REFERENCE.sub(f"url(#{name}-", value)
    if key == "style":
        return key, _style(value, colors)
    if key in ("d", "transform", "x", "y") and tag != "image":
        return key, ROUNDED.sub(_shorter, value).replace("\n", "")
    return key, value


def _style(value: str, colors: Mapping[str, str]) -> str:
    """Declarations with the page's own font and colors."""
    kept = []
    for declaration in value.split("; "):
        key, _, rest = declaration.partition(": ")
        if key == "font-family":
            continue
        if key == "font" and (found := FONT.match(rest)):
            key, rest = "font-size", found["size"]
        for code, color in colors.items():
            rest = rest.replace(code, f"var(--{color})")
        kept.append(f"{key}: {rest}")
    return "; ".join(kept)


def _shorter(found: re.Match[str]) -> str:
    return f"{float(found[0]):.2f}".rstrip("0").rstrip(".")


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

OF_STATIONS = (GROUPS[0], *GROUPS[2:])
"""Colors of errors after by station; orange is that of errors before."""

LINE = 100
"""Letters in a line below a picture."""

WIDTH = 7.2
"""Width of every figure [inch]."""

KINDS: Mapping[str, tuple[dict[str, Any], int]] = {
    "png": ({"Software": None}, 200),
    "pdf": ({"CreationDate": None}, 150),
    "svg": ({"Date": None}, 200),
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
        """A file of its own, one of `KINDS`, on white, with its heading and caption."""
        with self.worded():
            # Cut to what is there: the words stand outside of the figure.
            return self._saved(kind, PAPER, bbox_inches="tight", pad_inches=0.12)

    @contextmanager
    def worded(self) -> Iterator[None]:
        """The figure with its heading above and its caption below it."""
        figure, apart = self.figure, 0.12 / self.figure.get_figheight()
        with drawing():
            title = figure.text(0.01, 1.0 + apart, self.title, va="bottom", size=11)
            below = fill(self.reading, LINE)
            reading = figure.text(0.01, -apart, below, va="top", color=MUTED)
        try:
            yield
        finally:
            title.remove()
            reading.remove()

    def bare(self) -> bytes:
        """An SVG file without heading and caption, its letters as outlines.

        Whoever places it writes the words, and need not have the font.
        """
        return self._saved("svg", PAPER, letters="path")

    def _saved(
        self, kind: str, paper: str, letters: str = "none", **more: Any
    ) -> bytes:
        metadata, dpi = KINDS[kind]
        stream = io.BytesIO()
        with drawing(), mpl.rc_context({"svg.fonttype": letters}):
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


def inches(figure: Figure) -> Transform:
    """From inches, measured from the lower left corner of a figure, to its pixels.

    A file is cut to what is there. Then the axes move with the figure, as this does
    and `Figure.dpi_scale_trans` does not.
    """
    return Affine2D().scale(*(1.0 / figure.get_size_inches())) + figure.transFigure


def note(figure: Figure, left: float, top: float, text: str, **more: Any) -> None:
    """Text at a place that is measured from the upper left corner [inch]."""
    place = (left, figure.get_figheight() - top)
    figure.text(*place, text, transform=inches(figure), **more)


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

    `left`, `top` and `right` are the distances from the edges of the figure.
    """
    width = (WIDTH - left - right - (count - 1) * gap) / count
    return [
        panel(figure, left + k * (width + gap), top, width, height)
        for k in range(count)
    ]


def key(figure: Figure, entries: Mapping[str, Mapping[str, Any]], left: float) -> None:
    """The legend, in one line at the upper edge, `left` inches from the left one.

    The entries are properties of a `Line2D` by what it stands for.
    """
    figure.legend(
        [Line2D([], [], **properties) for properties in entries.values()],
        list(entries),
        loc="upper left",
        bbox_to_anchor=(left / WIDTH, 1.0 - 0.06 / figure.get_figheight()),
        ncols=len(entries),
        columnspacing=1.6,
    )
