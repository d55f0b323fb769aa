"""A robot that threads and processes share has the same poses as alone."""

from __future__ import annotations

import copy
import pickle
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

import calib_pin
from calib_pin.kinematics.skeleton import Skeleton

THREADS = 4


@pytest.fixture
def often() -> Iterator[None]:
    """Threads take turns a thousand times as often as they do otherwise."""
    usual = sys.getswitchinterval()
    sys.setswitchinterval(5e-6)
    yield
    sys.setswitchinterval(usual)


@pytest.mark.usefixtures("often")
def test_threads_share_a_robot() -> None:
    chain = calib_pin.load_chain("space7")
    skeleton = Skeleton(chain.robot, chain.robot.root)
    collisions = calib_pin.load_collisions(chain)
    assert collisions is not None
    q = np.random.default_rng(0).uniform(-2.0, 2.0, (THREADS, 10, 7))

    def everything(k: int) -> list[Any]:
        placements = [p.homogeneous[None].repeat(10, 0) for p in chain.placements]
        placements[0][:, 0, 3] += 0.01 * k
        return [
            chain.poses(q[k]),
            chain.poses(q[k], placements),
            *chain.jacobian(q[k]),
            *chain.regressor(q[k]),
            chain.gravity_torques(q[k], (0.0, 0.0, -9.81)),
            skeleton.placements(q[k][0]),
            collisions.contacts(q[k][:2]),
        ]

    alone = [everything(k) for k in range(THREADS)]

    def differences(k: int) -> int:
        rounds = (zip(everything(k), alone[k], strict=True) for _ in range(20))
        return sum(not np.array_equal(a, b) for pairs in rounds for a, b in pairs)

    with ThreadPoolExecutor(THREADS) as pool:
        assert list(pool.map(differences, range(THREADS))) == [0] * THREADS
    for other in (pickle.loads(pickle.dumps(chain)), copy.deepcopy(chain)):
        assert np.array_equal(other.poses(q[0]), alone[0][0])


def calibration(chain: calib_pin.Chain, seed: int) -> bytes:
    """A calibration in bytes; each seed has measurements of its own."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-2.0, 2.0, (25, 7))
    y = chain.poses(q + 0.01)[:, :3, 3] + rng.normal(0.0, 1e-4, (25, 3))
    rows = calib_pin.Measurements(chain.joints, q, "position", y)
    setup = calib_pin.Setup(parameters=("joint-offset",))
    result = calib_pin.calibrate(chain, rows, setup, validate=False, seed=seed)
    predicted = result.predict(q)
    return b"".join(a.tobytes() for a in (result.covariance, *predicted))


@pytest.mark.usefixtures("often")
@pytest.mark.parametrize(
    "backend", ["threading", pytest.param("loky", marks=pytest.mark.slow)]
)
def test_calibrations_side_by_side(backend: str) -> None:
    joblib = pytest.importorskip("joblib")
    chain = calib_pin.load_chain("space7")
    alone = [calibration(chain, seed) for seed in range(3)]
    work = (joblib.delayed(calibration)(chain, seed) for seed in range(3))
    assert joblib.Parallel(3, backend=backend)(work) == alone
