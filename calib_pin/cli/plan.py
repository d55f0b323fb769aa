"""`calib-pin plan`: which configurations to measure, or to visit in a test."""

from __future__ import annotations

import shlex
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from calib_pin.cli import files, options, printing, results
from calib_pin.cli.asked import Plan
from calib_pin.cli.compensate import require_solids, ways_of
from calib_pin.control.acceptance_poses import acceptance_poses
from calib_pin.errors import CalibPinError, OptionError, counted, enumerated
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.io import measurements, targets
from calib_pin.io.columns import ANGLE, LENGTH, split_header
from calib_pin.io.exchange.motions import speed_limits
from calib_pin.io.measured_columns import shown_columns
from calib_pin.io.measurements import encode_configurations, encode_table
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.collision import Collisions
from calib_pin.kinematics.joint_columns import JointColumns
from calib_pin.observations import BlockKey, Observations, fitted_and_held_out
from calib_pin.parameters import matching
from calib_pin.planning import plan as planning
from calib_pin.planning import travel, workspace
from calib_pin.planning.workspace import joint_limits
from calib_pin.report.acceptance_text import acceptance_schedule
from calib_pin.report.compensation_text import line_list
from calib_pin.report.plan_text import plan_report
from calib_pin.setup import Setup
from calib_pin.solvers import Status
from calib_pin.units import as_number
from calib_pin.validation.result import CalibrationResult
from calib_pin.validation.robot_state import expected_setup


def check(asked: Plan) -> None:
    """Refuse a plan of no number of configurations, or of two."""
    add, count = asked.add, asked.count
    if add and count not in (None, add):
        raise OptionError(f"--add {add} contradicts --count {count}")
    if not (asked.accept or add or count):
        raise OptionError("say how many configurations to plan with --count N")


def plan(asked: Plan, words: Sequence[str]) -> int:
    """Do what `Plan` asks for."""
    older, stated = files.open_older(asked.start, asked.stated(), planned=True)
    check(asked)
    pictures = results.figure_files(asked, "plan")
    inputs = [asked.robot, asked.setup, asked.srdf, asked.tests, asked.start]
    outputs = [asked.output, asked.motion, *pictures]
    files.check_outputs(outputs, [*inputs, *(asked.to or [])], asked.force)
    if asked.accept:
        stated = replace(stated, model="position")
    chains, keys, rows, stated = _opened(asked, stated, older)
    collisions, command, poses = None, printing.told_command(words), None
    if not asked.ignore_collisions:
        collisions = asked.collisions(chains, stated.obstacles, stated.file)
    if asked.accept:
        return _acceptance(asked, chains, keys, stated, collisions, command)
    if asked.motion is not None:
        require_solids("--motion", chains, collisions)
    if asked.tests is not None:
        about = stated.joints, stated.columns
        poses = measurements.read_configurations(asked.tests, chains, *about)
    with (
        options.asked_workers(asked.workers, asked.cluster) as several,
        printing.progress_bar(quiet=asked.quiet) as bar,
        _interruptible(bar) as progress,
    ):
        given = options.same(asked, planning.plan) | {
            "chain": chains,
            "model": keys,
            "count": asked.add or asked.count,
            "setup": stated,
            "measured": rows,
            "collisions": collisions,
            "tests": poses,
            "workers": several,
        }
        found = planning.plan(**given, progress=progress)
        drawn = results.draw("plan", found, bar) if pictures else []
        figures = results.figure_contents(drawn, pictures)
    encode = partial(
        measurements.encode_configurations,
        chains,
        joints=stated.joints,
        degrees=asked.degrees,
    )
    more: dict[str, Any] = {"places": found.places, "sides": planning.sides_of(found)}
    comments = [f"planned by: {command}"]
    table = encode(found.q, found.target, **more, comments=comments)
    contents, shut = {asked.output: table, **figures}, list[int]()
    written = [f"wrote {counted(len(found.q), 'configuration')} to {asked.output}"]
    if asked.motion is not None and collisions is not None:
        with printing.progress_bar(quiet=asked.quiet) as bar:
            free = travel.Ways(
                chains, collisions, *workspace.joint_limits(found.problem)
            )
            rng = np.random.default_rng(asked.seed)
            passage = free.through(found.q, rng, printing.stage(bar, "ways"))
        # A configuration is named by its line in the other file.
        first = table.count(b"\n") - len(found.q) + 1
        shut = [first + k for k in passage.blocked]
        lines = ["" if k == travel.VIA else str(first + k) for k in passage.row]
        if not shut:
            comments = [f"motion of: {command}"]
            motion = encode(passage.q, places={targets.ROW: lines}, comments=comments)
            contents[asked.motion] = motion
            written.append(f"wrote {passage.vias} more on the way to {asked.motion}")
    written += results.told_figures(figures, pictures)
    asked.give(contents, plan_report(found), written)
    if shut:
        printing.notice(
            f"no motion: no free way was found to {asked.output}, {line_list(shut)}"
        )
    if found.status is Status.STOPPED:
        printing.notice("interrupted: this is the best plan found so far")
    return 2 if shut else 0


def _opened(
    asked: Plan, stated: Setup, older: CalibrationResult | None
) -> tuple[Chains, Sequence[BlockKey], Observations | None, Setup]:
    """The chains, what is measured there, what was measured before, and the setup."""
    rows: Observations | None = None
    keys: Sequence[BlockKey]
    if asked.to:
        chains = asked.chains(stated, asked.chain)
        with printing.progress_bar(quiet=asked.quiet) as bar:
            chains, rows = asked.read(asked.to, chains, stated, bar=bar)
        rows = fitted_and_held_out(rows)[0]
        keys = rows.keys
    else:
        keys = files.stated_blocks(stated, *filter(None, [asked.chain]))
        chains = asked.chains(stated, keys)
    if older is not None:
        stated = expected_setup(chains, stated, older)
    if not asked.quiet:
        files.tell_limits(chains)
    narrower = parse_limits(asked.limits or [], chains)
    # Nothing of the file may turn out to be impossible after a long search.
    names = (*stated.planes, *stated.targets, *stated.anchors)
    still = np.zeros((len(names), len(chains.joints)))
    encode_configurations(chains, still, names, joints=stated.joints)
    return chains, keys, rows, replace(stated, limits={**stated.limits, **narrower})


@contextmanager
def _interruptible(
    bar: Callable[[str, float], None] | None,
) -> Iterator[Callable[[str, float], bool]]:
    """Progress that asks to stop after Ctrl-C; a second one ends the program."""
    asked = False

    def interrupt(signum: int, frame: object) -> None:
        nonlocal asked
        if asked:
            raise KeyboardInterrupt
        asked = True

    def progress(stage: str, part: float) -> bool:
        if bar is not None:
            bar(stage, part)
        return asked

    before = signal.signal(signal.SIGINT, interrupt)
    try:
        yield progress
    finally:
        signal.signal(signal.SIGINT, before)


def parse_limits(
    words: Sequence[str], chains: Chains
) -> dict[str, tuple[float, float]]:
    """Limits by joint name or glob [rad, m].

    Args:
        words: `JOINT=LOWER:UPPER`, with a unit in brackets if it is not rad or m.
        chains: The chains; whether a name is one of their joints is checked later.

    Raises:
        OptionError: If a word is not of this form, the limits cross, or the unit is
            none of a joint that is meant.
    """
    units = {**ANGLE.units, **LENGTH.units}
    limits = {}
    for word in words:
        # The name of a joint may hold a sign of equality, an interval cannot.
        joint, _, rest = word.rpartition("=")
        joint, (interval, unit) = joint.strip(), split_header(rest)
        ends = [as_number(end.strip()) for end in interval.split(":")]
        wrong = f"--limits cannot be {word!r}"
        factor = 1.0 if unit is None else units.get(unit, 0.0)
        if not joint or len(ends) != 2 or None in ends or not factor:
            allowed = "JOINT=LOWER:UPPER, such as 'elbow=-90:90 [deg]'; units "
            raise OptionError(wrong, allowed=allowed + ", ".join(units))
        lower, upper = (factor * float(end or 0.0) for end in ends)
        # Degrees would leave a joint as free as it was, without a word.
        if not -ANGLE.largest <= lower <= upper <= ANGLE.largest:
            most = f"at most {ANGLE.largest:.4g} rad or m"
            allowed = f"LOWER up to UPPER, {most}; other units in brackets: [deg]"
            raise OptionError(wrong, allowed=allowed)
        for k in matching(joint, chains.joints):
            kind = ANGLE if chains.revolute[k] else LENGTH
            if unit not in (None, *kind.units):
                wrong += f": joint '{chains.joints[k]}' is of another kind"
                raise OptionError(wrong, allowed=", ".join(kind.units))
        limits[joint] = (lower, upper)
    return limits


def _acceptance(
    asked: Plan,
    chains: Chains,
    keys: Sequence[BlockKey],
    setup: Setup,
    collisions: Collisions | None,
    command: str,
) -> int:
    """Find the poses of an acceptance test, write its visits, print its schedule.

    Args:
        asked: What is asked for.
        chains: The robot, of a single chain.
        keys: What may be measured there: by one instrument, with one tool.
        setup: The setup, with limits, region and tool.
        collisions: Collisions to avoid.
        command: The command line that asks for it.

    Raises:
        OptionError: If there are several chains, stations or tools, or no cube is
            found.
    """
    if len(chains.names) > 1:
        reason = "an acceptance test is of one chain; say which one with --chain"
        raise OptionError(reason, allowed=", ".join(chains.names))
    for kind in ("station", "tool"):
        if len(names := {getattr(key, kind): None for key in keys}) > 1:
            reason = f"an acceptance test is of one {kind}, the setup states several"
            file, value = setup.file or None, enumerated(names)
            allowed = f"one of '{kind}s'"
            raise OptionError(reason, file=file, value=value, allowed=allowed)
    chain = chains[chains.names[0]]
    problem, count = nominal_problem(chains, keys, setup), len(chain.joints)
    lower, upper = joint_limits(problem)
    ways = None
    if collisions is not None:
        ways = ways_of("--accept", chain, collisions)
    (term,) = problem.terms.values()
    found = acceptance_poses(
        chain,
        term.error.tool.homogeneous,
        limits=(lower[:count], upper[:count]),
        region=setup.region,
        free=None if ways is None else ways.collisions.free,
        moves=None if ways is None else ways.is_free,
    )
    try:
        speeds = speed_limits(chain, 1.0)
    except CalibPinError:
        speeds = None
    words = ["calib-pin", "accept", asked.robot, str(asked.output)]
    for name in ("setup", "base", "tip"):
        if (value := getattr(asked, name)) is not None:
            words += [f"--{name}", str(value)]
    cycles, robot = asked.cycles, chains.robot.name
    schedule = acceptance_schedule(found, robot, cycles, speeds, shlex.join(words))
    q, poses, each = found.cycles(cycles)
    shown = shown_columns(q, JointColumns.of(chain, setup.joints), asked.degrees)
    columns: dict[str, Sequence[object]] = {n: c.tolist() for n, c in shown.items()}
    for kind, name in zip(BlockKey._fields[1:], keys[0][1:], strict=True):
        columns |= {kind: [name] * len(q)} if name else {}
    columns |= {"cycle": each, "pose": [f"P{pose}" for pose in poses]}
    columns |= {f"{axis} [mm]": [""] * len(q) for axis in "xyz"}  # To be filled in.
    text = encode_table(columns, [f"planned by: {command}", "", *schedule.splitlines()])
    asked.give(
        {asked.output: text},
        schedule,
        [f"wrote {len(found.q) * cycles} visits to {asked.output}"],
    )
    return 0
