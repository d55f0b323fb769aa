"""`calib-pin compensate`: joint commands that reach targets on the real robot."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from calib_pin.cli import files, options, printing
from calib_pin.cli.options import Told, known
from calib_pin.errors import OptionError

if TYPE_CHECKING:
    from calib_pin.control.calibrated import Frame, Point
    from calib_pin.control.compensation import Compensation
    from calib_pin.io.targets import Targets
    from calib_pin.kinematics.chain import Chain
    from calib_pin.kinematics.spatial import Floats
    from calib_pin.observations import BlockKey, Indices
    from calib_pin.planning.travel import Ways
    from calib_pin.progress import Progress
    from calib_pin.report.blocks import Block
    from calib_pin.setup import Setup
    from calib_pin.validation.calibrated_model import CalibratedChain
    from calib_pin.validation.result import CalibrationResult

SPEED = 0.25
"""Part of the joint speeds at which programs move."""

FRAMES, POINTS = ("measuring", "base"), ("tool", "tip")
"""Frames of targets, and points that are brought there; the usual ones first."""

FORMAT = known("format", "io.exchange.motions:PROGRAMS", "csv")
FRAME, POINT = known("frame", "", *FRAMES), known("point", "", *POINTS)


@dataclass(frozen=True, kw_only=True)
class Commands(options.Untouched, options.InDegrees, options.OfChain):
    """Commands as they are asked for.

    Attributes:
        calibration: A calibration.
        targets: CSV file of positions or poses (optionally with joint positions to
            start from), or of joint positions alone: a motion of the nominal robot.
        output: File of joint commands to write.
        setup: Setup file (YAML); options override it.
        frame: Frame of the targets: measuring (default), that of the measurements, or
            base, the base link.
        point: Point to bring there: tool (default), the measured point, or tip, the tip
            link.
        payload: Payload of the robot, by its name in the setup of the calibration; none
            for nothing.
        station: Station in whose measurement frame the targets are; default the first.
        tool: Tool to bring there; default the first.
        position: Reach positions only, with any orientation.
        avoid_collisions: Touch neither the robot itself nor the obstacles of the setup,
            at targets and between them: via configurations are added.
        format: csv (default); urscript, a program of moves; joint-trajectory, a message
            of ROS (YAML).
        speed: Part of the URDF's joint speeds at which commands follow one another: of
            programs (default 0.25, or the file's own times), in CSV a column 'time'.
    """

    calibration: Annotated[Path, Told("calibration.json", "")]
    targets: Annotated[Path, Told("TARGETS", "")]
    output: Annotated[Path, Told("CSV", "Output")]
    setup: Annotated[Path | None, Told("FILE", "Robot")] = None
    frame: Annotated[str | None, Told("NAME", "Targets", FRAME)] = None
    point: Annotated[str | None, Told("NAME", "Targets", POINT)] = None
    payload: Annotated[str | None, Told("NAME", "Targets")] = None
    station: Annotated[str | None, Told("NAME", "Targets")] = None
    tool: Annotated[str | None, Told("NAME", "Targets")] = None
    position: Annotated[bool, Told("", "Targets")] = False
    avoid_collisions: Annotated[bool, Told("", "Constraints")] = False
    format: Annotated[str, Told("NAME", "Output", FORMAT)] = "csv"
    speed: Annotated[float | None, Told("PART", "Output", (1e-3, 1))] = None

    def checked(self) -> Setup:
        """The setup, of options that go together and files that may be written."""
        if self.format != "csv" and self.degrees:
            raise OptionError("--degrees is for --format csv")
        stated, avoided = files.open_setup(self.setup), self.avoid_collisions
        files.require_folders(self.package_dir or [])
        if not avoided:
            self.refuse_unused("--avoid-collisions belongs to", "package_dir")
        files.require_joints_only(self.setup, stated, *["obstacles"] * avoided)
        files.require_file(self.calibration)
        inputs = (self.calibration, self.targets, self.setup, self.srdf)
        files.check_outputs([self.output], inputs, self.force)
        return stated

    def read(
        self, model: CalibratedChain, stated: Setup
    ) -> tuple[Targets, Floats | None]:
        """The targets, and when they are reached if the file says so, (N,) [s]."""
        import numpy as np

        from calib_pin.io.targets import read_target_file, read_times

        file = self.targets
        targets = read_target_file(
            file,
            model.chain,
            columns=stated.columns or model.setup.columns,
            joints=stated.joints or model.setup.joints,
            base=None if self.frame == "base" else model.error.base.translation,
            notice=None if self.quiet else printing.notice,
        )
        motion, csv, times = targets.T is None, self.format == "csv", None
        if motion and (self.frame or self.point) is not None:
            reason = "the file holds joint positions only, and --frame and --point are "
            raise OptionError(f"{reason}for targets", file=file)
        if motion or not csv:
            times = read_times(targets)
        if times is not None and self.speed is not None:
            if csv:
                raise OptionError("--speed: the motion has times of its own", file=file)
            times = None
        # A file that cannot be written must not turn up after the work.
        still = np.zeros((1, len(model.chain.joints)))
        q = still if targets.q is None else targets.q[:1]
        first = None if times is None else times[:1]
        self.encoded(model.chain, targets, q, np.array([0]), first)
        return targets, times

    def found(
        self,
        model: CalibratedChain,
        targets: Targets,
        ways: Ways | None,
        progress: Progress | None,
    ) -> Compensation:
        """The commands for targets, or for a motion of the nominal robot."""
        from calib_pin.control.compensation import compensate, follow

        free = None if ways is None else ways.collisions.free
        if targets.T is None:
            assert targets.q is not None
            oriented = not self.position and len(targets.columns.tells) >= 6
            return follow(
                model, targets.q, orientation=oriented, free=free, progress=progress
            )
        return compensate(
            model,
            targets.T,
            targets.q,
            frame=cast("Frame", self.frame or FRAMES[0]),
            point=cast("Point", self.point or POINTS[0]),
            orientation=targets.oriented and not self.position,
            free=free,
            progress=progress,
        )

    def encoded(
        self,
        chain: Chain,
        targets: Targets,
        q: Floats,
        row: Indices,
        times: Floats | None,
        comments: Sequence[str] = (),
    ) -> bytes:
        """The file of commands (M, n), of rows of the targets (M,), by times (M,)."""
        from calib_pin.io.exchange.motions import PROGRAMS, moving_times, speed_limits
        from calib_pin.io.targets import encode_commands

        part = SPEED if self.speed is None else self.speed
        if self.format != "csv":
            program = PROGRAMS[self.format]
            return program(chain, targets.columns, q, part, comments, times)
        if self.speed is not None:
            times = moving_times(q, speed_limits(chain, part))
        elif targets.T is None:
            times = None  # The motion keeps its own.
        encode = partial(encode_commands, degrees=self.degrees, times=times)
        return encode(targets, q, row, comments=comments)


@options.spread
def compensate(asked: Commands, context: typer.Context) -> int:
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

    import calib_pin.report.compensation_text as texts
    from calib_pin.cli.documents import compensation_document
    from calib_pin.control.calibrated import block_of, model_errors, with_payload
    from calib_pin.estimation.evidence import TRUSTED
    from calib_pin.io.exchange.motions import paced
    from calib_pin.io.results import read_result, written_before
    from calib_pin.planning.travel import Passage
    from calib_pin.report import blocks, trust

    stated, file, output = asked.checked(), asked.calibration, asked.output
    result = read_result(file)
    doubt = ""
    if result.verdict not in TRUSTED:
        doubt = f"{file} must not be trusted: {result.reason}"
    key = block_of(result.model, asked.chain, asked.station, asked.tool)
    model = with_payload(result.model.of(key), asked.payload, file)
    chain, robot = model.chain, model.chain.robot.file
    own: list[str | Path] = [robot, file.parent / robot, *written_before(file)]
    files.check_outputs([output], own, asked.force)
    targets, timed = asked.read(model, stated)
    motion, lines = targets.T is None, targets.table.lines
    for remark in _remarks(asked, result, key, targets, chain):
        asked.tell(remark)
    ways, passed = None, None
    if asked.avoid_collisions:
        obstacles = stated.obstacles or model.setup.obstacles
        collisions = asked.collisions(chain, obstacles, stated.file or str(file))
        ways = options.ways_of("--avoid-collisions", chain, collisions)
    with printing.progress_bar(quiet=asked.quiet) as bar:
        found = asked.found(model, targets, ways, printing.stage(bar, "compensate"))
        (rows,) = np.nonzero(found.good)
        passage = Passage.straight(found.q[rows])
        if ways is not None:
            find = ways.checked if motion else ways.through
            rng = np.random.default_rng(0)
            passage = find(found.q[rows], rng, printing.stage(bar, "ways"))
    shut, row = lines[rows[list(passage.blocked)]].tolist(), passage.of(rows)
    times, hasty = None, list[int]()
    if timed is not None and len(rows):
        times, fast = paced(chain, passage.q, row, timed)
        hasty = lines[fast].tolist()
    torn = motion and found.complete and bool(found.jumps.any())
    good = not (doubt or shut or hasty or torn) and found.complete
    contents = {}
    if good or not (motion or doubt or shut or hasty or not len(rows)):
        comments = [f"commands of: {printing.told_command(context)}"]
        data = asked.encoded(chain, targets, passage.q, row, times, comments)
        contents[output] = data
    accuracy, numbers = model_errors(result), lines.tolist()
    said: list[Block] = [trust.judged(doubt), blocks.Line("")] if doubt else []
    about = {"motion": motion, "file": str(asked.targets), "lines": numbers}
    said += texts.compensation_report(found, chain, **about)
    if ways is not None:
        passed = passage.vias, shut
        said += texts.ways_report(found, passage, numbers, shut)
    said += [*texts.hasty_lines(hasty), *texts.accuracy_lines(accuracy)]
    written = output if contents else None
    asked.give(
        contents,
        lambda: compensation_document(
            found, chain, targets, doubt, written, accuracy, passed, hasty
        ),
        said,
        [f"wrote {written or 'nothing'}"],
    )
    if asked.quiet and not asked.json and doubt:
        printing.notice(f"untrusted: {doubt}")
    elif asked.quiet and not asked.json and not good:
        for cause, missed in (
            ("out of reach", lines[~found.reached]),
            ("in collision", lines[found.collides]),
            ("no free way to", shut),
            ("faster than the URDF allows", hasty),
            ("discontinuity in joint space", lines[found.jumps & torn]),
        ):
            if len(missed):
                printing.notice(f"{cause}: {asked.targets}, {texts.line_list(missed)}")
    return 0 if good else 2


def _remarks(
    asked: Commands,
    result: CalibrationResult,
    key: BlockKey,
    targets: Targets,
    chain: Chain,
) -> Iterator[str]:
    """Remarks on targets, before commands for them are looked for."""
    from calib_pin.control import calibrated, joints
    from calib_pin.measurement_models import declared
    from calib_pin.report.compensation_text import line_list

    own = [k.model for k in result.model.terms if k.chain == key.chain]
    oriented = targets.oriented and not asked.position and asked.point != "tip"
    if oriented and all(declared(name).tracks == "point" for name in own):
        yield (
            "the tool was measured as a point: its orientation is the stated one, or "
            "that of the tip link"
        )
    if targets.q is not None:
        long = targets.table.lines[joints.Joints.of(chain).long_ways(targets.q)]
        if len(long):
            yield (
                "a joint turns almost once around, where its limits allow a short way, "
                f"to {line_list(long)}"
            )
    ends = (asked.frame or FRAMES[0], asked.point or POINTS[0])
    if known := calibrated.ends_known(
        result, key, *(("base", "tip") if targets.T is None else ends)
    ):
        yield known
