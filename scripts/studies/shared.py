"""What the studies share: options, seeds side by side, files, figures, conditions."""

from __future__ import annotations

import argparse
import io
import json
import platform
import re
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter
from numba import config

from calib_pin.io.files import write_atomically

__all__ = [
    "COLORS",
    "Condition",
    "each",
    "figure",
    "log_axis",
    "options",
    "versions",
    "wrapped",
    "write_json",
]

COLORS = {
    "black": "#000000",
    "blue": "#0072B2",
    "green": "#009E73",
    "orange": "#E69F00",
    "purple": "#CC79A7",
    "red": "#D55E00",
    "sky": "#56B4E9",
}
"""The palette of Okabe and Ito, which the color-blind can tell apart."""

STYLE: dict[str, Any] = {
    "axes.axisbelow": True,
    "axes.grid": True,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlesize": 10,
    "figure.dpi": 150,
    "font.size": 9,
    "grid.color": "#DDDDDD",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
}

WIDTH = 80
"""Columns of the terminal."""

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


@dataclass(frozen=True)
class Condition:
    """Something that a study must show.

    Attributes:
        text: What.
        met: Whether it does.
        numbers: The numbers behind that, by name with unit.
    """

    text: str
    met: bool
    numbers: Mapping[str, object]

    def __str__(self) -> str:
        """Lines for the terminal."""
        return wrapped(f"{'met' if self.met else 'NOT MET':<8} {self.text}", 9)


class _Parser(argparse.ArgumentParser):
    """Errors in one line."""

    def error(self, message: str) -> NoReturn:
        sys.exit(f"{self.prog}: {message}")


def options(name: str, description: str, seeds: int) -> argparse.ArgumentParser:
    """Options that every study has.

    Args:
        name: Name of the study.
        description: What it is.
        seeds: Number of seeds of the whole study.
    """

    def whole(word: str) -> int:
        if not word.isdigit() or int(word) < 1:
            raise argparse.ArgumentTypeError(f"'{word}' is not a number from 1 on")
        return int(word)

    def folder(word: str) -> Path:
        # Known before the work, not after it.
        if Path(word).exists() and not Path(word).is_dir():
            raise argparse.ArgumentTypeError(f"'{word}' is not a folder")
        return Path(word)

    parser = _Parser(prog=f"reproduce {name}", description=description)
    parser.register("type", "count", whole)
    parser.add_argument(
        *("--seeds",),
        type="count",
        default=seeds,
        metavar="N",
        help="number of seeds, fewer for a short run (default: %(default)s)",
    )
    parser.add_argument(
        *("-o", "--output"),
        type=folder,
        default=Path("out") / name,
        metavar="DIR",
        help="folder of the results (default: %(default)s)",
    )
    return parser


def each(
    work: Callable[[_Item], _Result], items: Iterable[_Item], what: str
) -> list[_Result]:
    """Results of items, computed side by side with one process per core.

    Args:
        work: A function of a module.
        items: What it is called with.
        what: Name of an item, for the progress on a terminal.
    """
    items = list(items)
    cores = int(config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]
    count = min(cores, len(items))
    if count < 2:
        return list(_told(map(work, items), len(items), what))
    # Not forked: a copy of a process with threads may hang.
    with ProcessPoolExecutor(count, mp_context=get_context("spawn")) as pool:
        return list(_told(pool.map(work, items), len(items), what))


def _told(results: Iterable[_Result], count: int, what: str) -> Iterator[_Result]:
    terminal = sys.stderr.isatty()
    for k, result in enumerate(results, 1):
        if terminal:
            print(f"\r{what} {k} of {count}", end="", file=sys.stderr, flush=True)
        yield result
    if terminal:
        print("\r\x1b[K", end="", file=sys.stderr)


def versions() -> dict[str, str]:
    """Versions of what the numbers depend on."""
    packages = ("calib-pin", "numpy", "pin", "numba", "matplotlib")
    python = {"python": platform.python_version(), "machine": platform.machine()}
    return python | {name: version(name) for name in packages}


def renamed(settings: Any, names: Mapping[str, str]) -> dict[str, object]:
    """Settings by name, some under other names, with their units."""
    return {names.get(key, key): value for key, value in asdict(settings).items()}


def write_json(path: Path, document: Mapping[str, object]) -> None:
    """Write a document; lists of numbers take one line each."""
    text = json.dumps(document, indent=2, allow_nan=False)
    text = re.sub(
        r"\[[-+.\deE,\s]+\]", lambda found: re.sub(r"\s+", " ", found[0]), text
    )
    write_atomically(path, f"{text}\n".encode(), force=True)


@contextmanager
def figure(path: Path, width: float, height: float) -> Iterator[Figure]:
    """A figure that is written to a PNG file at the end.

    Args:
        path: The file.
        width: Width [inch].
        height: Height [inch].
    """
    with mpl.rc_context(STYLE):  # type: ignore[arg-type]
        result = Figure(figsize=(width, height), layout="constrained")
        yield result
        stream = io.BytesIO()
        # Without the version, the same numbers give the same bytes.
        result.savefig(stream, format="png", metadata={"Software": None})
    write_atomically(path, stream.getvalue(), force=True)


def draw(
    folder: Path, figures: Mapping[str, Callable[..., None]], *about: object
) -> tuple[str, ...]:
    """Write figures.

    Args:
        folder: Where to.
        figures: What draws each into a path, by the name of its file.
        about: What else it is given.

    Returns:
        Names of the files.
    """
    for name, draw_one in figures.items():
        draw_one(folder / name, *about)
    return tuple(figures)


def log_axis(axes: Axes) -> None:
    """A logarithmic y axis with plain numbers."""
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(_Plain())
    axes.yaxis.set_minor_formatter(_Plain(labelOnlyBase=False))


class _Plain(LogFormatter):
    """Labels without powers of ten; where a decade is short, few of them."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        return f"{x:g}" if super().__call__(x, pos) else ""


def wrapped(text: str, indent: int = 0) -> str:
    """Text in lines that fit the terminal, the later ones indented."""
    return textwrap.fill(text, WIDTH, subsequent_indent=" " * indent)
