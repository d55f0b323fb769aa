"""All measurement models in mixes of stations, tools and chains.

What simulation put in comes out of noise-free measurements, derivatives of stations and
chains agree with central differences, and very many measurements are no other problem.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from benchmarks.exact import exact_at
from calib_pin.estimation.fit import fit
from calib_pin.estimation.formulation import make_problem, nominal_problem
from calib_pin.estimation.identifiability import visible_directions
from calib_pin.estimation.nominal import analyze_structure, observable_configurations
from calib_pin.estimation.problem import Problem
from calib_pin.io.urdf import load_robot
from calib_pin.io.urdf_tree import parse_robot
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.robot import Robot
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import MEASUREMENT_MODELS, declared
from calib_pin.observations import BlockKey, Observations
from calib_pin.setup import (
    WORLD,
    AnchorSetup,
    CameraSetup,
    ChainSetup,
    FrameSetup,
    Payload,
    PlaneSetup,
    PointSetup,
    Setup,
    SphereSetup,
    ToolSetup,
)
from calib_pin.solvers import Status
from tests.shared import urdf_of

MODELS = tuple(MEASUREMENT_MODELS)
SETUP = Setup(
    stations={
        "one": FrameSetup((1.5, -0.4, 0.3), (0.3, 0.2, 2.0), estimate=True),
        "two": FrameSetup((-0.8, 1.2, 0.1), (-0.1, 0.3, -1.0), estimate=True),
        "eye one": FrameSetup((0.1, -0.2, 3.0), (0.3, -0.2, 0.4), estimate=True),
        "eye two": FrameSetup((-0.2, 0.1, 2.5), (-0.2, 0.1, 1.4), estimate=True),
    },
    tools={
        "ball": ToolSetup((0.05, 0.08, 0.12), (0.2, -0.3, 0.1), estimate=True),
        "pin": ToolSetup((-0.04, 0.02, 0.15), (-0.3, 0.1, 0.4), estimate=True),
        "cap": ToolSetup((0.0, 0.03, 0.1), (0.0, 0.2, 0.1), estimate=True),
        "tip": ToolSetup((0.03, -0.05, 0.08), (0.1, 0.2, -0.2), on="ball"),
    },
    targets={
        name: PointSetup(xyz, estimate=False)
        for name, xyz in {
            "a": (0.05, 0.08, 0.12),
            "b": (-0.06, 0.03, 0.1),
            "c": (0.02, -0.07, 0.15),
            "d": (0.1, 0.1, -0.05),
        }.items()
    }
    | {
        f"post {k}": PointSetup(xyz)
        for k, xyz in enumerate([(0.9, 0.1, 0.2), (-0.3, 0.8, 0.1), (0.4, 0.5, 1.1)])
    },
    sockets={"s/0": PointSetup((0.6, 0.3, 0.4)), "s/1": PointSetup((0.5, -0.2, 0.6))},
    planes={
        "table": PlaneSetup((0.0, 0.1, 1.0), -0.4, estimate=False),
        "wall": PlaneSetup((1.0, 0.1, 0.3), -0.5),
        "door": PlaneSetup((0.2, 1.0, 0.1), -0.3),
    },
    spheres={"dome": SphereSetup((0.5, 0.2, 0.4), 0.15, estimate=True)},
    anchors={"wire": AnchorSetup((1.5, 0.2, 0.4), 0.01, estimate_bias=True)},
    camera=CameraSetup("world", (900.0, 910.0), (640.0, 500.0), estimate=True),
)
POINTS = ("a", "b", "c", "d")
SEEN = ("post 0", "post 1", "post 2")
LOOKED_AT: Mapping[str, Sequence[str]] = {
    "camera": POINTS,
    "fixed-point": ("s/0", "s/1"),
    "plane-contact": ("table", "wall", "door"),
    "plane-distance": ("wall", "door"),
    "sphere-contact": ("dome",),
    "point-distance": ("wire",),
}
"""What measurements of a model name."""


@dataclass(frozen=True)
class Mix:
    """What is measured in one fit.

    Attributes:
        keys: The blocks.
        setup: The setup.
        robot: Name of the robot; empty for a torso with a head and two arms.
    """

    keys: Sequence[BlockKey]
    setup: Setup = SETUP
    robot: str = "space6"


def station(model: str, number: str, beside: str = "") -> str:
    """What a camera sees of a robot, and a tracker, and what is fixed to the floor.

    What is fixed may stand in the frame of a tracker beside it.
    """
    if model == "camera":
        return f"eye {number}"
    followed = (name for name in (model, beside) if name and declared(name).tracks)
    return number if any(followed) else f"floor {number}"


def pair(first: str, second: str) -> list[BlockKey]:
    """Two models that share a station and a tool, one of them elsewhere as well."""
    return [
        BlockKey(first, station=station(first, "one", second), tool="ball"),
        BlockKey(second, station=station(second, "one", first), tool="ball"),
        BlockKey(second, station=station(second, "two"), tool="pin"),
    ]


LEFT = BlockKey("position", "left", "one", "ball")
RIGHT = BlockKey("pose", "right", "one", "pin")
HEAD = BlockKey("position", "head", "two", "cap")
GAZE = BlockKey("camera", "gaze", "eye one", "ball")
TOUCH = BlockKey("fixed-point", "touch", "on hand", "pin")
POSTS = [BlockKey("position", WORLD, number) for number in ("one", "two")]
ARM = [BlockKey("position", station=number, tool="ball") for number in ("one", "two")]
BODY = replace(
    SETUP,
    chains={
        "left": ChainSetup(tip="left hand"),
        "right": ChainSetup(tip="right hand"),
        "head": ChainSetup(tip="head"),
        "gaze": ChainSetup(base="head", tip="left hand"),
        "touch": ChainSetup(base="left hand", tip="right hand"),
    },
    sockets={"s/0": PointSetup((0.1, 0.0, 0.1)), "s/1": PointSetup((0.0, 0.15, 0.1))},
)

NEIGHBORS = list(pairwise([*MODELS, MODELS[0]]))[::2]
"""Pairs that have each model."""

MIXES = {
    **{f"{a}, {b}": Mix(pair(a, b)) for a, b in NEIGHBORS},
    "posts tie stations": Mix([*ARM, *POSTS]),
    "a post seen with the robot elsewhere": Mix([ARM[0], *POSTS]),
    "a tool on another": Mix(
        [BlockKey("pose", station="one", tool="ball"), ARM[1]._replace(tool="tip")]
    ),
    "gears and compliance": Mix(
        [*ARM, *(key._replace(tool="pin") for key in ARM)],
        replace(
            SETUP,
            parameters=("placement", "transmission", "compliance"),
            payloads={"load": Payload(4.0, (0.05, 0.02, 0.1))},
        ),
        "pa10",
    ),
    "gears of three chains": Mix(
        [LEFT, RIGHT, HEAD], replace(BODY, parameters=("placement", "transmission")), ""
    ),
    "all of a body": Mix([LEFT, RIGHT, HEAD, GAZE, TOUCH, *POSTS], BODY, ""),
    "only touch": Mix([TOUCH], BODY, ""),
}


@pytest.fixture(scope="session")
def body() -> Robot:
    """A torso of three joints, one of which mimics another, a head and two arms."""
    rng = np.random.default_rng(0)
    joints = [
        limb("torso", "chest", ["waist", "hip", "belly"], rng),
        limb("chest", "head", ["pan", "tilt"], rng),
        *(
            limb("chest", f"{side} hand", [f"{side} {k}" for k in range(1, 7)], rng)
            for side in ("left", "right")
        ),
    ]
    every = [joint for joints in joints for joint in joints]
    every[2]["more"] = '<mimic joint="hip" multiplier="-0.6" offset="0.1"/>'
    return parse_robot(urdf_of(*every).encode(), "body.urdf")


def limb(
    start: str, end: str, joints: Sequence[str], rng: np.random.Generator
) -> list[dict[str, Any]]:
    """Joints from one link to another, neither parallel nor square."""
    links = [start, *(f"after {name}" for name in joints[:-1]), end]
    return [
        {
            "name": name,
            "parent": parent,
            "child": child,
            "placement": pin.exp6(rng.uniform(-1, 1, 6) * [0.2, 0.2, 0.2, 1, 1, 1]),
            "axis": tuple(np.eye(3)[k % 3]),
        }
        for k, (name, parent, child) in enumerate(
            zip(joints, links, links[1:], strict=False)
        )
    ]


def problem_of(mix: Mix, body: Robot) -> Problem:
    """The problem of a mix, without measurements."""
    robot = load_robot(mix.robot) if mix.robot else body
    names = dict.fromkeys(key.chain for key in mix.keys)
    chains = Chains(robot, setups=mix.setup.chains, names=tuple(names))
    measured = {
        key: SEEN if key.chain == WORLD else LOOKED_AT.get(key.model, ("",))
        for key in mix.keys
    }
    return nominal_problem(chains, measured, mix.setup)


def drawn(
    problem: Problem, theta: Floats, count: int, rng: np.random.Generator
) -> Problem:
    """The problem with exact measurements of every block."""
    at = [
        observable_configurations(problem, key, theta, count, rng)
        for key in problem.terms
    ]
    return exact_at(problem, theta, *at)


def disturbed(problem: Problem, count: int) -> tuple[Problem, Floats]:
    """Measurements of every block away from their prediction, and parameters.

    So the curvature of residuals counts.
    """
    rng = np.random.default_rng(3)
    theta = 0.01 * rng.normal(size=len(problem.parameters))
    exact, noisy = drawn(problem, theta, count, rng), []
    for data in exact.data.blocks:
        term = problem.terms[data.key]
        noise = 0.05 * rng.normal(size=(len(data), term.components))
        values = term.measurement.disturb(data.values, noise)
        q = data.q
        if term.measurement.declaration.contact:
            q = q + 0.01 * rng.normal(size=q.shape)
        noisy.append(replace(data, q=q, values=values))
    return replace(exact, data=Observations(tuple(noisy))), theta


@pytest.mark.parametrize("name", ["all of a body", "gears and compliance"])
def test_jacobians_agree_with_central_differences(name: str, body: Robot) -> None:
    """Of stations, tools and chains; of each model by itself in `test_jacobians`."""
    measured, theta = disturbed(problem_of(MIXES[name], body), 3)
    r, J = measured.linearize_rows(theta)
    np.testing.assert_allclose(r, measured.residual(theta), rtol=0, atol=1e-6)
    for way in np.random.default_rng(0).choice([-1e-6, 1e-6], (12, len(theta))):
        change = measured.residual(theta + way) - measured.residual(theta - way)
        error = np.abs(J @ way - change / 2).max()
        assert error < 2e-13 * np.abs(J).max()


@pytest.mark.parametrize(
    "name",
    [
        "all of a body",
        "gears of three chains",
        "plane-contact, sphere-contact",
        "plane-distance, point-distance",
    ],
)
def test_very_many_measurements_have_the_same_normal_equations(name, body, monkeypatch):
    """Through the kernels, where these know the model."""
    plain, theta = disturbed(problem_of(MIXES[name], body), 20)
    r, J = plain.linearize(theta)
    lengths = np.linalg.norm(np.column_stack([J, r]), axis=0)
    lengths[lengths == 0.0] = 1.0
    monkeypatch.setattr("calib_pin.estimation.problem.MANY", 0)
    many = replace(plain)
    assert not many.station_parameters

    def products(r: Floats, J: Floats) -> Floats:
        columns = np.column_stack([J, r]) / lengths
        return np.asarray(columns.T @ columns)

    found = products(*many.linearize(theta))
    np.testing.assert_allclose(found, products(r, J), rtol=0, atol=1e-11)
    assert many.cost(theta) == pytest.approx(plain.cost(theta), rel=1e-11)
    errors = plain.errors(theta)
    size = max(1.0, np.abs(errors).max())
    np.testing.assert_allclose(many.errors(theta), errors, rtol=0, atol=1e-12 * size)


@pytest.mark.parametrize("name", MIXES)
def test_noise_free_recovery(name: str, body: Robot) -> None:
    """Of equal robots the one closest to nominal, with frames and instruments."""
    problem = problem_of(MIXES[name], body)
    rng, parameters = np.random.default_rng(7), problem.parameters
    zero = np.zeros(len(parameters))
    structure, J = analyze_structure(problem, zero, rng)
    visible = visible_directions(J, parameters)
    size = 0.1 * parameters.scales
    truth = size * (visible @ rng.normal(size=visible.shape[1]))
    least = min(p.components for p in problem.terms.values())
    count = -(-3 * len(parameters) // (len(problem.terms) * least))
    fitted = fit(drawn(problem, truth, max(count, 12), rng), rng)
    assert fitted.result.status is Status.CONVERGED
    assert fitted.rank == structure.rank
    assert np.abs(fitted.problem.errors(fitted.theta)).max() < 1e-9
    difference = np.abs(fitted.theta - truth) / parameters.scales
    shown = [c.row(len(truth)) for c in structure.combinations]
    assert difference[np.any(shown, axis=0)].max() < 1e-9
    # What nothing shows stays, up to the rounding of steps along what hardly shows.
    assert difference.max() < 1e-6

    # Without a guess of any frame the robot measures the same elsewhere.
    elsewhere = drawn(problem, truth, 10, rng).data
    setup = problem.setup
    on_others = {name: tool for name, tool in setup.tools.items() if tool.on}
    nothing = dict.fromkeys((tool.on for tool in on_others.values()), ToolSetup())
    bare = replace(setup, stations={}, tools=nothing | on_others)
    again = fit(make_problem(problem.chains, fitted.problem.data, bare), rng)
    assert again.rank == structure.rank
    there = replace(again.problem, data=elsewhere)
    assert np.abs(there.errors(again.theta) / there.sigma).max() < 1e-5
