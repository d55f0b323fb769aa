"""Very many rows, chunk by chunk, against the plain rows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.exact import exact_problem
from calib_pin.compiled.blocks import BLOCK
from calib_pin.compiled.threads import Threads
from calib_pin.estimation.fit import fit
from calib_pin.estimation.fitted import Fit, with_prior
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.many_rows import ManyRows
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.solve import PopulationCost
from calib_pin.io.urdf import load_chain
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import MEASUREMENT_MODELS
from calib_pin.measurement_models.position import Position
from calib_pin.observations import Conditions, Labels, Observations
from calib_pin.setup import (
    CameraSetup,
    FrameSetup,
    Payload,
    PlaneSetup,
    PointSetup,
    Setup,
)
from calib_pin.solvers import Status
from tests.residual_models.corrections import Wave
from tests.shared import FRAMED, chain_of, measured, simulated, urdf_of

Measured = Callable[..., Problem]

# Rows that are relative to others never come here.
MODELS = [name for name in MEASUREMENT_MODELS if name != "relative-distance"]
KINDS = ("placement", "transmission", "compliance")
CHUNK = 2 * BLOCK
ROWS = 2 * CHUNK + BLOCK + 3

LOADS = {"light": Payload(1.0, (0.1, 0.0, 0.0)), "heavy": Payload(9.0, (0.0, 0.2, 0.1))}
"""What the robot carries in turn, beside nothing."""

STATED = {"payloads": LOADS, "gear_ratios": {"*": -31.5}, "gravity": (1.0, -2.0, -9.5)}


def reweighted(problem: Problem, weight: Floats) -> Problem:
    """The problem with other weights of its measurements, shape (N,)."""
    return replace(problem, data=problem.data.weighted(weight))


@pytest.fixture(autouse=True)
def small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Some hundred rows make several chunks."""
    monkeypatch.setattr("calib_pin.estimation.many_rows.CHUNK", CHUNK)


@pytest.fixture(scope="module")
def geared() -> Measured:
    """Problem whose rows carry one payload after the other: `geared(chain, model)`.

    Joints come from either side, or nobody knows from where.
    """

    def make(
        chain: Chain, model: str, rows: int = ROWS, kinds: Sequence[str] = KINDS
    ) -> Problem:
        problem = measured(chain, model, kinds, rows, **STATED)
        names = [("light", "none", "heavy")[k % 3] for k in range(rows)]
        shape = problem.data.q.shape
        sides = np.random.default_rng(4).integers(-1, 2, shape).astype(np.int8)
        held = Conditions(Labels.of(names), sides)
        data = replace(problem.data.only, conditions=held)
        return replace(problem, data=Observations.of(data))

    return make


def many(problem: Problem) -> ManyRows:
    (block,) = problem.blocks
    return ManyRows(block, problem.sigma)


def through_kernels(problem: Problem, monkeypatch: pytest.MonkeyPatch) -> Problem:
    """The same problem, whose rows just suffice for the kernels."""
    entries = len(problem.sigma) * len(problem.parameters)
    monkeypatch.setattr("calib_pin.estimation.problem.MANY", entries)
    return replace(problem)


def values_of(problem: Problem, size: float = 1.0) -> Floats:
    """Errors of so many times their expected sizes, frames a little off."""
    rng = np.random.default_rng(1)
    unit = np.where(problem.parameters.nuisance, 0.02, size * problem.parameters.scales)
    return np.asarray(unit * rng.normal(size=len(unit)))


def rounding(problem: Problem, theta: Floats) -> Floats:
    """What rounding of poses, of meters and radians, leaves of every error, (M,)."""
    found = []
    for term, data, _, _ in problem.blocks:
        instrument = term.values(theta)[1]
        T = term.poses(theta, data)
        J_pose = term.measurement.linearize(T, instrument, data).J_pose
        found.append(np.maximum(1.0, np.linalg.norm(J_pose, axis=2)).reshape(-1))
    return np.asarray(1e-13 * np.concatenate(found))


def assert_same_products(found: Floats, rows: tuple[Floats, Floats]) -> None:
    """Products of columns, relative to the lengths of these."""
    A = np.column_stack([rows[1], rows[0]])
    unit = np.linalg.norm(A, axis=0)
    unit[unit == 0.0] = 1.0
    np.testing.assert_allclose(
        found / np.outer(unit, unit), (A / unit).T @ (A / unit), rtol=0, atol=1e-11
    )


def assert_same(problem: Problem, theta: Floats) -> None:
    """Errors and factors of all blocks, by kernels and plain."""
    assert not problem.many
    chunked = many(problem)
    off = np.abs(chunked.errors(theta).reshape(-1) - problem.errors(theta))
    assert (off <= rounding(problem, theta)).all()
    (plain,) = problem.factorize(theta)
    r, J = chunked.factorize(theta)
    A = np.column_stack([J, r])
    assert len(A) <= A.shape[1]
    assert_same_products(A.T @ A, plain)


@pytest.mark.parametrize(
    ("model", "rows"),
    [
        *((model, ROWS) for model in MODELS),
        *(("position", rows) for rows in (1, BLOCK, CHUNK - 1, CHUNK, CHUNK + 1)),
    ],
)
def test_the_same_as_row_by_row(
    model: str, rows: int, geared: Measured, special_chain: Chain
) -> None:
    """At nominal motions, near them, and tenths of a radian away.

    Also of joints that shift, run backward, or follow others, from either side.
    """
    problem = geared(load_chain("space6"), model, rows)
    size = (0.0, 1.0, 100.0)[MODELS.index(model) % 3]
    assert_same(problem, values_of(problem, size))
    if model == "pose":
        problem = geared(special_chain, model, rows, (*KINDS, "hysteresis"))
        assert_same(problem, values_of(problem))


@pytest.mark.parametrize("model", ["pose", "point-distance"])
def test_the_number_of_threads_changes_no_bit(
    model: str, geared: Measured, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = geared(load_chain("space6"), model)
    theta = values_of(problem)

    def computed(count: int) -> list[bytes]:
        monkeypatch.setattr(
            "calib_pin.estimation.many_rows.Threads", lambda: Threads(count)
        )
        chunked = many(problem)
        arrays = [*chunked.factorize(theta), chunked.errors(theta)]
        return [array.tobytes() for array in arrays]

    assert computed(1) == computed(3)


def test_factors_resolve_what_one_noisy_row_sees() -> None:
    """A joint stands still in all rows but one, which says next to nothing."""
    problem = measured(load_chain("space6"), "position", ["placement", "dh"], 300)
    data = problem.data.only
    q, sigma = data.q.copy(), problem.blocks[0].table(problem.sigma).copy()
    q[:, 2], q[150, 2] = 0.3, -0.9
    sigma[150] *= 1e7
    problem = replace(problem, data=Observations.of(replace(data, q=q, sigma=sigma)))
    theta = np.zeros(len(problem.parameters))

    def singular_values(J: Floats) -> Floats:
        s = np.linalg.svd(J * problem.parameters.scales, compute_uv=False)
        return np.asarray(s / s[0])

    expected = singular_values(problem.linearize(theta)[1])
    # Its squares are below the rounding of normal equations.
    assert ((expected > 1e-12) & (expected < 1e-9)).any()
    found = singular_values(many(problem).factorize(theta)[1])
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=2e-14)


# What goes through the kernels, and what does not.


def test_what_kernels_do_not_know_goes_row_by_row(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """However many rows there are; also where the fit without it did not."""
    relative = measured(load_chain("space6"), "relative-distance", ["placement"], 300)
    assert not through_kernels(relative, monkeypatch).many
    plain = measured(load_chain("space6"), "pose", ["placement"], 30)
    theta, term = values_of(plain), plain.only
    error = replace(term.error, learned=Wave(shift=np.zeros(len(term.error.screws))))
    terms = {term.key: replace(term, error=error)}
    few = through_kernels(plain, monkeypatch)
    learned = replace(few, terms=terms)
    assert few.many and not learned.many
    expected = replace(plain, terms=terms).errors(theta)
    np.testing.assert_array_equal(learned.errors(theta), expected)
    assert np.abs(expected - plain.errors(theta)).max() > 1e-3


@pytest.mark.parametrize("kernels", [True, False])
def test_other_weights_and_references_are_those_of_a_new_problem(
    kernels: bool, geared: Measured, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Though what was prepared for the old one is used again."""
    problem = geared(load_chain("space6"), "point-distance")
    if kernels:
        problem = through_kernels(problem, monkeypatch)
    theta = values_of(problem)
    weight = np.random.default_rng(0).uniform(0.1, 1.0, len(problem.data))
    weight[::7] = 0.0
    ((_, before),) = problem.factorize(theta)
    for changed, values in (
        (reweighted(problem, weight), theta),
        problem.rebased(theta),
        (reweighted(reweighted(problem, weight), np.ones(len(weight))), theta),
    ):
        ((_, found),) = changed.factorize(values)
        ((_, expected),) = replace(changed, _known=None).factorize(values)
        np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(found, before)
    ((_, weighted),) = reweighted(problem, weight).factorize(theta)
    assert np.abs(weighted - found).max() > 1.0


def test_what_is_set_aside_may_be_impossible(
    geared: Measured, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of every chunk the fifth row."""
    problem = geared(load_chain("space6"), "plane-distance")
    problem = through_kernels(problem, monkeypatch)
    theta, kind = values_of(problem), type(problem.only.measurement)
    linearize = kind.linearize

    def broken(*arguments: Any) -> object:
        found = linearize(*arguments)
        found.residual[5] = found.J_pose[5] = np.nan
        return found

    monkeypatch.setattr(kind, "linearize", broken)
    assert np.isnan(problem.cost(theta))
    weight = np.ones(len(problem.data))
    weight[5::CHUNK] = 0.0
    aside = reweighted(problem, weight)
    assert np.isfinite(aside.cost(theta))
    assert all(np.isfinite(part).all() for part in aside.linearize(theta))


def test_short_steps_are_linear(geared: Measured) -> None:
    """What is left of residuals is of the square of the step."""
    problem = geared(load_chain("space6"), "position")
    theta, rows = values_of(problem), many(problem)
    first, J = rows.factorize(theta)
    rng = np.random.default_rng(2)
    near = 0.1 * np.minimum(1e-3, problem.parameters.scales)
    step = rng.uniform(-1.0, 1.0, len(theta)) * near
    r, same = rows.factorize(theta + step)
    assert same is J and not np.array_equal(r, first)
    change = float(np.linalg.norm(J @ step))
    exact, _ = many(problem).factorize(theta + step)
    assert abs(np.linalg.norm(r) - np.linalg.norm(exact)) < 1e-3 * change
    # Farther away it is linearized anew.
    assert rows.factorize(theta + 10.0 * near)[1] is not J


# Whole fits.

CASES = {
    "prior": ("position", Setup(prior={"*.placement.*": 1e-3}), 100),
    "bound": ("position", Setup(bounds={"joint_2.placement.*": 1e-4}), 10_000),
    "fixed": ("pose", Setup(fixed=("joint_2.*", "base.frame.z")), 100),
}


@pytest.mark.parametrize("case", CASES)
def test_a_fit_of_very_many_rows(case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """With and without a first fit to a sample, linearized at every step."""
    monkeypatch.setattr("calib_pin.estimation.many_rows.NEAR", 0.0)
    model, setup, sample = CASES[case]
    monkeypatch.setattr("calib_pin.estimation.solve.SAMPLE", sample)
    free = replace(setup, prior={}, bounds={}, fixed=())
    job, _ = simulated(model, free, CHUNK + 70, 1.0, seed=1, noise=1e-4)
    problem = replace(nominal_problem(job.chains, model, setup), data=job.data)

    plain = fit(problem, np.random.default_rng(0))
    found = fit(through_kernels(problem, monkeypatch), np.random.default_rng(0))
    assert plain.result.evaluator == "pinocchio"
    assert found.result.evaluator == "kernel"
    for one in (plain, found):
        assert one.result.status is Status.CONVERGED
        assert bool(one.problem.held_at) == (case == "bound")
    assert found.problem.held_at == plain.problem.held_at
    assert counts(found) == counts(plain)
    # What is least is the cost with the rows of the prior: that of the rows alone has
    # a gradient there.
    assert least(found) == pytest.approx(least(plain), rel=1e-9)
    np.testing.assert_allclose(found.problem.units, plain.problem.units, rtol=1e-8)
    # The last step may promise 1e-12 of the cost, some 5e-5 standard deviations.
    deviations = np.sqrt(np.diag(plain.covariance))
    assert np.all(np.abs(found.theta - plain.theta) < 1e-3 * deviations + 1e-12)
    largest = np.abs(plain.covariance).max()
    assert np.abs(found.covariance - plain.covariance).max() < 1e-6 * largest


def least(found: Fit) -> float:
    """The cost of a solution, the prior included."""
    _, result, _ = with_prior(found)
    return 0.5 * float(result.fun @ result.fun)


def counts(found: Fit) -> tuple[int, ...]:
    """Ranks, degrees of freedom, directions that moved, and those that did not."""
    directions = found.directions
    rank = found.structure.rank
    return rank, found.rank, found.dof, directions.count, directions.weak.shape[1]


PRIOR = {"joint_2.*": 1e-3}
BENDING = ("placement", "compliance", "cross-compliance")
LOAD = {"load": Payload(2.0, (0.05, -0.1, 0.2))}


class Unbatched(Position):
    """A measurement model that no kernel knows."""

    batches = None  # type: ignore[assignment]


def members(problem: Problem, count: int) -> Floats:
    """Random parameters, the nominal ones among them."""
    shape = count, len(problem.parameters)
    theta = 0.02 * np.random.default_rng(1).normal(size=shape)
    theta[-1] = 0.0
    return np.asarray(theta)


def assert_costs(problem: Problem, theta: Floats, evaluator: str = "kernel") -> Floats:
    """The costs, which are those of the members."""
    costs = PopulationCost(problem)
    assert costs.evaluator == evaluator
    found = costs(theta)
    expected = [problem.cost(member) for member in theta]
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=0)
    return found


@pytest.mark.parametrize("model", MEASUREMENT_MODELS)
def test_every_model_and_kind_of_correction(model: str) -> None:
    """Every member moves the joints in its own way, some of them far."""
    odd = sorted(MEASUREMENT_MODELS).index(model) % 2
    kinds = ["dh", "transmission"] if odd else ["placement", "compliance"]
    given: dict[str, Any] = {"payloads": FRAMED.payloads}
    given["gear_ratios"] = FRAMED.gear_ratios
    bare, problem = (
        measured(load_chain("space6"), model, kinds, 40, **given, prior=prior)
        for prior in ({}, PRIOR)
    )
    theta = members(problem, 4)
    corrected = problem.only.index[problem.only.error.joint_corrections]
    theta[1, corrected] *= 30.0
    found = assert_costs(problem, theta)
    rows = problem.further.residual(theta)
    assert rows.shape[1] > 4
    added = found - PopulationCost(bare)(theta)
    expected = 0.5 * np.sum(rows**2, axis=1)
    np.testing.assert_allclose(added, expected, rtol=0, atol=1e-9 * found.max())
    # The corrections do something.
    theta[:, corrected] = 0.0
    assert (np.abs(PopulationCost(problem)(theta) - found)[:-1] > 1.0).all()


@pytest.mark.parametrize("mount", ["hand", "world"])
def test_cameras_on_the_hand_and_beside_the_robot(mount: str) -> None:
    """Points are carried into one beside the robot; one on the hand has no kernel."""
    chain, rng = load_chain("space6"), np.random.default_rng(0)
    q = chain.random_configurations(1, rng) + 0.1 * rng.normal(size=(30, 6))
    seen = chain.poses(q[:1])[0] @ np.array([0.0, 0.0, 4.0, 1.0])
    led = (0.03, -0.02, 0.05) if mount == "world" else tuple(seen[:3])
    base = FrameSetup((0.1, -0.2, 4.0), (np.pi, 0.1, 0.2), estimate=True)
    setup = Setup(
        camera=CameraSetup(mount, focal=(900.0, 900.0), center=(640.0, 480.0)),
        base_frame=base if mount == "world" else FrameSetup(),
        targets={"led": PointSetup(led)},
    )
    problem = nominal_problem(chain, "camera", setup)
    zero = np.zeros(len(problem.parameters))
    rows = exact_problem(problem, zero, q, ("led",) * 30).data
    evaluator = "kernel" if mount == "world" else "loop"
    assert_costs(replace(problem, data=rows), 0.1 * members(problem, 4)[:3], evaluator)


def test_what_no_kernel_knows_is_evaluated_in_a_loop() -> None:
    """Models without a batch form, what was learned, and places that bend."""
    problem = measured(load_chain("space6"), "position", ["placement"], 40, prior=PRIOR)
    theta, term = members(problem, 3), problem.only
    plain = PopulationCost(problem)(theta)
    unbatched = replace(
        problem, terms={term.key: replace(term, measurement=Unbatched())}
    )
    found = assert_costs(unbatched, theta, "loop")
    np.testing.assert_allclose(found, plain, rtol=1e-10)
    learned = replace(term, error=replace(term.error, learned=Wave()))
    found = assert_costs(replace(problem, terms={term.key: learned}), theta, "loop")
    assert np.abs(found - plain).min() > 1.0
    bending = measured(load_chain("space6"), "pose", BENDING, 20, payloads=LOAD)
    assert_costs(bending, members(bending, 2), "loop")


@pytest.mark.parametrize("offset", [-1.0, 0.0])
def test_a_beam_along_the_plane(offset: float) -> None:
    """The distance is infinite, or 0/0 in the plane: no exception, no warning."""
    chain = chain_of(urdf_of({"name": "j", "parent": "a", "child": "b"}))
    setup = Setup(
        parameters=("placement",),
        base_frame=FrameSetup(estimate=False),
        planes={"wall": PlaneSetup((1.0, 0.0, 0.0), offset)},
    )
    problem = nominal_problem(chain, "plane-distance", setup)
    rows = problem.data.only.rows(np.zeros(3, int))
    data = Observations.of(replace(rows, values=np.ones((3, 1))))
    problem = replace(problem, data=data)
    # The beam runs along z until the second member tilts it.
    tilted = problem.parameters.vector({"tool.frame.ry": 0.5, "j.placement.x": 0.1})
    found = PopulationCost(problem)(np.array([0.0 * tilted, tilted, 0.0 * tilted]))
    assert not np.isfinite(found[[0, 2]]).any()
    assert found[1] == pytest.approx(problem.cost(tilted), rel=1e-10)
