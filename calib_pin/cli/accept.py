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
from calib_pin.io import json_text, measurements
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
    paths, subject = asked.measurements, files.open_subject(asked, "limit", "report")
    calibrated, used = subject.calibration, subject.setup
    limit, made, no_pdf = used.limit, list[Path](), ""
    if asked.output is not None:
        made = [asked.output / name for name in NAMES]
        try:
            require_pdf()
        except OptionError as error:
            pdf = made.pop()
            stays = f"; {pdf} is not from this test" if files.exists(pdf) else ""
            no_pdf = f"no {pdf.name} is written: {error.reason}{stays}"
    inputs = [subject.file or asked.robot, asked.setup, *paths]
    files.check_outputs(made, inputs, asked.force)
    doubts = [subject.doubt] if subject.doubt else []
    with printing.progress_bar(quiet=asked.quiet) as bar:
        measured, rows = files.open_tested(asked, paths, subject, bar)
        with in_file(str(paths[0])):
            tests, about = acceptance.tested(
                calibrated or measured,
                rows,
                used,
                registration=asked.register,
                named=_visit_numbers(paths, used.columns),
                doubts=doubts,
            )
    blocks = [*acceptance_text.acceptance_report(tests, limit, about)]
    contents = {}
    if made:
        entries, robot = used.report, subject.chains.robot
        if calibrated is not None and entries is calibrated.model.setup.report:
            # These of the calibration are not those of the test.
            entries = replace(entries, date=None, temperature=None, load="", speed="")
        figure = next(figures.drawn("acceptance", tests, limit))
        entries = dated(entries)
        cover = acceptance_cover(tests, limit, robot, entries, about, figure=figure)
        data = [
            json_text.encode(acceptance_document(tests, limit)),
            measurements.encode_table(acceptance.visits_table(tests), [about]),
            html.acceptance_page(cover, blocks),
        ]
        data += [] if no_pdf else [pdf_report(cover, blocks)]
        contents = dict(zip(made, data, strict=True))
    for remark in filter(None, (*doubts, no_pdf)):
        printing.notice(remark)
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
    tables = [read_table(file, columns=columns) for file in files]
    numbering = {}
    for column in ("pose", "cycle"):
        given = dict[tuple[str, int], str]()
        for table in tables:
            names = table.texts([column]).get(column, ())
            lines = zip(table.lines.tolist(), names, strict=False)
            given |= {(table.file, line): name for line, name in lines if name}
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
