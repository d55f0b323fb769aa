"""Paths of the product and their references, for the guard of speed.

A path is the call of a command with its user's input. Its reference is the same work
written in Pinocchio, numpy or scipy, or the least that the work needs.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pinocchio as pin
from scipy.optimize import least_squares
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, WhiteKernel

import calib_pin
from benchmarks.evolution import ranger_problem
from benchmarks.report import page_of, scatter_of
from benchmarks.timing import simulated
from calib_pin.control.compensation import compensate
from calib_pin.estimation.formulation import make_problem
from calib_pin.estimation.nominal import registered
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Measurements
from calib_pin.setup import DistanceSetup, FrameSetup, PointSetup, Setup, SolverSetup
from calib_pin.validation.result import CalibrationResult


@dataclass(frozen=True)
class Race:
    """A path of the product and its reference.

    Attributes:
        path: The call of a command.
        reference: The job it is compared with.
        share: How much of the path's work the reference does once.
    """

    path: Callable[[], object]
    reference: Callable[[], object]
    share: float = 1.0


# Robot, measurements and settings of the paths.

TOOL = FrameSetup((0.05, 0.03, 0.1))
NOISE = 1e-4
SOCKETS = {
    "s/0": PointSetup((0.6, 0.3, 0.4)),
    "s/1": PointSetup((0.5, -0.2, 0.6)),
    "s/2": PointSetup((0.7, 0.0, 0.2)),
}
APART = DistanceSetup(("s/0", "s/1"), 0.547722557505166, 1e-5)
MEMBERS, GENERATIONS = 150, 200
_FOLDER = tempfile.TemporaryDirectory()
SEARCH = SolverSetup(
    "de", {"population_size": MEMBERS, "maxiter": GENERATIONS, "tol": 0.0}
)


@cache
def _chain() -> calib_pin.Chain:
    return calib_pin.load_chain("space6")


def _simulated(model: str, count: int, setup: Setup) -> Measurements:
    """Measurements of a robot whose frames and instrument are nominal."""
    return simulated(_chain(), model, setup, count, NOISE, registered=True)[2]


@cache
def _positions(count: int) -> Measurements:
    return _simulated("position", count, Setup(tool_frame=TOOL))


def _fitted(rows: Measurements, **options: object) -> CalibrationResult:
    """A calibration without validation; options of the setup."""
    return calib_pin.calibrate(_chain(), rows, Setup(**options), validate=False)  # type: ignore[arg-type]


@cache
def _calibration() -> CalibrationResult:
    return calib_pin.calibrate(_chain(), _positions(500))


def _forward(q: Floats) -> None:
    """Forward kinematics of Pinocchio, row by row."""
    model = _chain().robot.model
    data = model.createData()
    for row in q:
        pin.forwardKinematics(model, data, row)


# The races.


def evolution(model: str, **options: object) -> Race:
    """A cost of a whole search beside one cost in a Pinocchio loop."""
    problem, ranger = ranger_problem()
    setup = Setup(**{"tool_frame": TOOL, **options})  # type: ignore[arg-type]
    if model == "plane-distance":
        setup, rows = problem.setup, problem.data.only
    else:
        rows = _simulated(model, 100, setup)
    setup = replace(setup, solver=SEARCH)
    plain = np.zeros(26)
    return Race(
        lambda: calib_pin.calibrate(_chain(), rows, setup, validate=False),
        lambda: [ranger.loop(plain) for _ in range(100)],
        MEMBERS * (GENERATIONS + 1) / 100,
    )


def fit() -> Race:
    """A fit of 500 measurements beside that of scipy with the same residual."""
    rows = _positions(500)
    problem = make_problem(_chain(), rows, Setup())
    problem = registered(problem, np.zeros(len(problem.parameters)))
    scales = problem.parameters.scales
    return Race(
        lambda: _fitted(rows),
        lambda: least_squares(lambda x: problem.residual(x * scales), 0.0 * scales),
    )


def two_step() -> Race:
    """Alternating least squares beside scipy."""
    rows = _positions(500)
    return replace(fit(), path=lambda: _fitted(rows, solver=SolverSetup("two-step")))


def jacobian() -> Race:
    """A Jacobian of 500 measurements beside central differences."""
    problem = make_problem(_chain(), _positions(500), Setup())
    theta = np.full(len(problem.parameters), 1e-3)
    shifts = 1e-6 * np.eye(len(theta))
    return Race(
        lambda: [problem.linearize(theta) for _ in range(10)],
        lambda: [problem.residual(theta + s * h) for h in shifts for s in (-1, 1)],
        10,
    )


def validation() -> Race:
    """A calibration with five folds beside a fit alone."""
    rows = _positions(500)
    return Race(lambda: calib_pin.calibrate(_chain(), rows), lambda: _fitted(rows))


def very_many() -> Race:
    """A fit of 100 000 measurements beside a product of large matrices."""
    rows = _positions(100_000)
    A = np.random.default_rng(0).normal(size=(1200, 1200))
    return Race(lambda: _fitted(rows), lambda: A @ A)


def reading() -> Race:
    """Reading 20 000 measurements beside numpy's reader."""
    file = Path(_FOLDER.name) / "rows.csv"
    calib_pin.write_measurements(file, _positions(20_000))
    return Race(
        lambda: calib_pin.read_measurements(file, _chain()),
        lambda: np.loadtxt(file, delimiter=",", skiprows=1),
    )


def planning() -> Race:
    """A plan beside singular values of a matrix for each candidate."""
    A = np.random.default_rng(0).normal(size=(300, 45, 48))
    setup = Setup(tool_frame=TOOL)
    return Race(
        lambda: calib_pin.plan(
            _chain(), "position", 15, setup, method="exchange", candidates=300
        ),
        lambda: [np.linalg.svd(matrix) for matrix in A],
    )


def identification() -> Race:
    """The identifiability analysis beside singular values of as many rows."""
    A = np.random.default_rng(0).normal(size=(600, 48))
    setup = Setup(tool_frame=TOOL)
    return Race(
        lambda: [calib_pin.identify(_chain(), "position", setup) for _ in range(5)],
        lambda: [np.linalg.svd(A, full_matrices=False) for _ in range(20)],
        5 / 20,
    )


def evaluation() -> Race:
    """Accuracy on 10 000 measurements beside bare forward kinematics."""
    model, rows = _calibration().model, _positions(10_000)
    return Race(
        lambda: calib_pin.evaluate(model, rows),
        lambda: [_forward(rows.q) for _ in range(5)],
        1 / 5,
    )


def simulation() -> Race:
    """Simulating 10 000 measurements beside bare forward kinematics."""
    q = _positions(10_000).q
    return Race(
        lambda: _simulated("position", 10_000, Setup(tool_frame=TOOL)),
        lambda: [_forward(q) for _ in range(5)],
        1 / 5,
    )


def compensation() -> Race:
    """Commands for 1000 poses beside Pinocchio's regressor of each."""
    model, chain = _calibration().model.of(), _chain()
    q = chain.random_configurations(1000, np.random.default_rng(0))
    targets = model.poses(q)
    robot = chain.robot.model
    data, tip = robot.createData(), robot.getFrameId(chain.tip)

    def regressors() -> None:
        for row in q:
            pin.forwardKinematics(robot, data, row)
            pin.updateFramePlacements(robot, data)
            pin.computeFrameKinematicRegressor(robot, data, tip, pin.LOCAL)

    return Race(
        lambda: compensate(model, targets, q),
        lambda: [regressors() for _ in range(10)],
        1 / 10,
    )


def learned(name: str) -> Race:
    """A learned correction beside scikit-learn's regression of the residual."""
    rows = _positions(100)
    features = np.concatenate([np.sin(rows.q), np.cos(rows.q)], axis=1)
    kernel = RBF(np.ones(features.shape[1])) + WhiteKernel()
    regression = GaussianProcessRegressor(kernel, normalize_y=True)
    errors = np.random.default_rng(0).normal(size=(100, 3)) + features[:, :3]
    return Race(
        lambda: _fitted(rows, learned=name), lambda: regression.fit(features, errors)
    )


def page() -> Race:
    """The page of a calibration beside one scatter plot as SVG."""
    result = _calibration()
    return Race(partial(page_of, result), partial(scatter_of, result))


def help_page() -> Race:
    """`calib-pin --help` beside importing Pinocchio."""

    def run(*words: str) -> None:
        subprocess.run([sys.executable, *words], check=True, capture_output=True)

    return Race(
        partial(run, "-m", "calib_pin", "--help"),
        partial(run, "-c", "import pinocchio"),
    )


RACES: Mapping[str, Callable[[], Race]] = {
    "calibrate --solver de, position": partial(evolution, "position"),
    "calibrate --solver de, pose": partial(evolution, "pose"),
    "calibrate --solver de, plane distance": partial(evolution, "plane-distance"),
    "calibrate --solver de, known distance": partial(
        evolution, "fixed-point", sockets=SOCKETS, distances=(APART,)
    ),
    "calibrate --solver de, transmission": partial(
        evolution, "position", parameters=("placement", "transmission")
    ),
    "calibrate": fit,
    "calibrate --solver two-step": two_step,
    "calibrate, five folds": validation,
    "calibrate, 100 000 measurements": very_many,
    "calibrate --learned gaussian-process": partial(learned, "gaussian-process"),
    "calibrate --learned network": partial(learned, "network"),
    "Jacobian": jacobian,
    "identify": identification,
    "evaluate": evaluation,
    "simulate": simulation,
    "plan": planning,
    "compensate": compensation,
    "reading": reading,
    "page": page,
    "--help": help_page,
}
"""The races by what users call."""
