"""Information matrices against dense linear algebra."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.kinematics.spatial import Floats
from calib_pin.planning.information import Information, Trials, whiten
from calib_pin.planning.planned_problem import identification
from calib_pin.planning.workspace import Workspace
from calib_pin.setup import FrameSetup, PlaneSetup, Setup

COLUMNS = 9
SHAPES = [(d, f) for d in (1, 3, 6) for f in (0, 4)]


def table(d: int, count: int, seed: int = 0) -> Floats:
    """Rows of configurations whose columns differ by 1e4, shape (count, d, m)."""
    rng = np.random.default_rng(seed)
    return rng.normal(size=(count, d, COLUMNS)) * np.logspace(-2, 2, COLUMNS)


def gram(rows: Floats) -> Floats:
    U = rows.reshape(-1, rows.shape[-1])
    return U.T @ U


def schur(M: Floats, f: int) -> Floats:
    """What is left of M about the robot, by its definition."""
    if f == 0:
        return M
    return M[f:, f:] - M[f:, :f] @ np.linalg.solve(M[:f, :f], M[:f, f:])


def unpacked(lower: Floats, d: int) -> Floats:
    """Lower triangular matrices, (pairs, T) row by row -> (T, d, d)."""
    result = np.zeros((lower.shape[1], d, d))
    a, b = np.tril_indices(d)
    result[:, a, b] = lower.T
    return result


def of_robot_alone(trials: Trials, d: int) -> Floats:
    """Logarithms of `det(S + s Z'Z) / det(S)`, NaN where singular, shape (T,)."""
    L, L_n = unpacked(trials.of_all, d), unpacked(trials.of_nuisances, d)
    with np.errstate(invalid="ignore"):
        logs = [np.log(np.einsum("taa->ta", one)).sum(axis=1) for one in (L, L_n)]
    return 2.0 * (logs[0] - logs[1])


def factored(M: Floats, f: int) -> Information:
    found = Information.of(M, f)
    assert found is not None
    return found


@pytest.mark.parametrize("f", [0, 1, 4, COLUMNS - 1])
def test_factor_holds_the_matrix_and_its_schur_complement(f: int) -> None:
    M = gram(table(3, 20))
    found = factored(M, f)
    assert (np.tril(found.factor, -1) == 0.0).all()
    np.testing.assert_allclose(found.factor.T @ found.factor, M, rtol=1e-12)
    np.testing.assert_allclose(
        found.inverse @ found.factor, np.eye(COLUMNS), atol=1e-10
    )
    S = schur(M, f)
    np.testing.assert_allclose(found.singular_values**2, np.linalg.svd(S)[1], rtol=1e-7)
    left, s, right = found.svd
    assert (np.diff(s) <= 0.0).all()
    np.testing.assert_allclose(
        right.T @ S @ right, np.diag(s**2), atol=1e-9 * s[0] ** 2
    )
    np.testing.assert_allclose((left * s) @ right.T, found.factor[f:, f:], atol=1e-9)


def test_singular_values_are_those_of_the_projected_rows() -> None:
    """The nuisances projected out of the rows, without any information matrix."""
    U = table(3, 20).reshape(-1, COLUMNS)
    Q = np.linalg.qr(U[:, :4])[0]
    projected = U[:, 4:] - Q @ (Q.T @ U[:, 4:])
    expected = np.linalg.svd(projected, compute_uv=False)
    found = factored(U.T @ U, 4)
    np.testing.assert_allclose(found.singular_values, expected, rtol=1e-8)


def dependent(kind: str) -> Floats:
    rows = table(3, 20)
    if kind == "null column":
        rows[:, :, 5] = 0.0
    elif kind == "equal columns":
        rows[:, :, 7] = 1e3 * rows[:, :, 1]
    elif kind == "sum of columns":
        rows[:, :, 8] = rows[:, :, :8] @ np.random.default_rng(1).normal(size=8)
    elif kind == "too few rows":
        rows = rows[:2]
    elif kind == "dependent nuisances":
        rows[:, :, 2] = rows[:, :, 0] - rows[:, :, 1]
    return rows


@pytest.mark.parametrize(
    "kind",
    [
        "null column",
        "equal columns",
        "sum of columns",
        "too few rows",
        "dependent nuisances",
    ],
)
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_singular_matrices_have_no_factor(kind: str, scale: float) -> None:
    M = gram(scale * dependent(kind))
    assert np.linalg.matrix_rank(dependent(kind).reshape(-1, COLUMNS)) < COLUMNS
    assert Information.of(M, 4) is None


@pytest.mark.parametrize(
    ("robot", "model"), [("space7", "position"), ("pa10", "pose"), ("space7", "ranger")]
)
def test_too_few_rows_are_never_enough(robot: str, model: str) -> None:
    """Of a robot, whose columns hardly differ; one row less than columns, or none."""
    setup = Setup(tool_frame=FrameSetup((0.05, 0.08, 0.12)))
    if model == "ranger":
        model, planes = "plane-distance", {"wall": PlaneSetup((1.0, 0.3, 0.2), -3.0)}
        setup = replace(setup, planes=planes)
    problem = nominal_problem(calib_pin.load_chain(robot), model, setup)
    rng = np.random.default_rng(0)
    workspace = Workspace.create(problem)
    candidates = workspace.candidates(500, rng)
    _, rows, _ = identification(problem, workspace.aims, candidates)
    U = rows.rows(candidates.q, candidates.aim)
    size, d = U.shape[2], U.shape[1]
    for _ in range(400):
        few = U[rng.choice(500, (size - 1) // d, replace=False)]
        assert Information.of(gram(few), rows.nuisances) is None
        enough = U[rng.choice(500, -(-size // d) + 1, replace=False)]
        assert Information.of(gram(enough), rows.nuisances) is not None


def test_no_information_has_no_factor() -> None:
    assert Information.of(np.zeros((3, 3)), 1) is None


@pytest.mark.parametrize("gap", [1e-3, 1e-5])
def test_almost_singular_is_not_singular(gap: float) -> None:
    rows = table(3, 20)
    rows[:, :, 7] = (
        rows[:, :, 1]
        + gap
        * np.random.default_rng(3).normal(size=(20, 3))
        * np.abs(rows[:, :, 1]).max()
    )
    assert Information.of(gram(rows), 2) is not None


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("d", "f"), SHAPES)
def test_trials_are_those_of_fresh_factorizations(d: int, f: int, sign: float) -> None:
    rows = table(d, 30)
    M = gram(rows)
    found = factored(M, f)
    # What leaves must be in the set; what joins is new.
    tried = rows[:8] if sign < 0.0 else table(d, 8, seed=5)
    trials = found.trials(np.swapaxes(tried, 0, 1), sign)
    assert trials.sign == sign
    L, L_n = unpacked(trials.of_all, d), unpacked(trials.of_nuisances, d)
    of_robot = trials.robot()
    determinants = of_robot_alone(trials, d)
    before = np.linalg.slogdet(schur(M, f))[1]
    R_rr = found.factor[f:, f:]
    for t, U in enumerate(tried):
        changed = M + sign * U.T @ U
        Y = trials.whitened[:, t]
        np.testing.assert_allclose(Y @ found.factor, U, atol=1e-9)
        np.testing.assert_allclose(
            L[t] @ L[t].T, np.eye(d) + sign * Y @ Y.T, atol=1e-12
        )
        np.testing.assert_allclose(
            L_n[t] @ L_n[t].T,
            np.eye(d) + sign * Y[:, :f] @ Y[:, :f].T,
            atol=1e-12,
        )
        ratio = np.linalg.slogdet(changed)[1] - np.linalg.slogdet(M)[1]
        assert 2.0 * np.log(np.diag(L[t])).sum() == pytest.approx(ratio, abs=1e-9)
        # The same of the robot alone, and its whole new Schur complement.
        after = schur(changed, f)
        assert determinants[t] == pytest.approx(
            np.linalg.slogdet(after)[1] - before, abs=1e-9
        )
        Z = of_robot[:, t] @ R_rr
        size = np.sqrt(np.outer(np.diag(after), np.diag(after)))
        difference = schur(M, f) + sign * Z.T @ Z - after
        assert np.abs(difference / size).max() < 1e-9
        fresh = factored(changed, f)
        np.testing.assert_allclose(
            fresh.singular_values**2,
            np.linalg.eigvalsh(R_rr.T @ R_rr + sign * Z.T @ Z)[::-1],
            rtol=1e-6,
        )


@pytest.mark.parametrize("f", [0, 4])
def test_removal_that_leaves_too_little(f: int) -> None:
    """Three configurations of three rows determine nine columns, two do not."""
    rows = table(3, 3)
    found = factored(gram(rows), f)
    determinants = of_robot_alone(found.trials(np.swapaxes(rows, 0, 1), -1.0), 3)
    # NaN, or by rounding a determinant of next to nothing.
    left = np.exp(np.nan_to_num(determinants, nan=-np.inf))
    assert (left < 1e-6).all()


def test_removal_that_leaves_the_nuisances_undetermined() -> None:
    rows = table(1, 30)
    # Only one configuration tells of the first nuisance.
    rows[1:, :, 0] = 0.0
    found = factored(gram(rows), 2)
    trials = found.trials(np.swapaxes(rows, 0, 1), -1.0)
    left = np.nan_to_num(trials.of_nuisances[0], nan=0.0)
    assert left[0] < 1e-7
    assert (left[1:] > 0.1).all()
    determinants = of_robot_alone(trials, 1)
    assert np.isfinite(determinants[1:]).all()


@pytest.mark.parametrize("d", [1, 3, 6])
def test_whitening_solves(d: int) -> None:
    rng = np.random.default_rng(0)
    L = np.tril(rng.normal(size=(5, d, d))) + 3.0 * np.eye(d)
    rows = rng.normal(size=(5, d, 4))
    packed = L[:, *np.tril_indices(d)].T
    found = whiten(packed, np.swapaxes(rows, 0, 1))
    np.testing.assert_allclose(
        np.swapaxes(found, 0, 1), np.linalg.solve(L, rows), atol=1e-12
    )


@pytest.mark.parametrize("f", [0, 4])
def test_pull_is_the_chain_rule_through_the_schur_complement(f: int) -> None:
    rng = np.random.default_rng(4)
    rows = rng.normal(size=(20, 3, COLUMNS))
    M = gram(rows)
    by_S = rng.normal(size=(COLUMNS - f, COLUMNS - f))
    by_S += by_S.T
    by_M = factored(M, f).pull(by_S)
    for _ in range(5):
        dM = rng.normal(size=(COLUMNS, COLUMNS))
        dM = 1e-4 * (dM + dM.T)
        change = np.sum(by_S * (schur(M + dM, f) - schur(M - dM, f))) / 2.0
        assert np.sum(by_M * dM) == pytest.approx(change, rel=1e-6)
