"""The fit, the Jacobian and the commands."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pinocchio as pin
from scipy.optimize import least_squares

import calib_pin
from benchmarks.timing import DATA, best, show, simulated
from calib_pin.estimation.formulation import make_problem, nominal_problem
from calib_pin.estimation.registration import registered
from calib_pin.kinematics.chain import Chain
from calib_pin.observations import Measurements
from calib_pin.setup import FrameSetup, Setup
from calib_pin.simulation import exact_problem


def talos_rows() -> tuple[Chain, Measurements]:
    """The TALOS measurements, or as many simulated ones where they are absent."""
    chain = calib_pin.load_chain("example:talos_reduced", tip="gripper_left_base_link")
    file = DATA / "talos_left_arm" / "measurements.csv"
    if file.is_file():
        return chain, calib_pin.read_measurements(file, chain)
    print(f"(no real measurements in {DATA}: simulated ones)")
    setup = Setup(tool_frame=FrameSetup((0.1, 0.05, 0.1)))
    return chain, simulated(chain, "position", setup, 61, 3e-4)[2]


def fit_talos() -> None:
    """A calibration of TALOS against scipy on the same residual, without a rank."""
    chain, rows = talos_rows()
    seconds = best(lambda: calib_pin.calibrate(chain, rows, validate=False))
    problem = make_problem(chain, rows, Setup())
    problem = registered(problem, np.zeros(len(problem.parameters)))
    scales = problem.parameters.scales

    def scipy_fit() -> None:
        least_squares(lambda x: problem.residual(x * scales), 0.0 * scales)

    reference = best(scipy_fit, 1)
    show("TALOS calibration, 61 x 66", seconds, "scipy's", reference)


def jacobian() -> None:
    """One Jacobian of 500 positions x 48 parameters."""
    chain = calib_pin.load_chain("space6")
    nominal = nominal_problem(chain, "position", Setup())
    rng = np.random.default_rng(0)
    theta = rng.normal(size=len(nominal.parameters)) * 1e-3
    q = chain.random_configurations(500, rng)
    problem = exact_problem(nominal, theta, q, [""] * 500)
    seconds = best(lambda: problem.linearize(theta), 20)

    def differences() -> None:
        for k in range(len(theta)):
            shift = 1e-6 * np.eye(len(theta))[k]
            problem.residual(theta + shift)
            problem.residual(theta - shift)

    reference = best(differences, 3)
    show("Jacobian, 500 positions x 48", seconds, "central differences", reference)
    model, data = chain.robot.model, chain.robot.model.createData()

    def kinematics() -> None:
        for row in q:
            pin.forwardKinematics(model, data, row)

    share = best(kinematics, 20) / seconds
    print(f"{'':<40}{'':>14}bare forward kinematics are {100 * share:.0f} % of it")


def commands() -> None:
    """Whole processes of the command line."""

    def run(*words: str) -> None:
        command = [sys.executable, "-m", "calib_pin.cli", *words]
        subprocess.run(command, check=True, capture_output=True)

    bare = best(lambda: subprocess.run([sys.executable, "-c", ""], check=True))
    loaded = best(
        lambda: subprocess.run([sys.executable, "-c", "import pinocchio"], check=True)
    )
    helped = best(lambda: run("--help"))
    show("calib-pin --help", helped, "importing pinocchio", loaded)
    print(f"{'':<40}{'':>14}an empty Python process takes {1e3 * bare:.0f} ms")
    with tempfile.TemporaryDirectory() as folder:
        rows = Path(folder) / "rows.csv"
        tool = Path(folder) / "setup.yaml"
        tool.write_text("frames: {tool: {xyz: [0.05, 0.1, 0.1]}}\n")
        model = ("--model", "position", "--setup", str(tool), "--noise", "1e-4")
        run("simulate", "space6", *model, "--count", "500", "-o", str(rows))
        out = str(Path(folder) / "out")
        whole = best(
            lambda: run("calibrate", "space6", str(rows), "-o", out, "--force"), 3
        )
    show("calib-pin calibrate, 500, 5-fold", whole, "one scipy fit", _scipy())


def _scipy() -> float:
    """Time of one scipy fit of 500 measurements with differences [s]."""
    chain = calib_pin.load_chain("space6")
    nominal, truth, rows = simulated(chain, "position", Setup(), 500, 1e-4)
    problem = exact_problem(nominal, 0 * truth, rows.q, rows.target)
    scales = problem.parameters.scales
    return best(
        lambda: least_squares(lambda x: problem.residual(x * scales), truth / scales), 1
    )
