"""Known distances and priors count as measurements of what they say."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.errors import OptionError
from calib_pin.estimation.formulation import make_problem, nominal_problem
from calib_pin.estimation.problem import distinct_values, known_count, known_values
from calib_pin.estimation.row_blocks import (
    KnownDistances,
    Priors,
    expected_places,
    feet,
)
from calib_pin.estimation.statistics.population_prior import (
    RobotEvidence,
    prior_of_type,
)
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.robot_types import robot_type
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.references import (
    Anchor,
    Plane,
    Point,
    ReferenceObject,
    Sphere,
)
from calib_pin.setup import (
    DistanceSetup,
    FrameSetup,
    PlaneSetup,
    PointSetup,
    Setup,
)
from calib_pin.setup.population import PopulationPrior
from tests.shared import chain_of, joint, refused, simulated, urdf_of

REFERENCES: tuple[ReferenceObject, ...] = (
    Point("probe", "target", np.array([0.0, 0.0, 0.1])),
    Plane("table", np.array([0.0, 0.0, 1.0])),
    Point("left", "socket", np.array([1.0, 0.0, 0.0])),
    Sphere("ball", np.array([1.0, 3.0, 4.0]), 0.1),
    Anchor("wire", np.array([1.0, 0.0, -2.0])),
    Point("right", "socket", np.array([3.0, 0.0, 0.0])),
)
DISTANCES = (
    DistanceSetup(("left", "ball"), 4.9, 0.1),
    DistanceSetup(("wire", "right"), 2.0, 1e-3),
    DistanceSetup(("left", "nowhere"), 1.0, 1e-3),
)


def distances_of(
    stated: Sequence[DistanceSetup], references: Sequence[ReferenceObject]
) -> tuple[KnownDistances, Floats]:
    """Known distances between objects by their names, and zero for their parameters."""
    names = [p.name for reference in references for p in reference.parameters]
    named = {(reference.section, reference.name): reference for reference in references}
    return KnownDistances.of(stated, named, names), np.zeros(len(names))


def known() -> tuple[KnownDistances, Floats]:
    return distances_of(DISTANCES, REFERENCES)


def test_those_whose_ends_are_known() -> None:
    """What is not there has no place."""
    found, zero = known()
    assert found.stated == DISTANCES[:2] and len(found) == 2
    np.testing.assert_allclose(found.lengths(zero), [5.0, np.sqrt(8.0)])
    # Probe 3, table 3, left 3, ball 4, wire 4, right 3.
    assert found.columns.tolist() == [
        [[6, 7, 8], [9, 10, 11]],
        [[13, 14, 15], [17, 18, 19]],
    ]
    residual = found.residual(zero)
    np.testing.assert_allclose(residual, [1.0, (np.sqrt(8.0) - 2.0) / 1e-3])
    none, zero = distances_of((), REFERENCES)
    assert none.residual(zero).shape == (0,)
    assert none.jacobian(zero).shape == (0, len(zero))


def test_a_distance_of_planes_is_that_of_known_planes() -> None:
    """In a frame of their own; distances are between points."""
    tool = FrameSetup((0.05, 0.08, 0.12), estimate=True)
    faces = {"a": -0.3, "b": -0.55}
    planes = {name: PlaneSetup((0, 0, 1), at, False) for name, at in faces.items()}
    planes["c"] = PlaneSetup((1, 0, 0), 0.5, False)
    setup = Setup(tool_frame=tool, base_frame=FrameSetup(estimate=True), planes=planes)
    found = calib_pin.identify(ARM, "plane-contact", setup)
    assert found.identifiability.scale_observable
    apart = replace(setup, distances=(DistanceSetup(("a", "b"), 0.25),))
    with refused(OptionError, reason="is about planes", value=["a", "b"]):
        calib_pin.identify(ARM, "plane-contact", apart)


# In a problem.

ARM = calib_pin.load_chain("space6")
SOCKETS = {"s/0": PointSetup((0.6, 0.3, 0.4)), "s/1": PointSetup((0.5, -0.2, 0.6))}
TOOL = FrameSetup((0.05, 0.08, 0.12), (0.2, -0.3, 0.1), estimate=True)


def test_rows_of_a_problem() -> None:
    distances = (DistanceSetup(("s/0", "s/1"), 0.5, 1e-5),)
    prior = {"joint_1.placement.x": 1e-3}
    setup = Setup(sockets=SOCKETS, tool_frame=TOOL, distances=distances, prior=prior)
    problem = nominal_problem(ARM, "fixed-point", setup)
    plain = replace(problem, setup=replace(setup, distances=()))
    theta = 1e-3 * np.random.default_rng(0).normal(size=len(problem.parameters))
    # Behind the rows, before the priors.
    r, J = problem.linearize(theta)
    assert known_count(problem) == known_count(plain) + 1 == len(r)
    assert distinct_values(problem) == distinct_values(plain) + 1
    np.testing.assert_allclose(r, problem.residual(theta), rtol=1e-12, atol=1e-9)
    bare = plain.linearize(theta)
    np.testing.assert_array_equal(np.delete(r, -2), bare[0])
    np.testing.assert_array_equal(np.delete(J, -2, axis=0), bare[1])
    between = np.subtract(SOCKETS["s/1"].xyz, SOCKETS["s/0"].xyz)
    between = between + theta[-3:] - theta[-6:-3]
    assert r[-2] == pytest.approx((np.linalg.norm(between) - 0.5) / 1e-5)
    assert not J[-2, :-6].any()
    slope = between / np.linalg.norm(between) / 1e-5
    np.testing.assert_allclose(J[-2, -6:], [*-slope, *slope])


@pytest.mark.parametrize(
    ("known", "said"),
    [
        (DistanceSetup(("s/0", "t/0"), 0.5), "'t/0', which no measurement does"),
        (DistanceSetup(("ball", "s/0"), 0.5), "base.frame and tool.frame"),
        (DistanceSetup(("s/0", "s/1"), 0.5), ""),
    ],
)
def test_nothing_that_is_known_is_ignored(known: DistanceSetup, said: str) -> None:
    """It is used, or refused where there is no such thing in one frame."""
    points = {"ball": PointSetup((0.0, 0.0, 0.1))}
    setup = replace(
        Setup(sockets=SOCKETS, targets=points, tool_frame=TOOL), distances=(known,)
    )
    if said:
        with pytest.raises(OptionError, match=re.escape(said)):
            calib_pin.identify(ARM, "fixed-point", setup)
    else:
        found = calib_pin.identify(ARM, "fixed-point", setup)
        assert found.identifiability.scale_observable


def prior_of(names: Sequence[str]) -> PopulationPrior:
    """A prior of six robots of the type of `ARM`."""
    rng, count = np.random.default_rng(0), len(names)
    robot, units = robot_type(Chains.of(ARM)), ("m",) * count
    noise = {"position": 2e-4}
    told = [
        RobotEvidence(
            *(robot, tuple(names), units, np.full(count, 1e-3)),
            *(rng.normal(size=(count, count)), rng.normal(size=count), noise),
        )
        for _ in range(6)
    ]
    return replace(prior_of_type(told), file="fleet.json")


@pytest.fixture(scope="module")
def prior() -> PopulationPrior:
    problem = nominal_problem(ARM, "position", Setup())
    return prior_of([p.name for p in problem.parameters if ".placement." in p.name])


@pytest.mark.parametrize("fixed", [(), ("*.placement.z",)])
def test_a_prior_of_several_parameters(
    prior: PopulationPrior, fixed: tuple[str, ...]
) -> None:
    """Rows of deviation one by the covariance; what is free keeps its marginal one."""
    parameters = nominal_problem(ARM, "position", Setup(fixed=fixed)).parameters
    block = Priors.together(prior, parameters)
    free = [k for k, name in enumerate(prior.names) if not fixed or name[-2:] != ".z"]
    index = [parameters.index(prior.names[k]) for k in free]
    W, covariance = block.rows[:, index], np.array(prior.covariance)[np.ix_(free, free)]
    np.testing.assert_allclose(W @ covariance @ W.T, np.eye(len(W)), atol=1e-9)
    assert not np.delete(block.rows, index, axis=1).any()
    mean = np.zeros(len(parameters))
    mean[index] = [prior.parameters[k].mean for k in free]
    assert not block.residual(mean).any() and len(block) == len(index)
    theta = mean + 1e-3 * np.random.default_rng(0).normal(size=len(mean))
    expected = block.rows @ (theta - mean)
    np.testing.assert_allclose(block.residual(theta), expected, atol=1e-9)
    np.testing.assert_array_equal(block.jacobian(theta), block.rows)


def test_the_prior_of_a_problem(prior: PopulationPrior) -> None:
    """Its rows are the last ones; values that priors hold count as known."""
    data = simulated("position", count=10)[0].data
    plain = make_problem(ARM, data, Setup())
    problem = make_problem(ARM, data, Setup(prior=prior))
    theta = 1e-3 * np.random.default_rng(0).normal(size=len(problem.parameters))
    block = Priors.together(prior, problem.parameters)
    r, J = problem.linearize(theta)
    np.testing.assert_allclose(r[-len(block) :], block.residual(theta), rtol=1e-9)
    np.testing.assert_array_equal(J[-len(block) :], block.rows)
    assert known_count(problem) == known_count(plain) + len(block)
    assert known_values(problem) == distinct_values(plain) + len(block)
    # Noise is that of the robots, unless it is stated.
    assert problem.setup.noise == prior.noise
    stated = Setup(prior=prior, noise={"position": 3e-3})
    assert make_problem(ARM, data, stated).setup.noise["position"] == 3e-3


def test_a_prior_of_another_type_or_of_fewer_parameters(prior: PopulationPrior) -> None:
    chain = calib_pin.load_chain("pa10")
    with refused(OptionError, reason="'space6'", file="fleet.json"):
        nominal_problem(chain, "position", Setup(prior=prior))
    more = Setup(prior=prior, parameters=("placement", "transmission"))
    with refused(OptionError, reason=".transmission.gain"):
        nominal_problem(ARM, "position", more)
    gears = replace(more, fixed=("*.transmission.*",))
    found = nominal_problem(ARM, "position", gears).further.priors
    assert len(found) == len(prior.names)


ROBOT = calib_pin.load_chain("heavy6")


def test_a_joint_with_a_fixed_error_has_its_frame() -> None:
    setup = Setup(fixed=("joint_1.placement.x",))
    problem = nominal_problem(ROBOT, "position", setup)
    own = [name.startswith("joint_1.") for name in problem.parameters.names]
    C = expected_places(problem, problem.parameters)
    np.testing.assert_array_equal(C[own], np.eye(len(own))[own])
    assert not np.array_equal(C, np.eye(len(own)))


@pytest.mark.parametrize(("length", "factor"), [(1.0, 1.0), (3.0, 1.5)])
def test_lengths_of_a_crane_are_expected_to_be_off_by_more(
    length: float, factor: float
) -> None:
    """Its angles are not. Where its frames stand on their axes is no matter."""
    place = f"{length} 5 0"
    joints = (joint(f"j{k}", f"l{k} l{k + 1}", place, "0 1 0") for k in range(3))
    for block in feet(chain_of(urdf_of(*joints))):
        np.testing.assert_allclose(np.diagonal(block), [factor] * 3 + [1.0] * 3)
