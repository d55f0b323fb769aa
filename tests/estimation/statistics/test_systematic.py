"""Which effects of gears and compliance are looked for, and how large they may be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.directions import Directions
from calib_pin.estimation.fit import fit
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.statistics.systematic import MOST, candidates, systematic
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Conditions, Observations
from calib_pin.setup import CameraSetup, FrameSetup, Payload, PointSetup, Setup

TOOL = FrameSetup((0.05, 0.08, 0.12), (0.2, -0.3, 0.1))


def problem_of(robot: str, setup: Setup | None = None, payload: str = "") -> Problem:
    chain = calib_pin.load_chain(robot)
    setup = replace(setup or Setup(), tool_frame=TOOL)
    problem = nominal_problem(chain, "position", setup)
    rows = replace(
        problem.data.only, conditions=Conditions((payload,) * len(problem.data))
    )
    return replace(problem, data=Observations.of(rows))


def names(problem: Problem) -> list[str]:
    found = candidates(problem)
    if found is None:
        return []
    return list(found.names)


def test_what_is_estimated_is_no_random_effect() -> None:
    assert len(names(problem_of("pa10"))) == 7 * 5
    gears = replace(Setup(), parameters=("placement", "transmission"))
    assert {name.split(".")[1] for name in names(problem_of("pa10", gears))} == {
        "compliance"
    }
    both = replace(Setup(), parameters=("transmission", "compliance"))
    assert names(problem_of("pa10", both)) == []


def test_what_has_no_mass_does_not_give() -> None:
    assert {name.split(".")[1] for name in names(problem_of("space6"))} == {
        "transmission"
    }
    carried = Setup(payloads={"p": Payload(5.0, (0.0, 0.0, 0.0))})
    assert any(n.endswith("k") for n in names(problem_of("space6", carried)))
    # Of what these rows carry nothing is known.
    assert not any(n.endswith("k") for n in names(problem_of("pa10", payload="p")))


@pytest.mark.parametrize("model", ["position", "fixed-point", "relative-distance"])
def test_rows_are_those_of_the_parameters(model: str) -> None:
    """A column is the residual that its effect adds, by central differences."""
    from benchmarks.recovery import CASES

    setup = CASES[model].setup
    chain = calib_pin.load_chain("space6")
    plain = nominal_problem(chain, model, setup)
    more = replace(setup, parameters=("transmission",))
    true = nominal_problem(chain, model, more)
    rng = np.random.default_rng(0)
    zero = np.zeros(len(true.parameters))
    rows = calib_pin.simulate(true, zero, rng, count=12, noise=0.0)
    effects = candidates(replace(plain, data=rows))
    assert effects is not None
    plain, true = replace(plain, data=rows), replace(true, data=rows)
    X = effects.rows(plain, np.zeros(len(plain.parameters)))
    for k, name in enumerate(effects.names):
        moved = np.zeros(len(true.parameters))
        moved[true.parameters.names.index(name)] = effects.sizes[k]
        change = 0.5 * (true.errors(moved) - true.errors(-moved)) / true.sigma
        # The amplitude of 3e-4 rad is the step: its square is left.
        np.testing.assert_allclose(X[:, k], change, atol=1e-5)


def test_effects_leave_no_more_than_is_found() -> None:
    """Residuals of another kind do not make gears that predict far larger ones."""
    chain = calib_pin.load_chain("space6")
    problem = nominal_problem(chain, "position", Setup(tool_frame=TOOL))
    rng = np.random.default_rng(0)
    rows = calib_pin.simulate(
        problem, np.zeros(len(problem.parameters)), rng, count=150, noise=2e-5
    )
    # Fifth harmonics within a small part of the workspace.
    q = 0.4 * rows.q
    error = problem.only.error
    zero = np.zeros(len(error.screws))
    T, shifted = (error.poses(p, zero) for p in (q, q + 3e-4 * np.sin(5.0 * q)))
    values: Floats = shifted[:, :3, 3] + 2e-5 * rng.normal(size=(150, 3))
    assert not np.allclose(T, shifted)
    data = replace(rows.only, q=q, values=values, sigma=None)
    problem = replace(problem, data=Observations.of(data))
    fitted = fit(problem, rng)
    problem = replace(fitted.problem, units=np.full(1, fitted.sigma0))
    found = systematic(problem, fitted.theta, fitted.directions)
    if found is not None:
        X = found.rows(problem, fitted.theta)
        _, J = problem.linearize_rows(fitted.theta)
        U = np.linalg.qr(
            J @ (problem.parameters.scales[:, None] * fitted.directions.basis)
        )[0]
        left = np.sum((X - U @ (U.T @ X)) ** 2)
        squares = 2.0 * problem.cost(fitted.theta)
        noise = found.noise[0] * (problem.count - fitted.rank)
        assert left <= MOST * (squares - noise) * (1.0 + 1e-6)


def test_a_nominal_robot_behind_the_camera_tells_no_effects() -> None:
    """A fit to wrong measurements has lifted the robot before the camera."""
    camera = CameraSetup("world", (900.0, 900.0), (640.0, 500.0))
    below = FrameSetup((0.0, 0.0, -2.5), (0.0, 0.0, 0.0))
    points = {"a": PointSetup((0.05, 0.08, 0.12)), "b": PointSetup((0.1, 0.0, 0.1))}
    setup = Setup(camera=camera, targets=points, base_frame=below)
    chain = calib_pin.load_chain("space6")
    problem = nominal_problem(chain, "camera", setup)
    theta = np.zeros(len(problem.parameters))
    theta[problem.parameters.index("joint_1.placement.z")] = 5.0
    rng = np.random.default_rng(0)
    rows = calib_pin.simulate(problem, theta, rng, count=60, noise=1.0)
    seen = replace(problem, data=rows)
    assert not np.isfinite(seen.residual(np.zeros(len(theta)))).all()
    none = np.zeros((len(theta), 0))
    assert systematic(seen, theta, Directions(none, none, none)) is None
