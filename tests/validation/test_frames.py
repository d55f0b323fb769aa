"""Which frames hang together, and which nobody can tell apart."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pinocchio as pin

from calib_pin.estimation.fit import fit_model
from calib_pin.estimation.formulation import make_problem, nominal_problem
from calib_pin.kinematics.chain import Chain
from calib_pin.setup import FrameSetup, Setup
from calib_pin.simulation import simulate
from calib_pin.validation.frames import coupled_frames, ties


def test_frames_fall_apart_without_the_block_between(moved_job) -> None:
    job = moved_job((30, 60), (45,))
    found = ties(make_problem(job.chain, job.named, Setup()))
    assert [found[key] for key in job.named.keys] == [
        (("s0",), ("t0", "s1", "t1", "s2")),
        (("s0", "t0"), ("s1", "t1", "s2")),
        (("s0", "t0", "s1"), ("t1", "s2")),
        (("s0", "t0", "s1", "t1"), ("s2",)),
    ]


def test_known_tools_are_one_thing(moved_job) -> None:
    job = moved_job((45,), (45,))
    apart = ties(make_problem(job.chain, job.named, Setup()))
    groups = ("s0",), ("t0",), ("s1", "t1")
    assert set(apart[job.named.keys[0]]) == set(groups)
    known = {k: replace(v, estimate=False) for k, v in job.truth.tools.items()}
    found = ties(make_problem(job.chain, job.named, Setup(tools=known)))
    assert set(found.values()) == {(("s0",), ("s1",))}


def parallel(urdf_of: Callable[..., str], chain_of: Callable[..., Chain]) -> Chain:
    """Three joints about parallel axes: a shift along these is that of either end."""
    joints = [
        {
            "name": f"joint_{k}",
            "parent": f"link_{k - 1}",
            "child": f"link_{k}",
            "axis": (0, 0, 1),
            "placement": pin.SE3(np.eye(3), np.array([0.4, 0.0, 0.1])),
        }
        for k in (1, 2, 3)
    ]
    return chain_of(urdf_of(*joints))


def test_frames_of_parallel_axes_cannot_be_told_apart(urdf_of, chain_of) -> None:
    chain = parallel(urdf_of, chain_of)
    truth = Setup(
        base_frame=FrameSetup((0.3, -0.2, 0.5), (0.0, 0.0, 0.4)),
        tool_frame=FrameSetup((0.1, 0.05, 0.2)),
    )
    problem = nominal_problem(chain, "position", truth)
    rng = np.random.default_rng(0)
    rows = simulate(
        problem, np.zeros(len(problem.parameters)), rng, count=60, noise=5e-5
    )
    fitted = fit_model(chain, rows, Setup(), 0).fit
    found = [c for c in coupled_frames(fitted) if "base.frame.z" in c.expression]
    (coupled,) = found
    assert coupled.frames == ("base", "tool")
    assert coupled.expression in (
        "base.frame.z + tool.frame.z",
        "base.frame.z - tool.frame.z",
    )
    assert coupled.sentence == (
        "a shift along z of the base cannot be told from a shift along z of the tool; "
        f"only {coupled.expression} is known"
    )


def test_frames_of_an_arm_can_be_told_apart(moved_job) -> None:
    job = moved_job((30, 60), (45,))
    assert coupled_frames(fit_model(job.chain, job.named, Setup(), 0).fit) == ()
