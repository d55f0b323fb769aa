"""Very many rows, chunk by chunk, against the plain rows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.compiled.blocks import BLOCK
from calib_pin.compiled.threads import Threads
from calib_pin.estimation.elimination import square_root
from calib_pin.estimation.fit import fit
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.many_rows import ManyRows
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.solve import least_squares
from calib_pin.io.urdf import load_chain
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import MEASUREMENT_MODELS
from calib_pin.observations import Observations
from calib_pin.setup import PlaneSetup, Setup
from calib_pin.solvers import Status

Measured = Callable[..., Problem]

# Rows that are relative to others never come here.
MODELS = [name for name in MEASUREMENT_MODELS if name != "relative-distance"]
FREE = ("position", "pose", "plane-distance")
"""Models whose rows need not name anything."""

CHUNK = 2 * BLOCK
SIZES = (1, BLOCK, CHUNK - 1, CHUNK, CHUNK + 1, 2 * CHUNK + BLOCK + 3)


@pytest.fixture(autouse=True)
def small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Some hundred rows make several chunks."""
    monkeypatch.setattr("calib_pin.estimation.many_rows.CHUNK", CHUNK)


def many(problem: Problem) -> ManyRows:
    return ManyRows(problem.blocks, problem.sigma)


def for_a_step(rows: ManyRows, theta: Floats) -> tuple[Floats, Floats]:
    """Residual and Jacobian from the products of columns."""
    (K,) = rows.normal(theta)
    return square_root((np.arange(len(K)), K), len(theta))


def parameters_of(problem: Problem) -> Floats:
    size = len(problem.parameters)
    return 0.02 * np.random.default_rng(1).normal(size=size)


def rounding(problem: Problem) -> float:
    """What errors of meters are exact to, and errors of pixels."""
    return 1e-13 * max(1.0, np.abs(problem.data.only.values).max(initial=0.0))


def assert_same_system(
    rows: tuple[Floats, Floats], reduced: tuple[Floats, Floats], tolerance: float
) -> None:
    """The same normal equations in no more rows than there are columns."""
    A, B = (np.column_stack([J, r]) for r, J in (rows, reduced))
    assert B.shape[1] == A.shape[1] and len(B) <= B.shape[1]
    unit = np.linalg.norm(A, axis=0)
    unit[unit == 0.0] = 1.0
    A, B = A / unit, B / unit
    np.testing.assert_allclose(B.T @ B, A.T @ A, rtol=0, atol=tolerance)


# The rows.


@pytest.mark.parametrize(
    ("model", "rows"),
    [
        (model, rows)
        for model in MODELS
        for rows in (SIZES if model in FREE else SIZES[-1:])
    ],
)
def test_any_number_of_rows(model: str, rows: int, measured: Measured) -> None:
    problem = measured(load_chain("space6"), model, ["placement", "dh"], rows)
    assert not problem.many
    theta = parameters_of(problem)
    chunked = many(problem)
    errors = np.concatenate(chunked.errors(theta)).reshape(-1)
    exact = rounding(problem)
    np.testing.assert_allclose(errors, problem.errors(theta), rtol=0, atol=exact)
    # Half a sum of squares, each of a residual that is exact to so much.
    lost = np.abs(problem.residual(theta)) @ (exact / problem.sigma)
    cost = pytest.approx(problem.cost(theta), rel=1e-13, abs=float(lost))
    assert 0.5 * chunked.square(theta) == cost

    assert_same_system(problem.linearize(theta), for_a_step(chunked, theta), 1e-11)
    (exact,) = chunked.factorize(theta)
    assert_same_system(problem.linearize(theta), exact, 1e-12)


@pytest.mark.parametrize("model", MODELS)
def test_the_number_of_threads_changes_no_bit(
    model: str, measured: Measured, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = measured(load_chain("space6"), model, ["placement"], SIZES[-1])
    theta = parameters_of(problem)

    def computed(count: int) -> list[bytes]:
        monkeypatch.setattr(
            "calib_pin.estimation.many_rows.Threads", lambda: Threads(count)
        )
        chunked = many(problem)
        arrays = [chunked.normal(theta), *chunked.factorize(theta)[0]]
        arrays += [*chunked.errors(theta), np.array(chunked.square(theta))]
        return [array.tobytes() for array in arrays]

    assert computed(1) == computed(2) == computed(3)


# Ranks.


@pytest.mark.parametrize(
    ("model", "ratio"), [("position", 1e9), ("pose", 1e9), ("plane-distance", 1e6)]
)
def test_triangular_resolves_what_one_noisy_row_sees(
    model: str, ratio: float, measured: Measured
) -> None:
    """A joint stands still in all rows but one, which says next to nothing."""
    problem = measured(load_chain("space6"), model, ["placement", "dh"], 700)
    data = problem.data.only
    q, sigma = data.q.copy(), problem.blocks[0].table(problem.sigma).copy()
    q[:, 2], q[350, 2] = 0.3, -0.9
    sigma[350] *= ratio
    data = replace(data, q=q, sigma=sigma)
    problem = replace(problem, data=Observations.of(data))
    theta = np.zeros(len(problem.parameters))
    chunked = many(problem)

    def singular_values(J: Floats) -> Floats:
        s = np.linalg.svd(J * problem.parameters.scales, compute_uv=False)
        return np.asarray(s / s[0])

    _, J = problem.linearize(theta)
    expected = singular_values(J)
    faint = (expected > 5e-15) & (expected < 1e-12)
    assert faint.any() and (expected < 1e-16).any()
    found = singular_values(chunked.factorize(theta)[0][1])
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=2e-15)
    # The normal equations have lost it, and say so by zeros.
    found = singular_values(for_a_step(chunked, theta)[1])
    assert found[expected < 1e-12].max() < 1e-16
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)


# Dispatch.


def through_kernels(problem: Problem, monkeypatch: pytest.MonkeyPatch) -> Problem:
    """The same problem, whose rows just suffice for the kernels."""
    entries = len(problem.sigma) * len(problem.parameters)
    monkeypatch.setattr("calib_pin.estimation.problem.MANY", entries)
    return replace(problem)


@pytest.mark.parametrize("model", MODELS)
def test_problems_with_very_many_rows(
    model: str, measured: Measured, monkeypatch: pytest.MonkeyPatch
) -> None:
    prior = {"joint_2.placement.*": 1e-3}
    chain = load_chain("space6")
    plain = measured(chain, model, ["placement"], 300, prior=prior)
    assert not plain.many
    chunked = through_kernels(plain, monkeypatch)
    assert chunked.many
    assert not replace(plain, data=plain.data.rows(np.arange(299))).many

    theta = parameters_of(plain)
    errors = plain.errors(theta)
    exact = rounding(plain)
    np.testing.assert_allclose(chunked.errors(theta), errors, rtol=0, atol=exact)
    assert chunked.cost(theta) == pytest.approx(plain.cost(theta), rel=1e-13)
    np.testing.assert_allclose(
        chunked.residual(theta), plain.residual(theta), rtol=0, atol=1e3 * exact
    )
    # The priors stand behind the rest, once.
    bare = measured(chain, model, ["placement"], 300)
    for r, J in (chunked.linearize(theta), chunked.factorize(theta)):
        np.testing.assert_allclose(r[-6:], plain.further.residual(theta), rtol=1e-15)
        np.testing.assert_array_equal(J[-6:], plain.linearize(theta)[1][-6:])
        assert_same_system(bare.linearize(theta), (r[:-6], J[:-6]), 1e-11)


def test_rows_relative_to_others_go_row_by_row(
    measured: Measured, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = measured(load_chain("space6"), "relative-distance", ["placement"], 300)
    assert not through_kernels(plain, monkeypatch).many


def test_few_rows_are_not_reduced(measured: Measured) -> None:
    problem = measured(load_chain("space6"), "position", ["placement"], 300)
    theta = parameters_of(problem)
    pairs = zip(problem.factorize(theta), problem.linearize(theta), strict=True)
    for found, expected in pairs:
        np.testing.assert_array_equal(found, expected)


def test_a_beam_along_the_plane_is_no_start(
    urdf_of: Callable[..., str],
    chain_of: Callable[..., Chain],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    chain = chain_of(urdf_of({"name": "j", "parent": "a", "child": "b"}))
    setup = Setup(planes={"wall": PlaneSetup((1.0, 0.0, 0.0), -1.0)})
    problem = nominal_problem(chain, "plane-distance", setup)
    rows = problem.data.only.rows(np.zeros(300, int))
    data = Observations.of(replace(rows, values=np.ones((300, 1))))
    problem = replace(problem, data=data)
    problem = through_kernels(problem, monkeypatch)
    size = len(problem.parameters)
    result = least_squares(problem, np.zeros(size), np.eye(size))
    assert result.status is Status.NOT_FINITE


RANGER, POSES = (
    calib_pin.read_setup(calib_pin.robot_file(robot, "setup.yaml"))
    for robot in ("space6", "space7")
)
CASES = {
    "position": ("space6", "position", Setup()),
    "pose": ("space7", "pose", POSES),
    "plane-distance": ("space6", "plane-distance", RANGER),
    "prior": ("space6", "position", Setup(prior={"*.placement.*": 1e-3})),
    "bound": ("space6", "position", Setup(bounds={"*.placement.*": 5e-4})),
    "gears": (
        "pa10",
        "pose",
        Setup(parameters=("placement", "transmission", "compliance")),
    ),
    "fixed": ("space6", "pose", Setup(fixed=("joint_2.*", "base.frame.z"))),
}


@pytest.mark.parametrize("sample", [100, 10_000])
@pytest.mark.parametrize("case", CASES)
def test_a_fit_of_very_many_rows(
    case: str, sample: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With and without a first fit to a sample of the rows."""
    monkeypatch.setattr("calib_pin.estimation.solve.SAMPLE", sample)
    robot, model, setup = CASES[case]
    chain = load_chain(robot, tip=setup.tip)
    rng = np.random.default_rng(1)
    free = nominal_problem(chain, model, replace(setup, prior={}, bounds={}, fixed=()))
    truth = calib_pin.draw_errors(free.parameters, rng)
    rows = calib_pin.simulate(free, truth, rng, count=700, noise=1e-4)
    problem = replace(nominal_problem(chain, model, setup), data=rows)

    plain = fit(problem, np.random.default_rng(0))
    found = fit(through_kernels(problem, monkeypatch), np.random.default_rng(0))
    assert (plain.solution.evaluator, found.solution.evaluator) == (
        "pinocchio",
        "kernel",
    )
    for one in (plain, found):
        assert one.result.status is Status.CONVERGED
        assert bool(one.problem.held_at) == (case == "bound")
    assert found.problem.held_at == plain.problem.held_at
    assert found.structure.rank == plain.structure.rank
    assert counts(found) == counts(plain)
    # What is least is the cost with the rows of the prior: that of the rows alone has
    # a gradient there.
    assert least(found) == pytest.approx(least(plain), rel=1e-11)
    assert sizes(found) == sizes(plain)
    np.testing.assert_allclose(found.problem.units, plain.problem.units, rtol=1e-9)
    # Ranks and covariance come from the factor that loses nothing.
    # A common unit weight comes by conversion.
    units = found.problem.units
    common = units[0] if (units == units[0]).all() else 1.0
    given = replace(found.problem, units=units / common)
    _, J = given.factorize(found.theta)
    np.testing.assert_array_equal(found.result.jac, J / common)
    # The last step may promise 1e-12 of the cost, some 5e-5 standard deviations.
    deviations = np.sqrt(np.diag(plain.covariance))
    assert np.all(np.abs(found.theta - plain.theta) < 1e-4 * deviations + 1e-12)
    largest = np.abs(plain.covariance).max()
    assert np.abs(found.covariance - plain.covariance).max() < 1e-6 * largest
    np.testing.assert_allclose(found.singular_values, plain.singular_values, rtol=1e-8)


def sizes(found: Fit) -> list[float]:
    return [] if found.evidence is None else found.evidence.expected.sizes.tolist()


def least(found: Fit) -> float:
    """The cost of a solution, the prior included."""
    _, result, _ = found.held
    return 0.5 * float(result.fun @ result.fun)


def counts(found: Fit) -> tuple[int, int, int, int]:
    """Rank, degrees of freedom, directions that moved, and those that did not."""
    directions = found.directions
    return found.rank, found.dof, directions.count, directions.weak.shape[1]
