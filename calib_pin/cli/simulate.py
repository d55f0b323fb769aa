"""`calib-pin simulate`: measurements of a robot with known errors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import calib_pin.cli.files as files
from calib_pin.cli.asked import Simulate
from calib_pin.cli.options import same
from calib_pin.cli.printing import command_line, notice, progress_bar, stage
from calib_pin.errors import OptionError, counted, in_file
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.io import measurements, results
from calib_pin.io.setup import read_true_errors
from calib_pin.io.table import read_table
from calib_pin.kinematics.joint_columns import JointColumns
from calib_pin.simulation import draw_errors
from calib_pin.simulation import simulate as run
from calib_pin.validation.calibrated_model import CalibratedModel

PLACES = ("chain", "station", "tool")
"""Columns of a file that say which block measures a configuration."""


def simulate(asked: Simulate, words: Sequence[str]) -> int:
    """Do what `Simulate` asks for."""
    setup, file, truth = files.setup_for(asked), asked.configurations, asked.truth
    keys = files.block_keys(setup)
    if (asked.count is None) == (file is None):
        raise OptionError("give either --count or --configurations")
    inputs = (asked.robot, asked.setup, file, asked.errors)
    files.check_outputs((asked.output, truth), inputs, asked.force)
    if file is not None:
        table = read_table(file, columns=setup.columns)
        named = table.texts(("target", *PLACES))
        arms = named["chain"].distinct if "chain" in table else ()
        keys = files.block_keys(setup, *arms)
    chains = files.open_chains(asked, setup, keys)
    # With a map of joints the file has the columns of their controller.
    with in_file(setup.file):
        layout = JointColumns.of(chains, setup.joints) if setup.joints else None
    problem = nominal_problem(chains, keys, setup)
    rng = np.random.default_rng(asked.seed)
    if asked.errors is None:
        theta = draw_errors(problem.parameters, rng)
    else:
        errors = read_true_errors(asked.errors, problem.parameters.names)
        theta = problem.parameters.vector(errors)
    given = same(asked, run)
    given["per_configuration"] = setup.board is not None  # All corners in an image.
    with progress_bar() as bar:
        stage(bar, "measure")
        if file is None:
            files.tell_limits(chains)
            rows = run(problem, theta, rng, **given)
        else:
            read = measurements.read_configurations
            q = read(file, chains, setup.joints, setup.columns)
            held = measurements.read_held(table, chains.joints, q)
            given |= {"q": q, "target": named.pop("target", ()), "places": named}
            with in_file(str(file)):
                rows = run(problem, theta, rng, conditions=held, **given)
        comment = f"simulated by: {command_line(words)}"
        columns = measurements.measurement_columns(rows, layout)
        data = measurements.encode_table(columns, [comment], stage(bar, "write"))
    contents = {asked.output: data}
    written = [f"wrote {counted(len(rows), 'measurement')} to {asked.output}"]
    if truth is not None:
        true = CalibratedModel.create(problem, theta)
        contents[truth] = results.encode_urdf(true.without_corrections, truth)
        if any(true.of(name).tool_carries_tip for name in true.measured_chains):
            notice(f"{truth} lacks the error behind the last joint: no link holds it")
        if not true.geometric:
            notice(f"{truth} holds the geometry only; a URDF cannot hold other errors")
        written.append(f"wrote the true robot to {truth}")
    asked.give(contents, written=written)
    return 0
