"""A correction learned from 5 000 to 200 000 measurements: time, memory and accuracy.

A UR10 with wrong placements, waves in its gears, compliance, and links that bend, which
no correction of the joints describes. Measured are positions with 0.05 mm of noise.
Accuracy is that at configurations that were not measured: against the true positions,
and against measurements of them. Every size has a process of its own; its time is that
of the fit of the placements and that of all that is learned.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time

import numpy as np
import pinocchio as pin

from calib_pin.estimation.fit import fit, learned_correction
from calib_pin.estimation.formulation import make_problem
from calib_pin.io.urdf import load_chain
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Measurements, Observations
from calib_pin.parameterizations.error_model import ErrorModel
from calib_pin.setup import FrameSetup, Setup
from calib_pin.simulation import draw_errors

SIZES = (5_000, 20_000, 200_000)
UNSEEN = 20_000

NOISE = 5e-5
"""Standard deviation of a component [m]."""

TOOL = (0.05, 0.03, 0.1)
FLEXIBLE = 0.3
"""Errors of gears and compliance, in those that a setup expects."""

PIECE = 20_000
"""Configurations that are simulated at a time."""


def main() -> None:
    """Print a table."""
    print(f"{'measured':>10}{'fit':>8}{'learned':>9}{'CPU':>8}{'MB':>7}", end="")
    print(f"{'before':>10}{'after':>9}{'measured':>10}{'  space':>8}")
    for size in SIZES:
        command = [sys.executable, "-m", "benchmarks.learned", str(size)]
        answer = subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout
        found = json.loads(answer)
        print(
            f"{size:>10}{found['fit']:>7.1f}s{found['learned']:>8.1f}s"
            f"{found['cpu']:>7.1f}s{found['memory']:>7.0f}{found['before']:>10.4f}"
            f"{found['after']:>9.4f}{found['unseen']:>10.4f}{found['space']:>8}",
            flush=True,
        )
    print("before, after: error of a component at unseen configurations [mm];")
    print("measured: the same after, against measurements of them [mm]")


def _measure(size: int) -> dict[str, object]:
    """Learn from so many measurements; seconds, MB and errors in mm."""
    chain = load_chain("example:ur10_robot", base="base_link", tip="tool0")
    rng = np.random.default_rng(0)
    q = chain.random_configurations(size + UNSEEN, rng)
    exact = _true_positions(chain, q)
    measured = exact + NOISE * rng.normal(size=exact.shape)
    data = Observations.of(
        Measurements(
            chain.joints,
            q[:size],
            "position",
            measured[:size],
            np.full((size, 3), NOISE),
        )
    )
    start = time.perf_counter(), time.process_time()
    fitted = fit(make_problem(chain, data, Setup(tool_frame=FrameSetup(TOOL))), rng)
    problem, theta = fitted.problem.rebased(fitted.theta)
    middle = time.perf_counter()
    learned = learned_correction("gaussian-process", fitted, rng)
    end = time.perf_counter(), time.process_time()
    assert learned is not None
    term = problem.only
    of_robot, _ = term.values(theta)

    def errors(error: ErrorModel, positions: Floats) -> float:
        unseen, found = q[size:], []
        for start in range(0, UNSEEN, PIECE):
            found.append(error.poses(unseen[start : start + PIECE], of_robot))
        away = np.concatenate(found)[:, :3, 3] - positions[size:]
        return 1e3 * float(np.sqrt((away**2).mean()))

    corrected = problem.learning(learned).only.error
    return {
        "fit": middle - start[0],
        "learned": end[0] - middle,
        "cpu": end[1] - start[1],
        "memory": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6,
        "before": errors(term.error, exact),
        "after": errors(corrected, exact),
        "unseen": errors(corrected, measured),
        "space": learned.space,
    }


def _true_positions(chain: Chain, q: Floats) -> Floats:
    """Positions of the tool of the simulated robot, shape (N, 3) [m]."""
    error = ErrorModel.create(chain, ["placement", "transmission", "compliance"])
    error = error.with_frames(
        pin.SE3.Identity(), pin.SE3(np.eye(3), np.array(TOOL, float))
    )
    theta = draw_errors(error.parameters, np.random.default_rng(7))
    theta[error.joint_corrections] *= FLEXIBLE
    # A wrong gear ratio is another correction after every turn, and no wave.
    theta[[each.name.endswith(".gain") for each in error.parameters]] = 0.0
    phase, result = np.arange(len(chain.joints)), np.empty((len(q), 3))
    for start in range(0, len(q), PIECE):
        at = q[start : start + PIECE]
        waves = 8e-5 * np.sin(20.0 * at + phase) + 6e-5 * np.cos(7.0 * at + phase)
        T = error.poses(at + waves, theta)
        turned, shoulder, elbow, wrist, hand, _ = at.T
        bent = 2.5e-4 * np.column_stack(
            [
                np.sin(shoulder) * np.cos(shoulder + elbow) * np.cos(2.0 * turned),
                np.cos(shoulder + elbow + wrist) * np.sin(hand),
                np.sin(elbow) ** 2 * np.cos(wrist),
            ]
        )
        moved = T[:, :3, 3] + (T[:, :3, :3] @ bent[:, :, None])[:, :, 0]
        result[start : start + PIECE] = moved
    return result


if __name__ == "__main__":
    print(json.dumps(_measure(int(sys.argv[1]))))
