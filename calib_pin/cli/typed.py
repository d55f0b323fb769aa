"""Readings that are typed: each is in the file before the next one is asked for."""

from __future__ import annotations

import csv
import io
import os
import re
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from calib_pin.cli.files import FLAGS, open_chains, open_setup
from calib_pin.cli.options import Request
from calib_pin.cli.printing import say
from calib_pin.errors import InputError, OptionError
from calib_pin.guidance.proposals import remaining
from calib_pin.io.columns import Kind
from calib_pin.io.measured_columns import asked_models, infer_model, needed
from calib_pin.io.table import read_table

ASKED = "a number each, and a unit, such as 523.5 mm"


def reading(text: str, kinds: Mapping[str, Kind], unit: str) -> tuple[list[float], str]:
    """Typed numbers in SI units, and the unit they were in.

    A comma is a decimal mark; blanks or semicolons separate. Where no unit is typed, it
    is that of the reading before.

    Args:
        text: The text.
        kinds: The columns that are asked for.
        unit: The unit of the reading before; empty where there was none.

    Raises:
        InputError: If the text is something else.
    """
    words = re.sub(r"(?<=\d)(?=[a-zA-Z])", " ", text.replace(",", ".")).split()
    words = [word for word in re.split(r"[\s;]+", " ".join(words)) if word]
    if words and not re.match(r"[-+.\d]", words[-1]):
        unit = words.pop()
    (kind,) = {one.si: one for one in kinds.values()}.values()
    if unit not in kind.units:
        raise InputError("say the unit", value=unit, allowed=", ".join(kind.units))
    try:
        numbers = [kind.units[unit] * float(word) for word in words]
    except ValueError:
        numbers = []
    if len(numbers) != len(kinds) or not np.isfinite(numbers).all():
        raise InputError("cannot be read", value=text, allowed=ASKED)
    if max(map(abs, numbers)) > kind.largest:
        raise InputError(
            "is too large", value=text, allowed=f"{kind.largest:g} {kind.si}"
        )
    return numbers, unit


def typed(request: Request, plan: Path) -> Callable[[], None]:
    """Asks for the reading of the next configuration of a plan, and writes its row.

    What is in the file already is not asked for again; `skip` leaves a configuration
    out, `back` takes the last row of the file back.

    Raises:
        InputError: If the plan or the file cannot be used.
        OptionError: If nothing says what is measured.
    """
    (file,), asked = request.measurements, vars(request)
    setup = open_setup(request.setup, **{name: asked[name] for name in FLAGS})
    chains = open_chains(request.robot, setup, "", request.package_dir)
    table = read_table(plan, columns=setup.columns)
    models = asked_models(setup.model)
    if not models and not file.exists():
        raise OptionError("say what is measured with --model", allowed="--model NAME")
    model = models[0] if models else infer_model(read_table(file), ())
    kinds = needed(model)
    if len({kind.si for kind in kinds.values()}) != 1:
        raise OptionError("readings of this model cannot be typed", value=model)
    header = [*(c.header for c in table.columns.values()), *kinds]
    if not file.exists() or not file.stat().st_size:
        _append(file, header)
    skipped, unit = set[int](), ""

    def ask() -> None:
        nonlocal unit
        first, _, rest = file.read_text().partition("\n")
        if next(csv.reader([first])) != header:
            allowed = ", ".join(header)
            raise InputError("has other columns", file=file, allowed=allowed)
        empty = table.rows(slice(0))
        rows = read_table(file, columns=setup.columns) if rest else empty
        left = remaining(table, rows, chains, setup)
        row = next((k for k in left if k not in skipped), None)
        if row is None:
            say("all configurations of the plan are measured or skipped\n")
            raise EOFError
        cells = [column.text(row) for column in table.columns.values()]
        where = ", ".join(f"{n} {c}" for n, c in zip(header, cells, strict=False))
        say(f"{len(left)} left; go to {where}\n")
        while True:
            text = input(f"{' '.join(kinds)}{f' [{unit}]' * bool(unit)}, skip, back: ")
            if text.strip() == "skip":
                skipped.add(row)
                return
            if text.strip() == "back":
                _take_back(file)
                return
            try:
                numbers, unit = reading(text, kinds, unit)
            except InputError as error:
                say(f"{error}\n")
                continue
            _append(file, [*cells, *(f"{number:.9g}" for number in numbers)])
            return

    return ask


def _append(file: Path, cells: list[str]) -> None:
    """A row at the end of a file, on the disk when this returns."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(cells)
    with file.open("ab+") as stream:
        if stream.tell():
            stream.seek(-1, os.SEEK_END)
            stream.write(b"" if stream.read() == b"\n" else b"\n")
        stream.write(text.getvalue().encode())
        stream.flush()
        os.fsync(stream.fileno())


def _take_back(file: Path) -> None:
    """Take the last row of a file back; the header stays."""
    lines = file.read_bytes().splitlines(keepends=True)
    with file.open("rb+") as stream:
        stream.truncate(len(b"".join(lines[:-1] if len(lines) > 1 else lines)))
        os.fsync(stream.fileno())
