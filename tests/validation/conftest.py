"""Jobs of several stations and tools, and the same as people forget to say so."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.formulation import make_problem, nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import BlockKey, Observations
from calib_pin.setup import FrameSetup, Setup, ToolSetup
from calib_pin.simulation import draw_errors, simulate
from calib_pin.validation.findings.case import Case, QuickFit

NOISE = 5e-5


@dataclass(frozen=True)
class MovedJob:
    """A simulated job.

    Attributes:
        chain: The nominal chain.
        named: The measurements with their stations and tools.
        plain: The same without.
        problem: The true problem.
        theta: True parameter values, shape (P,).
        truth: Its frames.
    """

    chain: Chain
    named: Observations
    plain: Observations
    problem: Problem
    theta: Floats
    truth: Setup


def _pose(rng: np.random.Generator, reach: float) -> dict[str, tuple[float, ...]]:
    xyz, rpy = rng.uniform(-reach, reach, 3), rng.uniform(-3.0, 3.0, 3)
    return {"xyz": tuple(xyz.tolist()), "rpy": tuple(rpy.tolist())}


@pytest.fixture(scope="session")
def moved_job() -> Callable[..., MovedJob]:
    """Jobs of space6, whose file starts in line 2."""

    def make(
        stations: Sequence[int] = (30, 60),
        tools: Sequence[int] = (45,),
        count: int = 90,
        seed: int = 0,
        *,
        model: str = "position",
        step: float | None = None,
    ) -> MovedJob:
        """A job of so many measurements.

        Args:
            stations: Measurements before each move of the instrument.
            tools: Measurements before each change of the tool.
            count: Number of measurements.
            seed: Seed of all that is random.
            model: The measurement model.
            step: Size of the moves [m, rad]; default anywhere.
        """
        rng = np.random.default_rng(seed)
        places = [_pose(rng, 2.0) for _ in range(len(stations) + 1)]
        ends = [_pose(rng, 0.15) for _ in range(len(tools) + 1)]
        if step is not None:
            for frames in (places, ends):
                for k in range(1, len(frames)):
                    frames[k] = {
                        name: tuple(values + step * rng.normal(size=3))
                        for name, values in frames[0].items()
                    }
        truth = Setup(
            stations={f"s{k}": FrameSetup(**at) for k, at in enumerate(places)},  # type: ignore[arg-type]
            tools={f"t{k}": ToolSetup(**at) for k, at in enumerate(ends)},  # type: ignore[arg-type]
        )
        edges = sorted({0, count, *stations, *tools})
        pieces = []
        for first, last in pairwise(edges):
            s, t = (sum(at <= first for at in kind) for kind in (stations, tools))
            pieces.append((BlockKey(model, "", f"s{s}", f"t{t}"), first, last))
        chain = calib_pin.load_chain("space6")
        problem = nominal_problem(chain, [key for key, _, _ in pieces], truth)
        theta = draw_errors(problem.parameters, rng)
        blocks = []
        for key, first, last in pieces:
            found = simulate(
                problem, theta, rng, key=key, count=last - first, noise=NOISE
            ).only
            lines = np.arange(first, last) + 2
            blocks.append(replace(found, lines=lines, files=["job.csv"] * len(found)))
        plain = [replace(block, station="", tool="") for block in blocks]
        named, every = Observations.of(*blocks), Observations.of(*plain)
        return MovedJob(chain, named, every, problem, theta, truth)

    return make


@pytest.fixture(scope="session")
def quick_case() -> Callable[..., Case]:
    """Measurements to which a robot was fitted in a few steps, whatever they are."""

    def make(chain: Chain, data: Observations, setup: Setup | None = None) -> Case:
        problem = make_problem(chain, data, setup or Setup())
        fit = QuickFit.of(problem)
        return Case(data, fit, np.arange(len(data)), fit.theta)

    return make
