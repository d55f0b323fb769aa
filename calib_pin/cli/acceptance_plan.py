"""`calib-pin plan --accept`: the poses and the schedule of an acceptance test."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING

from calib_pin.cli.collisions import ways_of
from calib_pin.cli.printing import say, say_written
from calib_pin.errors import OptionError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from calib_pin.cli.plan_request import PlanRequest
    from calib_pin.kinematics.chains import Chains
    from calib_pin.kinematics.collision import Collisions
    from calib_pin.setup import Setup

CYCLES = 30
"""Cycles of an acceptance test."""


def plan_acceptance(
    asked: PlanRequest,
    chains: Chains,
    setup: Setup,
    collisions: Collisions | None,
    command: str,
) -> int:
    """Find the poses of an acceptance test, write its visits, print its schedule.

    Args:
        asked: What is asked for.
        chains: The robot, of a single chain.
        setup: The setup, with limits, region and tool.
        collisions: Collisions to avoid.
        command: The command line that asks for it.

    Raises:
        OptionError: If there are several chains, or no cube is found.
    """
    import numpy as np

    from calib_pin.control.acceptance_poses import acceptance_poses
    from calib_pin.errors import CalibPinError
    from calib_pin.estimation.formulation import nominal_problem
    from calib_pin.io.exchange.motions import speed_limits
    from calib_pin.io.files import write_files
    from calib_pin.io.measured_columns import shown_columns
    from calib_pin.io.measurements import encode_table
    from calib_pin.kinematics.joint_columns import JointColumns
    from calib_pin.planning.workspace import joint_limits
    from calib_pin.report.acceptance_text import acceptance_schedule

    if len(chains.names) > 1:
        raise OptionError(
            "an acceptance test is of one chain; say which one with --chain",
            allowed=", ".join(chains.names),
        )
    chain = chains[chains.names[0]]
    problem = nominal_problem(chain, "position", setup)
    lower, upper = joint_limits(problem)
    count = len(chain.joints)
    ways = None if collisions is None else ways_of("--accept", chain, collisions)
    (term,) = problem.terms.values()
    found = acceptance_poses(
        chain,
        term.error.tool.homogeneous,
        limits=(lower[:count], upper[:count]),
        region=setup.region,
        free=None if ways is None else ways.collisions.free,
        moves=None if ways is None else ways.is_free,
    )
    speeds: np.ndarray | None
    try:
        speeds = speed_limits(chain, 1.0)
    except CalibPinError:
        speeds = None
    words = ["calib-pin", "accept", asked.robot, str(asked.output)]
    for name in ("setup", "base", "tip"):
        if (value := getattr(asked, name)) is not None:
            words += [f"--{name}", str(value)]
    cycles = asked.cycles or CYCLES
    robot = chains.robot.name
    schedule = list(
        acceptance_schedule(found, robot, cycles, speeds, [shlex.join(words)])
    )
    q, poses, each = found.cycles(cycles)
    shown = shown_columns(q, JointColumns.of(chain, setup.joints), asked.degrees)
    columns: dict[str, Sequence[object]] = {
        name: column.tolist() for name, column in shown.items()
    }
    columns |= {"cycle": each, "pose": [f"P{pose}" for pose in poses]}
    columns |= {f"{axis} [mm]": [""] * len(q) for axis in "xyz"}  # To be filled in.
    text = encode_table(columns, [f"planned by: {command}", "", *schedule])
    with write_files({asked.output: text}, force=asked.force):
        if not asked.quiet:
            say("".join(f"{line}\n" for line in schedule))
    if not asked.quiet:
        say_written([f"wrote {len(found.q) * cycles} visits to {asked.output}"])
    return 0
