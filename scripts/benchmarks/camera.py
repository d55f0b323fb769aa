"""A camera on the hand: a calibration by very many pixels, and one residual of them.

The reference of the residual is written without a library: forward kinematics of
Pinocchio for every image, and its points projected with numpy.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pinocchio as pin
from numba import config

import calib_pin
from benchmarks.exact import exact_problem
from benchmarks.timing import best, show
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.nominal import unmeasured
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Measurements, Observations
from calib_pin.setup import CameraSetup, FrameSetup, PointSetup, Setup

IMAGES = 10_000
NOISE = 0.5
"""Standard deviation of a pixel [px]."""

LENS = (-0.2, 0.05, 0.002, -0.001, 0.01)
CAMERA = CameraSetup("hand", (900.0, 910.0), (640.0, 480.0), LENS, (1280.0, 960.0))
BOARD = {
    f"corner_{i}_{j}": PointSetup((0.03 * i, 0.03 * j, 0.0))
    for i in range(5)
    for j in range(4)
}
FRAMES = Setup(
    targets=BOARD,
    camera=CAMERA,
    base_frame=FrameSetup((0.3, -0.2, 0.4), (0.5, -0.3, 1.0), estimate=True),
    tool_frame=FrameSetup((0.05, -0.02, 0.1), (0.2, -0.1, 0.4), estimate=True),
)


def main() -> None:
    """Print the time of a fit with known and with estimated intrinsics."""
    rng = np.random.default_rng(0)
    chain = calib_pin.load_chain("space6")
    nominal = nominal_problem(chain, "camera", FRAMES)
    q = _configurations(nominal, rng)
    target = tuple(BOARD) * len(q)
    truth = calib_pin.draw_errors(nominal.parameters, rng)
    exact = exact_problem(nominal, truth, np.repeat(q, len(BOARD), axis=0), target)
    values = exact.data.only.values
    values = values + rng.normal(size=values.shape) * NOISE
    data = replace(exact.data.only, values=values, sigma=np.full_like(values, NOISE))
    threads = int(config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]
    print(f"space6, {len(q)} images of {len(BOARD)} points, {threads} threads")
    for estimate in (False, True):
        setup = Setup(targets=BOARD, camera=replace(CAMERA, estimate=estimate))
        _calibrate(chain, data, setup, "estimated" if estimate else "known")
    _residual(nominal, data)


def _calibrate(chain: Chain, data: Measurements, setup: Setup, intrinsics: str) -> None:
    """Calibrate, and print how long it took."""
    # Compiles, and loads what is loaded once.
    few = data.rows(np.arange(20_000))
    calib_pin.calibrate(chain, few, setup, validate=False)
    start = time.perf_counter()
    found = calib_pin.calibrate(chain, data, setup, validate=False)
    seconds = time.perf_counter() - start
    print(
        f"intrinsics {intrinsics:<10}{seconds:9.2f} s{found.solver.iterations:5} steps"
        f"{found.identifiability.rank:5} of {len(found.parameters)} parameters"
        f"{found.statistics.sigma0:9.4f} sigma0"
    )


def _residual(nominal: Problem, data: Measurements) -> None:
    """One evaluation of all residuals at the nominal robot."""
    problem = replace(nominal, data=Observations.of(data))
    theta = np.zeros(len(problem.parameters))
    np.testing.assert_allclose(
        problem.errors(theta), _plain_loop(problem).reshape(-1), atol=1e-8
    )
    seconds = best(lambda: problem.errors(theta))
    reference = best(lambda: _plain_loop(problem), 3)
    show("residual, 200 000 pixels", seconds, "a plain loop", reference)


def _configurations(nominal: Problem, rng: np.random.Generator) -> Floats:
    """Configurations with the whole board in the image, shape (IMAGES, n)."""
    found: list[Floats] = []
    zero, key = np.zeros(len(nominal.parameters)), nominal.only.key
    while sum(map(len, found)) < IMAGES:
        q = nominal.chains.random_configurations(20_000, rng)
        for name in BOARD:
            q = q[
                nominal.observable(zero, unmeasured(nominal, key, q, (name,) * len(q)))
            ]
        found.append(q)
    return np.concatenate(found)[:IMAGES]


def _plain_loop(problem: Problem) -> Floats:
    """Residuals image by image, shape (N, 2) [px]."""
    ((part, data, *_),) = problem.blocks
    chain = part.error.chain
    model = chain.robot.model
    buffers, tip = model.createData(), model.getFrameId(chain.tip)
    points = np.array([point.xyz for point in BOARD.values()])
    k_1, k_2, p_1, p_2, k_3 = LENS
    result = np.empty_like(data.values)
    for row in range(0, len(data), len(points)):
        pin.forwardKinematics(model, buffers, data.q[row])
        F = pin.updateFramePlacement(model, buffers, tip)
        T = part.error.base * F * part.error.tool
        X = (points - T.translation) @ T.rotation
        x, y = X[:, 0] / X[:, 2], X[:, 1] / X[:, 2]
        r = x * x + y * y
        s = 1.0 + k_1 * r + k_2 * r * r + k_3 * r * r * r
        u = x * s + 2.0 * p_1 * x * y + p_2 * (r + 2.0 * x * x)
        v = y * s + p_1 * (r + 2.0 * y * y) + 2.0 * p_2 * x * y
        pixels = np.column_stack([u, v]) * CAMERA.focal + CAMERA.center
        result[row : row + len(points)] = pixels - data.values[row : row + len(points)]
    return result
