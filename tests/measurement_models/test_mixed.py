"""Several ways of measuring in one fit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import calib_pin
from calib_pin.errors import InputError, OptionError
from calib_pin.estimation.fit import fit
from calib_pin.estimation.formulation import make_problem, nominal_problem
from calib_pin.estimation.nominal import register
from calib_pin.estimation.population import PopulationCost
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.registration import extended, registered
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import Mixed, measurement_model
from calib_pin.measurement_models.mixed import qualified
from calib_pin.measurement_models.mount import Frame, Mounted
from calib_pin.measurement_models.side_by_side import by_part, concatenate
from calib_pin.observations import Measurements, states_sigmas
from calib_pin.setup import (
    CameraSetup,
    DistanceSetup,
    FrameSetup,
    PlaneSetup,
    PointSetup,
    Setup,
)
from calib_pin.simulation import exact_problem

Simulated = Callable[..., tuple[Problem, Floats]]
Equipped = Callable[..., Problem]

ARM = calib_pin.load_chain("space6")
BASE = FrameSetup((1.5, -0.4, 0.3), (0.3, 0.2, 2.0), estimate=True)
TOOL = FrameSetup((0.05, 0.08, 0.12), (0.2, -0.3, 0.1), estimate=True)
SOCKETS = {"s/0": PointSetup((0.6, 0.3, 0.4)), "s/1": PointSetup((0.5, -0.2, 0.6))}
TABLE = PlaneSetup((0.0, 0.1, 1.0), -0.4)
PARTS = ("position", "pose", "fixed-point", "plane-contact", "camera")


def mixed(setup: Setup, *names: str, targets: tuple[str, ...] = ()) -> Mixed:
    model = measurement_model("+".join(names), setup, targets)
    assert isinstance(model, Mixed)
    return model


@pytest.fixture
def all_parts(equipped_problem: Equipped) -> tuple[Problem, Floats]:
    """A problem with rows of every part at random configurations, and parameters."""
    problem = equipped_problem(ARM, "+".join(PARTS))
    rng = np.random.default_rng(0)
    theta = 0.01 * rng.normal(size=len(problem.parameters))
    target = problem.data.target
    q = ARM.random_configurations(len(target), rng)
    there = exact_problem(problem, theta, q, target)
    noise = 0.1 * rng.normal(size=there.sigma.shape)
    values = there.measurement.disturb(there.data.values, noise)
    return replace(there, data=replace(there.data, values=values)), theta


# What it is made of.


def test_names_and_quantities(equipped: Setup) -> None:
    model = mixed(equipped, *PARTS)
    assert model.name == "position+pose+fixed-point+plane-contact+camera"
    assert model.width == 3 + 7 + 0 + 0 + 2
    told = [(q.name, q.noise, q.unit) for q in model.quantities]
    assert told == [
        ("position (position)", "position", "m"),
        ("position (pose)", "position", "m"),
        ("orientation", "orientation", "rad"),
        ("position (fixed-point)", "position", "m"),
        ("contact", "contact", "m"),
        ("pixel", "pixel", "px"),
    ]
    assert model.targets[:3] == ("position:probe", "position:nest", "pose:")
    assert "fixed-point:nest@left/1" in model.targets
    stated = model.declaration
    assert stated.external and not stated.contact and not stated.relative
    contacts = mixed(equipped, "fixed-point", "sphere-contact")
    assert contacts.declaration.contact and not contacts.declaration.external
    assert mixed(equipped, "pose", "relative-distance").declaration.relative


def test_targets_of_the_parts() -> None:
    rows = ("pose:", "fixed-point:a@s/0", "pose:", "fixed-point:s/1")
    assert qualified(("pose", "fixed-point", "position"), rows) == {
        "pose": ("",),
        "fixed-point": ("a@s/0", "s/1"),
        "position": (),
    }


def test_what_several_parts_name_is_one_reference() -> None:
    """The ball that a tracker sees rests in the sockets."""
    ball = {"ball": PointSetup((0.05, 0.08, 0.12))}
    setup = Setup(targets=ball, sockets=SOCKETS)
    rows = ("position:ball", "fixed-point:ball@s/0", "fixed-point:ball@s/1")
    model = mixed(setup, "position", "fixed-point", targets=rows)
    assert [reference.name for reference in model.references] == ["ball", "s/0", "s/1"]
    assert len(model.parameters) == 9
    moved = model.rebased(np.array([0.1, 0, 0, 0, 0.2, 0, 0, 0, 0]))
    for part in moved.parts.values():
        np.testing.assert_allclose(part.references[0].xyz, [0.15, 0.08, 0.12])
    np.testing.assert_allclose(moved.parts["fixed-point"].references[1].xyz[1], 0.5)


@pytest.mark.parametrize("order", [("position", "camera"), ("camera", "position")])
def test_what_one_part_estimates_is_estimated(order: tuple[str, str]) -> None:
    """Points are known to a camera unless it is told, and unknown to a tracker."""
    setup = Setup(
        targets={"m": PointSetup((0.05, 0.08, 0.12)), "n": PointSetup((0.1, 0, 0))},
        camera=CameraSetup("world", (900.0, 910.0), (640.0, 500.0)),
    )
    rows = ("position:m", "camera:m", "camera:n")
    model = mixed(setup, *order, targets=rows)
    references = {reference.name: reference for reference in model.references}
    assert len(references["m"].parameters) == 3 and not references["n"].parameters
    assert isinstance(model.parts["camera"], Mounted)
    assert len(model.parameters) == 3 + 9 + 12


def test_only_a_camera_has_frames_of_its_own(equipped: Setup) -> None:
    frames = [f for f in mixed(equipped, *PARTS).references if isinstance(f, Frame)]
    assert [(f.name, f.kind) for f in frames] == [
        ("camera", "base"),
        ("camera", "tool"),
    ]
    names = [p.name for f in frames for p in f.parameters]
    assert names[0] == "camera.base.x" and names[-1] == "camera.tool.rz"


# The rows.


def test_rows_are_those_of_the_parts(all_parts: tuple[Problem, Floats]) -> None:
    problem, theta = all_parts
    model, data = problem.measurement, problem.data
    assert isinstance(model, Mixed)
    T, instrument = problem.poses(theta, data), problem.split(theta)[1]
    linear, start = model.linearize(T, instrument, data), 0
    seen: list[int] = []
    names = [p.name for p in model.parameters]
    for name, part in model.parts.items():
        rows, of_part = by_part(data)[name]
        assert of_part.model == name and of_part.values.shape[1] == part.width
        assert len(of_part) == len(rows) > 0
        columns = [names.index(p.name) for p in part.parameters]
        alone = part.linearize(T[rows], instrument[columns], of_part)
        size = alone.residual.shape[1]
        here = slice(start, start + size)
        start += size
        np.testing.assert_array_equal(linear.residual[rows, here], alone.residual)
        np.testing.assert_array_equal(linear.J_pose[rows, here], alone.J_pose)
        found = linear.J_instrument[rows, here]
        np.testing.assert_array_equal(found[:, :, columns], alone.J_instrument)
        assert not np.delete(found, columns, axis=2).any()
        # Others have nothing in these components.
        others = np.setdiff1d(np.arange(len(data)), rows)
        for array in (linear.residual, linear.J_pose, linear.J_instrument):
            assert not array[others, here].any()
        assert np.isinf(problem.sigma[others, here]).all()
        assert np.isfinite(problem.sigma[rows, here]).all()
        seen += rows.tolist()
    assert sorted(seen) == list(range(len(data)))
    assert start == problem.components
    np.testing.assert_array_equal(model.residual(T, instrument, data), linear.residual)


def test_the_cost_is_that_of_the_parts(all_parts: tuple[Problem, Floats]) -> None:
    problem, theta = all_parts
    shown = problem.masked_errors(theta)
    told = np.isfinite(shown)
    assert problem.values == told.sum() < shown.size
    assert problem.count == problem.values + 1  # A known distance.
    sigma = {"position": 1e-4, "orientation": 1e-4, "contact": 1e-4, "pixel": 0.5}
    cost = 0.5 * float(np.sum(problem.residual(theta)[-1] ** 2))
    for quantity in problem.measurement.quantities:
        part = shown[:, quantity.columns]
        cost += 0.5 * float(np.nansum((part / sigma[quantity.noise]) ** 2))
        sizes = quantity.errors(shown)
        assert len(sizes) == told[:, quantity.columns].any(axis=1).sum()
    assert problem.cost(theta) == pytest.approx(cost, rel=1e-12)
    (other,) = PopulationCost(problem)(theta[None])
    assert other == pytest.approx(cost, rel=1e-10)


def test_the_noise_of_a_setup_holds_for_its_parts(equipped: Setup) -> None:
    setup = replace(equipped, noise={"position": 3e-5})
    problem = nominal_problem(ARM, "position+pose+plane-contact", setup)
    target = problem.data.target
    zero = np.zeros(len(problem.parameters))
    problem = exact_problem(
        problem,
        zero,
        ARM.random_configurations(len(target), np.random.default_rng(0)),
        target,
    )
    expected = {
        "position": [3e-5] * 3,
        "pose": [3e-5] * 3 + [1e-4] * 3,
        "plane-contact": [1e-4],
    }
    for name, sigma in zip(target, problem.sigma, strict=True):
        told = sigma[np.isfinite(sigma)]
        assert told.tolist() == expected[name.partition(":")[0]]


def test_stated_sigmas_are_those_of_their_rows(simulated: Simulated) -> None:
    """Rows of one part state theirs, those of the other do not."""
    setup = Setup(base_frame=BASE, tool_frame=TOOL, sockets=SOCKETS)
    position, _ = simulated("position", setup, 4)
    fixed, _ = simulated("fixed-point", setup, 4)
    stated = replace(position.data, sigma=np.full((4, 3), 2e-5))
    data = concatenate([stated, fixed.data])
    problem = make_problem(ARM, data, setup)
    assert not states_sigmas(data)
    expected = np.full((8, 6), np.inf)
    expected[:4, :3], expected[4:, 3:] = 2e-5, 1e-4
    np.testing.assert_array_equal(problem.sigma, expected)


# Registration and fits.


def rows_of_all(simulated: Simulated, setup: Setup, **models: int) -> Measurements:
    """Rows of several models on one robot."""
    parts = []
    for model, count in models.items():
        problem, _ = simulated(model.replace("_", "-"), setup, count)
        parts.append(problem.data)
    return concatenate(parts)


@pytest.mark.parametrize("order", [1, -1])
def test_frames_come_first_and_sites_after(simulated: Simulated, order: int) -> None:
    """Sockets stand in the frame of a tracker, which is known when they are put."""
    setup = Setup(
        base_frame=BASE, tool_frame=TOOL, sockets=SOCKETS, planes={"table": TABLE}
    )
    counts = {"fixed_point": 12, "plane_contact": 12, "position": 15}
    data = rows_of_all(simulated, setup, **dict(list(counts.items())[::order]))
    problem = make_problem(ARM, data, Setup())
    assert problem.measurement.missing
    found = registered(problem, np.zeros(len(problem.parameters)))
    zero = np.zeros(len(found.parameters))
    assert np.abs(found.errors(zero)).max() < 1e-9
    located = {reference.name: reference for reference in found.measurement.references}
    np.testing.assert_allclose(located["s/1"].xyz, SOCKETS["s/1"].xyz, atol=1e-9)
    normal = np.array(TABLE.normal) / np.linalg.norm(TABLE.normal)
    np.testing.assert_allclose(located["table"].normal, normal, atol=1e-9)
    np.testing.assert_allclose(found.error.base.translation, BASE.xyz, atol=1e-9)
    np.testing.assert_allclose(found.error.tool.translation, TOOL.xyz, atol=1e-9)


@pytest.mark.parametrize("order", [1, -1])
def test_unknown_points_leave_the_tool_to_others(
    simulated: Simulated, order: int
) -> None:
    """They say nothing of its frame, which poses show."""
    points = {"a": PointSetup((0.05, 0.08, 0.12)), "b": PointSetup((-0.06, 0.03, 0.1))}
    setup = Setup(base_frame=BASE, tool_frame=TOOL, targets=points)
    counts = {"position": 12, "pose": 9}
    data = rows_of_all(simulated, setup, **dict(list(counts.items())[::order]))
    problem = make_problem(ARM, data, Setup())
    found, result = register(problem, np.zeros(len(problem.parameters)))
    np.testing.assert_allclose(found.error.tool.translation, TOOL.xyz, atol=1e-9)
    assert np.abs(found.errors(result.x)).max() < 1e-12


def test_a_camera_beside_a_tracker(equipped_problem: Equipped) -> None:
    """Where it stands and looks is found without a guess."""
    rng = np.random.default_rng(0)
    names = [f"m{k}" for k in range(8)]
    board = {
        name: PointSetup(tuple(rng.uniform(-0.1, 0.1, 3)), False) for name in names
    }
    truth = equipped_problem(ARM, "pose+camera", targets=board)
    zero = np.zeros(len(truth.parameters))
    seen = np.repeat(ARM.random_configurations(10, rng), len(names), axis=0)
    q = np.concatenate([ARM.random_configurations(10, rng), seen])
    target = ("pose:",) * 10 + tuple(f"camera:{name}" for name in names) * 10
    rows = exact_problem(truth, zero, q, target).data
    bare = replace(truth.setup, base_frame=FrameSetup(), tool_frame=FrameSetup())
    problem = make_problem(ARM, rows, bare)
    found = registered(problem, zero)
    stand, site = (f for f in found.measurement.references if isinstance(f, Frame))
    known = [f for f in truth.measurement.references if isinstance(f, Frame)]
    for frame, other in zip((stand, site), known, strict=True):
        np.testing.assert_allclose(
            frame.pose.homogeneous, other.pose.homogeneous, atol=1e-6
        )
    assert np.abs(found.errors(zero)).max() < 1e-3  # A thousandth of a pixel.


def test_each_part_weighs_by_its_sigma(simulated: Simulated) -> None:
    """Sockets that a tracker of half their noise has seen are worth a fifth."""
    setup = Setup(
        parameters=("joint-offset",), base_frame=BASE, tool_frame=TOOL, sockets=SOCKETS
    )
    data = rows_of_all(simulated, setup, position=20, fixed_point=20)
    rng = np.random.default_rng(0)
    off = replace(data, values=data.values + 1e-4 * rng.normal(size=data.values.shape))
    fits = []
    for sigma in (1e-4, 1e-2):
        sigmas = np.full((40, 6), np.inf)
        sigmas[:20, :3], sigmas[20:, 3:] = sigma, 1e-4
        problem = make_problem(ARM, replace(off, sigma=sigmas), setup)
        fits.append(fit(problem, rng))
    gaps = [np.abs(f.problem.errors(f.theta)[20:, 3:]).max() for f in fits]
    # The gap is all that counts where the tracker says nothing.
    assert gaps[1] < 0.05 * gaps[0]


def test_positions_give_the_sockets_their_scale(simulated: Simulated) -> None:
    setup = Setup(base_frame=BASE, tool_frame=TOOL, sockets=SOCKETS)
    data = rows_of_all(simulated, setup, position=30, fixed_point=30)
    fitted = fit(make_problem(ARM, data, Setup()), np.random.default_rng(0))
    assert (fitted.rank, fitted.structure.scaled) == (33, True)
    assert np.abs(fitted.problem.errors(fitted.theta)).max() < 1e-10
    alone = Setup(sockets=SOCKETS, tool_frame=TOOL, planes={"table": TABLE})
    found = calib_pin.identify(ARM, "fixed-point+plane-contact", alone)
    assert not found.identifiability.scale_observable


def test_known_distances_reach_across_parts() -> None:
    """Between a socket and the center of a sphere, say."""
    setup = Setup(
        sockets=SOCKETS,
        tool_frame=TOOL,
        distances=(DistanceSetup(("s/0", "s/1"), 0.5, 1e-5),),
    )
    found = calib_pin.identify(ARM, "fixed-point+relative-distance", setup)
    assert found.identifiability.scale_observable


def test_new_sites_are_located_by_their_measurements(simulated: Simulated) -> None:
    setup = Setup(base_frame=BASE, tool_frame=TOOL, sockets=SOCKETS)
    data = rows_of_all(simulated, setup, position=20, fixed_point=20)
    first = [not name.endswith("s/1") for name in data.target]
    known = replace(setup, sockets={"s/0": SOCKETS["s/0"]})
    problem = make_problem(ARM, data.rows(np.array(first)), known)
    problem = registered(problem, np.zeros(len(problem.parameters)))
    zero = np.zeros(len(problem.parameters))
    wider, theta = extended(problem, zero, data)
    assert [f.name for f in wider.measurement.references] == ["s/0", "s/1"]
    site = wider.measurement.references[1]
    np.testing.assert_allclose(site.xyz, SOCKETS["s/1"].xyz, atol=1e-12)
    assert np.abs(wider.errors(theta)).max() < 1e-12


# What does not go.


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("position+fixed-pont", "unknown measurement model 'fixed-pont'"),
        ("position+", "unknown measurement model ''"),
    ],
)
def test_unknown_parts(name: str, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        measurement_model(name, Setup())


def test_rows_of_an_unknown_socket(simulated: Simulated) -> None:
    setup = Setup(base_frame=BASE, tool_frame=TOOL, sockets=SOCKETS)
    data = rows_of_all(simulated, setup, position=5, fixed_point=5)
    wrong = replace(
        data,
        target=(*data.target[:-1], "fixed-point:s/2"),
        lines=np.arange(1, 11),
        files=("m.csv",) * 10,
    )
    problem = make_problem(ARM, wrong, setup)
    with pytest.raises(InputError, match=r"m\.csv:10: there is no socket 's/2'"):
        registered(problem, np.zeros(len(problem.parameters)))


def test_a_study_lacks_what_a_part_lacks() -> None:
    with pytest.raises(OptionError, match="'sockets' in a setup file"):
        nominal_problem(ARM, "pose+fixed-point", Setup())


def test_pose_of_a_frame() -> None:
    """A turn about screws in their order, as those of base and tool."""
    frame = Frame("camera", "base", pin.exp6(np.array([1.0, 2, 3, 0.3, 0.2, 0.1])))
    instrument = np.array([0.1, 0.0, -0.2, 0.3, -0.1, 0.2])
    expected = frame.pose
    for k in range(6):
        expected = expected * pin.exp6(np.eye(6)[k] * instrument[k])
    moved = frame.rebased(instrument)
    np.testing.assert_allclose(moved.pose.homogeneous, expected.homogeneous, atol=1e-14)
    step = 1e-6
    for k in range(6):
        shift = step * np.eye(6)[k]
        ahead, behind = (frame.rebased(instrument + s).pose for s in (shift, -shift))
        twist = pin.log6(behind.actInv(ahead)).vector / (2.0 * step)
        np.testing.assert_allclose(frame.twists(instrument)[:, k], twist, atol=1e-9)
    stated = frame.stated()
    np.testing.assert_allclose(stated.xyz, frame.pose.translation)
    np.testing.assert_allclose(pin.rpy.rpyToMatrix(*stated.rpy), frame.pose.rotation)
