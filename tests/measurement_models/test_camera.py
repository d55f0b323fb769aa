"""Pixels of known points, seen from the hand or by a camera in the world."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.errors import InputError, OptionError
from calib_pin.estimation.fit import fit
from calib_pin.estimation.formulation import make_problem, nominal_problem
from calib_pin.io.urdf import load_chain
from calib_pin.kinematics.spatial import Floats, invert
from calib_pin.measurement_models.base import CurvedModel
from calib_pin.measurement_models.camera import CameraModel
from calib_pin.measurement_models.camera_start import IMAGES, ROWS, Rays
from calib_pin.measurement_models.pinhole import distort, turning_radius, undistort
from calib_pin.measurement_models.references import Point
from calib_pin.observations import Measurements
from calib_pin.setup import BoardSetup, CameraSetup, FrameSetup, PointSetup, Setup
from calib_pin.simulation import draw_errors, simulate

ARM = load_chain("space6")
LENS = (-0.2, 0.05, 0.002, -0.001, 0.01)
SEEN = CameraSetup("hand", (900.0, 910.0), (640.0, 480.0), LENS, (1280.0, 960.0))
GRID = np.array([[i, j, 0.0] for i in range(4) for j in range(3)]) * 0.04
SPACE = np.random.default_rng(0).uniform(-0.1, 0.1, (10, 3))
MOUNTS = ("hand", "world")

# Where the board is for a camera on the hand, and a camera before the robot.
BASES = {
    "hand": pin.exp6(np.array([0.3, -0.2, 0.4, 0.5, -0.3, 1.0])),
    "world": pin.SE3(
        np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
        @ pin.exp3(np.array([0.1, -0.2, 0.05])),
        np.array([0.0, 1.0, 3.0]),
    ),
}
TOOL = pin.exp6(np.array([0.05, -0.02, 0.1, 0.2, -0.1, 0.4]))


def setup_of(
    mount: str,
    points: Floats,
    estimate: bool = False,
    estimated: tuple[int, ...] = (),
    size: tuple[float, float] | None = (1280.0, 960.0),
) -> Setup:
    targets = {
        f"p{k}": PointSetup((x, y, z), True if k in estimated else None)
        for k, (x, y, z) in enumerate(points.tolist())
    }
    given = replace(SEEN, mount=mount, estimate=estimate, size=size)
    return Setup(camera=given, targets=targets)


def model_of(mount: str, points: Floats, *arguments: object) -> CameraModel:
    return CameraModel.from_setup(setup_of(mount, points, *arguments), ())  # type: ignore[arg-type]


def zero(model: CameraModel) -> Floats:
    return np.zeros(len(model.parameters))


def views(
    model: CameraModel, count: int, seed: int = 0, chain: bool = False
) -> tuple[Floats, tuple[str, ...]]:
    """Tool poses, or joint positions, at which points are seen, each in turn."""
    rng = np.random.default_rng(seed)
    q = ARM.random_configurations(400 * count, rng)
    base = BASES[model.camera.mount].homogeneous
    T = base @ ARM.poses(q) @ TOOL.homogeneous
    names = [model.targets[k % len(model.targets)] for k in range(len(q))]
    seen = np.flatnonzero(model.observable(T, zero(model), names))[:count]
    assert len(seen) == count
    return (q if chain else T)[seen], tuple(names[k] for k in seen)


def data_of(model: CameraModel, T: Floats, target: tuple[str, ...]) -> Measurements:
    values = model.predict(T, zero(model), target)
    return Measurements(
        ("j",),
        np.zeros((len(T), 1)),
        "camera",
        values,
        target=target,
        lines=np.arange(2, len(T) + 2),
        files=("m.csv",) * len(T),
    )


def images(
    model: CameraModel, count: int, seed: int = 0
) -> tuple[Floats, Measurements]:
    """Tip poses and exact rows of all points that are in so many images."""
    rng = np.random.default_rng(seed)
    q = ARM.random_configurations(100 * count, rng)
    base = BASES[model.camera.mount].homogeneous
    T = base @ ARM.poses(q) @ TOOL.homogeneous
    names = model.targets
    seen = [model.observable(T, zero(model), [name] * len(q)) for name in names]
    q = q[np.sum(seen, axis=0) >= min(6, len(names))][:count]
    assert len(q) == count
    rows, target = np.repeat(q, len(names), axis=0), tuple(names) * count
    F = ARM.poses(rows)
    T = base @ F @ TOOL.homogeneous
    seen_rows = model.observable(T, zero(model), target)
    values = np.nan_to_num(model.predict(T, zero(model), target))
    data = Measurements(ARM.joints, rows, "camera", values, target=target)
    return F[seen_rows], data.rows(seen_rows)


# Projection.


def textbook(X: Floats, given: CameraSetup) -> Floats:
    """Zhang's pinhole with the distortion that the OpenCV manual states."""
    x, y = X[0] / X[2], X[1] / X[2]
    k_1, k_2, p_1, p_2, k_3 = given.distortion
    r = np.sqrt(x**2 + y**2)
    radial = 1 + k_1 * r**2 + k_2 * r**4 + k_3 * r**6
    x_2 = x * radial + 2 * p_1 * x * y + p_2 * (r**2 + 2 * x**2)
    y_2 = y * radial + p_1 * (r**2 + 2 * y**2) + 2 * p_2 * x * y
    (f_x, f_y), (c_x, c_y) = given.focal, given.center
    return np.array([f_x * x_2 + c_x, f_y * y_2 + c_y])


@pytest.mark.parametrize("mount", MOUNTS)
def test_pixels(mount: str) -> None:
    model = model_of(mount, SPACE)
    T, target = views(model, 30)
    pixels = model.predict(T, zero(model), target)
    for pose, name, pixel in zip(T, target, pixels, strict=True):
        point = np.append(SPACE[int(name[1:])], 1.0)
        X = (np.linalg.inv(pose) if mount == "hand" else pose) @ point
        np.testing.assert_allclose(pixel, textbook(X[:3], SEEN), atol=1e-9)


def test_axes_of_the_image() -> None:
    plain = replace(SEEN, distortion=(0.0,) * 5)
    points = {"axis": (0.0, 0.0, 2.0), "right": (0.2, 0, 2.0), "down": (0.0, 0.2, 2.0)}
    targets = {name: PointSetup(xyz) for name, xyz in points.items()}
    model = CameraModel.from_setup(Setup(camera=plain, targets=targets), ())
    pixels = model.predict(np.tile(np.eye(4), (3, 1, 1)), zero(model), list(targets))
    np.testing.assert_allclose(pixels, [[640, 480], [730, 480], [640, 571]])


@pytest.mark.parametrize("mount", MOUNTS)
def test_behind_the_camera_there_is_no_pixel(mount: str) -> None:
    model = model_of(mount, GRID, True, (1,))
    T = np.tile(np.eye(4), (3, 1, 1))
    depths = np.array([0.5, 0.0, -0.5])
    T[:, 2, 3] = depths if mount == "world" else -depths
    target, instrument = ("p0", "p1", "p2"), zero(model)
    assert np.isfinite(model.predict(T, instrument, target)).all(axis=1).tolist() == [
        *(True, False, False)
    ]
    assert np.isnan(model.predict(T[1:], instrument, target[1:])).all()
    assert model.observable(T, instrument, target).tolist() == [True, False, False]
    data = Measurements(("j",), T[:, 0, :1], "camera", T[:, :2, 0], None, target)
    linear = model.linearize(T, instrument, data)
    assert np.isfinite(linear.residual).all(axis=1).tolist() == [True, False, False]
    assert np.isnan(linear.J_pose[1:]).any(axis=(1, 2)).all()


# Distortion.


@pytest.mark.parametrize("lens", [(0.0,) * 5, LENS, (0.3, 0.1, 0.003, 0.002, 0.05)])
def test_distortion_is_undone(lens: tuple[float, ...]) -> None:
    coefficients = np.array(lens)
    points = np.random.default_rng(1).uniform(-0.7, 0.7, (200, 2))
    distorted = np.column_stack(distort(*points.T, coefficients))
    np.testing.assert_allclose(undistort(distorted, coefficients), points, atol=1e-11)


def test_rays_of_pixels() -> None:
    model = model_of("world", SPACE)
    T, target = views(model, 20)
    sites = np.array([SPACE[int(name[1:])] for name in target])
    X = np.einsum("nij,nj->ni", T[:, :3, :3], sites) + T[:, :3, 3]
    rays = model.camera.rays(model.predict(T, zero(model), target))
    np.testing.assert_allclose(rays, X[:, :2] / X[:, 2:], atol=1e-12)


def test_distortion_that_folds_back() -> None:
    assert turning_radius(np.zeros(5)) == np.inf
    assert turning_radius(np.array([0.1, 0.02, 0.1, 0.1, 0.0])) == np.inf
    for k in range(5):
        assert turning_radius(1e-320 * np.eye(5)[k]) > 1e6
        assert turning_radius(-1e-320 * np.eye(5)[k]) > 1e6
    # r (1 - r^2 / 3) turns at r = 1, where it is 2/3.
    barrel = np.array([-1.0 / 3.0, 0.0, 0.0, 0.0, 0.0])
    assert turning_radius(barrel) == pytest.approx(1.0)
    pixels = np.array([[0.6, 0.0], [0.0, 0.66], [0.7, 0.0], [0.6, 0.6]])
    assert np.isnan(undistort(pixels, barrel)).any(axis=1).tolist() == [
        *(False, False, True, True)
    ]
    given = replace(SEEN, distortion=tuple(barrel), size=(4000.0, 4000.0))
    points = np.array([[0.99, 0.0, 1.0], [1.01, 0.0, 1.0], [0.8, 0.8, 1.0]])
    targets = {f"p{k}": PointSetup(tuple(p)) for k, p in enumerate(points.tolist())}
    model = CameraModel.from_setup(Setup(camera=given, targets=targets), ())
    T = np.tile(np.eye(4), (3, 1, 1))
    seen = model.observable(T, zero(model), list(targets))
    assert seen.tolist() == [True, False, False]
    # A lens that is estimated folds where its parameters say.
    instrument = zero(model)
    instrument[4] = 0.2
    assert model.observable(T, instrument, list(targets)).all()


def test_the_edges_of_the_image() -> None:
    x = np.array([-0.72, -0.70, 0.70, 0.72])
    points = np.column_stack([x, 0.0 * x, 1.0 + 0.0 * x])
    targets = {f"p{k}": PointSetup(tuple(p)) for k, p in enumerate(points.tolist())}
    plain = replace(SEEN, distortion=(0.0,) * 5)
    for size, expected in (
        ((1280.0, 960.0), [False, True, True, False]),
        ((1280.0, 400.0), [False] * 4),
        # Twice the principal point.
        (None, [False, True, True, False]),
    ):
        model = CameraModel.from_setup(
            Setup(camera=replace(plain, size=size), targets=targets), ()
        )
        seen = model.observable(np.tile(np.eye(4), (4, 1, 1)), zero(model), [*targets])
        assert seen.tolist() == expected


# Derivatives.


@pytest.mark.parametrize("mount", MOUNTS)
@pytest.mark.parametrize("kind", ["marker", "point"])
def test_derivatives(mount: str, kind: str) -> None:
    model = model_of(mount, SPACE, True, (1, 4, 7))
    if kind == "point":
        # Another model may hand over its own, which always have parameters.
        other = Point("p2", "target", SPACE[2], estimate=False)
        kept = [other if p.name == "p2" else p for p in model.points]
        model = model.with_references([model.camera, *kept])
    T, target = views(model, 30)
    data = data_of(model, T, target)
    scales = np.array([p.scale for p in model.parameters])
    instrument = np.random.default_rng(2).normal(size=len(scales)) * scales * 0.02
    linear = model.linearize(T, instrument, data)
    np.testing.assert_array_equal(linear.residual, model.residual(T, instrument, data))
    assert linear.J_instrument.shape == (30, 2, len(instrument))
    step = 1e-6
    for k in range(6):
        shift = pin.exp6(step * np.eye(6)[k])
        ahead = model.residual(T @ shift.homogeneous, instrument, data)
        behind = model.residual(T @ shift.inverse().homogeneous, instrument, data)
        difference = (ahead - behind) / (2 * step)
        np.testing.assert_allclose(linear.J_pose[:, :, k], difference, atol=2e-5)
    for k, scale in enumerate(scales):
        shift = step * scale * np.eye(len(instrument))[k]
        ahead, behind = (
            model.residual(T, instrument + s, data) for s in (shift, -shift)
        )
        difference = (ahead - behind) / (2 * step)
        found = scale * linear.J_instrument[:, :, k]
        np.testing.assert_allclose(found, difference, atol=2e-5)


@pytest.mark.parametrize("mount", MOUNTS)
def test_curvature(mount: str) -> None:
    model = model_of(mount, SPACE, True, (1, 4, 7))
    assert isinstance(model, CurvedModel)
    T, target = views(model, 20)
    scales = np.array([p.scale for p in model.parameters])
    instrument = np.random.default_rng(3).normal(size=len(scales)) * scales * 0.02
    data = data_of(model, T, target)
    curvature = model.curvature(T, instrument, target)
    step = 1e-6
    for k in range(6):
        shift = pin.exp6(step * np.eye(6)[k])
        ahead = model.linearize(T @ shift.homogeneous, instrument, data)
        behind = model.linearize(T @ shift.inverse().homogeneous, instrument, data)
        for found, plus, minus in (
            (curvature.J_pose, ahead.J_pose, behind.J_pose),
            (curvature.J_instrument, ahead.J_instrument, behind.J_instrument),
        ):
            difference = (plus - minus) / (2 * step)
            np.testing.assert_allclose(found[..., k], difference, rtol=1e-7, atol=5e-4)


# Features.


def test_parameters() -> None:
    model = model_of("hand", GRID[:3], True, (1,))
    intrinsics = ["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"]
    assert [p.name for p in model.parameters] == [
        *(f"camera.intrinsics.{name}" for name in intrinsics),
        *(f"p1.target.{c}" for c in "xyz"),
    ]
    assert [p.unit for p in model.parameters] == 4 * ["px"] + 5 * [""] + 3 * ["m"]
    assert all(p.nuisance and p.free for p in model.parameters)
    known = model_of("hand", GRID[:3])
    assert len(known.parameters) == 9
    assert not any(p.free for p in known.parameters)
    assert known.targets == ("p0", "p1", "p2") and known.missing == ""
    assert known.width == 2
    stated = known.declaration
    assert (stated.contact, stated.relative) == (False, False)
    assert stated.external and known.sees_tool


def test_instrument_parameters_move_into_the_references() -> None:
    model = model_of("world", SPACE, True, (2,))
    T, target = views(model, 20)
    instrument = np.array(
        [5.0, -3.0, 2.0, 1.0, 0.01, -0.02, 1e-3, 2e-3, 0.01, 0.1, 0.2, 0.3]
    )
    moved = model.rebased(instrument)
    again = moved.predict(T, zero(moved), target)
    np.testing.assert_array_equal(again, model.predict(T, instrument, target))
    assert [p.name for p in moved.parameters] == [p.name for p in model.parameters]
    stated, *points = (reference.stated() for reference in moved.references)
    assert isinstance(stated, CameraSetup) and stated.estimate
    assert stated.focal == (905.0, 907.0) and stated.size == SEEN.size
    assert stated.center == (642.0, 481.0) and stated.mount == "world"
    np.testing.assert_allclose(stated.distortion, LENS + instrument[4:9])
    assert isinstance(points[2], PointSetup) and points[2].xyz is not None
    np.testing.assert_allclose(points[2].xyz, SPACE[2] + instrument[9:])
    assert points[3] == PointSetup(tuple(SPACE[3].tolist()), False)
    assert model_of("hand", GRID).references[0].stated() == SEEN


def test_only_points_that_rows_name_count() -> None:
    setup = setup_of("hand", GRID[:4])
    targets = {**setup.targets, "p9": PointSetup()}
    setup = replace(setup, targets=targets)
    assert CameraModel.from_setup(setup, ()).targets == ("p0", "p1", "p2", "p3", "p9")
    # A wrong name is met by all that are right.
    assert len(CameraModel.from_setup(setup, ("p0", "q")).points) == 5
    model = CameraModel.from_setup(setup, ("p2", "p0"))
    assert model.targets == ("p0", "p2") and model.missing == ""
    # What is set aside may name others.
    T = np.tile(np.eye(4), (2, 1, 1))
    data = Measurements(
        ("j",), np.zeros((2, 1)), "camera", np.zeros((2, 2)), None, ("p3", "p0")
    )
    wider = model.extended(T, data)
    assert wider.targets == ("p0", "p2", "p3")
    assert model.extended(T, replace(data, target=("p2", "p0"))) is model


def test_noise_and_quantities() -> None:
    model = model_of("hand", GRID)
    (quantity,) = model.quantities
    assert (quantity.name, quantity.unit, quantity.sigma) == ("pixel", "px", 0.5)
    values = np.array([[1.0, 2.0]])
    np.testing.assert_array_equal(model.disturb(values, 2.0 * values), 3.0 * values)


# Boards.

BOARD = BoardSetup("charuco", columns=7, rows=5, square=0.03)


def test_the_corners_of_a_board_are_known_points() -> None:
    setup = Setup(camera=SEEN, board=BOARD)
    model = CameraModel.from_setup(setup, ())
    assert model.targets == tuple(map(str, range(24))) and model.missing == ""
    assert len(model.parameters) == 9 and not any(p.free for p in model.parameters)
    np.testing.assert_allclose(model.points[7].xyz, [0.03, 0.03, 0.0], atol=1e-15)
    # Measurements name those that were seen; others may be named later.
    some = CameraModel.from_setup(setup, ("3", "17"))
    assert some.targets == ("3", "17") and len(some.spare) == 22


@pytest.mark.parametrize("mount", MOUNTS)
def test_a_robot_is_known_from_images_of_a_board(mount: str) -> None:
    rng = np.random.default_rng(7)
    given = replace(SEEN, mount=mount)
    over = pin.SE3(pin.rpy.rpyToMatrix(np.pi, 0.0, 0.0), np.zeros(3))
    # A board on the hand shows its face to the camera there already.
    base = over * BASES[mount] if mount == "hand" else BASES[mount]
    frames = {
        end: FrameSetup(
            tuple(T.translation.tolist()),
            tuple(pin.rpy.matrixToRpy(T.rotation).tolist()),
        )
        for end, T in (("base_frame", base), ("tool_frame", TOOL))
    }
    setup = Setup(camera=given, board=BOARD)
    problem = nominal_problem(ARM, "camera", replace(setup, **frames))
    truth = draw_errors(problem.parameters, rng)
    rows = simulate(problem, truth, rng, count=30, per_configuration=True, noise=0.0)
    assert rows.configurations == 30 and len(rows) > 30 * 6
    # Nothing but the measurements says where the board and the camera are.
    fitted = fit(make_problem(ARM, rows, setup), rng)
    new = simulate(problem, truth, rng, count=50, noise=0.0)
    found = replace(fitted.problem, data=new).errors(fitted.theta)
    assert np.abs(found).max() < 1e-6


@pytest.mark.parametrize("mount", MOUNTS)
def test_a_board_is_seen_from_the_front(mount: str) -> None:
    setup = Setup(camera=replace(SEEN, mount=mount), board=BOARD)
    model = CameraModel.from_setup(setup, ())
    target = ("0",) * 3
    # The camera looks along the normal, against it, and nearly along the board.
    turns = np.array([[0.0, 0, 0], [np.pi, 0, 0], [1.4, 0, 0]])
    T = np.tile(np.eye(4), (3, 1, 1))
    T[:, :3, :3] = [pin.rpy.rpyToMatrix(*turn) for turn in turns]
    for pose in T:
        sight = pose[:3, :3] @ [0.0, 0.0, 1.0]
        pose[:3, 3] = -sight if mount == "hand" else [0.0, 0.0, 1.0]
    seen = model.observable(T, np.zeros(9), target)
    assert seen.tolist() == [True, False, False]
    free = replace(model, printed=False)
    assert free.observable(T, np.zeros(9), target).all()


# Registration.


@pytest.mark.parametrize("mount", MOUNTS)
@pytest.mark.parametrize("points", ["plane", "space", "line", "one"])
@pytest.mark.parametrize("known", ["neither", "base", "tool", "both"])
def test_registration(mount: str, points: str, known: str) -> None:
    board = {"plane": GRID, "space": SPACE, "line": GRID[:2], "one": GRID[4:5]}[points]
    model = model_of(mount, board + np.array([0.02, 0.01, 0.1]))
    F, data = images(model, 8 if len(board) > 2 else 40)
    B = BASES[mount] if known in ("base", "both") else None
    X = TOOL if known in ("tool", "both") else None
    found, base, tool = model.register(F, data, B, X)
    assert found is model
    if B is not None:
        assert base == B
    if X is not None:
        assert tool == X
    T = base.homogeneous @ F @ tool.homogeneous
    residual = found.residual(T, zero(found), data)
    assert np.abs(residual).max() < 1e-6
    if len(board) > 2:
        np.testing.assert_allclose(
            base.homogeneous, BASES[mount].homogeneous, atol=1e-9
        )
        np.testing.assert_allclose(tool.homogeneous, TOOL.homogeneous, atol=1e-9)


@pytest.mark.parametrize("mount", MOUNTS)
@pytest.mark.parametrize("factor", [0.3, 0.7, 1.0, 1.3, 4.0])
@pytest.mark.parametrize("known", ["neither", "both"])
def test_focal_lengths_that_are_estimated_start_from_the_images(
    mount: str, factor: float, known: str
) -> None:
    model = model_of(mount, GRID + np.array([0.02, 0.01, 0.1]))
    F, data = images(model, 8)
    stated = model.camera.with_focal(factor * model.camera.intrinsics[:2])
    B, X = (BASES[mount], TOOL) if known == "both" else (None, None)
    kept = replace(model, camera=stated)
    assert kept.register(F, data, BASES[mount], TOOL)[0].camera is stated
    free = replace(model, camera=replace(stated, estimate=True))
    found, base, _ = free.register(F, data, B, X)
    # As close as three rounds come.
    part = found.camera.intrinsics[:2] / model.camera.intrinsics[:2]
    assert np.abs(part - 1.0).max() < 0.05
    assert np.abs(base.translation - BASES[mount].translation).max() < 0.03


@pytest.mark.parametrize("mount", MOUNTS)
@pytest.mark.parametrize("known", ["neither", "base", "tool"])
@pytest.mark.parametrize("without", ["_images", "_resection"])
def test_either_way_to_a_start_is_exact(
    mount: str, known: str, without: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each of them alone: the better one would hide a mistake in the other."""
    none = np.zeros((0, 4, 4))
    monkeypatch.setattr(
        Rays, without, lambda *_: (none, none) if without == "_images" else iter(())
    )
    model = model_of(mount, GRID)
    F, data = images(model, 20)
    B = BASES[mount] if known == "base" else None
    X = TOOL if known == "tool" else None
    _, base, tool = model.register(F, data, B, X)
    np.testing.assert_allclose(base.homogeneous, BASES[mount].homogeneous, atol=1e-8)
    np.testing.assert_allclose(tool.homogeneous, TOOL.homogeneous, atol=1e-8)


def test_a_start_from_more_images_than_it_takes() -> None:
    model = model_of("world", GRID)
    F, data = images(model, 210)
    assert len(data) > ROWS and len(data) / len(GRID) > IMAGES
    # A wrong name or a wrong pixel in some rows must not count.
    values = data.values.copy()
    values[::97] += 100.0
    _, base, tool = model.register(F, replace(data, values=values), None, None)
    residual = model.residual(
        base.homogeneous @ F @ tool.homogeneous, zero(model), data
    )
    assert np.median(np.abs(residual)) < 3.0


@pytest.mark.parametrize("mount", MOUNTS)
@pytest.mark.parametrize("points", ["plane", "one"])
def test_noise_does_not_spoil_a_start(mount: str, points: str) -> None:
    model = model_of(mount, GRID if points == "plane" else GRID[:1])
    F, data = images(model, 60 if points == "one" else 24)
    rng = np.random.default_rng(4)
    noisy = replace(data, values=data.values + rng.normal(size=data.values.shape))
    _, base, tool = model.register(F, noisy, None, None)
    T = base.homogeneous @ F @ tool.homogeneous
    residual = model.residual(T, zero(model), data)
    assert np.sqrt(np.mean(residual**2)) < 3.0


def test_rows_of_one_image_may_be_apart() -> None:
    model = model_of("hand", GRID)
    F, data = images(model, 4)
    order = np.random.default_rng(5).permutation(len(data))
    _, base, tool = model.register(F[order], data.rows(order), None, None)
    np.testing.assert_allclose(base.homogeneous, BASES["hand"].homogeneous, atol=1e-8)
    np.testing.assert_allclose(tool.homogeneous, TOOL.homogeneous, atol=1e-8)


def test_a_small_tool_is_guessed_where_rows_are_few() -> None:
    model = model_of("world", np.zeros((1, 3)))
    q, target = views(model, 10, chain=True)
    F = ARM.poses(q)
    T = BASES["world"].homogeneous @ F
    data = data_of(model, T, target)
    _, base, tool = model.register(F, data, None, None)
    np.testing.assert_allclose(base.homogeneous, BASES["world"].homogeneous, atol=1e-8)
    assert tool == pin.SE3.Identity()


@pytest.mark.parametrize("mount", MOUNTS)
def test_too_few_rows(mount: str) -> None:
    model = model_of(mount, GRID[:1])
    T, target = views(model, 1)
    data = data_of(model, T, target)
    with pytest.raises(InputError, match=r"^the camera cannot .* \(1\)"):
        model.register(T, data, None, None)


def test_a_start_with_points_behind_the_camera(refused: Callable[..., Any]) -> None:
    model = model_of("hand", GRID)
    T, target = views(model, 3)
    data = data_of(model, T, target)
    away = pin.SE3(pin.exp3(np.array([np.pi, 0.0, 0.0])), np.zeros(3))
    reason = [f"point '{target[0]}' is behind the camera", "'frames' in a setup file"]
    with refused(InputError, reason, file="m.csv", line=2):
        model.register(T, data, pin.SE3.Identity(), away)


@pytest.mark.parametrize(
    ("name", "reason"),
    [("p12", ["no target 'p12'", "did you mean"]), ("", "names no target")],
)
def test_a_point_that_nobody_gave(
    name: str, reason: str | list[str], refused: Callable[..., Any]
) -> None:
    model = model_of("hand", GRID)
    T, target = views(model, 2)
    data = replace(data_of(model, T, target), target=("p0", name))
    with refused(InputError, reason, file="m.csv", line=3, allowed="p0, p1"):
        model.register(T, data, None, None)


def test_a_single_point_needs_no_name() -> None:
    model = model_of("hand", GRID[:1])
    T, target = views(model, 5)
    unnamed = ("",) * 5
    np.testing.assert_array_equal(
        model.predict(T, zero(model), unnamed), model.predict(T, zero(model), target)
    )


@pytest.mark.parametrize(
    ("targets", "text"),
    [
        ({}, "give the xyz of 'a' and 1 more under 'targets'"),
        ({"a": PointSetup((0.0, 0.0, 0.0)), "b": PointSetup()}, "give the xyz of 'b'"),
    ],
)
def test_points_without_a_place(targets: dict[str, PointSetup], text: str) -> None:
    model = CameraModel.from_setup(Setup(camera=SEEN, targets=targets), ("a", "b"))
    assert model.missing.startswith(text) and model.missing.endswith("(--setup)")
    data = Measurements(
        ("j",), np.zeros((2, 1)), "camera", np.zeros((2, 2)), None, ("a", "b")
    )
    with pytest.raises(InputError, match="needs known points: give the xyz of"):
        model.register(np.tile(np.eye(4), (2, 1, 1)), data, None, None)


def test_without_any_points() -> None:
    model = CameraModel.from_setup(Setup(camera=SEEN), ())
    words = "give the xyz under 'targets', or a 'board', in a setup file (--setup)"
    assert model.missing == words


def test_without_a_camera(refused: Callable[..., Any]) -> None:
    needed = "'camera'", "--setup", "mount, focal and center"
    with refused(OptionError, needed, file="s.yaml"):
        CameraModel.from_setup(Setup(file="s.yaml"), ())


@pytest.mark.parametrize("focal", [(0.0, 900.0), (900.0, -1.0), (np.nan, 900.0)])
def test_focal_lengths_are_positive(focal: tuple[float, float]) -> None:
    with pytest.raises(OptionError, match="focal lengths of the camera are positive"):
        CameraModel.from_setup(Setup(camera=replace(SEEN, focal=focal)), ())


def test_the_pose_of_the_camera_is_the_tool() -> None:
    """On the hand X = T^-1 P, in the world X = T P: one is the other reversed."""
    hand, world = model_of("hand", SPACE), model_of("world", SPACE)
    T, target = views(hand, 10)
    np.testing.assert_allclose(
        hand.predict(T, zero(hand), target),
        world.predict(invert(T), zero(world), target),
        atol=1e-9,
    )
