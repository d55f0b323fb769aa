"""Lost motion shows in fits without it, and in no others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.calibration import calibrate
from calib_pin.estimation.evidence import Finding
from calib_pin.estimation.fit import fit_model
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Conditions, Observations
from calib_pin.setup import FrameSetup, Setup
from calib_pin.simulation import draw_errors, simulate
from calib_pin.validation.findings.approach import approach, approach_order
from calib_pin.validation.findings.case import Case

CHAIN = calib_pin.load_chain("pa10")
TOOL = FrameSetup((0.1, 0.05, 0.15), estimate=True)
PLACEMENT = Setup(parameters=("placement",), tool_frame=TOOL)


def robot_with(
    lost: dict[int, float],
    seed: int,
    count: int = 60,
    true: Sequence[str] = ("placement",),
    chain: Chain = CHAIN,
    path: bool = False,
) -> Observations:
    """Measurements of a robot with lost motion of some joints [rad]."""
    setup = replace(PLACEMENT, parameters=(*true, "hysteresis"))
    problem = nominal_problem(chain, "position", setup)
    rng = np.random.default_rng(seed)
    theta = draw_errors(problem.parameters, rng)
    for k, name in enumerate(problem.parameters.names):
        if ".hysteresis." in name:
            theta[k] = lost.get(chain.joints.index(name.split(".")[0]), 0.0)
    noise = rng.uniform(2e-5, 5e-5)
    q = waves(chain, count, rng) if path else None
    many = None if path else count
    rows = simulate(problem, theta, rng, q=q, count=many, noise=noise).only
    # As from a file that does not state them.
    held = replace(rows.conditions, source="order")
    return Observations.of(replace(rows, conditions=held))


def waves(chain: Chain, count: int, rng: np.random.Generator) -> Floats:
    """A path on which each joint goes to and fro, at its own pace."""
    lower, upper = np.maximum(chain.lower, -2.0), np.minimum(chain.upper, 2.0)
    paces, phases = rng.uniform(1.0, 8.0, len(lower)), rng.uniform(0, 6.28, len(lower))
    part = np.linspace(0.0, 2.0 * np.pi, count)[:, None]
    middle, width = 0.5 * (lower + upper), 0.4 * (upper - lower)
    return np.asarray(middle + width * np.sin(part * paces + phases))


def case_of(data: Observations, chain: Chain = CHAIN) -> Case:
    return Case.of(fit_model(chain, data, PLACEMENT, 0).fit, Chains.of(chain))


def told(data: Observations, chain: Chain = CHAIN) -> Finding | None:
    return next(approach(case_of(data, chain)), None)


def drawn(rng: np.random.Generator) -> dict[int, float]:
    """Lost motion of 0.2 to 2 mrad of three of the joints that matter."""
    joints = rng.choice(len(CHAIN.joints), 3, replace=False)
    sizes = np.exp(rng.uniform(np.log(2e-4), np.log(2e-3), 3))
    return dict(zip(joints.tolist(), sizes.tolist(), strict=True))


@pytest.mark.parametrize("lost", [{1: 2e-3}, {1: 2e-3, 2: 5e-4, 4: 1e-3}])
def test_lost_motion_is_told(lost: dict[int, float]) -> None:
    result = calibrate(CHAIN, robot_with(lost, 3), PLACEMENT)
    (found,) = (f for f in result.findings if f.code == "backlash")
    names = {CHAIN.joints[j]: size for j, size in lost.items()}
    assert set(str(found.evidence["joints"]).split(", ")) == set(names)
    for name, size in names.items():
        # Half of the smallest is a tenth of a millimeter here, beside the noise.
        assert abs(float(found.evidence[name]) - size) < 1e-4
    assert found.setup == {"parameters": ["placement", "hysteresis"]}
    assert "--parameters placement,hysteresis" in found.remedy
    # What goes with the sign of the last motion is not taken for a part of it.
    assert not {"lag", "instrument-drift"} & {f.code for f in result.findings}


def test_what_is_estimated_is_not_sought() -> None:
    data = robot_with({1: 2e-3, 2: 1e-3}, 3)
    setup = replace(PLACEMENT, parameters=("placement", "hysteresis"))
    result = calibrate(CHAIN, data, setup)
    codes = {f.code: f.severity for f in result.findings}
    assert "backlash" not in codes and codes["approach-by-order"] == "info"
    held = replace(data.only.conditions, source="columns")
    stated = Observations.of(replace(data.only, conditions=held))
    assert not [*approach_order(case_of(stated))]


def test_nothing_is_sought_where_no_side_is_known() -> None:
    data = robot_with({1: 2e-3}, 3)
    assert told(data) is not None
    unknown = replace(data.only, conditions=Conditions())
    assert told(Observations.of(unknown)) is None


def test_one_way_tells_nothing() -> None:
    """Of a joint that never turns back no lost motion is known, whatever is left."""
    data = robot_with({1: 2e-3}, 3)
    one_way = np.ones_like(data.conditions.direction)
    held = replace(data.conditions, direction=one_way)
    assert told(Observations.of(replace(data.only, conditions=held))) is None


@pytest.mark.parametrize("true", [("placement",), ("placement", "transmission")])
def test_none_is_invented(true: tuple[str, ...]) -> None:
    found = [told(robot_with({}, seed, true=true)) for seed in range(12)]
    assert sum(one is not None for one in found) <= 1


@pytest.mark.slow
def test_false_alarms_along_paths() -> None:
    """What the model lacks changes as slowly as the sides do."""
    chain = calib_pin.load_chain("heavy6")
    true = ("placement", "transmission", "compliance")
    jobs = (robot_with({}, seed, 120, true, chain, True) for seed in range(100))
    assert sum(told(data, chain) is not None for data in jobs) <= 2


@pytest.mark.slow
@pytest.mark.parametrize("count", [40, 80])
@pytest.mark.parametrize(
    "true", [("placement",), ("placement", "transmission", "compliance")]
)
def test_false_alarms_of_many_jobs(true: tuple[str, ...], count: int) -> None:
    """One of two hundred is expected; five and more come in 0.4 % of the cases."""
    chain = calib_pin.load_chain("heavy6")
    found = [
        told(robot_with({}, seed, count, true, chain), chain) for seed in range(200)
    ]
    assert sum(one is not None for one in found) <= 4


@pytest.mark.slow
@pytest.mark.parametrize("true", [("placement",), ("placement", "transmission")])
def test_every_joint_is_found(true: tuple[str, ...]) -> None:
    """Of three joints each; those next to the tool move it by little."""
    hits = invented = wanted = 0
    for seed in range(100):
        lost = drawn(np.random.default_rng(seed))
        found = told(robot_with(lost, seed, 80, true))
        names = (
            set() if found is None else set(str(found.evidence["joints"]).split(", "))
        )
        real = {CHAIN.joints[j] for j in lost}
        hits += len(names & real)
        invented += bool(names - real)
        wanted += len(real)
    assert hits >= 0.9 * wanted and invented <= 4
