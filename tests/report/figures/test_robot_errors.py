"""The picture of the robot: its points, its colors, its size, and its bytes."""

from __future__ import annotations

import base64
import io
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import calib_pin
from calib_pin.io.robot_shapes import robot_shapes
from calib_pin.report.figures.canvas import Drawn
from calib_pin.report.figures.robot_errors import POINTS, robot_errors
from calib_pin.report.figures.robot_scene import SceneImage, best_view, scene_of
from calib_pin.validation.result import CalibrationResult

LARGEST = 150_000
"""Bytes of the figure in a page."""


def images(drawn: Drawn) -> list[np.ndarray]:
    """The images in a figure, shape (h, w, 4) each."""
    found = re.findall(r"data:image/png;base64,([A-Za-z0-9+/=]+)", drawn.svg())
    return [
        np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGBA"))
        for data in found
    ]


def yellow(image: np.ndarray) -> int:
    """Pixels in the color of large errors."""
    red, green, blue, opacity = np.moveaxis(image.astype(int), 2, 0)
    return int(((red - blue > 60) & (green - blue > 60) & (opacity == 255)).sum())


def test_errors_are_colored_on_one_scale(
    draw: Callable[..., Drawn], calibrated: CalibrationResult
) -> None:
    drawn = draw(robot_errors, calibrated)
    assert drawn.name == "robot-errors"
    before, after = images(drawn)
    assert before.shape == after.shape
    assert yellow(before) > 200 and yellow(after) < 0.1 * yellow(before)
    # The robot and the ground are the same in both.
    same = (before == after).all(axis=2)
    assert 0.9 < same.mean() < 1.0
    words = re.sub("<[^>]*>", " ", drawn.svg())
    error = next(e for e in calibrated.errors if e.name == "position")
    first = error.validation_before or error.before
    assert f"before: {1e3 * first.mean:.0f}" in words and "mm on average" in words
    assert "position error [mm]" in words


def test_equal_errors_have_equal_colors(
    draw: Callable[..., Drawn],
    calibrated: CalibrationResult,
    with_errors: Callable[..., CalibrationResult],
) -> None:
    flat = with_errors(calibrated, before=2e-3, after=2e-3)
    before, after = images(draw(robot_errors, replace(flat, held_out=None)))
    np.testing.assert_array_equal(before, after)


def test_unpredictable_errors_look_like_the_largest(
    draw: Callable[..., Drawn],
    calibrated: CalibrationResult,
    with_errors: Callable[..., CalibrationResult],
) -> None:
    lost = replace(with_errors(calibrated, before=np.inf), held_out=None, errors=())
    drawn = draw(robot_errors, lost)
    before, _ = images(drawn)
    assert yellow(before) > 1000
    assert "before: inf mm" in drawn.svg() and "more at the end" in drawn.svg()


def test_nothing_known_is_not_drawn(
    calibrated: CalibrationResult, with_errors: Callable[..., CalibrationResult]
) -> None:
    unknown = with_errors(calibrated, before=np.nan, after=np.nan)
    assert robot_errors(replace(unknown, held_out=None)) is None


def test_very_many_points_are_thinned_and_the_page_stays_small(
    draw: Callable[..., Drawn], many: Callable[[int], CalibrationResult]
) -> None:
    drawn = draw(robot_errors, many(20_000))
    assert f"{POINTS} of 40000 measurements are drawn" in drawn.reading
    assert len(drawn.svg()) < LARGEST


@pytest.mark.parametrize(
    "name",
    ["example:ur10_robot", pytest.param("example:so101", marks=pytest.mark.slow)],
)
def test_meshes_are_drawn_as_small(
    draw: Callable[..., Drawn], calibrated: CalibrationResult, name: str
) -> None:
    tip = {"example:ur10_robot": "tool0", "example:so101": "gripper_frame_link"}[name]
    chain = calib_pin.load_chain(name, tip=tip)
    problem_rows = simulated(chain)
    result = calib_pin.calibrate(chain, problem_rows)
    shapes = robot_shapes(chain.robot)
    assert shapes.missing == ()
    simple = draw(robot_errors, result)
    full = draw(lambda r: robot_errors(r, shapes.parts), result)
    assert full.svg() != simple.svg()
    assert max(len(simple.svg()), len(full.svg())) < LARGEST


def simulated(chain: calib_pin.Chain) -> calib_pin.Observations:
    from calib_pin.estimation.formulation import nominal_problem

    problem = nominal_problem(chain, "position", calib_pin.Setup())
    rng = np.random.default_rng(0)
    theta = calib_pin.draw_errors(problem.parameters, rng)
    return calib_pin.simulate(problem, theta, rng, count=300)


def test_the_view_shows_robot_points_and_ground(calibrated: CalibrationResult) -> None:
    from calib_pin.kinematics.stand_ins import stand_ins

    points = calibrated.fitted.points
    shapes = stand_ins(calibrated.model.chains.robot)
    scene = scene_of(calibrated, shapes, points)
    room = np.array([300.0, 280.0])
    view = best_view(scene, points, 0.01, room)
    assert view.size[0] <= 300 and view.size[1] <= 280
    spots, _ = view.project(np.concatenate([points, scene.frame]))
    assert spots.min() >= 0.0 and (spots <= view.size).all()
    image = SceneImage.of(view, scene).with_balls(
        points, 0.01, np.full((len(points), 3), 0.5)
    )
    assert image.shape == (*view.size[::-1], 4)


TWICE = """
import calib_pin, hashlib
from calib_pin.report.figures import calibration_figures
chain = calib_pin.load_chain("space6")
from tests.report.figures.test_robot_errors import simulated
result = calib_pin.calibrate(chain, simulated(chain))
drawn = next(iter(calibration_figures(result)))
print(drawn.name, hashlib.sha256(drawn.svg().encode()).hexdigest())
"""


@pytest.mark.slow
def test_the_bytes_do_not_depend_on_threads() -> None:
    import os

    found = []
    for threads in ("1", "2"):
        names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
        environment = {**os.environ, **dict.fromkeys(names, threads)}
        child = subprocess.run(
            [sys.executable, "-c", TWICE],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
        found.append(child.stdout)
    assert found[0] == found[1] and found[0].startswith("robot-errors ")
