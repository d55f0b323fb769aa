"""Pixels of known points, seen from the hand or by a camera in the world."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.errors import InputError, OptionError
from calib_pin.estimation.fit import fit
from calib_pin.estimation.formulation import make_problem, nominal_problem
from calib_pin.io.urdf import load_chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.camera import CameraModel
from calib_pin.measurement_models.pinhole import distort, turning_radius, undistort
from calib_pin.observations import Measurements
from calib_pin.setup import BoardSetup, CameraSetup, FrameSetup, PointSetup, Setup
from calib_pin.simulation import draw_errors, simulate
from tests.shared import refused, rows_of

ARM = load_chain("space6")
LENS = (-0.2, 0.05, 0.002, -0.001, 0.01)
SEEN = CameraSetup("hand", (900.0, 910.0), (640.0, 480.0), LENS, (1280.0, 960.0))
GRID = np.array([[i, j, 0.0] for i in range(4) for j in range(3)]) * 0.04
SPACE = np.random.default_rng(0).uniform(-0.1, 0.1, (10, 3))
MOUNTS = ("hand", "world")
BOARD = BoardSetup("charuco", columns=7, rows=5, square=0.03)

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


@pytest.mark.parametrize("mount", MOUNTS)
def test_behind_the_camera_there_is_no_pixel(mount: str) -> None:
    model = model_of(mount, GRID, True, (1,))
    T = np.tile(np.eye(4), (3, 1, 1))
    depths = np.array([0.5, 0.0, -0.5])
    T[:, 2, 3] = depths if mount == "world" else -depths
    target, instrument = ("p0", "p1", "p2"), zero(model)
    seen, pixels = [True, False, False], model.predict(T, instrument, target)
    assert np.isfinite(pixels).all(axis=1).tolist() == seen
    assert model.observable(T, instrument, target).tolist() == seen
    data = Measurements(("j",), T[:, 0, :1], "camera", T[:, :2, 0], None, target)
    linear = model.linearize(T, instrument, data)
    assert np.isfinite(linear.residual).all(axis=1).tolist() == seen
    assert np.isnan(linear.J_pose[1:]).any(axis=(1, 2)).all()


# Distortion.


@pytest.mark.parametrize("lens", [(0.0,) * 5, LENS, (0.3, 0.1, 0.003, 0.002, 0.05)])
def test_distortion_is_undone(lens: tuple[float, ...]) -> None:
    coefficients = np.array(lens)
    points = np.random.default_rng(1).uniform(-0.7, 0.7, (200, 2))
    distorted = np.column_stack(distort(*points.T, coefficients))
    np.testing.assert_allclose(undistort(distorted, coefficients), points, atol=1e-11)


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
    folded = np.isnan(undistort(pixels, barrel)).any(axis=1)
    assert folded.tolist() == [False, False, True, True]
    points = np.array([[0.99, 0.0, 1.0], [1.01, 0.0, 1.0], [0.8, 0.8, 1.0]])
    setup = setup_of("hand", points, size=(4000.0, 4000.0))
    given = replace(setup.camera, distortion=tuple(barrel))
    model = CameraModel.from_setup(replace(setup, camera=given), ())
    T = np.tile(np.eye(4), (3, 1, 1))
    seen = model.observable(T, zero(model), model.targets)
    assert seen.tolist() == [True, False, False]
    # A lens that is estimated folds where its parameters say.
    instrument = zero(model)
    instrument[4] = 0.2
    assert model.observable(T, instrument, model.targets).all()


def test_the_edges_of_the_image() -> None:
    x = np.array([-0.72, -0.70, 0.70, 0.72])
    points = np.column_stack([x, 0.0 * x, 1.0 + 0.0 * x])
    T, inside = np.tile(np.eye(4), (4, 1, 1)), [False, True, True, False]
    for size, expected in (
        ((1280.0, 960.0), inside),
        ((1280.0, 400.0), [False] * 4),
        # Twice the principal point.
        (None, inside),
    ):
        setup = setup_of("hand", points, size=size)
        plain = replace(setup.camera, distortion=(0.0,) * 5)
        model = CameraModel.from_setup(replace(setup, camera=plain), ())
        seen = model.observable(T, zero(model), model.targets)
        assert seen.tolist() == expected


def test_derivatives_of_a_camera_on_the_hand() -> None:
    """Those of a camera in the world are in `test_jacobians`."""
    model = model_of("hand", SPACE, True, (1, 4, 7))
    T, target = views(model, 30)
    data = rows_of("camera", model.predict(T, zero(model), target), *target)
    scales = np.array([p.scale for p in model.parameters])
    instrument = np.random.default_rng(2).normal(size=len(scales)) * scales * 0.02
    linear = model.linearize(T, instrument, data)
    step = 1e-6
    for k in range(6):
        moved = [T @ pin.exp6(s * np.eye(6)[k]).homogeneous for s in (step, -step)]
        ahead, behind = (model.linearize(M, instrument, data) for M in moved)
        slope = (ahead.residual - behind.residual) / (2 * step)
        np.testing.assert_allclose(linear.J_pose[:, :, k], slope, atol=2e-5)
    for k, scale in enumerate(scales):
        shift = step * scale * np.eye(len(instrument))[k]
        ahead, behind = (
            model.residual(T, instrument + s, data) for s in (shift, -shift)
        )
        found = scale * linear.J_instrument[:, :, k]
        np.testing.assert_allclose(found, (ahead - behind) / (2 * step), atol=2e-5)


# Features.


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


@pytest.mark.parametrize(
    ("mount", "points", "known"),
    [
        ("hand", "plane", "neither"),
        ("world", "plane", "base"),
        ("hand", "space", "tool"),
        ("world", "space", "neither"),
        ("hand", "line", "base"),
        ("world", "line", "neither"),
        ("hand", "one", "both"),
        ("world", "one", "tool"),
    ],
)
def test_registration(mount: str, points: str, known: str) -> None:
    board = {"plane": GRID, "space": SPACE, "line": GRID[:2], "one": GRID[4:5]}[points]
    model = model_of(mount, board + np.array([0.02, 0.01, 0.1]))
    F, data = images(model, 8 if len(board) > 2 else 40)
    if points == "plane":
        # Rows of one image may be apart.
        order = np.random.default_rng(5).permutation(len(data))
        F, data = F[order], data.rows(order)
    B = BASES[mount] if known in ("base", "both") else None
    X = TOOL if known in ("tool", "both") else None
    found, base, tool = model.register(F, data, B, X)
    assert found is model
    assert B is None or base == B
    assert X is None or tool == X
    T = base.homogeneous @ F @ tool.homogeneous
    # Pixels by hundreds, of frames that are known to 1e-9 of their reach.
    assert np.abs(found.residual(T, zero(found), data)).max() < 1e-6
    if len(board) > 2:
        for one, true in ((base, BASES[mount]), (tool, TOOL)):
            np.testing.assert_allclose(one.homogeneous, true.homogeneous, atol=1e-8)


@pytest.mark.parametrize(
    ("mount", "factor", "known"),
    [
        ("hand", 0.3, False),
        ("world", 1.3, False),
        ("world", 4.0, False),
        ("hand", 0.7, True),
    ],
)
def test_focal_lengths_that_are_estimated_start_from_the_images(
    mount: str, factor: float, known: bool
) -> None:
    model = model_of(mount, GRID + np.array([0.02, 0.01, 0.1]))
    F, data = images(model, 8)
    stated = model.camera.with_focal(factor * model.camera.intrinsics[:2])
    B, X = (BASES[mount], TOOL) if known else (None, None)
    kept = replace(model, camera=stated)
    assert kept.register(F, data, BASES[mount], TOOL)[0].camera is stated
    free = replace(model, camera=replace(stated, estimate=True))
    found, base, _ = free.register(F, data, B, X)
    # As close as three rounds come.
    part = found.camera.intrinsics[:2] / model.camera.intrinsics[:2]
    assert np.abs(part - 1.0).max() < 0.05
    assert np.abs(base.translation - BASES[mount].translation).max() < 0.03


def test_what_cannot_be_registered() -> None:
    model = model_of("hand", GRID)
    T, target = views(model, 3)
    data = rows_of("camera", model.predict(T, zero(model), target), *target)
    with refused(InputError):
        model.register(T[:1], data.rows(np.arange(1)), None, None)
    # All points are behind the camera.
    away = pin.SE3(pin.exp3(np.array([np.pi, 0.0, 0.0])), np.zeros(3))
    with refused(InputError, file="m.csv", line=2):
        model.register(T, data, pin.SE3.Identity(), away)
    for name in ("p12", ""):
        wrong = replace(data, target=("p0", name, "p1"))
        with refused(InputError, file="m.csv", line=3):
            model.register(T, wrong, None, None)


def test_cameras_that_cannot_be() -> None:
    """Without points, points without a place, no camera, and bad focal lengths."""
    assert CameraModel.from_setup(Setup(camera=SEEN), ()).missing
    targets = {"a": PointSetup((0.0, 0.0, 0.0)), "b": PointSetup()}
    model = CameraModel.from_setup(Setup(camera=SEEN, targets=targets), ("a", "b"))
    assert "'b'" in model.missing
    data = rows_of("camera", np.zeros((2, 2)), "a", "b")
    with refused(InputError, "'b'"):
        model.register(np.tile(np.eye(4), (2, 1, 1)), data, None, None)
    with refused(OptionError, "'camera'", file="s.yaml"):
        CameraModel.from_setup(Setup(file="s.yaml"), ())
    for focal in ((0.0, 900.0), (900.0, -1.0), (np.nan, 900.0)):
        with refused(OptionError):
            CameraModel.from_setup(Setup(camera=replace(SEEN, focal=focal)), ())
