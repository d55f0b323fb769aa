"""`calib-pin compensate`: joint commands that reach targets on the real robot."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

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
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import declared
from calib_pin.observations import BlockKey
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
    targets, times = read(asked, model, setup)
    report = list[Block]()
    carried = asked.payload or ("" if model.geometric else model.setup.heaviest)
    _require_meant(targets, result, {**key._asdict(), "payload": carried})
    if carried and asked.payload is None:
        asked.tell(f"commands are for payload '{carried}'; --payload says another one")
    for remark in _remarks(asked, result, key, targets):
        asked.tell(remark)
    chain, motion, lines = model.chain, targets.T is None, targets.table.lines
    commands = commanded(asked, model, targets)
    (rows,) = np.nonzero(commands.reached)
    hasty = rows[:0]
    if times is not None and len(rows):
        times, hasty = paced(chain, commands.q[rows], rows, times)
    torn = commands.jumps & (motion and commands.complete)
    faults = zip(FAULTS, (~commands.reached, hasty, torn), strict=True)
    named = {fault: lines[of].tolist() for fault, of in faults}
    missed = {fault: at for fault, at in named.items() if at}
    contents, wrote = {}, "nothing"
    if doubt:
        report += [trust.judged(doubt, result.verdict), blocks.Line("")]
    elif not missed or (len(rows) and not motion and missed.keys() <= {UNREACHED}):
        comments = [f"commands of: {printing.command_line(words)}"]
        q, part = commands.q[rows], SPEED if asked.speed is None else asked.speed
        if asked.format == "csv" and asked.speed is not None:
            times = moving_times(q, speed_limits(chain, part))
        elif asked.format == "csv" and motion:
            times = None  # The motion keeps its own.
        if asked.format == "csv":
            data = encode_commands(
                targets, q, rows, degrees=asked.degrees, times=times, comments=comments
            )
        else:
            program = PROGRAMS[asked.format]
            data = program(chain, targets.columns, q, part, comments, times)
        contents[output], wrote = data, str(output)
    elif motion:
        wrote += ": a motion is written whole"
    about = {"motion": motion, "file": str(asked.targets), "lines": lines.tolist()}
    report += texts.compensation_report(commands, chain, **about)
    report += texts.hasty_lines(named[HASTY])
    report += texts.accuracy_lines(calibrated.model_errors(result))
    asked.give(contents, report, [f"wrote {wrote}"])
    if asked.quiet and doubt:
        printing.notice(f"{result.verdict}: {doubt}")
    elif asked.quiet:
        for fault, at in missed.items():
            printing.notice(f"{fault}: {asked.targets}, {line_list(at)}")
    return 2 if doubt or missed else 0


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
    motion, csv = targets.T is None, asked.format == "csv"
    if motion and (asked.frame or asked.point) is not None:
        reason = "the file holds joint positions only, and --frame and --point are "
        raise OptionError(f"{reason}for targets", file=file)
    times = read_times(targets) if motion or not csv else None
    if times is not None and asked.speed is not None:
        if csv:
            raise OptionError("--speed: the motion has times of its own", file=file)
        times = None
    return targets, times


def commanded(
    asked: Compensate, model: CalibratedChain, targets: Targets
) -> Compensation:
    """Commands for targets."""
    with printing.progress_bar(quiet=asked.quiet) as bar:
        about: dict[str, Any] = {"progress": printing.stage(bar, "compensate")}
        if targets.T is None:
            assert targets.q is not None
            poses = not asked.position and len(targets.columns.tells) >= 6
            return compensation.follow(model, targets.q, orientation=poses, **about)
        about["orientation"] = targets.oriented and not asked.position
        about["frame"] = asked.frame or FRAMES[0]
        about["point"] = asked.point or POINTS[0]
        return compensation.compensate(model, targets.T, targets.q, **about)
