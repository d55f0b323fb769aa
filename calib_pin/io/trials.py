"""Trials of a Monte Carlo study: a file that grows robot by robot, in their order.

What a killed study leaves is whole, and a study goes on behind it. The head of the file
says of which study it is.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import fields
from itertools import chain
from pathlib import Path

from calib_pin.errors import InputError
from calib_pin.io.files import read_bytes, write_atomically
from calib_pin.io.measurements import encode_table
from calib_pin.monte_carlo import Trial

COLUMNS = tuple(field.name for field in fields(Trial))
"""Columns of the file."""


def encode_trials(study: str, trials: Sequence[Trial] = ()) -> bytes:
    """A file of trials; of none it is the first lines of every file of the study.

    Args:
        study: Everything that the numbers depend on, as a hash.
        trials: The trials.
    """
    columns = {name: [getattr(trial, name) for trial in trials] for name in COLUMNS}
    return encode_table(columns, [f"calib-pin Monte Carlo, study {study}"])


def read_trials(path: Path, study: str, each: int) -> list[tuple[Trial, ...]]:
    """The trials of the robots that a file holds, in their order from the first on.

    Args:
        path: The file.
        study: The study that they have to be of.
        each: Number of trials of a robot.

    Raises:
        InputError: If they are of another study, or are damaged before the end.
    """
    from pydantic import TypeAdapter

    data, begin = read_bytes(path), encode_trials(study)
    if not (data.startswith(begin) or begin.startswith(data)):
        raise InputError("holds trials of another study; use --force", file=path)
    whole = data[len(begin) : data.rfind(b"\n") + 1].decode("utf-8", "replace")
    with suppress(ValueError):
        lines = csv.reader(io.StringIO(whole, newline=""))
        cells = [dict(zip(COLUMNS, line, strict=True)) for line in lines]
        trials = TypeAdapter(list[Trial]).validate_python(cells)
        if all(trial.robot == k // each for k, trial in enumerate(trials)):
            ends = range(each, len(trials) + 1, each)
            return [tuple(trials[end - each : end]) for end in ends]
    raise InputError("damaged; use --force", file=path)


def written_trials(
    path: Path,
    study: str,
    known: Sequence[tuple[Trial, ...]],
    further: Iterable[tuple[Trial, ...]],
) -> Iterator[tuple[Trial, ...]]:
    """Trials of one robot after the other, each written before it is told.

    Args:
        path: The file.
        study: The study.
        known: Trials of the first robots.
        further: Trials of the others.

    Raises:
        OutputError: If the file cannot be written.
    """
    head = encode_trials(study)
    data = encode_trials(study, [*chain.from_iterable(known)])
    write_atomically(path, data, force=True)
    yield from known
    for trials in further:
        data += encode_trials(study, trials).removeprefix(head)
        write_atomically(path, data, force=True)
        yield trials
