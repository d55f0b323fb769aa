"""One fit: fixed, bounded and prior parameters, and which directions may move."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.fit import (
    fit,
    fit_model,
    training_rows,
    with_drift,
    with_time_course,
    with_warm_up,
)
from calib_pin.estimation.fitted import Fit, with_prior
from calib_pin.estimation.formulation import make_problem, nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.row_blocks import expected_places
from calib_pin.io.json_text import encode
from calib_pin.io.results import calibration_document, read_calibration
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import MEASUREMENT_MODELS
from calib_pin.observations import Conditions, Observations
from calib_pin.residual_models import RESIDUAL_MODELS, TrainingRows
from calib_pin.setup import DriftSetup, FrameSetup, Setup, ThermalSetup
from calib_pin.simulation import draw_errors, simulate
from calib_pin.solvers import Status
from calib_pin.validation.held_out import left_out
from calib_pin.validation.model_errors import fitted_errors, model_errors
from calib_pin.validation.result import Provenance
from calib_pin.validation.splits import Grouping, folds
from tests.residual_models.corrections import Everywhere
from tests.shared import FRAMED, measured, simulated
from tests.validation.test_splits import SETUP as OFFSETS_ALONE
from tests.validation.test_splits import measured_rows

KNOWN = FrameSetup(estimate=False)
SETUP = Setup(base_frame=KNOWN, tool_frame=KNOWN, parameters=("joint-offset",))
OFF_AXIS = FrameSetup((0.1, 0.0, 0.05), estimate=False)
OFFSETS = [0.004, -0.003, 0.002, 0.005, -0.001, 0.003]


def offsets_problem(setup: Setup, noise: float = 0.0) -> tuple[Problem, np.ndarray]:
    """`space6` with joint offsets, measured by position."""
    offsets = {f"joint_{k}.joint-offset.q": x for k, x in enumerate(OFFSETS, start=1)}
    about = {"seed": 1, "noise": noise, "changes": offsets}
    job, truth = simulated("position", replace(SETUP, tool_frame=OFF_AXIS), 30, **about)
    stated = replace(setup, tool_frame=OFF_AXIS)
    problem = nominal_problem(job.chains, "position", stated)
    return replace(problem, data=job.data), truth


def run(problem: Problem) -> Fit:
    return fit(problem, np.random.default_rng(0))


def test_bounds_hold_and_the_others_make_up_for_it() -> None:
    problem, truth = offsets_problem(replace(SETUP, bounds={"joint_4.*": 0.002}))
    found = run(problem)
    k = problem.parameters.index("joint_4.joint-offset.q")
    assert found.result.status is Status.CONVERGED
    assert found.theta[k] == 0.002
    assert found.problem.held_at == {k: 0.002}
    # Optimal under the bound: the gradient of the posterior vanishes for all others.
    _, held, _ = with_prior(found)
    assert len(held.fun) == len(found.result.fun) + found.directions.robot.shape[1]
    gradient = held.jac.T @ held.fun
    by_rows = found.result.jac.T @ found.result.fun
    others = problem.parameters.free & (np.arange(len(truth)) != k)
    # It was weighed by sigma0, of which the unit weight is the better estimate.
    pull = np.abs(by_rows[others]).max()
    assert np.abs(gradient[others]).max() < 1e-3 * pull < 1e-4 * np.abs(gradient[k])


def test_a_prior_is_a_measurement_of_zero() -> None:
    sigma = 1e-5
    problem, _ = offsets_problem(replace(SETUP, prior={"*": sigma}), noise=1e-4)
    found = run(problem)
    J, r = found.result.jac[:, problem.parameters.free], found.result.fun
    # The normal equations hold with the prior's rows among them.
    assert np.abs(J.T @ r).max() < 1e-6 * np.linalg.norm(J) * np.linalg.norm(r)
    assert len(found.result.fun) == 30 * 3 + 6
    assert np.abs(found.theta).max() < max(OFFSETS)


def test_noisy_rows_leave_weak_directions_to_the_prior() -> None:
    """By least squares they would move by ten expected sizes and more."""
    problem, _ = simulated("position", count=14, size=1.0, robot="pa10", noise=2e-3)
    found = run(problem)
    weak = found.directions.weak
    assert weak.shape[1] > 0
    assert found.evidence is not None and found.evidence.matters
    (size,) = set(found.evidence.sizes[~problem.parameters.nuisance])
    # Of independent errors, about the places where these are expected.
    places = expected_places(found.problem, problem.parameters)
    errors = np.linalg.solve(places, found.theta / problem.parameters.scales)
    own = np.linalg.solve(places, weak)
    # The rows tell them to ten sizes at best, so that they keep a hundredth of what
    # these say.
    assert np.abs(np.linalg.qr(own)[0].T @ errors).max() < 0.1 * size
    # What they may be off by is what they were expected to be, and no more.
    C = found.covariance / np.outer(*[problem.parameters.scales] * 2)
    deviations = np.sqrt(np.diag(weak.T @ C @ weak))
    expected = size * np.sqrt(np.diag(np.linalg.inv(own.T @ own)))
    np.testing.assert_allclose(deviations, expected, rtol=0.05)


def test_every_value_stays_within_its_bounds() -> None:
    limit = 2e-4
    problem, truth = placement_problem(Setup(bounds={"*.placement.*": limit}))
    found = run(problem)
    robot = ~problem.parameters.nuisance
    assert np.abs(truth[robot]).max() > limit
    assert np.abs(found.theta[robot]).max() <= limit
    assert found.problem.held_at
    # No parameter is called known because a bound stopped it.
    held = list(found.problem.held_at)
    assert not found.problem.parameters.free[held].any()


def placement_problem(setup: Setup) -> tuple[Problem, np.ndarray]:
    """`space6` with placement errors, measured by position with 0.1 mm noise."""
    free = Setup(tool_frame=FrameSetup((0.1, 0.05, 0.05)))
    job, truth = simulated("position", free, 40, 1.0, seed=1, noise=1e-4)
    problem = nominal_problem(job.chains, "position", setup)
    return replace(problem, data=job.data), truth


HOUR = 3600.0
CHAIN = calib_pin.load_chain("space6")
CHAINS = Chains.of(CHAIN)
PLAIN = Setup(tool_frame=FrameSetup((0.0, 0.0, 0.1), estimate=True))
WARM = replace(PLAIN, parameters=("placement", "warm-up"))
DRIFTING = replace(PLAIN, parameters=("placement", "instrument-drift"))


@dataclass(frozen=True)
class Job:
    """A robot that is measured for an hour, and the truth about it."""

    problem: Problem
    theta: Floats

    @staticmethod
    def warm(constant: float, seed: int) -> Job:
        """Links that are 0.6 per mille shorter when cold."""
        thermal = ThermalSetup(switched_on=(0.0,), warm_up_time=constant)
        problem = nominal_problem(CHAIN, "position", replace(WARM, thermal=thermal))
        theta = draw_errors(problem.parameters, np.random.default_rng(seed))
        warm = [".warm-up." in name for name in problem.parameters.names]
        return Job(problem, np.where(warm, 6e-4, theta))

    @staticmethod
    def drifting(shift: float, turn: float) -> Job:
        """A walk of these sizes."""
        drift = DriftSetup({"base": (0.0, HOUR)}, shift, turn)
        problem = nominal_problem(CHAIN, "position", replace(DRIFTING, drift=drift))
        rng = np.random.default_rng(0)
        theta = draw_errors(problem.parameters, rng)
        for k, parameter in enumerate(problem.parameters):
            if "drift" in parameter.name:
                theta[k] = rng.normal() * parameter.prior
        return Job(problem, theta)

    def measured(self, seed: int, count: int, noise: float = 2e-5) -> Observations:
        """Positions within the hour."""
        rng = np.random.default_rng(seed)
        time = Conditions(time=np.append(0.0, np.sort(rng.uniform(0.0, HOUR, count))))
        q = CHAIN.random_configurations(count + 1, rng)
        return simulate(
            self.problem, self.theta, rng, q=q, conditions=time, noise=noise
        )


@pytest.fixture(scope="module")
def drifting() -> tuple[Job, Observations]:
    job = Job.drifting(1e-4, 0.0)
    return job, job.measured(1, 60)


def test_the_time_constant_of_a_warm_up_is_found() -> None:
    found = with_warm_up(CHAINS, Job.warm(400.0, 1).measured(1, 40), WARM, 0).thermal
    assert found.switched_on == (0.0,)
    assert found.warm_up_time == pytest.approx(400.0, rel=0.3)


def test_what_is_stated_stands(drifting: tuple[Job, Observations]) -> None:
    _, data = drifting
    warm = replace(WARM, thermal=ThermalSetup(switched_on=(0.0,), warm_up_time=900.0))
    drift = DriftSetup({"base": (0.0, 1800.0)}, 5e-5, 0.0)
    for stated in (PLAIN, warm, replace(DRIFTING, drift=drift)):
        found = with_time_course(CHAINS, data, stated, 0)
        assert (found.drift, found.thermal) == (stated.drift, stated.thermal)


def test_the_geometry_is_that_of_the_warm_robot() -> None:
    job = Job.warm(900.0, 3)
    data = job.measured(3, 40)
    result = calib_pin.calibrate(CHAIN, data, job.problem.setup, validate=False)
    still = fit(make_problem(CHAIN, data, PLAIN), np.random.default_rng(0))
    q = CHAIN.random_configurations(100, np.random.default_rng(9))
    error, own = job.problem.only.error, job.problem.only.values(job.theta)[0]
    warm, errors = error.poses(q, own)[:, :3, 3], []
    term = still.problem.only
    for found in (
        result.model.of().poses(q),
        term.error.poses(q, term.values(still.theta)[0]),
    ):
        off = found[:, :3, 3] - warm
        errors.append(rms(off - off.mean(0)))
    assert errors[0] < 0.4 * errors[1]
    (told,) = [f for f in result.findings if f.code == "modeled-warm-up"]
    basis = error.basis(q, Conditions(time=np.zeros(len(q))))
    cold = error.poses(q, own, basis)[:, :3, 3] - warm
    assert told.evidence["cold"] == pytest.approx(rms(cold), rel=0.3)


def rms(vectors: Floats) -> float:
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))


def test_each_morning_anew() -> None:
    """A robot that is switched on twice is cold twice."""
    thermal = ThermalSetup(switched_on=(0.0, 1e5), warm_up_time=600.0)
    problem = nominal_problem(CHAIN, "position", replace(WARM, thermal=thermal))
    q = np.zeros((3, len(CHAIN.joints)))
    time = Conditions(time=np.array([0.0, 1e5 - 1.0, 1e5]))
    values = problem.only.error.basis(q, time)
    np.testing.assert_allclose(values[0], values[2])
    assert np.abs(values[0]).min() == 1.0 and np.abs(values[1]).max() < 1e-6


@pytest.mark.parametrize("size", [0.0, 1e-4])
def test_the_size_of_a_drift_is_that_of_the_walk(size: float) -> None:
    """A size of 24 increments is known to a sixth; what is not there is zero."""
    found = with_drift(CHAINS, Job.drifting(size, size).measured(0, 60), DRIFTING, 0)
    for one in (found.drift.shift, found.drift.turn):
        assert one is not None and 0.5 * size <= one <= 1.8 * size


def test_a_drift_costs_no_accuracy(drifting: tuple[Job, Observations]) -> None:
    """Within the hour, against a model that knows how much the instrument drifts."""
    job, data = drifting
    there, errors = job.measured(50, 150, noise=0.0), []
    for setup in (with_drift(CHAINS, data, DRIFTING, 0), job.problem.setup, PLAIN):
        model = fit_model(CHAIN, data, setup, 0)
        errors.append(rms(model_errors(model, there, np.arange(len(there))).after))
    assert errors[0] < 1.3 * errors[1] < 1.3 * 0.6 * errors[2]


def test_a_calibration_tells_and_keeps_a_drift(
    drifting: tuple[Job, Observations], tmp_path: Path
) -> None:
    job, data = drifting
    result = calib_pin.calibrate(CHAIN, data, DRIFTING, validate=False)
    (told,) = [f for f in result.findings if f.code == "modeled-drift"]
    assert told.severity == "info" and result.model.geometric
    # The walk is known to the noise of some positions.
    steps = [
        [f"base.instrument-drift.{axis}{k}" for k in range(1, 9)] for axis in "xyz"
    ]
    truth = dict(zip(job.problem.given.names, job.theta, strict=True))
    walk = [sum(truth[name] for name in axis) for axis in steps]
    place = {p.name: k for k, p in enumerate(result.parameters)}
    own = [[place[name] for name in axis] for axis in steps]
    covariance = np.asarray(result.covariance)
    sigma = np.sqrt(sum(covariance[np.ix_(axis, axis)].sum() for axis in own))
    assert told.evidence["shift"] == pytest.approx(np.linalg.norm(walk), abs=3 * sigma)
    assert sigma < 0.3 * np.linalg.norm(walk)
    # A file holds the walk and its time.
    file = tmp_path / "calibration.json"
    file.write_bytes(encode(calibration_document(result, Provenance.at("2026-01-01"))))
    (tmp_path / "nominal.urdf").write_bytes(CHAIN.robot.source)
    back, model = read_calibration(file), result.model
    at = job.measured(3, 50).only
    assert back.setup.drift == model.setup.drift
    np.testing.assert_allclose(
        back.predict(back.theta, at), model.predict(model.theta, at), rtol=0, atol=1e-12
    )
    early = replace(at, conditions=Conditions())
    moved = back.predict(back.theta, at) - back.predict(back.theta, early)
    assert np.abs(moved).max() > 1e-5


# Learned corrections.


RELATIVE = "relative-distance"
KINDS = ["placement", "transmission"]


@pytest.mark.parametrize("space", ["joint", "tip"])
def test_derivatives_of_training_rows(space: str, special_chain: Chain) -> None:
    geared = {"gear_ratios": FRAMED.gear_ratios}
    check_training_rows(measured(special_chain, "pose", KINDS, 5, **geared), space)


@pytest.mark.parametrize("model", sorted({*MEASUREMENT_MODELS} - {"pose", RELATIVE}))
def test_derivatives_of_every_model(model: str) -> None:
    """On one chain: what a model adds knows nothing of the chain."""
    space = ("joint", "tip")[sorted(MEASUREMENT_MODELS).index(model) % 2]
    chain = calib_pin.load_chain("space6")
    check_training_rows(measured(chain, model, KINDS, 5), space)


def check_training_rows(problem: Problem, space: str) -> None:
    rng = np.random.default_rng(4)
    theta = 0.02 * rng.normal(size=len(problem.parameters))
    error = problem.only.error
    directions = np.zeros((len(theta), 3))
    directions[: len(error.screws)] = rng.normal(size=(len(error.screws), 3))
    rows = training_rows(problem, theta, directions)
    assert len(rows.shift) == 3
    np.testing.assert_array_equal(rows.q, problem.data.q)
    np.testing.assert_array_equal(rows.groups, problem.data.groups())
    chain = error.chain
    np.testing.assert_array_equal(rows.revolute, chain.revolute)
    call = rows.by_joint if space == "joint" else rows.by_tip
    size = len(chain.joints) if space == "joint" else 6
    correction, shift = np.zeros((5, size)), 0.01 * rng.normal(size=3)
    if space == "joint":
        # Twists of the tip do not add up; their derivative is that at zero.
        correction = 0.02 * rng.normal(size=(5, size))
    at = call(correction, shift)
    step = 1e-6

    def difference(by_correction: Floats, by_shift: Floats) -> Floats:
        ahead, behind = (
            call(correction + s * by_correction, shift + s * by_shift).residual
            for s in (step, -step)
        )
        return np.asarray((ahead - behind) / (2.0 * step))

    still = np.zeros_like(correction), np.zeros(3)
    steps = [(np.tile(row, (5, 1)), still[1]) for row in np.eye(size)]
    steps += [(still[0], row) for row in np.eye(3)]
    found = np.stack([difference(*step) for step in steps], axis=2)
    expected = np.concatenate([at.by_correction, at.by_shift], axis=2)
    largest = np.abs(expected).max(axis=(0, 1)) + np.abs(expected).max()
    assert (np.abs(found - expected) <= 2e-7 * largest).all()
    # Nothing learned leaves the residual of the problem.
    plain = call(*still).residual
    expected = problem.blocks[0].table(problem.errors(theta) / problem.sigma)
    np.testing.assert_allclose(plain, expected, rtol=0, atol=1e-9)


@dataclass(frozen=True, kw_only=True)
class Steps(Everywhere):
    """A correction of all joints by one number."""

    memory: Memory

    def __call__(self, q: Floats) -> Floats:
        return np.full_like(q, self.size)

    def left_out(
        self, rows: TrainingRows, masks: list[Any], rng: np.random.Generator
    ) -> list[Self]:
        self.memory.rows.append(rows)
        self.memory.masks.append(masks)
        return super().left_out(rows, masks, rng)


class Memory:
    """A residual model that remembers what it was given."""

    def __init__(self) -> None:
        self.rows: list[TrainingRows] = []
        self.masks: list[list[Any]] = []

    def __call__(
        self, rows: TrainingRows, rng: np.random.Generator, *, progress: Any = None
    ) -> Steps:
        self.rows.append(rows)
        return Steps(0.001, np.zeros(len(rows.shift)), memory=self)


@pytest.fixture
def memory(monkeypatch: pytest.MonkeyPatch) -> Memory:
    result = Memory()
    monkeypatch.setitem(RESIDUAL_MODELS, "memory", result)  # type: ignore[arg-type]
    return result


def test_what_was_learned_is_on_top_of_the_fit(memory: Memory) -> None:
    chain, rows = measured_rows()
    plain = fit_model(chain, rows, OFFSETS_ALONE, 3)
    learned = fit_model(chain, rows, replace(OFFSETS_ALONE, learned="memory"), 3)
    np.testing.assert_array_equal(learned.theta, plain.theta)
    assert learned.problem.only.error.learned is None
    # It learned from what the fit has left, about the fitted frames.
    (given,) = memory.rows
    # Not those that turn the tool, which no position shows.
    assert len(given.shift) == learned.rank
    zero = np.zeros((len(rows), 6)), np.zeros(len(given.shift))
    sigma = plain.problem.sigma
    left = plain.problem.errors(plain.theta) / sigma
    table = plain.problem.blocks[0].table
    np.testing.assert_allclose(
        given.by_joint(*zero).residual, table(left), rtol=0, atol=1e-8
    )
    # And it predicts.
    corrected = given.by_joint(np.full((len(rows), 6), 0.001), zero[1]).residual
    found = fitted_errors(learned, rows)
    before, after = found.before, found.after
    np.testing.assert_allclose(after / table(sigma), corrected, rtol=0, atol=1e-8)
    np.testing.assert_array_equal(before, fitted_errors(plain, rows).before)


def test_left_out_measurements_have_no_part(memory: Memory) -> None:
    """The correction is asked once, and no part of the measurements is fitted."""
    chain, rows = measured_rows(repeats=2)
    model = fit_model(chain, rows, replace(OFFSETS_ALONE, learned="memory"), 7)
    masks = folds(Grouping.of(rows, OFFSETS_ALONE), model, 0)
    parts = left_out(model, masks, 7)
    (given, asked), (found,) = memory.rows, memory.masks
    np.testing.assert_array_equal(given.q, asked.q)
    np.testing.assert_array_equal(found, masks)
    whole = fitted_errors(model, rows)
    for part, mask in zip(parts, masks, strict=True):
        assert part is not None
        np.testing.assert_array_equal(part.positions, np.flatnonzero(mask))
        # The geometry stands on that of the fit: what is learned is its own matter.
        np.testing.assert_allclose(part.after, whole.after[mask], rtol=0, atol=1e-8)
        # Base and tool of the nominal robot are those of the others.
        assert np.abs(part.before).mean() > np.abs(whole.before[mask]).mean()
