"""Recovery: errors of simulated calibrations against their covariance.

For each way of measuring, calibrations of robots whose true errors lie in the gauge (of
equal robots the one closest to nominal), frames and instrument included. NEES is the
squared error of the identifiable combinations in the metric of their covariance; its
mean is the rank if the covariance is right.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

import calib_pin
from benchmarks.exact import exact_at
from calib_pin.estimation.fit import fit
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.identifiability import visible_directions
from calib_pin.estimation.nominal import analyze_structure, observable_configurations
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import BlockKey
from calib_pin.setup import (
    AnchorSetup,
    CameraSetup,
    DistanceSetup,
    FrameSetup,
    PlaneSetup,
    PointSetup,
    Setup,
    SphereSetup,
    ToolSetup,
)

RUNS = 200
SIZE = 0.3
"""Standard deviation of the true errors in their expected sizes."""

NORMAL = 1.959964
"""Standard deviations within which 95 % of a normal distribution lie."""


@dataclass(frozen=True)
class Case:
    """One way of measuring a robot.

    Attributes:
        model: Measurement model, or the blocks that are measured.
        setup: The setup.
        rows: Measurements of each run.
        noise: Standard deviation of each component [m, rad, px].
        rank: The structural rank that is expected.
        robot: Name of a bundled robot.
    """

    model: str | tuple[BlockKey, ...]
    setup: Setup
    rows: int
    noise: float
    rank: int
    robot: str = "space6"


TOOL = FrameSetup((0.05, 0.08, 0.12), (0.2, -0.3, 0.1), estimate=True)
BASE = FrameSetup((1.5, -0.4, 0.3), (0.3, 0.2, 2.0), estimate=True)
FAR = FrameSetup((0.1, -0.2, 3.0), (0.3, -0.2, 0.4), estimate=True)
FRAMES = Setup(base_frame=BASE, tool_frame=TOOL)
"""A base and a tool that are estimated."""

KNOWN = FrameSetup(estimate=False)
POINTS = {
    "a": PointSetup((0.05, 0.08, 0.12)),
    "b": PointSetup((-0.06, 0.03, 0.1)),
    "c": PointSetup((0.02, -0.07, 0.15)),
}
SOCKETS = {"s/0": PointSetup((0.6, 0.3, 0.4)), "s/1": PointSetup((0.5, -0.2, 0.6))}
APART = float(np.linalg.norm([0.1, 0.5, -0.2]))
PLANES = {
    "a": PlaneSetup((0.0, 0.1, 1.0), -0.4, estimate=False),
    "b": PlaneSetup((1.0, 0.1, 0.3), -0.5),
    "c": PlaneSetup((0.2, 1.0, 0.1), -0.3),
}
SPHERE = SphereSetup((0.5, 0.2, 0.4), 0.15, estimate=True)
WIRE = AnchorSetup((1.5, 0.2, 0.4), 0.01, estimate=True, estimate_bias=True)
CAMERA = CameraSetup("world", (900.0, 910.0), (640.0, 500.0), estimate=True)

STATIONS = {
    "before": BASE,
    "beside": FrameSetup((-0.8, 1.2, 0.1), (-0.1, 0.3, -1.0), estimate=True),
    "behind": FrameSetup((0.3, 1.9, -0.2), (0.2, -0.1, 0.6), estimate=True),
}
TOOLS = {
    "ball": ToolSetup(TOOL.xyz, TOOL.rpy, estimate=True),
    "pin": ToolSetup((-0.04, 0.02, 0.15), (-0.3, 0.1, 0.4), estimate=True),
}

CASES: Mapping[str, Case] = {
    "pose": Case("pose", FRAMES, 40, 5e-5, 30),
    "position": Case("position", FRAMES, 60, 5e-5, 27),
    "plane-distance": Case(
        "plane-distance",
        Setup(
            parameters=("dh",),
            base_frame=KNOWN,
            tool_frame=KNOWN,
            planes={"wall": PlaneSetup((0.0, 1.0, 4.6), -0.69)},
        ),
        120,
        1e-4,
        24,
    ),
    "joint corrections": Case(
        "position",
        replace(FRAMES, parameters=("placement", "transmission", "compliance")),
        60,
        2e-5,
        71,
        "pa10",
    ),
    "named points": Case(
        "position", Setup(targets=POINTS, base_frame=BASE), 60, 5e-5, 33
    ),
    "fixed-point": Case(
        "fixed-point",
        Setup(
            sockets=SOCKETS,
            tool_frame=TOOL,
            distances=(DistanceSetup(("s/0", "s/1"), APART, 1e-5),),
        ),
        60,
        5e-5,
        27,
    ),
    "plane-contact": Case(
        "plane-contact", Setup(planes=PLANES, tool_frame=TOOL), 120, 5e-5, 29
    ),
    "sphere-contact": Case(
        "sphere-contact",
        Setup(spheres={"ball": SPHERE}, tool_frame=TOOL),
        120,
        5e-5,
        24,
    ),
    "point-distance": Case(
        "point-distance",
        Setup(anchors={"wire": WIRE}, tool_frame=TOOL),
        120,
        5e-5,
        25,
    ),
    "relative-distance": Case(
        "relative-distance", Setup(tool_frame=TOOL), 120, 5e-5, 21
    ),
    "camera": Case(
        "camera",
        Setup(
            targets={**POINTS, "d": PointSetup((0.1, 0.1, -0.05))},
            camera=CAMERA,
            base_frame=FAR,
            tool_frame=TOOL,
        ),
        160,
        0.3,
        39,
    ),
    "position and fixed-point": Case(
        (BlockKey("position"), BlockKey("fixed-point")),
        replace(FRAMES, sockets=SOCKETS),
        120,
        5e-5,
        33,
    ),
    # A position has two directions of the tool, and three of each further frame.
    "three stations, two tools": Case(
        tuple(
            BlockKey("position", station=station, tool=tool)
            for station in STATIONS
            for tool in TOOLS
        ),
        Setup(stations=STATIONS, tools=TOOLS),
        90,
        5e-5,
        27 + 2 * 6 + 3,
    ),
}


@dataclass(frozen=True)
class Trials:
    """Results of R runs.

    Attributes:
        nees: NEES / rank, shape (R,).
        covered: Whether the 95 % interval of each combination holds the truth, (R, k).
        actual: Squared whitened errors on new configurations, shape (R,).
        predicted: What the covariance predicts of them, shape (R,).
    """

    nees: Floats
    covered: Floats
    actual: Floats
    predicted: Floats

    @property
    def accuracy(self) -> float:
        """Actual by predicted error on new configurations, root mean square."""
        return float(np.sqrt(self.actual.sum() / self.predicted.sum()))


class Study:
    """Simulated calibrations of one case."""

    def __init__(self, case: Case, seed: int = 7) -> None:
        """Analyze the nominal robot."""
        self.case, self.rng = case, np.random.default_rng(seed)
        chain = calib_pin.load_chain(case.robot)
        self.problem = nominal_problem(chain, case.model, case.setup)
        zero = np.zeros(len(self.problem.parameters))
        self.structure, J = analyze_structure(self.problem, zero, self.rng)
        self.visible = visible_directions(J, self.problem.parameters)
        self._combined = np.array(
            [c.row(len(zero)) for c in self.structure.combinations]
        )
        # A beam along the plane has no distance: only what can be measured counts.
        self._new = [
            observable_configurations(self.problem, key, zero, 30, self.rng)
            for key in self.problem.terms
        ]

    def truth(self, size: float = SIZE) -> Floats:
        """True errors in the gauge, shape (P,)."""
        drawn = self.visible @ self.rng.normal(size=self.visible.shape[1])
        return np.asarray(size * self.problem.parameters.scales * drawn)

    def calibrated(self, truth: Floats, noise: float) -> Fit:
        """The fit of measurements of that robot."""
        rows = calib_pin.simulate(
            self.problem, truth, self.rng, count=self.case.rows, noise=noise
        )
        return fit(replace(self.problem, data=rows), self.rng)

    def trials(self, runs: int = RUNS) -> Trials:
        """Calibrations of robots with noise."""
        C, nees, covered, ahead = self._combined, [], [], []
        for _ in range(runs):
            truth = self.truth()
            fitted = self.calibrated(truth, self.case.noise)
            if fitted.rank != self.structure.rank:
                raise ArithmeticError(
                    f"rank {fitted.rank} instead of {self.structure.rank}"
                )
            error = C @ (fitted.theta - truth)
            covariance = C @ fitted.covariance @ C.T
            nees.append(error @ np.linalg.solve(covariance, error))
            covered.append(np.abs(error) < NORMAL * np.sqrt(np.diag(covariance)))
            ahead.append(self._ahead(truth, fitted))
        actual, predicted = np.array(ahead).T
        return Trials(
            np.array(nees) / self.structure.rank, np.array(covered), actual, predicted
        )

    def _ahead(self, truth: Floats, fitted: Fit) -> tuple[float, float]:
        """Squared errors on new configurations, actual and predicted.

        Of what the instrument shows there, frames and instrument included.
        """
        # A gap that contacts have there must not differ by the units alone.
        known = replace(self.problem, units=fitted.problem.units)
        of_truth = exact_at(known, truth, *self._new)
        new = replace(fitted.problem, data=of_truth.data)
        count = new.sigma.size

        def rows(problem: Problem, theta: Floats) -> tuple[Floats, Floats]:
            # Without the known distances, which stand behind them.
            r, J = problem.linearize_rows(theta)
            return r[:count], J[:count]

        r, J = rows(new, fitted.theta)
        # Contacts have a gap there: configurations belong to the nominal robot.
        missed = r - rows(of_truth, truth)[0]
        return float(missed @ missed), float(np.trace(J @ fitted.covariance @ J.T))


def main() -> None:
    """Print the results of 200 runs of each case."""
    print(f"{RUNS} runs, ratios with three standard deviations of what chance gives")
    print(
        f"{'case':<26}{'rank':>4}{'NEES / rank':>20}{'covered':>12}"
        f"{'held out':>10}{'s/run':>8}"
    )
    for name, case in CASES.items():
        study = Study(case)
        start = time.perf_counter()
        found = study.trials()
        seconds = (time.perf_counter() - start) / RUNS
        chance = 3.0 * np.sqrt(2.0 / (RUNS * study.structure.rank))
        nees = f"{found.nees.mean():.3f} (1 +- {chance:.3f})"
        print(
            f"{name:<26}{study.structure.rank:>4}{nees:>20}"
            f"{100.0 * found.covered.mean():>10.1f} %{found.accuracy:>10.3f}"
            f"{seconds:>8.3f}",
            flush=True,
        )
