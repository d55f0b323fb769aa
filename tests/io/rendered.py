"""Rendered images of boards: a known camera, blur and noise."""

from __future__ import annotations

from functools import cache
from itertools import product

import numpy as np
from numpy.typing import NDArray

from calib_pin.io.boards import Detector
from calib_pin.measurement_models.pinhole import Image, undistort
from calib_pin.setup import BoardSetup

Floats = NDArray[np.float64]

SIZE = (640, 480)
INTRINSICS = np.array([700.0, 704.0, 322.3, 236.1, -0.12, 0.05, 4e-4, -3e-4, 0.0])
SCALE = 96
"""Pixels of a square or tag on the sheet."""


def pixels(board: BoardSetup, T: Floats) -> dict[str, Floats]:
    """True pixels of the points, T the pose of the board in the camera."""
    xyz = np.array([p.xyz for p in board.points.values()])
    seen = Image(INTRINSICS, (xyz @ T[:3, :3].T + T[:3, 3]).T).pixels
    return dict(zip(board.points, seen, strict=True))


@cache
def rays() -> list[Floats]:
    """Directions of 3 x 3 rays of every pixel, each shape (pixels, 3)."""
    parts = (np.arange(3) + 0.5) / 3.0 - 0.5
    v, u = np.mgrid[: SIZE[1], : SIZE[0]].astype(float)
    found = []
    for du, dv in product(parts, parts):
        at = np.column_stack([u.ravel() + du, v.ravel() + dv])
        some = undistort((at - INTRINSICS[2:4]) / INTRINSICS[:2], INTRINSICS[4:])
        found.append(np.column_stack([some, np.ones(len(some))]))
    return found


def rendered(
    board: BoardSetup, T: Floats, rng: np.random.Generator, noise: float, blur: float
) -> NDArray[np.uint8]:
    """The image, each pixel the mean of 3 x 3 rays; pixel centers at whole numbers."""
    import cv2

    sheet = sheet_of(board)
    # On the sheet the origin of the board, whose points are at corners of pixels.
    fewer = board.type in ("charuco", "chessboard")
    first = 1.0 if fewer else 0.5 if board.type == "circles" else 0.0
    offset = (first + MARGIN) * board.square
    total = np.zeros(SIZE[::-1])
    R, t = T[:3, :3], T[:3, 3]
    for some in rays():
        local = some @ R
        depth = (t @ R)[2] / local[:, 2]
        xy = depth[:, None] * local[:, :2] - (t @ R)[:2]
        place = (xy + offset) / board.square * SCALE - 0.5
        place = place.reshape(*SIZE[::-1], 2).astype(np.float32)
        total += cv2.remap(
            sheet, place[..., 0], place[..., 1], cv2.INTER_LINEAR, borderValue=160
        )
    image = cv2.GaussianBlur(total / 9.0, (0, 0), blur)
    image = 30.0 + 0.75 * image + noise * rng.normal(size=image.shape)
    return np.clip(image.round(), 0, 255).astype(np.uint8)


MARGIN = 1


def sheet_of(board: BoardSetup) -> NDArray[np.uint8]:
    """The printed board with a white margin of a square."""
    if board.type == "chessboard":
        i, j = np.mgrid[: board.rows, : board.columns]
        cells = np.where((i + j) % 2 == 0, 0, 255).astype(np.uint8)
        drawn = np.kron(cells, np.ones((SCALE, SCALE), np.uint8))
    elif board.type == "circles":
        y, x = (np.arange(SCALE * n) % SCALE for n in (board.rows, board.columns))
        middle = 0.5 * (SCALE - 1)
        inside = np.hypot(y[:, None] - middle, x - middle) < SCALE / 4
        drawn = np.where(inside, 0, 255).astype(np.uint8)
    else:
        drawn = Detector(board).drawn(SCALE)
    return np.pad(drawn, SCALE * MARGIN, constant_values=255)


def pose(rng: np.random.Generator, board: BoardSetup, distance: float) -> Floats:
    """A pose before the camera, the middle of the board near the optical axis."""
    import cv2

    turn = cv2.Rodrigues(rng.uniform(-0.45, 0.45, 3))[0]
    T = np.eye(4)
    T[:3, :3] = turn
    xyz = np.array([p.xyz for p in board.points.values()])
    middle = xyz.mean(axis=0)
    aim = np.array([*rng.uniform(-0.03, 0.03, 2), distance])
    T[:3, 3] = aim - turn @ middle
    return T
