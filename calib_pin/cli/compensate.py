"""`calib-pin compensate`: joint commands that reach targets on the real robot."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

import calib_pin.control.compensation as compensation
import calib_pin.io.results as results
import calib_pin.report.compensation_text as texts
from calib_pin.cli import files, printing
from calib_pin.cli.asked import FRAMES, POINTS, Compensate
from calib_pin.control import calibrated
from calib_pin.control.compensation import Compensation
from calib_pin.errors import OptionError
from calib_pin.io.exchange.motions import PROGRAMS, moving_times, paced, speed_limits
from calib_pin.io.targets import Targets, encode_commands, read_target_file, read_times
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import declared
from calib_pin.observations import BlockKey, Indices
from calib_pin.parameterizations import NOTHING
from calib_pin.report import blocks, trust
from calib_pin.report.blocks import Block
from calib_pin.report.compensation_text import line_list
from calib_pin.setup import Setup
from calib_pin.validation.calibrated_model import CalibratedChain
from calib_pin.validation.result import CalibrationResult

FAULTS = UNREACHED, HASTY, TORN = (
    "out of reach",
    "faster than the URDF allows",
    "discontinuity in joint space",
)
"""Faults of targets; a motion is whole, other targets of the first are left out."""

ENDS = ("chain", "station", "tool")
"""Columns of targets that options answer."""

SPEED = 0.25
"""Part of the joint speeds at which programs move."""


CONDITIONS = {
    "thermal": "commands are for links at {:g} degC",
    "warm-up": "commands are for the warm robot",
    "instrument-drift": "targets are where the instrument saw them before it drifted",
}
"""Conditions that commands hold for, by the parameters that depend on them: no target
states them."""


class Commanded(NamedTuple):
    """Commands for the targets of a file.

    Attributes:
        chain: The nominal chain.
        targets: The targets.
        commands: Their commands.
        rows: The targets that are commanded, shape (K,).
        times: When each of them is reached, shape (K,) [s]; None where the file has no
            times.
        faults: Lines of the file by their fault.
    """

    chain: Chain
    targets: Targets
    commands: Compensation
    rows: Indices
    times: Floats | None
    faults: Mapping[str, list[int]]


def compensate(asked: Compensate, words: Sequence[str]) -> int:
    """Do what `Compensate` asks for."""
    if asked.format != "csv" and asked.degrees:
        raise OptionError("--degrees is for --format csv")
    setup, output = files.open_setup(asked.setup), asked.output
    files.require_joints_only(setup)
    file = results.document_file(asked.calibration)
    result = results.read_result(file)
    doubt = results.doubt_of(result, file)
    key = calibrated.block_of(result.model, asked.chain, asked.station, asked.tool)
    model = calibrated.with_payload(result.applied.of(key), asked.payload, file)
    robot = model.chain.robot.file
    sources = robot, str(file.parent / robot), *map(str, results.written_before(file))
    inputs = [*sources, file, asked.targets, asked.setup]
    files.check_outputs([output], inputs, asked.force)
    targets, timed = read(asked, model, setup)
    carried = asked.payload or ("" if model.geometric else model.setup.heaviest)
    _require_meant(targets, result, {**key._asdict(), "payload": carried})
    if carried and asked.payload is None:
        asked.tell(f"commands are for payload '{carried}'; --payload says another one")
    for remark in _remarks(asked, result, key, targets):
        asked.tell(remark)
    done = commanded(asked, model, targets, timed)
    missed = {fault: lines for fault, lines in done.faults.items() if lines}
    apart = targets.T is not None and missed.keys() <= {UNREACHED}
    contents, wrote = {}, "nothing"
    if not doubt and (not missed or (apart and done.commands.reached.any())):
        comments = [f"commands of: {printing.command_line(words)}"]
        contents[output] = encoded(asked, done, comments)
        wrote = str(output)
    elif not doubt and targets.T is None:
        wrote += ": a motion is written whole"
    asked.give(
        contents,
        _report(asked, done, result, doubt),
        [f"wrote {wrote}"],
    )
    if asked.quiet:
        where = [(f, f"{asked.targets}, {line_list(n)}") for f, n in missed.items()]
        for cause, detail in [(result.verdict, doubt)] if doubt else where:
            printing.notice(f"{cause}: {detail}")
    return 2 if doubt or missed else 0


def _report(
    asked: Compensate, done: Commanded, result: CalibrationResult, doubt: str
) -> Iterator[Block]:
    """The report that is printed."""
    lines, motion = done.targets.table.lines.tolist(), done.targets.T is None
    if doubt:
        yield from (trust.judged(doubt, result.verdict), blocks.Line(""))
    about = {"motion": motion, "file": str(asked.targets), "lines": lines}
    yield from texts.compensation_report(done.commands, done.chain, **about)
    yield from texts.hasty_lines(done.faults[HASTY])
    yield from texts.accuracy_lines(calibrated.model_errors(result))


def _remarks(
    asked: Compensate,
    result: CalibrationResult,
    key: BlockKey,
    targets: Targets,
) -> Iterator[str]:
    """Remarks on targets, before commands for them are looked for."""
    if result.verdict == "no-gain":
        yield "without a gain the commands are those of the nominal robot"
    else:
        setup = result.model.setup
        for name, template in CONDITIONS.items():
            if name in setup.parameters:
                yield template.format(setup.thermal.reference)
    models = [k.model for k in result.model.terms if k.chain == key.chain]
    oriented = targets.oriented and not asked.position and asked.point != "tip"
    if oriented and all(declared(name).tracks == "point" for name in models):
        yield "measured as a point, the tool has its stated orientation, or the tip's"
    ends = (asked.frame or FRAMES[0], asked.point or POINTS[0])
    if known := calibrated.ends_known(
        result, key, *(("base", "tip") if targets.T is None else ends)
    ):
        yield known


def _require_meant(
    targets: Targets, result: CalibrationResult, meant: Mapping[str, str]
) -> None:
    """Refuse targets that are of something else than commands are meant for.

    Of a motion only the payload counts.

    Raises:
        InputError: If one names another chain, station, tool or payload that the
            calibration knows, or a point of the tool.
    """
    model, table = result.model, targets.table
    known = {"payload": [*model.setup.payloads, NOTHING] if meant["payload"] else []}
    if targets.T is not None:
        known |= {k: [getattr(key, k) for key in model.terms] for k in ENDS}
        known["target"] = [reference.name for reference in model.references.values()]
    for kind, names in known.items():
        own, way = meant.get(kind, ""), f"--{kind}"
        reason = f"commands are for {kind} '{own}'"
        if kind == "target":
            reason, way = "commands bring the tool there, not a point of it", "none"
        for name in dict.fromkeys(names):
            if name not in (own, ""):
                table.refuse(table.labels(kind).where(name), reason, kind, way)


def read(
    asked: Compensate, model: CalibratedChain, setup: Setup
) -> tuple[Targets, Floats | None]:
    """The targets, and when they are reached if the file says so, (N,) [s]."""
    file = asked.targets
    targets = read_target_file(
        file,
        model.chain,
        columns=setup.columns or model.setup.columns,
        joints=setup.joints or model.setup.joints,
        base=None if asked.frame == "base" else model.error.base.translation,
        timed=asked.format != "csv" and asked.speed is None,
        notice=asked.tell,
    )
    motion, csv, times = targets.T is None, asked.format == "csv", None
    if motion and (asked.frame or asked.point) is not None:
        reason = "the file holds joint positions only, and --frame and --point are "
        raise OptionError(f"{reason}for targets", file=file)
    if motion or not csv:
        times = read_times(targets)
    if times is not None and asked.speed is not None:
        if csv:
            raise OptionError("--speed: the motion has times of its own", file=file)
        times = None
    return targets, times


def commanded(
    asked: Compensate,
    model: CalibratedChain,
    targets: Targets,
    timed: Floats | None,
) -> Commanded:
    """Commands for targets that are reached by times (N,) [s], and what is wrong."""
    motion, lines = targets.T is None, targets.table.lines
    with printing.progress_bar(quiet=asked.quiet) as bar:
        about: dict[str, Any] = {"progress": printing.stage(bar, "compensate")}
        if targets.T is not None:
            about["orientation"] = targets.oriented and not asked.position
            about["frame"] = asked.frame or FRAMES[0]
            about["point"] = asked.point or POINTS[0]
            commands = compensation.compensate(model, targets.T, targets.q, **about)
        else:
            assert targets.q is not None
            poses = not asked.position and len(targets.columns.tells) >= 6
            commands = compensation.follow(model, targets.q, orientation=poses, **about)
    (rows,) = np.nonzero(commands.reached)
    times, hasty = None, rows[:0]
    if timed is not None and len(rows):
        times, hasty = paced(model.chain, commands.q[rows], rows, timed)
    torn = commands.jumps & (motion and commands.complete)
    faults = zip(FAULTS, (~commands.reached, hasty, torn), strict=True)
    named = {fault: lines[of].tolist() for fault, of in faults}
    return Commanded(model.chain, targets, commands, rows, times, named)


def encoded(asked: Compensate, done: Commanded, comments: Sequence[str]) -> bytes:
    """The file of commands."""
    chain, targets, times = done.chain, done.targets, done.times
    q = done.commands.q[done.rows]
    part = SPEED if asked.speed is None else asked.speed
    if asked.format != "csv":
        program = PROGRAMS[asked.format]
        return program(chain, targets.columns, q, part, comments, times)
    if asked.speed is not None:
        times = moving_times(q, speed_limits(chain, part))
    elif targets.T is None:
        times = None  # The motion keeps its own.
    return encode_commands(
        targets, q, done.rows, degrees=asked.degrees, times=times, comments=comments
    )
