"""Simulated measurements: the true robot, the stated noise, nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from benchmarks.exact import exact_at
from calib_pin.errors import InputError, OptionError
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.nominal import unmeasured
from calib_pin.estimation.problem import Problem
from calib_pin.io.urdf import load_chains
from calib_pin.observations import (
    BlockKey,
    Conditions,
    Labels,
    Measurements,
    Observations,
)
from calib_pin.setup import (
    CameraSetup,
    FrameSetup,
    Payload,
    PlaneSetup,
    PointSetup,
    Setup,
    SphereSetup,
)
from calib_pin.simulation import draw_errors, simulate

PLANES = {"wall": PlaneSetup((0, 1, 4.6), -0.69), "floor": PlaneSetup((0, 0, 1), 0.2)}
SETUPS = {
    "position": Setup(base_frame=FrameSetup((1, 2, 3), (0.1, 0.2, 0.3))),
    "pose": Setup(),
    "plane-distance": Setup(planes=PLANES),
}


def make(model: str, **changes: object) -> Problem:
    chain = calib_pin.load_chain("space6")
    return nominal_problem(chain, model, replace(SETUPS[model], **changes))


@pytest.fixture(params=SETUPS)
def problem(request: pytest.FixtureRequest) -> Problem:
    return make(request.param)


def simulated(*args: object, **options: object) -> Measurements:
    return simulate(*args, **options).only


def residuals(problem: Problem, rows: Measurements, theta: np.ndarray) -> np.ndarray:
    measured = replace(problem, data=Observations.of(rows))
    return measured.blocks[0].table(measured.errors(theta))


def errors(problem: Problem, seed: int = 0) -> np.ndarray:
    return draw_errors(problem.parameters, np.random.default_rng(seed))


# --- true errors -------------------------------------------------------------------


def test_drawn_errors_fill_the_scales_of_the_robot():
    problem = make("pose", fixed=("*.placement.x", "joint_2.*"))
    parameters = problem.parameters
    drawn = np.array([errors(problem, seed) for seed in range(400)])
    robot = [
        ".frame." not in name
        and not name.endswith("placement.x")
        and not name.startswith("joint_2.")
        for name in parameters.names
    ]
    assert (drawn[:, ~np.array(robot)] == 0.0).all()
    relative = drawn[:, robot] / parameters.scales[robot]
    assert np.abs(relative).max() <= 1.0
    # Uniform: variance 1/3, and a mean that vanishes.
    np.testing.assert_allclose(relative.var(axis=0), 1 / 3, atol=0.1)
    np.testing.assert_allclose(relative.mean(axis=0), 0.0, atol=0.12)


# --- noise -------------------------------------------------------------------------


def test_without_noise_the_values_are_exact(problem):
    theta = errors(problem)
    rows = simulated(problem, theta, np.random.default_rng(1), count=30, noise=0.0)
    assert rows.sigma is None
    assert len(rows) == 30
    assert np.abs(residuals(problem, rows, theta)).max() < 1e-12
    assert np.abs(residuals(problem, rows, 0.0 * theta)).max() > 1e-4


@pytest.mark.parametrize("noise", [None, 3e-4])
def test_noise_has_the_stated_size(problem, noise):
    theta = errors(problem)
    rows = simulated(problem, theta, np.random.default_rng(1), count=500, noise=noise)
    chain = problem.only.error.chain
    assert ((rows.q >= chain.lower) & (rows.q <= chain.upper)).all()
    assert rows.sigma is not None
    assert (rows.sigma == (1e-4 if noise is None else noise)).all()
    found = residuals(problem, rows, theta) / rows.sigma
    # 500 draws: the deviation of a standard deviation is 3 %.
    np.testing.assert_allclose(found.std(axis=0), 1.0, atol=0.13)
    np.testing.assert_allclose(found.mean(axis=0), 0.0, atol=0.18)


def test_the_setup_states_the_noise_of_each_block():
    noise = {"position": 1e-5, "orientation": 2e-3, "contact": 2e-4}
    problem = touched(("pose", "plane-contact"), noise=noise)
    theta = errors(problem)
    found = simulate(problem, theta, np.random.default_rng(1), count=91)
    assert [len(block) for block in found.blocks] == [46, 45]
    for block, sigma in zip(found.blocks, ([1e-5] * 3 + [2e-3] * 3, 2e-4), strict=True):
        assert (block.sigma == sigma).all()


# --- repeats -----------------------------------------------------------------------


def test_repeats_stay_together(problem):
    theta, rng = errors(problem), np.random.default_rng(1)
    q = simulated(problem, theta, rng, count=40).q
    rows = simulated(problem, theta, rng, q=q, repeats=4, noise=1e-3)
    groups = rows.groups().reshape(40, 4)
    assert (groups == groups[:, :1]).all()
    assert len(set(groups[:, 0])) == 40
    assert len(np.unique(rows.values[:, 0])) == 160
    np.testing.assert_allclose(rows.sigma, 1e-3)
    # The deviation of a standard deviation of 40 draws is 11 %.
    found = residuals(problem, rows, theta).std(axis=0)
    np.testing.assert_allclose(found, 1e-3, rtol=0.5)


# --- configurations ----------------------------------------------------------------


def test_what_cannot_be_measured_is_refused():
    """A beam that misses its plane, a plane and a socket out of reach."""
    rng = np.random.default_rng(1)
    problem = make("plane-distance", planes={"floor": PLANES["floor"]})
    q = simulated(problem, errors(problem), rng, count=3).q
    q[1] = [0.0, -np.pi / 2, 0.0, 0.0, 0.0, 0.0]  # Straight up.
    with pytest.raises(InputError, match="configuration 2 "):
        simulated(problem, errors(problem), rng, q=q)
    problem = make("plane-distance", planes={"sky": PlaneSetup((0, 0, 1), -90.0)})
    with pytest.raises(InputError):
        simulated(problem, errors(problem), rng, count=1)
    problem = touched("fixed-point", sockets={"s": PointSetup((5.0, 0.0, 0.0))})
    with pytest.raises(InputError, match="configuration 1 "):
        simulated(problem, errors(problem), rng, q=np.zeros((1, 6)))
    # Each instrument measures what it can.
    keys = [BlockKey("position"), BlockKey("plane-distance")]
    floor = Setup(planes={"floor": PLANES["floor"]})
    problem = nominal_problem(calib_pin.load_chain("space6"), keys, floor)
    found = simulate(problem, errors(problem), rng, q=q)
    assert [len(block) for block in found.blocks] == [3, 2]
    with pytest.raises(InputError, match="plane-distance"):
        simulate(problem, errors(problem), rng, q=q[1:2])


# --- contacts ----------------------------------------------------------------------

TOUCHED = Setup(
    tool_frame=FrameSetup((0.05, 0.08, 0.12), (0.2, -0.3, 0.1)),
    sockets={"s/0": PointSetup((0.6, 0.3, 0.4)), "s/1": PointSetup((0.5, -0.2, 0.6))},
    planes={"a": PlaneSetup((0, 0.1, 1), -0.4), "b": PlaneSetup((1, 0.1, 0.3), -0.5)},
    spheres={"ball": SphereSetup((0.5, 0.2, 0.4), 0.15)},
)
CONTACTS = ("fixed-point", "plane-contact", "sphere-contact")


def touched(measured: str | tuple[str, ...], **changes: object) -> Problem:
    chain = calib_pin.load_chain("space6")
    keys = measured if isinstance(measured, str) else [*map(BlockKey, measured)]
    return nominal_problem(chain, keys, replace(TOUCHED, **changes))


@pytest.mark.parametrize("model", CONTACTS)
def test_noise_of_a_contact_is_a_gap_of_the_stated_size(model):
    problem = touched(model, noise={"position": 5e-4, "contact": 5e-4})
    theta, sigma = errors(problem), 5e-4
    rows = simulated(problem, theta, np.random.default_rng(1), count=150)
    assert (rows.sigma == sigma).all()
    gap = residuals(problem, rows, theta)
    # 150 draws and more: the deviation of a standard deviation is 6 %.
    np.testing.assert_allclose(gap.std(axis=0), sigma, rtol=0.3)
    assert (np.abs(gap.mean(axis=0)) < 0.3 * sigma).all()
    # Of every row.
    assert len(np.unique(gap[:, 0])) == 150


@pytest.mark.parametrize("model", CONTACTS)
def test_a_gauge_reads_how_far_a_contact_is_off(model):
    problem = touched(model, gauge=1e-3, noise={"position": 1e-5, "contact": 1e-5})
    theta = errors(problem)
    rows = simulated(problem, theta, np.random.default_rng(1), count=40, repeats=2)
    gap = residuals(problem, replace(rows, values=rows.values[:, :0]), theta)
    assert np.abs(gap).max() <= 1e-3 + 1e-9 < 1e-3 + np.abs(gap).max() / 2.0
    # Both readings of a configuration differ by noise, as they differ from the gap.
    assert (rows.q[::2] == rows.q[1::2]).all()
    noise = residuals(problem, rows, theta)
    np.testing.assert_allclose(noise.std(axis=0), 1e-5, rtol=0.35)
    np.testing.assert_allclose(gap - rows.values, noise, atol=1e-12)


def test_given_configurations_are_brought_into_contact():
    problem = touched("plane-contact")
    theta, rng = errors(problem), np.random.default_rng(1)
    there = simulated(problem, theta, rng, count=4, noise=0.0)
    near = there.q + 0.01 * rng.normal(size=there.q.shape)
    rows = simulated(problem, theta, rng, q=near, target=there.target, noise=0.0)
    assert rows.target == there.target and (rows.q != near).any(axis=1).all()
    assert np.abs(rows.q - near).max() < 0.1
    assert np.abs(residuals(problem, rows, theta)).max() < 1e-12


# --- relative distances ------------------------------------------------------------


def test_ways_share_their_starts():
    """Ten rows from each start, which is no row itself."""
    problem = touched("relative-distance")
    theta = errors(problem)
    rows = simulated(problem, theta, np.random.default_rng(1), count=25, noise=0.0)
    assert rows.target == ("1",) * 10 + ("2",) * 10 + ("3",) * 5
    assert rows.start.shape == rows.q.shape
    assert len(np.unique(rows.start, axis=0)) == 3
    for name in "123":
        leg = [target == name for target in rows.target]
        assert (rows.start[leg] == rows.start[leg][0]).all()
        # Not one of the rows.
        assert (rows.q[leg] != rows.start[leg]).any(axis=1).all()
    of_robot = problem.only.values(theta)[0]
    ends = (
        problem.only.error.poses(q, of_robot)[:, :3, 3] for q in (rows.q, rows.start)
    )
    expected = np.linalg.norm(np.subtract(*ends), axis=1)
    np.testing.assert_allclose(rows.values[:, 0], expected, rtol=1e-12)


def test_starts_among_given_configurations():
    """The first configuration of each name is its start."""
    problem = touched("relative-distance")
    theta, rng = errors(problem), np.random.default_rng(1)
    q = problem.only.error.chain.random_configurations(6, rng)
    names = ("x", "y", "x", "x", "y", "y")
    rows = simulated(problem, theta, rng, q=q, target=names, noise=0.0)
    assert rows.target == ("x", "x", "y", "y")
    np.testing.assert_array_equal(rows.q, q[[2, 3, 4, 5]])
    np.testing.assert_array_equal(rows.start, q[[0, 0, 1, 1]])
    with pytest.raises(InputError, match="'z'"):
        simulated(problem, theta, rng, q=q, target=(*names[:-1], "z"))


# --- several models, and what is carried -------------------------------------------


BOARD = {f"c{k}": PointSetup((0.04 * (k % 4), 0.04 * (k // 4), 0.1)) for k in range(12)}
SEEN = Setup(
    base_frame=FrameSetup((0.1, -0.2, 3.0), (0.3, -0.2, 0.4)),
    camera=CameraSetup("world", (900.0, 900.0), (320.0, 240.0), size=(640, 480)),
    targets=BOARD,
)


def test_images_show_all_corners_that_are_seen() -> None:
    loads = {"light": Payload(1.0, (0.1, 0, 0)), "heavy": Payload(5.0, (0.1, 0, 0))}
    setup = replace(SEEN, parameters=("compliance",), payloads=loads)
    problem = nominal_problem(calib_pin.load_chain("space6"), "camera", setup)
    theta, rng = errors(problem), np.random.default_rng(1)
    rows = simulated(problem, theta, rng, count=30, per_configuration=True, noise=0.0)
    # Pixels by hundreds.
    assert np.abs(residuals(problem, rows, theta)).max() < 1e-9
    assert rows.configurations == 30 and set(rows.payload) == {"light", "heavy"}
    names = tuple(BOARD)
    for label in np.unique(rows.groups()):
        image = rows.rows(rows.groups() == label)
        each = np.repeat(image.q[:1], len(names), axis=0)
        carried = (image.payload[0],) * len(names)
        at = unmeasured(problem, problem.only.key, each, names, Conditions(carried))
        seen = problem.observable(theta, at)
        assert list(image.target) == [n for n, s in zip(names, seen, strict=True) if s]
    # Some images lack a corner, and beams and wires have one target all the same.
    assert len(rows) < 30 * 12
    problem = make("plane-distance")
    rows = simulated(problem, errors(problem), rng, count=10, per_configuration=True)
    assert len(rows) == 10


def arms() -> tuple[Problem, list[BlockKey]]:
    """Two hands of one robot before two trackers, and a post that stands still."""
    hands = ("arm_left_7_link", "arm_right_7_link")
    chains = load_chains("example:talos_reduced", names=(*hands, "world"))
    stations = {
        name: FrameSetup((3.0, y, 1.0), (0.0, 0.0, 0.3), estimate=True)
        for name, y in (("day 1", 2.0), ("day 2", -2.0))
    }
    keys = [BlockKey("position", hand, day) for hand in hands for day in stations]
    keys.append(BlockKey("position", "world", "day 1"))
    setup = Setup(stations=stations, noise={"position": 1e-5})
    return nominal_problem(chains, keys, setup), keys


def test_chains_and_stations_share_the_count() -> None:
    problem, keys = arms()
    theta = errors(problem)
    found = simulate(problem, theta, np.random.default_rng(1), count=23, repeats=2)
    assert found.keys == tuple(keys)
    assert [len(block) for block in found.blocks] == [10, 10, 10, 8, 8]
    assert found.joints == problem.chains.joints
    measured = replace(problem, data=found)
    assert np.abs(measured.errors(theta) / measured.sigma).max() < 5.0
    # One torso: an error of it is one of both hands.
    moved = theta.copy()
    moved[problem.parameters.names.index("torso_1_joint.placement.rz")] += 1e-2
    change = np.abs(measured.errors(moved) - measured.errors(theta))
    for block in measured.blocks:
        still = block.term.key.chain == "world"
        assert (block.table(change).max(axis=1) > 1e-4).all() != still


def test_a_block_by_itself_and_all_of_them_at_configurations() -> None:
    problem, keys = arms()
    theta, rng = errors(problem), np.random.default_rng(1)
    q = problem.chains.random_configurations(4, rng)
    every = simulate(problem, theta, rng, q=q, noise=0.0)
    assert len(every) == 5 * 4
    at = (unmeasured(problem, key, q, ("",) * 4) for key in keys)
    exact = exact_at(problem, theta, *at)
    for block, one, key in zip(every.blocks, exact.data.blocks, keys, strict=True):
        stated = {"chain": key.chain, "station": key.station}
        named = {kind: Labels.all(name, 4) for kind, name in stated.items()}
        alone = simulate(problem, theta, rng, places=named, q=q, noise=0.0).only
        np.testing.assert_array_equal(alone.values, block.values)
        np.testing.assert_array_equal(one.values, block.values)
    with pytest.raises(OptionError):  # A row for each block.
        simulate(problem, theta, rng, count=4)


def test_places_say_which_block_measures_a_configuration() -> None:
    problem, keys = arms()
    theta, rng = errors(problem), np.random.default_rng(1)
    q = problem.chains.random_configurations(3, rng)
    chain, day = keys[0].chain, Labels.of(["day 2", "day 1", "day 2"])
    places = {"chain": Labels.all(chain, 3), "station": day}
    found = simulate(problem, theta, rng, q=q, places=places, noise=0.0)
    assert [key.station for key in found.keys] == ["day 1", "day 2"]
    for block, rows in zip(found.blocks, ([1], [0, 2]), strict=True):
        np.testing.assert_array_equal(block.q, q[rows])
    places["station"] = Labels.of(["day 2", "day 3", "day 2"])
    with pytest.raises(InputError, match="configuration 2 "):
        simulate(problem, theta, rng, q=q, places=places)


def test_what_is_carried_takes_turns():
    """Every target is measured with every payload."""
    loads = {"light": Payload(1.0, (0.1, 0, 0)), "heavy": Payload(5.0, (0.1, 0, 0))}
    problem = touched("fixed-point", parameters=("compliance",), payloads=loads)
    theta = errors(problem)
    rows = simulated(problem, theta, np.random.default_rng(1), count=8, noise=0.0)
    pairs = set(zip(rows.target, rows.payload, strict=True))
    assert len(pairs) == 4
    assert np.abs(residuals(problem, rows, theta)).max() < 1e-12
    # Brought into contact as the robot bends under that load.
    other = replace(rows, conditions=Conditions(("light",) * 8))
    assert np.abs(residuals(problem, other, theta)).max() > 1e-5


# --- repeatability and mistakes ----------------------------------------------------


def test_the_generator_decides_everything(problem):
    theta = errors(problem)
    rows = [
        simulated(problem, theta, np.random.default_rng(seed), count=5)
        for seed in (1, 1, 2)
    ]
    np.testing.assert_array_equal(rows[0].values, rows[1].values)
    np.testing.assert_array_equal(rows[0].q, rows[1].q)
    assert not np.array_equal(rows[0].q, rows[2].q)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"count": 3, "q": np.zeros((1, 6))},
        {"count": 0},
        {"count": 3, "repeats": 0},
        {"count": 3, "noise": -1e-3},
        {"count": 3, "noise": np.nan},
        {"count": 3, "noise": np.inf},
    ],
)
def test_numbers_out_of_range(options):
    problem = make("pose")
    rng = np.random.default_rng(1)
    with pytest.raises(OptionError):
        calib_pin.simulate(problem, errors(problem), rng, **options)
