"""`calib-pin simulate`: measurements of a robot with known errors."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

import calib_pin.cli.files as files
from calib_pin.cli.asked import Simulate
from calib_pin.cli.printing import notice, progress_bar, stage, told_command
from calib_pin.errors import OptionError, counted, stated_in
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.io import measurements, results, setup
from calib_pin.io.table import read_table
from calib_pin.kinematics.joint_columns import JointColumns
from calib_pin.simulation import draw_errors
from calib_pin.simulation import simulate as run
from calib_pin.validation.calibrated_model import CalibratedModel

PLACES = ("chain", "station", "tool")
"""Columns of a file that say which block measures a configuration."""


def simulate(asked: Simulate, words: Sequence[str]) -> int:
    """Do what `Simulate` asks for."""
    stated, file, truth = files.stated_setup(asked), asked.configurations, asked.truth
    keys = files.stated_blocks(stated)
    if (asked.count is None) == (file is None):
        raise OptionError("give either --count or --configurations")
    inputs = (asked.robot, asked.setup, file, asked.errors)
    files.check_outputs((asked.output, truth), inputs, asked.force)
    if file is not None:
        table = read_table(file, columns=stated.columns)
        named = table.texts(("target", *PLACES))
        arms = named["chain"].distinct if "chain" in table else ()
        keys = files.stated_blocks(stated, *arms)
    chains = files.open_chains(asked, stated, keys)
    # With a map of joints the file has the columns of their controller.
    with stated_in(stated.file):
        own = JointColumns.of(chains, stated.joints) if stated.joints else None
    problem = nominal_problem(chains, keys, stated)
    rng = np.random.default_rng(asked.seed)
    if asked.errors is None:
        theta = draw_errors(problem.parameters, rng)
    else:
        given = setup.read_true_errors(asked.errors, problem.parameters.names)
        theta = problem.parameters.vector(given)
    measure = partial(
        run,
        problem,
        theta,
        rng,
        noise=asked.noise,
        repeats=asked.repeats,
        # An image shows all corners of a board.
        per_configuration=stated.board is not None,
    )
    with progress_bar() as bar:
        stage(bar, "measure")
        if file is None:
            files.tell_limits(chains)
            rows = measure(count=asked.count)
        else:
            read = measurements.read_configurations
            q = read(file, chains, stated.joints, stated.columns)
            held = measurements.read_held(table, chains.joints, q)
            target = named.pop("target", ())
            with stated_in(str(file)):
                rows = measure(q=q, target=target, places=named, conditions=held)
        comment = f"simulated by: {told_command(words)}"
        columns = measurements.measurement_columns(rows, own)
        data = measurements.encode_table(columns, [comment], stage(bar, "write"))
    contents = {asked.output: data}
    told = [f"wrote {counted(len(rows), 'measurement')} to {asked.output}"]
    if truth is not None:
        true = CalibratedModel.create(problem, theta)
        contents[truth] = results.encode_urdf(true.without_corrections, truth)
        if any(true.of(name).tool_carries_tip for name in true.measured_chains):
            notice(f"{truth} lacks the error behind the last joint: no link holds it")
        if not true.geometric:
            notice(f"{truth} holds the geometry only; a URDF cannot hold other errors")
        told.append(f"wrote the true robot to {truth}")
    asked.give(contents, written=told)
    return 0
