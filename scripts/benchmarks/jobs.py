"""Jobs of many stations and of several models, against as many plain measurements.

Times are those of the processor, all threads together: the ratios hold on a busy
machine as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from benchmarks.timing import processor_time
from calib_pin.estimation.fit import fit
from calib_pin.estimation.formulation import make_problem, nominal_problem
from calib_pin.io.urdf import load_chain
from calib_pin.kinematics.chain import Chain
from calib_pin.observations import BlockKey
from calib_pin.setup import CameraSetup, FrameSetup, PointSetup, Setup, ToolSetup
from calib_pin.simulation import draw_errors, simulate

STATIONS = 200
MEASURED = 100_000

PLAIN, POSES = BlockKey("position"), BlockKey("pose")
LOOKED = BlockKey("camera", "", "camera", "camera")
END = ToolSetup((0.05, 0.03, 0.1))
MIXED = Setup(
    base_frame=FrameSetup((2.0, 1.0, 0.5), (0.1, 0.2, 1.0)),
    tool_frame=END,
    stations={"camera": FrameSetup((0.1, -0.2, 3.0), (0.3, -0.2, 0.4))},
    tools={"camera": ToolSetup((0.02, 0.05, -0.03))},
    targets={
        f"c{k}": PointSetup(corner, estimate=False)
        for k, corner in enumerate(((0.03, 0.04, 0.01), (-0.03, 0.04, 0.02)))
    },
    camera=CameraSetup("world", (900.0, 900.0), (640.0, 500.0)),
)


def main() -> None:
    """Print the times and their ratios."""
    chain = load_chain("example:ur10_robot", tip="tool0")
    keys = [BlockKey("position", "", f"s{k}") for k in range(STATIONS)]
    one = _fitted(chain, [PLAIN], Setup(tool_frame=END), MEASURED)
    many = _fitted(chain, keys, _places(STATIONS), MEASURED)
    _show(f"{MEASURED} positions of 1 station", one)
    _show(f"the same of {STATIONS} stations", many, one)
    alone = {
        key: _fitted(chain, [key], MIXED, 2 * MEASURED)
        for key in (PLAIN, POSES, LOOKED)
    }
    for key, seconds in alone.items():
        _show(f"{2 * MEASURED} measurements, {key.model}", seconds)
    for other in (POSES, LOOKED):
        together = _fitted(chain, [PLAIN, other], MIXED, 2 * MEASURED)
        unmixed = 0.5 * (alone[PLAIN] + alone[other])
        _show(f"half of each: position and {other.model}", together, unmixed)


def _places(count: int) -> Setup:
    """Places of stations around a robot."""
    rng = np.random.default_rng(1)
    frames = {}
    for k in range(count):
        turn = pin.rpy.matrixToRpy(pin.exp3(rng.normal(size=3)))
        frames[f"s{k}"] = FrameSetup(tuple(2.0 * rng.normal(size=3)), tuple(turn))
    return Setup(stations=frames, tool_frame=END)


def _fitted(chain: Chain, keys: Sequence[BlockKey], setup: Setup, count: int) -> float:
    """Processor time of a fit, the best of three [s]."""
    problem, rng = nominal_problem(chain, keys, setup), np.random.default_rng(0)
    truth = draw_errors(problem.parameters, rng)
    data = simulate(problem, truth, rng, count=count)
    # Nobody has told where a tracker stands.
    known = replace(setup, stations={}) if len(keys) > 2 else setup

    def job() -> None:
        fit(make_problem(chain, data, known), np.random.default_rng(0))

    return min(processor_time(job) for _ in range(3))


def _show(name: str, seconds: float, other: float = 0.0) -> None:
    ratio = f"  {seconds / other:5.2f} x" if other else ""
    print(f"{name:<44}{seconds:8.2f} s{ratio}", flush=True)
