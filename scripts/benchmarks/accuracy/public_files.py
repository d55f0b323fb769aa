"""Numbers out of the text files that others publish, and into measurement files.

Nothing of a file is executed. One that is not as its layout says is refused with its
line.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from calib_pin.errors import InputError
from calib_pin.kinematics.spatial import Floats


def read_columns(
    file: Path,
    names: Sequence[str],
    *,
    separator: str = ",",
    decimal: str = ".",
    header: bool = True,
) -> Floats:
    """Columns of a file, shape (N, len(names)), without lines that lack one of them.

    Args:
        file: A text file of cells.
        names: The columns, in this order; without a header all columns there are.
        separator: Separator of two cells.
        decimal: Decimal mark.
        header: Whether the first line names the columns.

    Raises:
        InputError: If the file cannot be read, lacks a column or holds something else
            than finite numbers there.
    """
    lines = _lines(file, separator)
    _, found = next(lines, (1, list(names))) if header else (1, list(names))
    if absent := [name for name in names if name not in found]:
        columns = ", ".join(found)
        raise InputError(
            "a column is missing", file=file, line=1, column=absent[0], allowed=columns
        )
    places = [found.index(name) for name in names]
    rows = []
    for number, cells in lines:
        if len(cells) != len(found):
            reason = f"{len(cells)} cells, where there are {len(found)} columns"
            raise InputError(reason, file=file, line=number)
        texts = [cells[place] for place in places]
        if all(texts):
            pairs = zip(texts, names, strict=True)
            rows.append([_number(t, decimal, file, number, n) for t, n in pairs])
    if not rows:
        raise InputError("there are no measurements in it", file=file)
    return np.array(rows)


def _lines(file: Path, separator: str) -> Iterator[tuple[int, list[str]]]:
    """Number and trimmed cells of every line that is not blank."""
    try:
        with file.open(encoding="utf-8-sig", newline="") as stream:
            reader = csv.reader(stream, delimiter=separator, strict=True)
            for cells in reader:
                trimmed = [cell.strip() for cell in cells]
                if any(trimmed):
                    yield reader.line_num, trimmed
    except (OSError, UnicodeError, csv.Error) as error:
        said = error.strerror if isinstance(error, OSError) else str(error)
        raise InputError(f"it cannot be read: {said}", file=file) from None


def _number(text: str, decimal: str, file: Path, line: int, column: str) -> float:
    try:
        value = float(text.replace(decimal, ".") if "_" not in text else "")
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        reason = "it is no finite number"
        raise InputError(reason, file=file, line=line, column=column, value=text)
    return value


def write_rows(
    file: Path, columns: Mapping[str, Floats], labels: Sequence[str] = ()
) -> None:
    """Write a measurement file.

    Args:
        file: The file; its folder is made.
        columns: Values (N,) by the header of their column.
        labels: What each measurement refers to, N names, if anything.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    values: Iterable[Sequence[object]] = np.column_stack(
        list(columns.values())
    ).tolist()
    names = list(columns)
    if labels:
        names = ["target", *names]
        pairs = zip(labels, values, strict=True)
        values = ([label, *row] for label, row in pairs)
    with file.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(names)
        writer.writerows(values)
