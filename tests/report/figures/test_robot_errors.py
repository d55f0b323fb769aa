"""The picture of the robot: its points, its colors, its size, and its bytes."""

from __future__ import annotations

import base64
import io
import re
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import calib_pin
from calib_pin.io.robot_shapes import robot_shapes
from calib_pin.report.figures.robot_errors import POINTS, robot_errors
from tests.report.results import with_errors

LARGEST = 150_000
"""Bytes of the figure in a page."""


def images(svg: str) -> list[np.ndarray]:
    """The images in a figure, shape (h, w, 4) each."""
    found = re.findall(r"data:image/png;base64,([A-Za-z0-9+/=]+)", svg)
    return [
        np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGBA"))
        for data in found
    ]


def yellow(image: np.ndarray) -> int:
    """Pixels in the color of large errors."""
    red, green, blue, opacity = np.moveaxis(image.astype(int), 2, 0)
    return int(((red - blue > 60) & (green - blue > 60) & (opacity > 250)).sum())


def test_errors_are_colored_on_one_scale(calibrated, inline):
    svg = inline["robot-errors"]
    before, after, _ = images(svg)
    assert before.shape == after.shape
    assert yellow(before) > 100 and yellow(after) < 0.1 * yellow(before)
    # The robot and the ground are the same in both.
    same = (before == after).all(axis=2)
    assert 0.9 < same.mean() < 1.0
    words = re.sub("<[^>]*>", " ", svg)
    error = next(e for e in calibrated.errors if e.name == "position")
    first = error.validation_before or error.before
    assert f"{1e3 * first.mean:.0f}" in words and "[mm]" in words


@pytest.mark.slow
def test_unpredictable_errors_look_like_the_largest(draw, calibrated):
    lost = replace(with_errors(calibrated, before=np.inf), errors=())
    svg = draw(robot_errors, lost).svg()
    before, *_ = images(svg)
    assert yellow(before) > 150 and "inf mm" in svg
    unknown = with_errors(calibrated, before=np.nan, after=np.nan)
    assert robot_errors(unknown) is None


@pytest.mark.slow
def test_many_points_and_meshes_make_no_large_page(draw, many, calibrated_robot):
    drawn = draw(robot_errors, many(20_000))
    assert f"{POINTS} of 40000 " in drawn.reading
    assert len(drawn.svg()) < LARGEST
    chain = calib_pin.load_chain("example:ur10_robot", tip="tool0")
    result = calibrated_robot(count=40, robot=chain, validate=False)
    shapes = robot_shapes(chain.robot)
    assert shapes.missing == ()
    simple = draw(robot_errors, result)
    full = draw(lambda r: robot_errors(r, shapes.parts), result)
    assert full.svg() != simple.svg()
    assert max(len(simple.svg()), len(full.svg())) < LARGEST
