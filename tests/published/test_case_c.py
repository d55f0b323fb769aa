"""Liu Qian et al. 2022: link transformations, 34 of 48 parameters, six configurations.

REFERENCE of the numbers: Manned Spaceflight 28(6), 711-719.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.fit import fit
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.identifiability import visible_directions
from calib_pin.estimation.nominal import analyze_structure
from calib_pin.estimation.problem import Problem
from calib_pin.io.measurements import read_configurations
from calib_pin.io.setup import read_true_errors
from calib_pin.kinematics.spatial import adjoint, invert

COMBINATIONS = """
joint_1.link-transform.mz + joint_2.link-transform.mz
joint_1.link-transform.dz + joint_2.link-transform.dz
joint_2.link-transform.my - joint_3.link-transform.mz
joint_2.link-transform.dy - joint_3.link-transform.dz
joint_3.link-transform.my + joint_4.link-transform.mz + 0.76 joint_5.link-transform.dz
joint_3.link-transform.dy + joint_4.link-transform.dz
joint_4.link-transform.my + joint_5.link-transform.mz - 0.76 joint_6.link-transform.dz
joint_4.link-transform.dy + joint_5.link-transform.dz
joint_5.link-transform.my - joint_6.link-transform.mz
joint_5.link-transform.dy - joint_6.link-transform.dz
joint_6.link-transform.my - joint_7.link-transform.mz
joint_6.link-transform.dy - joint_7.link-transform.dz
joint_7.link-transform.my + tool_joint.link-transform.mz
joint_7.link-transform.dy + tool_joint.link-transform.dz
""".strip().splitlines()


def configurations(name: str) -> np.ndarray:
    chain = calib_pin.load_chain("space7")
    return read_configurations(calib_pin.robot_file("space7", f"{name}.csv"), chain)


@pytest.fixture(scope="module")
def problem() -> Problem:
    chain = calib_pin.load_chain("space7")
    setup = calib_pin.read_setup(calib_pin.robot_file("space7", "setup.yaml"))
    return nominal_problem(chain, "pose", setup)


@pytest.fixture(scope="module")
def preset(problem: Problem) -> np.ndarray:
    errors = read_true_errors(calib_pin.robot_file("space7", "errors.yaml"))
    return problem.parameters.vector(errors)


def exact_rows(problem: Problem, theta: np.ndarray) -> calib_pin.Measurements:
    rng = np.random.default_rng(0)
    q = configurations("swarm")
    return calib_pin.simulate(problem, theta, rng, q=q, noise=0.0)


def test_rank_combinations_and_tip_error(problem: Problem, preset: np.ndarray) -> None:
    chain = problem.only.error.chain
    rows = exact_rows(problem, preset)
    result = calib_pin.calibrate(chain, rows, problem.setup)
    assert result.verdict == "good"
    ranks = result.identifiability
    assert (ranks.parameters, ranks.rank, ranks.structural_rank) == (48, 34, 34)
    assert sorted(group.expression for group in result.groups) == sorted(COMBINATIONS)
    alone = [p for p in result.parameters if p.status == "identifiable"]
    assert len(alone) == 20
    printed = " ".join(calib_pin.format_report(result, details=True).split())
    assert "+ 0.76" in printed and "- 0.76" in printed
    third = next(g for g in result.groups if len(g.terms) == 3)
    assert [c for _, c in third.terms] == pytest.approx([1.0, 1.0, 0.76], abs=1e-12)

    q = chain.random_configurations(100, np.random.default_rng(1))
    true = problem.only.error.poses(q, preset)
    gap = invert(true) @ result.model.of().poses(q)
    assert np.linalg.norm(gap[:, :3, 3], axis=1).max() < 1e-9
    assert np.abs(gap[:, :3, :3] - np.eye(3)).max() < 1e-9


def test_values_agree_with_a_truth_in_the_gauge(problem, preset):
    """Of equal robots the fit gives the one closest to nominal; so must the truth be.

    The preset is not: its 34 sums differ from the fitted ones by second-order terms.
    """
    rng = np.random.default_rng(0)
    zero = np.zeros(len(preset))
    found, J = analyze_structure(problem, zero, rng)
    visible = visible_directions(J, problem.parameters)
    C = np.array([c.row(len(preset)) for c in found.combinations])
    assert C.shape[0] == 34
    scale = problem.parameters.scales
    truth = scale * (visible @ (visible.T @ (preset / scale)))
    assert np.abs(C @ truth - C @ preset).max() < 1e-12

    fitted = fit(replace(problem, data=exact_rows(problem, truth)), rng)
    assert np.abs(C @ (fitted.theta - truth)).max() < 1e-9


@pytest.mark.parametrize(
    ("name", "condition", "mean", "worst"),
    [
        ("hand_picked", 354.8, (0.118, 0.123), (0.78, 0.83)),
        ("swarm", 25.2, (0.020, 0.024), (0.11, 0.13)),
    ],
)
def test_one_linear_step_as_published(problem, preset, name, condition, mean, worst):
    """Spatial twists, lengths in m, residual `(T - T~) T~^-1`, 34 kept columns."""
    q = configurations(name)
    robot, _ = problem.only.values(preset)
    nominal, J = problem.only.error.jacobian(q, np.zeros(len(robot)))
    links = np.array([".link-transform." in n for n in problem.parameters.names])
    A = (adjoint(nominal) @ J[:, :, links]).reshape(-1, 48)
    kept = [k for k in range(48) if k < 6 or k % 6 not in (2, 5)]
    assert np.linalg.cond(A[:, kept]) == pytest.approx(condition, abs=0.1)

    E = (problem.only.error.poses(q, robot) - nominal) @ invert(nominal)
    turn = np.stack(
        [E[:, 2, 1] - E[:, 1, 2], E[:, 0, 2] - E[:, 2, 0], E[:, 1, 0] - E[:, 0, 1]],
        axis=1,
    )
    residual = np.concatenate([E[:, :3, 3], 0.5 * turn], axis=1).reshape(-1)
    step = np.linalg.lstsq(A[:, kept], residual, rcond=None)[0]
    true = np.linalg.lstsq(A[:, kept], A, rcond=None)[0] @ preset[links]
    stated = np.abs(true) > 1e-12
    relative = np.abs(step - true)[stated] / np.abs(true[stated])
    assert mean[0] <= relative.mean() <= mean[1]
    # The worst figure of a first-order step depends on second-order terms.
    assert worst[0] <= relative.max() <= worst[1]
