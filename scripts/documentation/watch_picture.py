"""A recording of `calib-pin watch`: a simulated job with two slips."""

from __future__ import annotations

import io
import os
import re
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from rich.console import Console

import calib_pin
from calib_pin.cli.asked import Watch
from calib_pin.cli.watch import styled, watched
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.kinematics.chains import Chains
from calib_pin.observations import Measurements
from calib_pin.setup import FrameSetup, Setup
from calib_pin.simulation import draw_errors, simulate

ROWS, FIRST = 26, 12
"""Rows of the job, and those of the first look."""

UNSEATED, REPEATED = 15, 19
"""Rows that are wrong: the reflector sat 3 mm off, and a line was written twice."""

PLAN = [[0.5, -1.2, 0.8, 1.1, -0.4, 0.0], [-2.1, 0.3, -0.7, 0.9, 1.3, 0.6]]
"""Configurations that are still to be measured [rad]."""


def rows() -> Measurements:
    """The rows of the job."""
    rng, chains = np.random.default_rng(5), Chains.of(calib_pin.load_chain("space6"))
    cell = Setup(
        base_frame=FrameSetup((2.7, -1.5, -0.4), (0.0, 0.0, 2.6)),
        tool_frame=FrameSetup((0.06, 0.02, 0.1)),
    )
    problem = nominal_problem(chains, "position", cell)
    theta = draw_errors(problem.parameters, rng)
    found = simulate(problem, theta, rng, count=ROWS, noise=5e-5).only
    values, q = found.values.copy(), found.q.copy()
    values[UNSEATED, 2] += 3e-3
    values[REPEATED], q[REPEATED] = values[REPEATED - 1], q[REPEATED - 1]
    return replace(found, values=values, q=q, sigma=None)


def text() -> str:
    """The text of docs/pictures/watch.svg."""
    every, before = rows(), Path.cwd()
    console = Console(record=True, width=118, file=io.StringIO(), force_terminal=True)
    with TemporaryDirectory() as folder:
        os.chdir(folder)  # Its name is in no line.
        try:
            # Those that watch plans itself end in other digits on other processors.
            joints = ",".join(every.joints)
            np.savetxt("plan.csv", PLAN, "%.4f", ",", header=joints, comments="")
            job = watched(
                Watch(
                    robot="space6",
                    measurements=[Path("tracker.csv")],
                    tip="tool",
                    plan=Path("plan.csv"),
                )
            )
            last = {}
            for count in range(FIRST, ROWS + 1):
                some = every.rows(np.arange(count))
                calib_pin.write_measurements("tracker.csv", some, force=True)
                for event in job.look():
                    last[event.kind] = event
                    if event.kind not in ("state", "next", "waiting"):
                        console.print(styled(event))
            for kind in ("state", "next"):
                console.print(styled(last[kind]))
        finally:
            os.chdir(before)
    title = "calib-pin watch space6 tracker.csv --tip tool --plan plan.csv"
    picture = console.export_svg(title=title, unique_id="watch")
    # A page that opens from disk loads no fonts.
    return re.sub(r"@font-face \{.*?\}\s*", "", picture, flags=re.DOTALL)
