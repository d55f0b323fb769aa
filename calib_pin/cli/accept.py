"""`calib-pin accept`: an acceptance test in the terms of ISO 9283."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from calib_pin.cli import files, printing
from calib_pin.cli.asked import Accept
from calib_pin.cli.results import dated
from calib_pin.errors import OptionError, enumerated, in_file
from calib_pin.io import json_text, measurements, results
from calib_pin.io.json_text import Json, format_keys
from calib_pin.io.table import read_table
from calib_pin.report import acceptance_text, figures, html
from calib_pin.report.cover import acceptance_cover
from calib_pin.report.pdf import pdf_report, require_pdf
from calib_pin.setup import LimitSetup
from calib_pin.validation import acceptance
from calib_pin.validation.acceptance import Acceptance, judged

NUMBERED = re.compile(r"(\D*)(\d{1,5})(?:\.0*)?")
"""A number, alone or behind a word."""

NAMES = tuple(f"acceptance.{kind}" for kind in ("json", "csv", "html", "pdf"))


def accept(asked: Accept) -> int:
    """Do what `Accept` asks for."""
    paths, output = asked.measurements, asked.output
    calibrated, chains, used = files.open_subject(asked, None, "limit", "report")
    limit, entries = used.limit, used.report
    if calibrated is not None and entries is calibrated.model.setup.report:
        # These of the calibration are not those of the test.
        entries = replace(entries, date=None, temperature=None, load="", speed="")
    made = [output / name for name in NAMES] if output is not None else []
    without, why = list[Path](), ""
    try:
        require_pdf()
    except OptionError as error:
        made, without, why = made[:-1], made[-1:], error.reason
    file = files.calibration_file(asked)
    doubts = [doubt] if (doubt := results.doubt_of(calibrated, file)) else []
    files.check_outputs(made, [file or asked.robot, asked.setup, *paths], asked.force)
    with printing.progress_bar(quiet=asked.quiet) as bar:
        measured, rows = files.open_rows(asked, paths, chains, used, bar=bar)
        with in_file(str(paths[0])):
            tests, about = acceptance.tested(
                calibrated or measured,
                rows,
                used,
                registration=asked.register,
                named=_visit_numbers(paths, used.columns),
                doubts=doubts,
            )
    for doubt in doubts:
        printing.notice(doubt)
    blocks = [*acceptance_text.acceptance_report(tests, limit, about)]
    contents = {}
    if made:
        figure = next(figures.drawn("acceptance", tests, limit))
        stated = dated(entries), about
        cover = acceptance_cover(tests, limit, chains.robot, *stated, figure=figure)
        data = (
            json_text.encode(acceptance_document(tests, limit)),
            measurements.encode_table(acceptance.visits_table(tests), [about]),
            html.acceptance_page(cover, blocks),
            *(pdf_report(cover, blocks) for _ in made[3:]),
        )
        contents = dict(zip(made, data, strict=True))
    for pdf in without:
        stays = f"; {pdf} is not from this test" if files.exists(pdf) else ""
        printing.notice(f"no {pdf.name} is written: {why}{stays}")
    asked.give(contents, blocks)
    *_, last = tests.values()
    passed = all(status == "pass" for _, status, *_ in acceptance.judged(last, limit))
    return 0 if passed and not last.doubts else 2


def _visit_numbers(
    files: list[Path], columns: Mapping[str, str]
) -> dict[str, dict[tuple[str, int], int]]:
    """Numbers in columns `pose` and `cycle`, by file and line.

    They stand alone or behind one word, as `P5` or `pose 5`. Other names are numbered
    in their order, which is told.
    """
    texts: dict[str, dict[tuple[str, int], str]] = {"pose": {}, "cycle": {}}
    for table in (read_table(file, columns=columns) for file in files):
        for column, labels in table.texts(texts).items():
            for line, name in zip(table.lines.tolist(), labels, strict=True):
                if name:
                    texts[column][table.file, line] = name
    numbering = {}
    for column, given in texts.items():
        parts = {name: NUMBERED.fullmatch(name) for name in given.values()}
        words = {part and part[1].strip().casefold() for part in parts.values()}
        numbers = {name: int(part[2]) for name, part in parts.items() if part}
        if None in words or len(words) > 1:
            numbers = {name: number for number, name in enumerate(parts, 1)}
            pairs = (f"{number} is '{name}'" for name, number in numbers.items())
            printing.notice(f"{column} {enumerated(pairs)}")
        numbering[column] = {place: numbers[name] for place, name in given.items()}
    return numbering


def acceptance_document(tests: Mapping[str, Acceptance], limit: LimitSetup) -> Json:
    """The numbers of an acceptance test, in SI units."""
    *_, last = tests.values()
    return {
        **format_keys("calib-pin/acceptance"),
        "limits": [
            {"quantity": name, "status": status, "limit": allowed, "unit": unit}
            for name, status, _, allowed, unit in judged(last, limit)
        ],
        "tests": tests,
    }
