"""A fit of real measurements, against scipy on the same residual."""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

import calib_pin
from benchmarks.timing import DATA, best, show, simulated
from calib_pin.estimation.formulation import make_problem
from calib_pin.estimation.nominal import registered
from calib_pin.kinematics.chain import Chain
from calib_pin.observations import Measurements
from calib_pin.setup import FrameSetup, Setup


def _talos() -> tuple[Chain, Measurements]:
    """The TALOS measurements, or as many simulated ones where they are absent."""
    chain = calib_pin.load_chain("example:talos_reduced", tip="gripper_left_base_link")
    file = DATA / "talos_left_arm" / "measurements.csv"
    if file.is_file():
        return chain, calib_pin.read_measurements(file, chain).only
    print(f"(no real measurements in {DATA}: simulated ones)")
    setup = Setup(tool_frame=FrameSetup((0.1, 0.05, 0.1)))
    return chain, simulated(chain, "position", setup, 61, 3e-4)[2]


def main() -> None:
    """A calibration of TALOS against scipy, which knows no rank."""
    chain, rows = _talos()
    seconds = best(lambda: calib_pin.calibrate(chain, rows, validate=False))
    problem = make_problem(chain, rows, Setup())
    problem = registered(problem, np.zeros(len(problem.parameters)))
    scales = problem.parameters.scales

    def scipy_fit() -> None:
        least_squares(lambda x: problem.residual(x * scales), 0.0 * scales)

    reference = best(scipy_fit, 1)
    show("TALOS calibration, 61 x 66", seconds, "scipy's", reference)
