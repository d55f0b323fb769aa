"""Few colors that look like many, and pictures with a palette in a page."""

from __future__ import annotations

import base64
import io

import numpy as np
from PIL import Image

from calib_pin.report.figures.palettes import PNG, with_few_colors, with_palette


def shaded() -> np.ndarray:
    """A gray ramp with colored spots, and nothing in a corner, (60, 80, 4)."""
    image = np.full((60, 80, 4), 255, np.uint8)
    ramp = np.linspace(20.0, 240.0, 60 * 80).reshape(60, 80)
    image[..., :3] = ramp[..., None] + np.array([0.0, 3.0, 6.0])
    image[5:9, 5:9, :3] = 250, 200, 20
    image[30:33, 40:43, :3] = 60, 10, 90
    image[40:, 60:, 3] = np.linspace(0.0, 255.0, 20).astype(np.uint8)
    image[50:, :20] = 0
    return image


def read(address: str) -> Image.Image:
    data = base64.b64decode(address.removeprefix(PNG))
    return Image.open(io.BytesIO(data))


def address(image: np.ndarray) -> str:
    stream = io.BytesIO()
    Image.fromarray(image).save(stream, format="png")
    return PNG + base64.b64encode(stream.getvalue()).decode()


def test_few_colors_are_close_to_many() -> None:
    image = shaded()
    few = with_few_colors(image)
    assert len(np.unique(few.reshape(-1, 4), axis=0)) <= 256
    opaque = image[..., 3] == 255
    away = np.abs(few[opaque].astype(int) - image[opaque])
    assert away.max() <= 12 and away.mean() < 2.0
    np.testing.assert_array_equal(few[50:, :20], 0)
    np.testing.assert_array_equal(few, with_few_colors(image))


def test_few_colors_stay_as_they_are() -> None:
    image = (shaded() // 64) * 64
    image[image[..., 3] == 0] = 0
    np.testing.assert_array_equal(with_few_colors(image), image)
    nothing = np.zeros((3, 4, 4), np.uint8)
    np.testing.assert_array_equal(with_few_colors(nothing), nothing)


def test_a_picture_of_few_colors_gets_a_palette() -> None:
    few = with_few_colors(shaded()).reshape(-1, 4)
    few = few[np.random.default_rng(0).integers(0, len(few), (200, 150))]
    long = address(few)
    short = with_palette(long)
    assert len(short) < 0.7 * len(long)
    assert read(short).mode == "P"
    found = np.asarray(read(short).convert("RGBA"))
    np.testing.assert_array_equal(found, few)


def test_other_pictures_are_left_alone() -> None:
    rng = np.random.default_rng(0)
    many = address(rng.integers(0, 255, (30, 30, 4), np.uint8))
    assert with_palette(many) == many
    small = address(np.zeros((4, 4, 4), np.uint8))
    assert len(with_palette(small)) <= len(small)
    assert with_palette("data:image/jpeg;base64,AA") == "data:image/jpeg;base64,AA"
