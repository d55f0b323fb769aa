"""The command: data sets in, table, JSON and figure out."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.console import Console

from benchmarks.accuracy.converters import converted
from benchmarks.accuracy.data_sets import DATA_SETS, DataSet
from benchmarks.accuracy.figure import figure_of
from benchmarks.accuracy.measuring import Measured, measure
from benchmarks.accuracy.published import PUBLISHED
from benchmarks.accuracy.showing import document, table
from calib_pin.cli.options import asked_workers
from calib_pin.cli.printing import progress_bar
from calib_pin.errors import CalibPinError
from calib_pin.io.files import write_atomically
from calib_pin.io.json_text import encode
from calib_pin.report.figures.canvas import KINDS, drawing

WIDTH = 150
"""Width of the table where no terminal says one."""


def main() -> None:
    """Measure the data sets that are there, and print the table."""
    options = _options()
    if options.data is None:
        print("accuracy: skipped, --data DIR says where the public measurements are")
        return
    faults: list[str] = []
    with _measurement_files(options.data, options.convert, faults) as folders:
        found = list(_measured(options, folders, faults))
    for fault in faults:
        print(f"accuracy: {fault}", file=sys.stderr)
    if found:
        console = Console(highlight=False)
        console.width = max(console.width, WIDTH)
        console.print(table(found))
        _sources(found)
        if options.output is not None:
            text = encode(document(found, options.seed))
            write_atomically(options.output, text, force=True)
        if options.figure is not None:
            with drawing():
                drawn = figure_of(found)
            picture = drawn.picture(options.figure.suffix[1:])
            write_atomically(options.figure, picture, force=True)
    if faults:
        sys.exit(1)


def _measured(
    options: argparse.Namespace, folders: list[Path], faults: list[str]
) -> Iterator[Measured]:
    """What was found for every data set that is there."""
    with (
        asked_workers(options.workers, options.cluster) as workers,
        progress_bar() as bar,
    ):
        for data_set in options.only:
            folder = next((f for f in folders if _there(data_set, f)), None)
            if folder is None:
                name = data_set.fitted.folder
                print(f"{data_set.key}: skipped, there is no '{name}' with its files")
                continue

            def tell(stage: str, part: float, key: str = data_set.key) -> None:
                if bar is not None:
                    bar(f"{key}, {stage}", part)

            try:
                found = measure(data_set, folder, options.seed, tell, workers)
            except CalibPinError as error:
                faults.append(f"{data_set.key}: {error}")
                continue
            print(f"{data_set.key}: {found.model}, {found.verdict}", flush=True)
            yield found


def _there(data_set: DataSet, folder: Path) -> bool:
    parts = [data_set.fitted, *filter(None, [data_set.near])]
    return all(part.there(folder) for part in parts)


@contextmanager
def _measurement_files(
    data: Path, kept: Path | None, faults: list[str]
) -> Iterator[list[Path]]:
    """Folders of measurement files: the given one, and what was converted from it."""
    with TemporaryDirectory() as temporary:
        into = Path(temporary) if kept is None else kept
        faults += converted(data, into)
        yield [data, into]


def _sources(found: list[Measured]) -> None:
    """Who says what others reach."""
    keys = {measured.data_set.key for measured in found}
    names = {each.key: each.name for each in DATA_SETS}
    cited: dict[str, list[str]] = {}
    for other in PUBLISHED:
        if other.data_set in keys:
            cited.setdefault(other.source, []).append(names[other.data_set])
    for source, of in cited.items():
        print(f"{', '.join(dict.fromkeys(of))}: {source}")


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="scripts/benchmark accuracy")
    parser.add_argument("--data", type=Path, metavar="DIR", help="the data sets")
    parser.add_argument(
        "--only",
        metavar="NAMES",
        type=_chosen,
        default=DATA_SETS,
        help=f"data sets: {', '.join(each.key for each in DATA_SETS)}",
    )
    parser.add_argument(
        "--convert", type=Path, metavar="FOLDER", help="keep measurement files here"
    )
    parser.add_argument("-o", "--output", type=Path, help="all numbers as JSON")
    parser.add_argument("--figure", type=_picture, help=f"a figure: {', '.join(KINDS)}")
    parser.add_argument("--seed", type=int, default=0, help="default 0")
    parser.add_argument("--workers", type=int, help="processes, default every core")
    parser.add_argument("--cluster", help="a dask scheduler instead of processes")
    words = sys.argv[1:]
    options = parser.parse_args([word for word in words if word != "accuracy"])
    if options.data is not None and not options.data.is_dir():
        parser.error(f"there is no folder {options.data}")
    return options


def _chosen(text: str) -> tuple[DataSet, ...]:
    """Data sets by their names, in the order of the table."""
    names = [name.strip().lower() for name in text.split(",")]
    keys = [each.key for each in DATA_SETS]
    # A robot stands for all of its data sets.
    wrong = [n for n in names if not any(n in (k, k.partition("-")[0]) for k in keys)]
    if wrong:
        raise argparse.ArgumentTypeError(
            f"unknown data set {wrong[0]}; there are {', '.join(keys)}"
        )
    return tuple(
        e for e in DATA_SETS if e.key in names or e.key.partition("-")[0] in names
    )


def _picture(text: str) -> Path:
    file = Path(text)
    if file.suffix[1:] not in KINDS:
        raise argparse.ArgumentTypeError(f"the suffix is one of {', '.join(KINDS)}")
    return file
