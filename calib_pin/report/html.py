"""`report.html`: one file that opens from disk, on a phone, in the dark, on paper.

It shows the blocks of the terminal's report, so that the numbers are the same, with
figures between them. Whatever comes from the user's files is escaped.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calib_pin.io.files import write_atomically
from calib_pin.io.results import (
    calibration_document,
    provenance,
    read_suggestions,
    read_written,
)
from calib_pin.io.robot_shapes import robot_shapes
from calib_pin.planning.suggestions import Suggestion, calibrated_setup, suggestions
from calib_pin.report.accuracy import (
    KNOWN,
    accuracy,
    beyond,
    moves,
    opening,
    subject,
    taken,
)
from calib_pin.report.blocks import Block, Cell, Column, Facts, Line, Table
from calib_pin.report.breakdown import frames_told, parts
from calib_pin.report.cover import Cover, program
from calib_pin.report.figures import Drawn, calibration_figures
from calib_pin.report.identification import (
    in_full,
    named_errors,
    ranks,
    remedied,
    unknown,
)
from calib_pin.report.places import frame_blocks
from calib_pin.report.recalibration import recalibrated
from calib_pin.report.robot_errors import offsets
from calib_pin.report.tables import (
    STATUS,
    listed,
    outlier_table,
    parameter_overview,
)
from calib_pin.report.templates import rendered
from calib_pin.report.tiles import tiles
from calib_pin.report.trust import (
    correlated,
    expected,
    noise,
    statistics,
)
from calib_pin.validation.result import CalibrationResult

LISTED = 200
"""Outliers and correlated pairs that the page lists; the file has all of them."""

FIRST = ("robot-errors", "cumulative-errors")
"""Figures of the first screen."""

SECTIONS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "frames": ("Tool, base, stations and cameras", ()),
    "measured": ("Measurements", ()),
    "findings": ("Outliers and findings", ("residuals-over-order",)),
    "accuracy": (
        "Accuracy",
        (
            "errors-per-measurement",
            "error-vectors",
            "errors-in-workspace",
            "tip-accuracy-in-workspace",
            "model-ladder",
        ),
    ),
    "identifiability": (
        "Identifiability",
        ("singular-values", "tip-error-by-count"),
    ),
    "parameters": ("Parameters", ("parameter-intervals",)),
    "residuals": ("Noise and statistics", ("residuals-by-joint",)),
    "provenance": ("Provenance", ("convergence",)),
}
"""Title and figures of each section behind the first screen, by its key.

First what a customer takes home, then what a statistician asks for.
"""


@dataclass(frozen=True)
class _Section:
    """A part of the page; the table of parameters can be sorted."""

    key: str
    title: str
    blocks: Sequence[Block]
    figures: Sequence[Drawn]
    parameters: Table | None = None
    statuses: Sequence[str] = ()

    @property
    def idle(self) -> Sequence[int]:
        """Rows of parameters that say nothing: no deviation, and no or a zero value."""
        rows = self.parameters.rows if self.parameters is not None else ()
        return [
            k
            for k, (_, value, sigma, *_) in enumerate(rows)
            if sigma.text == "-" and value.text.strip("-+0.") == ""
        ]


def html_report(
    result: CalibrationResult,
    document: Mapping[str, Any],
    *,
    figures: Sequence[Drawn] = (),
    suggestions: Sequence[Suggestion] = (),
) -> bytes:
    """The report of a calibration as UTF-8 text of one HTML file without references.

    The document is its `calibration.json`, which knows the files and their hashes.
    """
    name = result.model.chains.robot.name
    urgent, verdict, _ = opening(result)
    return rendered(
        "report.html",
        title=f"Calibration of {name}",
        subject=subject(result).text,
        verdict=verdict,
        # Lines to copy stand with the findings, as remarks do.
        urgent=[line for line in urgent if isinstance(line, Line) and not line.figure],
        tiles=list(tiles(result)),
        figures=[figure for figure in figures if figure.name in FIRST],
        sections=list(_sections(result, document, figures, suggestions)),
        version=document["provenance"]["calib_pin"],
        run=document.get("run", ""),
    )


def acceptance_page(cover: Cover, blocks: Sequence[Block]) -> bytes:
    """The page of an acceptance test, as one file without references.

    Args:
        cover: What it begins with.
        blocks: The report of the test.
    """
    # It is one page: the verdict stands on it once.
    rest = [block for block in blocks if block not in cover.said]
    return rendered("acceptance.html", cover=cover, blocks=rest)


def blocks_page(
    title: str, blocks: Sequence[Block], figures: Sequence[Drawn], numbers: str
) -> bytes:
    """The page of many robots, as one file without references.

    Args:
        title: Its heading.
        blocks: Its report, the verdict first.
        figures: Its figures.
        numbers: Name of the file with the numbers.
    """
    verdict, *rest = blocks
    return rendered(
        "fleet.html",
        title=title,
        verdict=verdict,
        figures=figures,
        blocks=rest,
        made=program(),
        numbers=numbers,
    )


def report(
    result: CalibrationResult | str | Path, file: str | Path, *, force: bool = False
) -> None:
    """Write the page of a calibration, with its figures.

    Args:
        result: The result, or the folder or `calibration.json` that holds it.
        file: The page.
        force: Replace an existing file.

    Raises:
        InputError: If a calibration cannot be read.
        OptionError: If the page exists and `force` is false.
        OutputError: If it cannot be written.

    Examples:
        >>> import calib_pin, tempfile
        >>> chain = calib_pin.load_chain("space7")
        >>> setup = calib_pin.read_setup(calib_pin.robot_file("space7", "setup.yaml"))
        >>> rows = calib_pin.read_measurements(
        ...     calib_pin.robot_file("space7", "measurements.csv"), chain
        ... )
        >>> result = calib_pin.calibrate(chain, rows, setup)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     calib_pin.report(result, Path(folder) / "page.html")
        ...     len((Path(folder) / "page.html").read_bytes()) > 100_000
        True
    """
    if isinstance(result, CalibrationResult):
        model = result.model
        suggested = suggestions(
            model.chains,
            tuple(model.terms),
            calibrated_setup(model),
            result,
            seed=result.solver.seed,
        )
        made = result.provenance if result.provenance.versions else provenance()
        document = calibration_document(result, made, suggestions=suggested)
    else:
        result, document = read_written(result)
        suggested = read_suggestions(document)
    shapes = robot_shapes(result.model.chains.robot).parts
    figures = list(calibration_figures(result, shapes))
    page = html_report(result, document, figures=figures, suggestions=suggested)
    write_atomically(Path(file), page, force=force)


def _sections(
    result: CalibrationResult,
    document: Mapping[str, Any],
    figures: Sequence[Drawn],
    suggestions: Sequence[Suggestion],
) -> Iterator[_Section]:
    blocks: dict[str, list[Block]] = {
        "frames": [*offsets(result, suggestions), *frame_blocks(result)]
        or [Line(KNOWN, "note")],
        "measured": [taken(result)],
        "findings": list(_findings(result, figures)),
        "accuracy": [
            *accuracy(result),
            *recalibrated(result),
            *parts(result),
            *moves(result),
            *expected(result),
            *beyond(result),
        ],
        "identifiability": list(_known(result, suggestions)),
        "parameters": list(listed("at a bound", result.solver.at_bounds)),
        "residuals": [*noise(result), *statistics(result)],
        "provenance": list(provenance_blocks(document)),
    }
    for key, (title, names) in SECTIONS.items():
        yield _Section(
            key=key,
            title=title,
            blocks=blocks[key],
            figures=[figure for figure in figures if figure.name in names],
            parameters=parameter_overview(result.parameters, result.unknown)
            if key == "parameters"
            else None,
            statuses=tuple(dict.fromkeys(STATUS[p.status] for p in result.parameters)),
        )


def _known(
    result: CalibrationResult, suggestions: Sequence[Suggestion]
) -> Iterator[Block]:
    yield ranks(result, fitted=True)
    yield from frames_told(result, details=True)
    yield from named_errors(result, fitted=True)
    yield from in_full(result)
    yield from unknown(result)
    yield from remedied(result, suggestions)
    for remedy in suggestions:
        yield from listed(f"identifiable if you {remedy.change}", remedy.parameters)
    yield from correlated(result, LISTED)


def _findings(result: CalibrationResult, figures: Sequence[Drawn]) -> Iterator[Block]:
    """All findings, and the measurements that do not fit."""
    before, _, behind = opening(result)
    drawn = {"", *(figure.name for figure in figures)}
    # A line leads to its figure, if that is there.
    found = [b for b in (*before, *behind) if getattr(b, "figure", "") in drawn]
    yield from found or [Line("There are no findings.", "note")]
    if result.statistics.outliers:
        count = len(result.statistics.outliers)
        yield Line(f"{count} of {len(result.fitted)} measurements are outliers.")
        yield outlier_table(result, LISTED)
        if count > LISTED:
            yield Line(f"{count - LISTED} more are in calibration.json.", "note")
    else:
        yield Line("No measurement is an outlier.")


def provenance_blocks(document: Mapping[str, Any]) -> Iterator[Block]:
    """Command, files with their hashes, versions and seed, as the document has them."""
    about, solver = document["provenance"], document["solver"]
    robot, measured = document["robot"], document["measurements"]
    used = [("robot", robot["file"], robot["sha256"])]
    if document["setup_file"] is not None:
        stated = document["setup_file"]
        used.append(("setup", stated["file"], stated["sha256"]))
    used += [("measurements", f["file"], f["sha256"]) for f in measured["files"]]
    if document["residual_model"] is not None:
        learned = document["residual_model"]
        used.append(("residual model", learned["file"], learned["sha256"]))
    versions = {k: v for k, v in about.items() if k not in ("command", "created")}
    yield Facts(
        "Provenance",
        [
            ("command", shlex.join(about["command"])),
            ("created", about["created"]),
            ("versions", ", ".join(f"{k} {v}" for k, v in versions.items())),
            ("chain", f"{robot['base']} to {robot['tip']}"),
            ("random seed", str(solver["seed"])),
            ("solver", f"{solver['name']}: {solver['status']}"),
            (
                "iterations",
                f"{solver['iterations']} ({solver['evaluations']} evaluations)",
            ),
            ("time", f"{solver['seconds']:.2f} s"),
        ],
    )
    yield Table(
        "Files",
        (Column("", "word"), Column("file", "name"), Column("SHA-256", "name")),
        [(Cell(what), Cell(file), Cell(content)) for what, file, content in used],
    )
