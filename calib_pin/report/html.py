"""Pages: one file that opens from disk, on a phone, in the dark, on paper.

They show the blocks of the terminal's report, so that the numbers are the same, with
figures between them. Whatever comes from the user's files is escaped.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from calib_pin import __version__
from calib_pin.estimation.evidence import TRUSTED
from calib_pin.io.files import write_atomically
from calib_pin.io.results import calibration_document, read_written
from calib_pin.io.robot_shapes import robot_shapes
from calib_pin.planning.suggestions import with_suggestions
from calib_pin.report.accuracy import subject
from calib_pin.report.blocks import Block, Code, Facts, Line, Table, note, table
from calib_pin.report.figures import Drawn, drawn
from calib_pin.report.tables import STATUS, parameter_overview
from calib_pin.report.text import Section, sections
from calib_pin.report.tiles import tiles
from calib_pin.report.trust import FIRST, findings, next_step, opening, serious
from calib_pin.validation.result import CalibrationResult, Provenance

if TYPE_CHECKING:
    from calib_pin.report.cover import Cover

FRONT = ("robot-errors", "cumulative-errors")
"""Figures of the first screen."""


def html_report(
    result: CalibrationResult,
    document: Mapping[str, Any],
    *,
    figures: Sequence[Drawn] = (),
) -> bytes:
    """The report of a calibration as UTF-8 text of one HTML file without references.

    The document is its `calibration.json`, which knows the files and their hashes.
    """
    verdict, *blocks = opening(result)
    named = {figure.name: figure for figure in figures}
    # A line leads to its figure, if that is there. Lines to copy stand in the section.
    blocks = [b for b in blocks if getattr(b, "figure", "") in ("", *named)]
    urgent = [b for b in blocks if isinstance(b, Line) and b.tone in ("bad", "strong")]
    grave = (
        () if result.verdict in TRUSTED else findings(serious(result), result.reason)
    )
    codes = [b for b in grave if isinstance(b, Code)]
    others = blocks or [note("There are no findings.")]
    chapters = [
        replace(s, blocks=[*others, *s.blocks]) if s.key == "findings" else s
        for s in sections(result)
    ]
    chapters.append(Section("provenance", "Provenance", [*provenance_blocks(document)]))
    parameters = parameter_overview(result.parameters, result.unknown)
    return rendered(
        "report.html",
        title=f"Calibration of {result.model.chains.robot.name}",
        subject=subject(result).text,
        verdict=verdict,
        urgent=[*urgent[:FIRST], *codes, *next_step(result)],
        tiles=list(tiles(result)),
        front=[named[name] for name in FRONT if name in named],
        sections=chapters,
        drawn=named,
        parameters=parameters,
        idle=_idle(parameters),
        statuses=tuple(dict.fromkeys(STATUS[p.status] for p in result.parameters)),
        made=f"calib-pin {document['provenance']['calib_pin']}",
        numbers="calibration.json",
        run=document.get("run", ""),
    )


def _idle(parameters: Table) -> list[int]:
    """Rows of parameters that say nothing: no deviation, and no or a zero value."""
    return [
        k
        for k, (_, value, sigma, *_) in enumerate(parameters.rows)
        if sigma.text == "-" and value.text.strip("-+0.") == ""
    ]


def acceptance_page(cover: Cover, blocks: Sequence[Block]) -> bytes:
    """The page of an acceptance test, as one file without references.

    Args:
        cover: What it begins with.
        blocks: The report of the test.
    """
    # It is one page: the verdict stands on it once.
    rest, numbers = [b for b in blocks if b not in cover.sentences], "acceptance.json"
    return rendered("acceptance.html", cover=cover, blocks=rest, numbers=numbers)


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
    shown = {"title": title, "verdict": verdict, "blocks": rest, "figures": figures}
    return rendered("fleet.html", **shown, numbers=numbers)


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
        result = with_suggestions(result)
        document = calibration_document(result, made_now(result))
    else:
        result, document = read_written(result)
    page = html_report(result, document, figures=report_figures(result))
    write_atomically(Path(file), page, force=force)


def made_now(result: CalibrationResult) -> Provenance:
    """How a result came about, as it says, or else at this time by a program."""
    now = datetime.now(UTC).isoformat(timespec="seconds")
    made = result.provenance
    return made if made.calib_pin else Provenance.at(now)


def report_figures(result: CalibrationResult) -> list[Drawn]:
    """The figures of the page of a calibration."""
    shapes = robot_shapes(result.model.chains.robot).parts
    return [*drawn("calibration", result, shapes=shapes)]


def provenance_blocks(document: Mapping[str, Any]) -> Iterator[Block]:
    """Command, files with their hashes, versions and seed, as the document has them."""
    about, solver = document["provenance"], document["solver"]
    robot, measured = document["robot"], document["measurements"]
    seconds, evaluations = solver["seconds"], f"{solver['evaluations']} evaluations"
    used = [("robot", robot), ("setup", document["setup_file"])]
    used += [("measurements", file) for file in measured["files"]]
    versions = {k: v for k, v in about.items() if k not in ("command", "created")}
    facts = {
        "command": shlex.join(about["command"]),
        "created": about["created"],
        "versions": ", ".join(f"{k} {v}" for k, v in versions.items()),
        "chain": f"{robot['base']} to {robot['tip']}",
        "random seed": str(solver["seed"]),
        "solver": f"{solver['name']}: {solver['status']}",
        "iterations": f"{solver['iterations']} ({evaluations})",
        "time": "unknown" if seconds is None else f"{seconds:.2f} s",
    }
    yield Facts("Provenance", [*facts.items()])
    rows = [(what, f["file"], f["sha256"]) for what, f in used if f is not None]
    yield table("Files", ("|word", "file|name", "SHA-256|name"), rows)


def rendered(template: str, **values: Any) -> bytes:
    """A page as UTF-8 text, with the style sheet and the script of all pages.

    Args:
        template: Its file in the folder `page`.
        values: What it shows; texts are escaped.
    """
    page = _pages().get_template(template).render(values)
    return page.encode("utf-8", "backslashreplace")


@cache
def _pages() -> Environment:
    environment = Environment(
        loader=PackageLoader("calib_pin.report", "page"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    environment.filters["kind"] = lambda block: type(block).__name__
    environment.filters["exact"] = repr
    environment.globals["made"] = f"calib-pin {__version__}"
    folder = files("calib_pin.report") / "page"
    for part, name in (("style", "style.css"), ("script", "script.js")):
        environment.globals[part] = Markup((folder / name).read_text("utf-8"))
    return environment
