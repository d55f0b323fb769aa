"""What images show of a board is held against how it was stated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib_pin.io.boards import View, board_of, fit_board, tags_of, whole_grid, word_of

pytestmark = pytest.mark.needs("vision")

WRONG = [
    ("apriltag:6x4:0.03:0.009", "apriltag:4x6:0.03:0.009"),
    ("apriltag:6x4:0.03:0.009", "apriltag:6x4:0.03:0.3"),
    ("apriltag:6x4:0.03:0.009", "apriltag:5x4:0.03:0.0108"),
    ("marker:5x3:0.04:0.01:first=7", "marker:5x3:0.04:0.01"),
    ("marker:5x3:0.04:0.01:first=7", "marker:5x3:0.04:0.01:first=60"),
    ("marker:1x1:0.04:first=7", "marker:1x1:0.04"),
    ("charuco:7x5:0.03:0.0222", "charuco:5x7:0.03:0.0222"),
    ("charuco:7x5:0.03:0.0222", "charuco:7x5:0.03:0.018"),
    ("charuco:8x6:0.03:0.0222:legacy", "charuco:8x6:0.03:0.0222"),
]


def seen(board, rng, count=2):
    """Tags of a board in views of it, some hidden, with a noise of 0.1 px."""
    charuco, images = board.type == "charuco", []
    shift = int(board.legacy and board.rows % 2 == 0)
    y, x = np.indices((board.rows, board.columns)).reshape(2, -1)
    on = (x + y + shift) % 2 == 1 if charuco else x >= 0
    pitch = board.square + (board.gap or 0.0)
    edge = board.marker if charuco else board.square
    corners = edge * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    for _ in range(count):
        turn = rng.uniform(-np.pi, np.pi)
        view = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        view = view @ (np.eye(2) + rng.uniform(-0.3, 0.3, (2, 2)))
        tilt = rng.uniform(-1.0, 1.0, 2)
        tags = {}
        for k, column, row in zip(tags_of(board), x[on], y[on], strict=True):
            xy = pitch * np.array([column, row]) + corners
            pixels = 1500.0 * (xy @ view.T) / (1.0 + xy @ tilt)[:, None]
            tags[k] = pixels + 0.1 * rng.normal(size=(4, 2)), np.ones((4, 2))
        images.append(View(tags=tags))
    tags.pop(next(iter(tags)))
    return images


@pytest.mark.parametrize(("true", "stated"), WRONG)
def test_tags_say_which_board_they_are_of(true, stated):
    board = board_of(true)
    images = seen(board, np.random.default_rng(5))
    assert word_of(fit_board(board_of(stated), images)) == true
    assert fit_board(board, images) == board


def test_tags_beside_the_board_are_not_of_it():
    """Another board that stands elsewhere in the image, of the numbers that follow."""
    board = board_of("marker:4x3:0.03:0.009")
    rng = np.random.default_rng(2)
    (image,) = seen(board, rng, 1)
    (other,) = seen(replace(board, columns=5, first=12), rng, 1)
    beside = {k: (four + 2000.0, sigma) for k, (four, sigma) in other.tags.items()}
    image = View(tags={**image.tags, **beside})
    assert fit_board(board, [image]) == board
    # Of another one nothing is said; the camera does not fit it.
    assert fit_board(replace(board, columns=3, rows=4), [image]) is None


@pytest.mark.parametrize("circles", [False, True])
def test_lines_outside_a_grid_are_seen(circles):
    """A board of 7 x 5 points, of which all, or fewer, are taken."""
    y, x = np.indices((321, 401)) / 40.0 - 2.0
    inside = (abs(x - 3.0) < 4.0) & (abs(y - 2.0) < 3.0)
    dark = np.floor(x) % 2 == np.floor(y) % 2
    if circles:
        dark = np.hypot(x - x.round(), y - y.round()) < 0.25
        inside &= (abs(x - 3.0) < 3.5) & (abs(y - 2.0) < 2.5)
    image = np.where(inside & dark, 20.0, 200.0)
    grid = 80.0 + 40.0 * np.stack(np.meshgrid(np.arange(7.0), np.arange(5.0)), axis=-1)
    grid -= 0.5 * (not circles)
    for part, whole in ((grid, True), (grid[:-1], False), (grid[1:, :-1], False)):
        assert whole_grid(image, part, circles) == (whole, True)
    assert not whole_grid(image[:, :-110], grid[:, :-2], circles)[1]
