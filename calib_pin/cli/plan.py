"""`calib-pin plan`: which configurations to measure, or to visit in a test."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib_pin.cli import files, options, printing
from calib_pin.cli.asked import Plan
from calib_pin.control.acceptance_poses import acceptance_poses
from calib_pin.errors import CalibPinError, OptionError, counted, enumerated
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.io import measurements
from calib_pin.io.collision import load_collisions
from calib_pin.io.exchange.motions import speed_limits
from calib_pin.io.measured_columns import shown_columns
from calib_pin.io.measurements import encode_configurations, encode_table
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.collision import Collisions
from calib_pin.kinematics.joint_columns import JointColumns
from calib_pin.observations import BlockKey, Observations, fitted_and_held_out
from calib_pin.planning import plan as planning
from calib_pin.planning.workspace import joint_limits
from calib_pin.report.acceptance_text import acceptance_schedule
from calib_pin.report.plan_text import plan_report
from calib_pin.setup import Setup
from calib_pin.validation.result import CalibrationResult
from calib_pin.validation.robot_state import expected_setup


def plan(asked: Plan, words: Sequence[str]) -> int:
    """Do what `Plan` asks for."""
    older, setup = files.open_older(asked.start, files.setup_for(asked), planned=True)
    if not (asked.accept or asked.count):
        raise OptionError("say how many configurations to plan with --count N")
    inputs = [asked.robot, asked.setup, asked.srdf, asked.tests, asked.start]
    files.check_outputs([asked.output], [*inputs, *(asked.to or [])], asked.force)
    if asked.accept:
        setup = replace(setup, model="position")
    chains, keys, rows, setup = _open_inputs(asked, setup, older)
    collisions, command, poses = None, printing.command_line(words), None
    if not asked.ignore_collisions:
        given = options.same(asked, load_collisions)
        given |= {"package_dirs": asked.package_dir or [], "notice": asked.tell}
        given |= {"chain": chains, "obstacles": setup.obstacles, "file": setup.file}
        collisions = load_collisions(**given)
    if asked.accept:
        return _acceptance(asked, chains, keys, setup, collisions, command)
    if asked.tests is not None:
        about = setup.joints, setup.columns
        poses = measurements.read_configurations(asked.tests, chains, *about)
    with printing.progress_bar(quiet=asked.quiet) as bar:
        given = options.same(asked, planning.plan) | {
            "chain": chains,
            "model": keys,
            "setup": setup,
            "measured": rows,
            "collisions": collisions,
            "tests": poses,
        }
        result = planning.plan(**given, progress=bar)
    table = encode_configurations(
        chains,
        result.q,
        result.target,
        places=result.places,
        sides=planning.sides_of(result),
        joints=setup.joints,
        degrees=asked.degrees,
        comments=[f"planned by: {command}"],
    )
    written = [f"wrote {counted(len(result.q), 'configuration')} to {asked.output}"]
    asked.give({asked.output: table}, plan_report(result), written)
    return 0


def _open_inputs(
    asked: Plan, setup: Setup, older: CalibrationResult | None
) -> tuple[Chains, Sequence[BlockKey], Observations | None, Setup]:
    """The chains, what is measured there, what was measured before, and the setup."""
    keys: Sequence[BlockKey]
    if asked.to:
        chains = files.open_chains(asked, setup, asked.chain)
        with printing.progress_bar(quiet=asked.quiet) as bar:
            chains, rows = files.open_rows(asked, asked.to, chains, setup, bar=bar)
        rows, _ = fitted_and_held_out(rows)
        keys = rows.keys
    else:
        keys = files.block_keys(setup, *filter(None, [asked.chain]))
        chains, rows = files.open_chains(asked, setup, keys), None
    if older is not None:
        setup = expected_setup(chains, setup, older)
    if not asked.quiet:
        files.tell_limits(chains)
    # Nothing of the file may turn out to be impossible after a long search.
    names = (*setup.planes, *setup.targets, *setup.anchors)
    still = np.zeros((len(names), len(chains.joints)))
    encode_configurations(chains, still, names, joints=setup.joints)
    return chains, keys, rows, setup


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
    for kind in ("chain", "station", "tool"):
        if len(names := {getattr(key, kind): None for key in keys}) > 1:
            reason = f"an acceptance test is of one {kind}, the setup states several"
            file, allowed = setup.file or None, enumerated(names)
            allowed += " (--chain)" * (kind == "chain")
            raise OptionError(reason, file=file, allowed=allowed)
    chain = chains[chains.names[0]]
    problem, count = nominal_problem(chains, keys, setup), len(chain.joints)
    lower, upper = joint_limits(problem)
    if collisions is not None and len(chains.joints) > len(chain.joints):
        reason = "--accept needs the joints that others mimic in the chain"
        raise OptionError(reason, value=chains.joints[-1])
    (term,) = problem.terms.values()
    poses = acceptance_poses(
        chain,
        term.error.tool.homogeneous,
        limits=(lower[:count], upper[:count]),
        region=setup.region,
        free=None if collisions is None else collisions.free,
        moves=None if collisions is None else collisions.move_is_free,
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
    schedule = acceptance_schedule(poses, robot, cycles, speeds, shlex.join(words))
    q, numbers, each = poses.cycles(cycles)
    shown = shown_columns(q, JointColumns.of(chain, setup.joints), asked.degrees)
    columns: dict[str, Sequence[object]] = {n: c.tolist() for n, c in shown.items()}
    for kind, name in zip(BlockKey._fields[1:], keys[0][1:], strict=True):
        columns |= {kind: [name] * len(q)} if name else {}
    columns |= {"cycle": each, "pose": [f"P{number}" for number in numbers]}
    columns |= {f"{axis} [mm]": [""] * len(q) for axis in "xyz"}  # To be filled in.
    text = encode_table(columns, [f"planned by: {command}", "", *schedule.splitlines()])
    written = [f"wrote {len(poses.q) * cycles} visits to {asked.output}"]
    asked.give({asked.output: text}, schedule, written)
    return 0
