"""Joint corrections of very many rows, chunk by chunk, against the plain rows."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import pytest

from calib_pin.compiled.blocks import BLOCK
from calib_pin.compiled.threads import Threads
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.many_rows import ManyRows
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.variants import reweighted
from calib_pin.io.urdf import load_chain
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import MEASUREMENT_MODELS
from calib_pin.observations import BlockKey, Conditions, Labels, Observations
from calib_pin.setup import FrameSetup, Payload, Setup, ToolSetup
from calib_pin.simulation import draw_errors, simulate

Measured = Callable[..., Problem]

# Rows that are relative to others never come here.
MODELS = [name for name in MEASUREMENT_MODELS if name != "relative-distance"]
KINDS = ("placement", "transmission", "compliance")

CHUNK = 2 * BLOCK
ROWS = 2 * CHUNK + BLOCK + 3

LOADS = {"light": Payload(1.0, (0.1, 0.0, 0.0)), "heavy": Payload(9.0, (0.0, 0.2, 0.1))}
"""What the robot carries in turn, beside nothing."""

STATED = {"payloads": LOADS, "gear_ratios": {"*": -31.5}, "gravity": (1.0, -2.0, -9.5)}


@pytest.fixture(autouse=True)
def small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Some hundred rows make several chunks."""
    monkeypatch.setattr("calib_pin.estimation.many_rows.CHUNK", CHUNK)


@pytest.fixture(scope="module")
def geared(measured: Measured) -> Measured:
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
    return ManyRows(problem.blocks, problem.sigma)


def values_of(problem: Problem, size: float) -> Floats:
    """Errors of so many times their expected sizes, frames a little off."""
    rng = np.random.default_rng(1)
    unit = np.where(problem.parameters.nuisance, 0.02, size * problem.parameters.scales)
    return np.asarray(unit * rng.normal(size=len(unit)))


def rounding(problem: Problem, theta: Floats) -> Floats:
    """What rounding of poses, of meters and radians, leaves of every error, (M,)."""
    found = []
    for part, data, _, _ in problem.blocks:
        instrument = part.values(theta)[1]
        T = part.poses(theta[part.index], data)
        J_pose = part.measurement.linearize(T, instrument, data).J_pose
        found.append(np.maximum(1.0, np.linalg.norm(J_pose, axis=2)).reshape(-1))
    return np.asarray(1e-13 * np.concatenate(found))


def assert_same_products(
    found: Floats, rows: tuple[Floats, Floats], atol: float
) -> None:
    """Products of columns, relative to the lengths of these."""
    A = np.column_stack([rows[1], rows[0]])
    unit = np.linalg.norm(A, axis=0)
    unit[unit == 0.0] = 1.0
    np.testing.assert_allclose(
        found / np.outer(unit, unit), (A / unit).T @ (A / unit), rtol=0, atol=atol
    )


def assert_same(problem: Problem, theta: Floats) -> None:
    """Errors, costs, products and factors of all blocks, by kernels and plain."""
    assert not problem.many
    chunked = many(problem)
    exact = rounding(problem, theta)
    errors = np.concatenate([e.reshape(-1) for e in chunked.errors(theta)])
    assert (np.abs(errors - problem.errors(theta)) <= exact).all()
    lost = np.abs(problem.residual(theta)) @ (exact / problem.sigma)
    cost = pytest.approx(problem.cost(theta), rel=1e-13, abs=float(lost))
    assert 0.5 * chunked.square(theta) == cost
    plain = [one.factorize(theta)[0] for one in problem.evaluators]
    products, factors = chunked.normal(theta), chunked.factorize(theta)
    for K, (r, J), rows in zip(products, factors, plain, strict=True):
        assert_same_products(K, rows, 1e-11)
        A = np.column_stack([J, r])
        assert len(A) <= A.shape[1]
        assert_same_products(A.T @ A, rows, 1e-12)


# The rows.


@pytest.mark.parametrize("size", [0.0, 1.0, 100.0])
@pytest.mark.parametrize("model", MODELS)
def test_the_same_as_row_by_row(model: str, size: float, geared: Measured) -> None:
    """At nominal motions, near them, and tenths of a radian away."""
    problem = geared(load_chain("space6"), model)
    names = problem.parameters.names
    for kind in KINDS[1:]:
        assert any(f".{kind}." in name for name in names)
    assert_same(problem, values_of(problem, size))


def test_sides_of_the_joints(special_chain: Chain, geared: Measured) -> None:
    kinds = ("placement", "hysteresis")
    problem = geared(special_chain, "position", ROWS, kinds)
    corrections = problem.only.error.joint_corrections
    assert len(corrections) >= len(special_chain.joints) - 1
    assert_same(problem, values_of(problem, 1.0))


def test_joints_of_any_kind(special_chain: Chain, geared: Measured) -> None:
    """Also those that shift, run backward, or follow others."""
    problem = geared(special_chain, "pose")
    assert_same(problem, values_of(problem, 1.0))


def test_every_correction_counts(geared: Measured) -> None:
    """Against differences: none is read from the column of another."""
    problem = geared(load_chain("space6"), "position", 40)
    theta = values_of(problem, 1.0)
    r, J = many(problem).factorize(theta)[0]
    gradient = J.T @ r
    (block,) = problem.blocks
    chunked = many(problem)
    for k in block.part.error.joint_corrections:
        step = 1e-4 * problem.parameters.scales[k] * np.eye(len(theta))[k]
        ahead, behind = chunked.square(theta + step), chunked.square(theta - step)
        expected = (ahead - behind) / (4.0 * step[k])
        # The third derivative, by the length of the column.
        allowed = 1e-6 * np.linalg.norm(J[:, k]) * np.linalg.norm(r)
        assert gradient[k] == pytest.approx(expected, abs=allowed)


@pytest.mark.parametrize("model", ["position", "pose"])
def test_several_stations(model: str) -> None:
    """One stream of measurements, of which each station has its products."""
    stations = {
        name: FrameSetup((x, 1.0 - x, 0.2), (0.1, x, 2.0 * x))
        for name, x in (("a", 0.4), ("b", -0.9), ("c", 1.3))
    }
    setup = Setup(
        parameters=KINDS,
        stations=stations,
        tools={"short": ToolSetup((0.05, 0.03, 0.1))},
        payloads={"light": LOADS["light"]},
    )
    keys = [BlockKey(model, "", station, "short") for station in stations]
    problem = nominal_problem(load_chain("space6"), keys, setup)
    rng = np.random.default_rng(4)
    truth = draw_errors(problem.parameters, rng)
    # Blocks end within chunks, and chunks within blocks.
    data = simulate(problem, truth, rng, count=3 * CHUNK + 50, noise=1e-3)
    problem = replace(problem, data=data)
    assert len(problem.blocks) == 3
    assert_same(problem, truth)


@pytest.mark.parametrize("model", MODELS)
def test_the_number_of_threads_changes_no_bit(
    model: str, geared: Measured, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = geared(load_chain("space6"), model)
    theta = values_of(problem, 1.0)

    def computed(count: int) -> list[bytes]:
        monkeypatch.setattr(
            "calib_pin.estimation.many_rows.Threads", lambda: Threads(count)
        )
        chunked = many(problem)
        arrays = [chunked.normal(theta), *chunked.factorize(theta)[0]]
        arrays += [*chunked.errors(theta), np.array(chunked.square(theta))]
        return [array.tobytes() for array in arrays]

    assert computed(1) == computed(2) == computed(3)


# What is prepared once.


def in_kernels(problem: Problem, monkeypatch: pytest.MonkeyPatch) -> Problem:
    """The same problem with very many rows."""
    monkeypatch.setattr("calib_pin.estimation.problem.MANY", 0)
    result = replace(problem)
    assert result.many
    return result


def prepared(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """A list that grows with every preparation."""
    found: list[int] = []
    prepare = ManyRows.__init__

    def counted(self: ManyRows, blocks: Sequence[object], sigma: Floats) -> None:
        found.append(len(sigma))
        prepare(self, blocks, sigma)  # type: ignore[arg-type]

    monkeypatch.setattr(ManyRows, "__init__", counted)
    return found


def test_other_references_prepare_nothing(
    geared: Measured, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = in_kernels(geared(load_chain("space6"), "point-distance"), monkeypatch)
    theta = values_of(problem, 1.0)
    count = prepared(monkeypatch)
    moved, values = problem.rebased(theta)
    products = moved.products(values)
    assert not count
    (expected,) = many(moved).normal(values)
    assert count
    np.testing.assert_array_equal(products[0][1], expected)
    assert np.abs(products[0][1] - problem.products(values)[0][1]).max() > 1.0


@pytest.mark.parametrize("kernels", [True, False])
def test_other_weights_prepare_nothing(
    kernels: bool, geared: Measured, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = geared(load_chain("space6"), "position")
    if kernels:
        problem = in_kernels(problem, monkeypatch)
    theta = values_of(problem, 1.0)
    weight = np.random.default_rng(0).uniform(0.1, 1.0, len(problem.data))
    weight[::7] = 0.0
    before, count = problem.products(theta), prepared(monkeypatch)
    (found,) = reweighted(problem, weight).products(theta)
    assert not count
    (expected,) = replace(problem, data=problem.data.weighted(weight)).products(theta)
    np.testing.assert_array_equal(found[1], expected[1])
    assert np.abs(found[1] - before[0][1]).max() > 1.0
    # And back again.
    (again,) = reweighted(problem, np.ones(len(weight))).products(theta)
    np.testing.assert_array_equal(again[1], before[0][1])


@pytest.mark.parametrize("kernels", [True, False])
def test_what_is_set_aside_may_be_impossible(
    kernels: bool, geared: Measured, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = geared(load_chain("space6"), "plane-distance")
    if kernels:
        problem = in_kernels(problem, monkeypatch)
    theta = values_of(problem, 1.0)
    residual = type(problem.only.measurement).residual
    linearize = type(problem.only.measurement).linearize

    def broken(values: Floats) -> Floats:
        return np.where(np.arange(len(values))[:, None] == 5, np.nan, values)

    def bad_residual(*arguments: object) -> Floats:
        return broken(residual(*arguments))  # type: ignore[arg-type]

    def bad_linearize(*arguments: object) -> object:
        found = linearize(*arguments)  # type: ignore[arg-type]
        J_pose = np.where(np.isnan(broken(found.residual))[:, :, None], np.nan, 1.0)
        return replace(
            found, residual=broken(found.residual), J_pose=J_pose * found.J_pose
        )

    kind = type(problem.only.measurement)
    monkeypatch.setattr(kind, "residual", bad_residual)
    monkeypatch.setattr(kind, "linearize", bad_linearize)
    assert np.isnan(problem.cost(theta))
    # The fifth row of every chunk.
    weight = np.ones(len(problem.data))
    weight[5::CHUNK] = 0.0
    aside = reweighted(problem, weight)
    assert np.isfinite(aside.cost(theta))
    for call in (aside.linearize, aside.factorize):
        assert all(np.isfinite(part).all() for part in call(theta))


def test_one_solve_begins_where_another_ended(
    geared: Measured, monkeypatch: pytest.MonkeyPatch
) -> None:
    chunked = many(geared(load_chain("space6"), "position"))
    theta = values_of(geared(load_chain("space6"), "position"), 1.0)
    first = chunked.normal(theta)
    assert chunked.normal(theta.copy()) is first
    assert chunked.normal(0.5 * theta) is not first
    # Nobody may change what others will be given.
    with pytest.raises(ValueError, match="read-only"):
        first[0, 0, 0] = 1.0


def test_what_is_prepared_can_go_to_another_process(
    geared: Measured, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = geared(load_chain("space6"), "position")
    chunked, theta = many(problem), values_of(problem, 1.0)
    sent = pickle.loads(pickle.dumps(chunked._chunks))
    assert len(sent) == len(chunked._chunks)
    threads = pickle.loads(pickle.dumps(chunked._threads))
    assert threads.count == chunked._threads.count
    chunked._chunks, chunked._threads = sent, threads
    np.testing.assert_array_equal(chunked.normal(theta), many(problem).normal(theta))


# What kernels do not know.


@dataclass(frozen=True)
class Nod:
    """Something learned: every joint is off by the same."""

    shift: Floats
    space: Literal["joint", "tip"] = "joint"

    def __call__(self, q: Floats) -> Floats:
        return np.full(q.shape, 0.01)

    def weight(self, q: Floats) -> Floats:
        return np.ones(len(q))


def test_a_learned_correction_goes_row_by_row(
    geared: Measured, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However many rows there are; also where the fit without it did not."""
    plain = geared(load_chain("space6"), "pose")
    theta = values_of(plain, 1.0)
    (part,) = plain.parts.values()
    error = replace(part.error, learned=Nod(np.zeros(len(part.error.screws))))
    parts = {part.key: replace(part, error=error)}
    learned = in_kernels(plain, monkeypatch).with_parts(parts)
    assert not learned.many
    expected = plain.with_parts(parts)
    np.testing.assert_array_equal(learned.errors(theta), expected.errors(theta))
    assert np.abs(learned.errors(theta) - plain.errors(theta)).max() > 1e-3
