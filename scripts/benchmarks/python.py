"""What Python users rely on: predictions cover the truth, and threads change nothing.

    scripts/benchmark python

Robots have random errors, half of them gears as well that no parameter describes; the
truth is computed by kinematics of its own. `result.predict` then has to have the true
position of the tool within its 95 % ellipsoid at 93 to 97 % of configurations where
nobody measured. Calls of one robot in eight threads have to have the bits that they
have alone.
"""

from __future__ import annotations

import argparse
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import calib_pin
from calib_pin.kinematics.spatial import Floats

TOOL = np.array([0.05, 0.02, 0.1])
NOISE = 5e-5
ERROR = 5e-4
GEAR = 2e-4


def motion(shift: Floats, turn: Floats) -> Floats:
    """Poses of shifts and rotation vectors, shape (..., 3) -> (..., 4, 4)."""
    T = np.zeros((*np.shape(turn)[:-1], 4, 4))
    T[..., :3, :3] = Rotation.from_rotvec(turn).as_matrix()
    T[..., :3, 3], T[..., 3, 3] = shift, 1.0
    return T


class Truth:
    """A robot with errors before a tracker."""

    def __init__(
        self, chain: calib_pin.Chain, rng: np.random.Generator, gears: bool
    ) -> None:
        """Draw the errors, the station of the tracker, and gears."""
        self.chain, n = chain, len(chain.joints)
        self.errors = ERROR * rng.normal(size=(n + 1, 2, 3))
        self.station = motion(rng.normal(size=3), rng.normal(size=3))
        self.gear = GEAR * gears * rng.normal(size=n), rng.uniform(0.0, 6.0, n)

    def points(self, q: Floats) -> Floats:
        """Where the tracker sees the tool, shape (N, 3) [m]."""
        size, phase = self.gear
        q, T = q + size * np.sin(q + phase), self.station
        for k, placement in enumerate(self.chain.placements):
            T = T @ placement.homogeneous @ motion(*self.errors[k])
            turns = q[:, k, None] * self.chain.axes[k]
            T = T @ motion(np.zeros(3), turns)
        T = T @ self.chain.tip_placement.homogeneous @ motion(*self.errors[-1])
        return np.asarray((T @ np.append(TOOL, 1.0))[:, :3])


def covered(chain: calib_pin.Chain, seed: int, gears: bool) -> float:
    """Share of true positions within the 95 % ellipsoids of a calibration."""
    rng = np.random.default_rng(seed)
    truth = Truth(chain, rng, gears)
    low, high = np.maximum(chain.lower, -2.5), np.minimum(chain.upper, 2.5)
    q, others = rng.uniform(low, high, (2, 60, len(chain.joints)))
    seen = truth.points(q)
    seen = seen + NOISE * rng.normal(size=seen.shape)
    rows = calib_pin.Measurements(chain.joints, q, "position", seen, sigma=NOISE)
    found = calib_pin.calibrate(chain, rows, validate=False).predict(others)
    off = found.poses[:, :3, 3] - truth.points(others)
    there = np.linalg.solve(found.covariance[:, :3, :3], off[:, :, None])[:, :, 0]
    return float(np.mean(np.sum(off * there, axis=1) < chi2.ppf(0.95, 3)))


def differences(chain: calib_pin.Chain, calls: int, threads: int = 8) -> int:
    """Calls in threads that have not the bits that they have alone."""
    rng = np.random.default_rng(0)
    q = rng.uniform(-2.0, 2.0, (threads, 20, len(chain.joints)))
    alone = [chain.jacobian(one) for one in q]

    def work(k: int) -> int:
        rounds = (chain.jacobian(q[k]) for _ in range(calls // threads))
        return sum(not all(map(np.array_equal, found, alone[k])) for found in rounds)

    usual = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    with ThreadPoolExecutor(threads) as pool:
        found = sum(pool.map(work, range(threads)))
    sys.setswitchinterval(usual)
    return found


def main() -> None:
    """Print shares and counts; an exit code where they are not as they have to be."""
    parser = argparse.ArgumentParser(prog="benchmark python")
    parser.add_argument("name", nargs="*")
    parser.add_argument("--robots", type=int, default=200)
    parser.add_argument("--calls", type=int, default=10_000)
    options = parser.parse_args()
    chain, good = calib_pin.load_chain("pa10", tip="tool"), True
    for gears in (False, True):
        count = options.robots // 2
        found = np.array([covered(chain, seed, gears) for seed in range(count)])
        good &= bool(0.93 <= found.mean() <= 0.97)
        spread = found.std() / len(found) ** 0.5
        kind = "with gears" if gears else "geometry alone"
        print(f"{count} robots, {kind}: {found.mean():.3f} +- {spread:.3f} covered")
    wrong = differences(chain, options.calls)
    print(f"{options.calls} calls in 8 threads: {wrong} differences")
    if wrong or not good:
        sys.exit(1)
