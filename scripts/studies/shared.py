"""Shared by the studies: options, seeds in parallel, files, figures."""

from __future__ import annotations

import argparse
import io
import json
import platform
import re
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, is_dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter

from calib_pin.io.files import write_atomically
from calib_pin.kinematics.spatial import Floats
from calib_pin.workers.local import LocalProcesses

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

Figures = Mapping[str, Callable[..., None]]
"""Functions that draw a figure into a path, by the names of the files."""

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


class _Parser(argparse.ArgumentParser):
    """Errors in one line."""

    def error(self, message: str) -> NoReturn:
        sys.exit(f"{self.prog}: {message}")


@dataclass(frozen=True)
class Number:
    """An option that is a number.

    Attributes:
        short: Its default, for a run of about a minute.
        full: Its value with `--full`, that of the whole study.
        help: What it is the number of.
    """

    short: int
    full: int
    help: str


def options(
    name: str, source: str, words: Sequence[str], **numbers: Number
) -> argparse.Namespace:
    """The options of a study.

    Args:
        name: Name of the study.
        source: The publication.
        words: The words of the command line.
        numbers: The options that are numbers, by name.
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

    parser = _Parser(prog=f"reproduce {name}", description=source)
    parser.add_argument(
        "--full", action="store_true", help="the whole study, which takes minutes"
    )
    for option, number in numbers.items():
        parser.add_argument(
            *(f"--{option}",),
            type=whole,
            metavar="N",
            help=f"{number.help} (default: {number.short}, --full: {number.full})",
        )
    parser.add_argument(
        *("-o", "--output"),
        type=folder,
        default=Path("out") / name,
        metavar="DIR",
        help="folder of the results (default: %(default)s)",
    )
    chosen = parser.parse_args(words)
    for option, number in numbers.items():
        if getattr(chosen, option) is None:
            default = number.full if chosen.full else number.short
            setattr(chosen, option, default)
    return chosen


def each(
    work: Callable[[_Item], _Result], items: Iterable[_Item], what: str
) -> list[_Result]:
    """Results of items, computed side by side with one process per core.

    Args:
        work: A function of a module.
        items: What it is called with.
        what: Name of an item, for the progress.
    """
    items = list(items)
    with LocalProcesses(patience=0.0) as workers:
        return list(_told(workers.map(_called, work, items), len(items), what))


def _called(work: Callable[[_Item], _Result], item: _Item) -> _Result:
    return work(item)


def _told(results: Iterable[_Result], count: int, what: str) -> Iterator[_Result]:
    """Results as they come, with progress: on a terminal of each, else of the stage."""
    terminal, began = sys.stderr.isatty(), time.monotonic()
    if not terminal:
        stage(f"{what} 1 to {count}")
    for k, result in enumerate(results, 1):
        if terminal:
            print(f"\r{what} {k} of {count}", end="", file=sys.stderr, flush=True)
        yield result
    if terminal:
        print("\r\x1b[K", end="", file=sys.stderr)
    else:
        stage(f"{what} 1 to {count}: {time.monotonic() - began:.0f} s")


def stage(text: str) -> None:
    """A line of progress."""
    print(f"reproduce: {text}", file=sys.stderr, flush=True)


def versions() -> dict[str, str]:
    """Versions of what the numbers depend on."""
    packages = ("calib-pin", "numpy", "pin", "numba", "matplotlib")
    python = {"python": platform.python_version(), "machine": platform.machine()}
    return python | {name: version(name) for name in packages}


def write_json(path: Path, document: Mapping[str, object]) -> None:
    """Write a document, see `plain`; lists of numbers take one line each."""
    text = json.dumps(plain(document), indent=2, allow_nan=False)
    text = re.sub(
        r"\[[-+.\deE,\s]+\]", lambda found: re.sub(r"\s+", " ", found[0]), text
    )
    write_atomically(path, f"{text}\n".encode(), force=True)


def plain(value: object) -> object:
    """A value as JSON has it; NaN and infinity are null.

    Dataclasses become objects of their fields, or of what their method `numbers`
    returns where they have one.
    """
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if is_dataclass(value):
        numbers = getattr(value, "numbers", None)
        return plain(numbers() if numbers else vars(value))
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def medians(values: Sequence[object]) -> object:
    """Medians of values that are alike, number by number, see `plain`."""
    documents = [plain(value) for value in values]
    first = documents[0]
    if isinstance(first, Mapping):
        return {key: medians([d[key] for d in documents]) for key in first}  # type: ignore[index]
    return float(np.median(documents))  # type: ignore[arg-type]


def rms(values: Floats) -> float:
    """The root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def summary(errors: Floats, unit: str) -> dict[str, float]:
    """Mean, root mean square and maximum of errors, by names that end in the unit."""
    numbers = float(errors.mean()), rms(errors), float(errors.max())
    names = (f"{name}_{unit}" for name in ("mean", "rms", "max"))
    return dict(zip(names, numbers, strict=True))


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


def legend(figure: Figure, axes: Axes, columns: int = 3) -> None:
    """A legend of what some axes show, below the panels."""
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=columns)


def log_axis(axes: Axes) -> None:
    """A logarithmic y axis with plain numbers."""
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(_Plain())
    axes.yaxis.set_minor_formatter(_Plain(labelOnlyBase=False))


class _Plain(LogFormatter):
    """Labels without powers of ten; where a decade is short, few of them."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        return f"{x:g}" if super().__call__(x, pos) else ""
