"""`calib-pin compensate`: joint commands that reach targets on the real robot."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import calib_pin.cli.options as options
from calib_pin.cli.collisions import (
    Clearance,
    Srdf,
    check_options,
    open_collisions,
    ways_of,
)
from calib_pin.cli.files import (
    check_outputs,
    open_setup,
    require_file,
    require_joints_only,
)
from calib_pin.cli.printing import (
    notice,
    progress_bar,
    say,
    say_written,
    show,
    stage,
    told_command,
)
from calib_pin.errors import OptionError, require_known

if TYPE_CHECKING:
    from calib_pin.control.compensation import Compensation
    from calib_pin.io.targets import Targets
    from calib_pin.observations import BlockKey
    from calib_pin.planning.ways import Ways
    from calib_pin.validation.calibrated_model import CalibratedChain, CalibratedModel

targets_option = partial(options.option, "Targets")

FRAMES = ("measuring", "base")
POINTS = ("tool", "tip")

SPEED = 0.25
"""Part of the joint speeds at which programs move."""


def compensate(
    context: typer.Context,
    calibration: Annotated[
        Path, typer.Argument(metavar="calibration.json", help="A calibration.")
    ],
    targets: Annotated[
        Path,
        typer.Argument(
            metavar="TARGETS",
            help="CSV file of positions or poses (optionally with joint positions to "
            "start from), or of joint positions alone: a motion of the nominal robot.",
        ),
    ],
    output: Annotated[
        Path, options.output("-o --output CSV", "File of joint commands to write.")
    ],
    frame: Annotated[
        str | None,
        targets_option(
            "--frame NAME",
            "Frame of the targets: measuring (default), that of the "
            "measurements, or base, the base link.",
        ),
    ] = None,
    point: Annotated[
        str | None,
        targets_option(
            "--point NAME",
            "Point to bring there: tool (default), the measured point, or tip, "
            "the tip link.",
        ),
    ] = None,
    payload: Annotated[
        str | None,
        targets_option(
            "--payload NAME",
            "Payload of the robot, by its name in the setup of the calibration; "
            "none for nothing.",
        ),
    ] = None,
    chain: options.ChainName = None,
    station: Annotated[
        str | None,
        targets_option(
            "--station NAME",
            "Station in whose measurement frame the targets are; default the first.",
        ),
    ] = None,
    tool: Annotated[
        str | None,
        targets_option("--tool NAME", "Tool to bring there; default the first."),
    ] = None,
    position: Annotated[
        bool,
        targets_option("--position", "Reach positions only, with any orientation."),
    ] = False,
    avoid_collisions: Annotated[
        bool,
        options.constraints(
            "--avoid-collisions",
            "Touch neither the robot itself nor the obstacles of the setup, at targets "
            "and between them: via configurations are added.",
        ),
    ] = False,
    srdf: Srdf = None,
    package_dir: options.PackageDirs = None,
    clearance: Clearance = None,
    degrees: options.Degrees = False,
    form: Annotated[
        str,
        options.output(
            "--format NAME",
            "csv (default); urscript, a program of moves; joint-trajectory, a message "
            "of ROS (YAML).",
        ),
    ] = "csv",
    speed: Annotated[
        float | None,
        options.output(
            "--speed PART",
            "Part of the URDF's joint speeds at which commands follow one another: of "
            "programs (default 0.25, or the file's own times), in CSV a column 'time'.",
            options.number(float, "--speed", "0.001 to 1", 1e-3, 1.0),
        ),
    ] = None,
    setup: options.SetupFile = None,
    force: options.Force = False,
    quiet: options.Quiet = False,
    json: options.Json = False,
) -> int:
    """Find the joint commands that bring the real robot to targets.

    Commands for targets have a column 'row', the line of the target, empty where a
    command only leads around something. A motion keeps its other columns; its commands
    bring the tip link to where that of the nominal robot would be in the base link
    (with fewer than six joints: its position), as exactly as base and tool are known.
    Exit status 2: a target cannot be reached (only the others are written, of a motion
    none), no way to it is free or the calibration must not be trusted (no command is
    written).
    """
    import numpy as np

    from calib_pin.cli.documents import compensation_document
    from calib_pin.control.calibrated import ends_known, with_payload
    from calib_pin.control.joints import Joints
    from calib_pin.estimation.evidence import TRUSTED
    from calib_pin.io.exchange.motions import (
        PROGRAMS,
        moving_times,
        paced,
        speed_limits,
    )
    from calib_pin.io.files import write_files
    from calib_pin.io.json_text import encode
    from calib_pin.io.results import read_result, written_before
    from calib_pin.io.targets import (
        command_columns,
        encode_commands,
        read_target_file,
        read_times,
    )
    from calib_pin.measurement_models import declared
    from calib_pin.planning.ways import Passage
    from calib_pin.report.accuracy import judged
    from calib_pin.report.compensation_text import (
        accuracy_lines,
        compensation_report,
        hasty_lines,
        line_list,
        ways_report,
    )

    require_known("format", form, ("csv", *PROGRAMS))
    if form != "csv" and degrees:
        raise OptionError("--degrees is for --format csv")
    require_known("frame", frame or FRAMES[0], FRAMES)
    require_known("point", point or POINTS[0], POINTS)
    stated = open_setup(setup)
    check_options(
        avoid_collisions, srdf, package_dir, clearance, "--avoid-collisions belongs to"
    )
    require_joints_only(setup, stated, *["obstacles"] * avoid_collisions)
    require_file(calibration)
    check_outputs((output,), (calibration, targets, setup, srdf), force)
    result = read_result(calibration)
    calibrated, doubts = result.model, list[str]()
    if result.verdict not in TRUSTED:
        doubts.append(f"{calibration} must not be trusted: {result.reason}")
    accuracy = {
        e.name: {
            "unit": e.unit,
            "mean": e.validation_after.mean,
            "max": e.validation_after.max,
            "method": result.validation.method,
        }
        for e in result.errors
        if e.validation_after is not None and e.unit in ("m", "rad")
    }
    key = _block(calibrated, chain, station, tool)
    model = with_payload(calibrated.of(key), payload, calibration)
    robot = model.chain.robot.file
    read: list[str | Path] = [robot, calibration.parent / robot]
    read += written_before(calibration)
    check_outputs((output,), read, force)
    asked = read_target_file(
        targets,
        model.chain,
        columns=stated.columns or model.setup.columns,
        joints=stated.joints or model.setup.joints,
        base=None if frame == "base" else model.error.base.translation,
        notice=None if quiet else notice,
    )
    if asked.T is None and (frame is not None or point is not None):
        raise OptionError(
            "the file holds joint positions only, and --frame and --point are for "
            "targets",
            file=targets,
        )
    oriented = asked.oriented and not position
    own = [k.model for k in calibrated.terms if k.chain == key.chain]
    measured_point = all(declared(name).tracks == "point" for name in own)
    of_tool = asked.T is not None and point != "tip"
    if oriented and of_tool and measured_point and not quiet:
        notice(
            "the tool was measured as a point: its orientation is the stated one, or "
            "that of the tip link"
        )
    if asked.q is not None and not quiet:
        long = asked.lines[Joints.of(model.chain).long_ways(asked.q)]
        if len(long):
            notice(
                "a joint turns almost once around, where its limits allow a short way, "
                f"to {line_list(long)}"
            )
    # A file that cannot be written must not turn up after the work.
    if asked.q is not None:
        command_columns(asked, asked.q, np.arange(len(asked.q)))
    motion = asked.T is None
    stated_times = None if form == "csv" and not motion else read_times(asked)
    if stated_times is not None and speed is not None and form == "csv":
        raise OptionError("--speed: the motion has times of its own", file=targets)
    timed = None if speed is not None else stated_times
    if form != "csv":
        still = np.zeros((1, len(model.chain.joints)))
        first = None if timed is None else timed[:1]
        PROGRAMS[form](model.chain, asked.columns, still, 1.0, (), first)
    elif speed is not None:
        speed_limits(model.chain, speed)
    ends = ("base", "tip") if motion else (frame or FRAMES[0], point or POINTS[0])
    known = ends_known(result, key, *ends)
    if known and not quiet:
        notice(known)
    ways = None
    if avoid_collisions:
        obstacles = stated.obstacles or model.setup.obstacles
        collisions = open_collisions(
            model.chain,
            obstacles,
            srdf,
            package_dir,
            clearance,
            file=stated.file or str(calibration),
            quiet=quiet,
        )
        ways = ways_of("--avoid-collisions", model.chain, collisions)
    with progress_bar(quiet=quiet) as bar:
        told = stage(bar, "compensate")
        found = _run(model, asked, *ends, position, ways, told)
        (rows,) = np.nonzero(found.good)
        passage = Passage.straight(found.q[rows])
        if ways is not None:
            told = stage(bar, "ways")
            find = ways.checked if motion else ways.through
            passage = find(found.q[rows], np.random.default_rng(0), told)
    shut = asked.lines[rows[list(passage.blocked)]].tolist()
    times, hasty = None, list[int]()
    if timed is not None and len(rows):
        times, fast = paced(model.chain, passage.q, passage.of(rows), timed)
        hasty = asked.lines[fast].tolist()
    torn = motion and bool(found.jumps.any())
    bad = bool(shut or hasty)
    good = not doubts and found.complete and not torn and not bad
    written = bool(len(rows)) and not doubts and (good or not motion) and not bad
    contents = {}
    if written:
        comment = f"commands of: {told_command(context)}"
        part = SPEED if speed is None else speed
        if form == "csv":
            if speed is not None:
                times = moving_times(passage.q, speed_limits(model.chain, part))
            contents[output] = encode_commands(
                asked,
                passage.q,
                passage.of(rows),
                degrees=degrees,
                times=None if motion and speed is None else times,
                comments=[comment],
            )
        else:
            program = PROGRAMS[form]
            contents[output] = program(
                model.chain, asked.columns, passage.q, part, [comment], times
            )
    with write_files(contents, force=force):
        if json:
            made = output if written else None
            document = compensation_document(
                found,
                model.chain,
                asked,
                doubts,
                made,
                accuracy,
                None if ways is None else (passage.vias, shut),
                hasty,
            )
            say(encode(document).decode())
        elif not quiet:
            if doubts:
                show([judged(doubts[0])])
                say("\n")
            lines = asked.lines.tolist()
            said = compensation_report(
                found, model.chain, motion=motion, file=str(targets), lines=lines
            )
            moved = [] if ways is None else ways_report(found, passage, lines, shut)
            show([*said, *moved, *hasty_lines(hasty), *accuracy_lines(accuracy)])
    if json:
        return 0 if good else 2
    if not quiet:
        say_written([f"wrote {output}" if written else "wrote nothing"])
    elif doubts:
        notice(f"untrusted: {doubts[0]}")
    elif not good:
        for cause, missed in (
            ("out of reach", asked.lines[~found.reached]),
            ("in collision", asked.lines[found.collides]),
            ("no free way to", shut),
            ("faster than the URDF allows", hasty),
            (
                "discontinuity in joint space",
                asked.lines[found.jumps & (torn and found.complete)],
            ),
        ):
            if len(missed):
                notice(f"{cause}: {targets}, {line_list(missed)}")
    return 0 if good else 2


def _block(
    model: CalibratedModel, chain: str | None, station: str | None, tool: str | None
) -> BlockKey:
    """The first block of a calibration of a chain, a station and a tool.

    Raises:
        OptionError: If a name is not among those that were measured, or there are
            several chains and none is named.
    """
    if chain is None and len(model.measured_chains) > 1:
        raise OptionError(
            "the calibration is of several chains; say which one with --chain",
            allowed=", ".join(model.measured_chains),
        )
    found = [key for key in model.terms if key.chain in model.measured_chains]
    for kind, name in (("chain", chain), ("station", station), ("tool", tool)):
        if name is not None:
            require_known(kind, name, dict.fromkeys(getattr(k, kind) for k in found))
            found = [key for key in found if getattr(key, kind) == name]
    return found[0]


def _run(
    model: CalibratedChain,
    asked: Targets,
    frame: str,
    point: str,
    position: bool,
    ways: Ways | None,
    progress: Callable[[float], None] | None,
) -> Compensation:
    from typing import cast

    from calib_pin.control import Frame, Point
    from calib_pin.control.compensation import compensate as run
    from calib_pin.control.compensation import follow

    free = None if ways is None else ways.collisions.free
    if asked.T is None:
        assert asked.q is not None
        oriented = not position and len(asked.columns.tells) >= 6
        return follow(
            model, asked.q, orientation=oriented, free=free, progress=progress
        )
    return run(
        model,
        asked.T,
        asked.q,
        frame=cast(Frame, frame),
        point=cast(Point, point),
        orientation=asked.oriented and not position,
        free=free,
        progress=progress,
    )
