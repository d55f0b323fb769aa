"""Readings that are typed: each is in the file before the next one is asked for."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from pathlib import Path

from calib_pin.cli.init import reading
from calib_pin.cli.options import Request
from calib_pin.cli.printing import say
from calib_pin.errors import InputError, OptionError
from calib_pin.guidance.proposals import remaining
from calib_pin.io.files import write_atomically
from calib_pin.io.measured_columns import asked_models, infer_model, needed
from calib_pin.io.table import read_table


def typed(request: Request, plan: Path) -> Callable[[], None]:
    """Asks for the reading of the next configuration of a plan, and writes its row.

    What is in the file already is not asked for again; `skip` leaves a configuration
    out, `back` takes the last row of the file back.

    Raises:
        InputError: If the plan or the file cannot be used.
        OptionError: If nothing says what is measured.
    """
    (file,), setup = request.measurements, request.stated()
    chains = request.chains(setup, "")
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
        _rewrite(file, header)
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
                _rewrite(file)
                return
            try:
                numbers, unit = reading(text, kinds, unit)
            except InputError as error:
                say(f"{error}\n")
                continue
            _rewrite(file, [*cells, *(f"{number:.9g}" for number in numbers)])
            return

    return ask


def _rewrite(file: Path, cells: Sequence[str] = ()) -> None:
    """Put a row at the end of a file, or take the last one back; the header stays.

    It is on the disk when this returns. The other rows stay byte by byte: a person may
    have written them with another program.
    """
    lines = file.read_bytes().splitlines(keepends=True) if file.exists() else []
    if cells:
        row = io.StringIO()
        csv.writer(row, lineterminator="\n").writerow(cells)
        if lines and not lines[-1].endswith((b"\n", b"\r")):
            lines[-1] += b"\n"
        lines.append(row.getvalue().encode())
    elif len(lines) > 1:
        lines.pop()
    write_atomically(file.resolve(), b"".join(lines), force=True)
