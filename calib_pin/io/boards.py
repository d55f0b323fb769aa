"""Corners of calibration boards and tags in images, found by OpenCV, which is an extra.

The decoders of images are foreign code: only formats of cameras get to them, and
headers that promise more than a large sensor has are refused before anything is
decoded.
"""

from __future__ import annotations

import io
import os
from contextlib import suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import InputError, OptionError
from calib_pin.io.files import read_bytes
from calib_pin.observations.corners import corner_sigmas, marker_corners, noise_of
from calib_pin.setup import BoardSetup, CameraSetup
from calib_pin.setup.references import TAGS

PIXELS = 1 << 27
"""Most pixels of an image."""

LARGEST = 1 << 30
"""Most bytes of an image file."""

FORMATS = (
    *(b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"BM", b"II*\0", b"MM\0*"),
    *(b"P2", b"P3", b"P5", b"P6"),
)
"""First bytes of PNG, JPEG, BMP, TIFF, and portable gray and color maps."""

Gray = NDArray[np.uint8]


def vision() -> Any:
    """OpenCV, with a limit on images and without words of its own.

    Raises:
        OptionError: If the extra is missing.
    """
    if find_spec("cv2") is None:
        raise OptionError(
            "images need OpenCV, which is missing: pip install 'calib-pin[vision]'"
        )
    # It reads these where it is loaded.
    os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(PIXELS))
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
    import cv2

    return cv2


def read_image(path: Path) -> Gray:
    """The gray levels of an image as the sensor has them, shape (height, width).

    Colors become gray, transparency is dropped, and more than 8 bits are scaled. A
    note in the file that the image be turned is not followed.

    Raises:
        InputError: If the file is no image, is damaged, or has too many pixels.
        OptionError: If the extra is missing.
    """
    cv2 = vision()
    data = read_bytes(path, LARGEST)
    if not data.startswith(FORMATS):
        allowed = "PNG, JPEG, BMP, TIFF, PGM, PPM"
        raise InputError("is no image", file=path, allowed=allowed)
    flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    image = None
    with suppress(cv2.error, MemoryError):
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    if image is None:
        reason = f"cannot be read: it is damaged, or has more than {PIXELS} pixels"
        raise InputError(reason, file=path)
    if image.dtype != np.uint8:
        # Sensors of 10 to 14 bits leave the upper ones empty.
        levels = np.nan_to_num(image.astype(float), posinf=0.0, neginf=0.0)
        image = (levels * (255.0 / max(float(levels.max()), 1e-300))).round()
    return np.asarray(image, np.uint8)


def encode_png(image: Gray, density: float) -> bytes:
    """A PNG file of gray levels that prints at its size.

    Args:
        image: Gray levels, shape (height, width).
        density: Pixels per meter.
    """
    from PIL import Image

    data, per_inch = io.BytesIO(), 0.0254 * density
    Image.fromarray(image).save(data, "PNG", dpi=(per_inch, per_inch))
    return data.getvalue()


Floats = NDArray[np.float64]

FORM = (
    "TYPE:COLUMNSxROWS:SQUARE[:MARKER or GAP][:DICTIONARY][:legacy], such as "
    "charuco:7x5:0.03:0.022:DICT_4X4_50"
)

WINDOWS = (2, 7)
"""Least and largest half width of the window in which a corner is refined [px]."""

STEPS = 60, 1e-4
"""Most steps of a refinement, and the one after which it ends [px]."""

OFF_CENTER = 0.08
"""Standard deviation of the center of a circle [px]: perspective draws the middle of an
ellipse off it, by 0.065 px in rendered images, whatever their noise."""

VIEWS = 3
"""Images from which intrinsics are estimated."""

CORNERS = 8
"""Corners that each of them has at least."""

ASSUMED = 1.2
"""Focal length that is assumed without them, in widths or heights of the image."""


@dataclass(frozen=True)
class Found:
    """The corners of a board in one image.

    Attributes:
        names: Names of the corners.
        pixels: Corners (u, v), pixel centers at whole numbers, shape (N, 2) [px].
        sigma: Standard deviations, shape (N, 2) [px].
    """

    names: tuple[str, ...]
    pixels: Floats
    sigma: Floats


def board_of(word: str) -> BoardSetup:
    """The board that a word such as `charuco:7x5:0.03:0.022` states.

    Raises:
        OptionError: If it states none.
    """
    from calib_pin.io.setup import setup_of

    kind, grid, square, *rest = f"{word}::".split(":")
    columns, _, rows = grid.partition("x")
    stated: dict[str, object] = {"type": kind, "columns": columns, "rows": rows}
    stated["square"] = square
    for part in filter(None, rest):
        size = "marker" if kind == "charuco" else "gap"
        name = "dictionary" if part.startswith("DICT_") else size
        stated |= {"legacy": True} if part == "legacy" else {name: part}
    try:
        board = setup_of({"board": stated}).board
    except ValueError:
        raise OptionError("--board is no board", value=word, allowed=FORM) from None
    assert board is not None
    return board


class Detector:
    """Finds one board in images."""

    def __init__(self, board: BoardSetup) -> None:
        """Set it up.

        Args:
            board: The board.

        Raises:
            OptionError: If the board does not say all, or the extra is missing.
        """
        self.board, self._cv2 = board, vision()
        self.points = {n: p.xyz or (0.0, 0.0, 0.0) for n, p in board.points.items()}
        if board.type in ("charuco", *TAGS):
            self._search = self._tags_search()

    def find(self, image: Gray) -> Found | None:
        """The board in an image; None where it is not there."""
        kind = self.board.type
        search = self._grid if kind in ("chessboard", "circles") else self._tags
        names, pixels = search(image)
        if not names:
            return None
        if kind == "circles":
            return Found(names, pixels, np.full(pixels.shape, OFF_CENTER))
        half, levels = self._half(names, pixels), image.astype(float)
        if kind in TAGS:
            tags = np.split(pixels, len(pixels) // 4)
            met = [marker_corners(levels, four, self._cells) for four in tags]
            fine, sigma = (np.concatenate(part) for part in zip(*met, strict=True))
        else:
            cv2 = self._cv2
            rough = np.ascontiguousarray(pixels, np.float32).reshape(-1, 1, 2)
            criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, *STEPS)
            fine = cv2.cornerSubPix(image, rough, (half, half), (-1, -1), criteria)
            fine = np.asarray(fine, float).reshape(-1, 2)
            sigma = corner_sigmas(levels, fine, half, noise_of(levels))
        # A corner that ran away was none; one at the edge of the image has no window.
        edge = np.array(image.shape[::-1]) - 1.0 - half
        kept = np.hypot(*(fine - pixels).T) < half
        kept &= ((fine >= half) & (fine <= edge)).all(axis=1)
        names = tuple(n for n, keep in zip(names, kept, strict=True) if keep)
        return Found(names, fine[kept], sigma[kept]) if names else None

    def drawn(self, pixels: int) -> Gray:
        """A board to print, so many pixels to a square.

        Raises:
            OptionError: If OpenCV draws no such board.
        """
        board = self.board
        if board.type not in ("charuco", *TAGS):
            raise OptionError("--draw draws boards with markers only", value=board.type)
        size = self.extent * (pixels / board.square)
        width, height = np.round(size).astype(int).tolist()
        return np.asarray(self._board.generateImage((width, height)), np.uint8)

    @property
    def extent(self) -> Floats:
        """Width and height of the printed board [m]."""
        counts = np.array([self.board.columns, self.board.rows], float)
        gap = self.board.gap or 0.0
        return np.asarray(counts * (self.board.square + gap) - gap)

    def _tags_search(self) -> Any:
        """The detector of tags; the board as it is drawn is kept."""
        board, aruco = self.board, self._cv2.aruco
        usual = "DICT_APRILTAG_36h11" if board.type == "apriltag" else "DICT_4X4_50"
        name, size = board.dictionary or usual, (board.columns, board.rows)
        dictionary = aruco.getPredefinedDictionary(getattr(aruco, name))
        charuco, known = board.type == "charuco", len(dictionary.bytesList)
        if charuco and board.marker is None:
            raise OptionError("a charuco board is found by the edge of its 'marker'")
        # The white squares: of an odd number of squares the first one is black.
        last = board.first + board.columns * board.rows // (2 if charuco else 1) - 1
        if last >= known:
            reason, allowed = f"the board has tags up to {last}", f"more than {known}"
            raise OptionError(reason, value=name, allowed=f"a dictionary of {allowed}")
        ids = np.arange(board.first, last + 1, dtype=np.int32)
        self._cells = dictionary.markerSize + 2
        settings = aruco.DetectorParameters()
        if charuco:
            lengths = (board.square, board.marker)
            self._board = aruco.CharucoBoard(size, *lengths, dictionary, ids)
            self._board.setLegacyPattern(board.legacy)
            return aruco.CharucoDetector(self._board, detectorParams=settings)
        settings.cornerRefinementMethod = aruco.CORNER_REFINE_SUBPIX
        lengths = (board.square, board.gap or board.square)
        self._board = aruco.GridBoard(size, *lengths, dictionary, ids)
        return aruco.ArucoDetector(dictionary, settings)

    def _tags(self, image: Gray) -> tuple[tuple[str, ...], Floats]:
        if self.board.type == "charuco":
            corners, ids, _, _ = self._search.detectBoard(image)
            # OpenCV numbers them as the model does, row by row from 0.
            names = [str(k) for k in np.ravel([] if ids is None else ids)]
        else:
            around, found, _ = self._search.detectMarkers(image)
            every = [*np.ravel([] if found is None else found)]
            # A tag that is there twice, or is none of the board, tells nothing.
            good = [f"{k}/0" in self.points and every.count(k) == 1 for k in every]
            pairs = [(k, c) for k, c, ok in zip(every, around, good, strict=True) if ok]
            names = [f"{k}/{n}" for k, _ in pairs for n in range(4)]
            corners = [four for _, four in pairs]
        pixels = np.array(corners if names else [], float)
        return tuple(names), pixels.reshape(-1, 2)

    def _grid(self, image: Gray) -> tuple[tuple[str, ...], Floats]:
        cv2, board = self._cv2, self.board
        chess = board.type == "chessboard"
        size = (board.columns - chess, board.rows - chess)
        if chess:
            seen, points = cv2.findChessboardCornersSB(
                image, size, flags=cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
            )
        else:
            seen, points = cv2.findCirclesGrid(image, size)
        if not seen:
            return (), np.empty((0, 2))
        given = np.asarray(points, float).reshape(size[1], size[0], 2)
        ways = [np.rot90(grid, k) for grid in (given, given[::-1]) for k in range(4)]
        ways = [w for w in ways if w.shape == given.shape and _turn(w) > 0.0]
        dark = [w for w in ways if chess and _first_is_dark(image, w)]
        chosen = min(dark or ways, key=lambda way: float(way[0, 0].sum()))
        pixels = chosen.reshape(-1, 2)
        return tuple(map(str, range(len(pixels)))), pixels

    def _half(self, names: tuple[str, ...], pixels: Floats) -> int:
        """Half width of the window of a corner, in which there is no other edge."""
        sites = np.array([self.points[name][:2] for name in names])
        apart = np.linalg.norm(sites[:, None] - sites, axis=2)
        seen = np.linalg.norm(pixels[:, None] - pixels, axis=2)
        near = (apart > 0.0) & (apart < 1.5 * self.board.square)
        scale = float((seen[near] / apart[near]).min()) if near.any() else 0.0
        free = 0.4 * self.board.square
        if self.board.type == "charuco":
            # To the corner of the marker in the square, along each axis.
            free = 0.9 * 0.5 * (self.board.square - (self.board.marker or 0.0))
        elif self.board.type in TAGS:
            free = 0.9 * self.board.square / self._cells
        return int(np.clip(scale * free, *WINDOWS))


def ambiguous(board: BoardSetup) -> bool:
    """Whether a board looks the same from two sides."""
    if board.type == "circles":
        return True
    return board.type == "chessboard" and (board.columns + board.rows) % 2 == 0


def start_camera(
    mount: Literal["hand", "world"],
    board: Detector,
    size: tuple[int, int],
    images: list[Found],
) -> tuple[CameraSetup, float | None]:
    """Intrinsics to start from, and their rms [px]; None where they are assumed.

    Args:
        mount: `hand` or `world`.
        board: The board.
        size: Width and height of the images [px].
        images: The corners in each.
    """
    cv2, largest = vision(), max(size)
    center = ((size[0] - 1) / 2.0, (size[1] - 1) / 2.0)
    focal = (ASSUMED * largest, ASSUMED * largest)
    assumed = CameraSetup(mount, focal, center, size=size, estimate=True)
    usable = [image for image in images if len(image.names) >= CORNERS]
    if len(usable) < VIEWS:
        return assumed, None
    sites = [np.array([board.points[n] for n in i.names], np.float32) for i in usable]
    pixels = [image.pixels.astype(np.float32) for image in usable]
    # The sixth power of the radius is left to the calibration.
    about = (size, None, None, None, None, cv2.CALIB_FIX_K3)
    try:
        rms, K, lens, *_ = cv2.calibrateCamera(sites, pixels, *about)
    except cv2.error:  # Corners on a line.
        return assumed, None
    numbers = np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *np.ravel(lens)[:5]])
    sane = (0.1 * largest < numbers[:2]) & (numbers[:2] < 100.0 * largest)
    if not (np.isfinite(numbers).all() and sane.all()):
        return assumed, None
    # A start needs no more digits.
    fx, fy, cx, cy = (round(float(number), 3) for number in numbers[:4])
    k_1, k_2, p_1, p_2, k_3 = (round(float(number), 6) for number in numbers[4:])
    distortion = (k_1, k_2, p_1, p_2, k_3)
    camera = CameraSetup(mount, (fx, fy), (cx, cy), distortion, size, estimate=True)
    return camera, float(rms)


def _turn(grid: Floats) -> float:
    """Positive where rows run as they do on a board that is seen from the front."""
    x, y = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    return float(x[0] * y[1] - x[1] * y[0])


def _first_is_dark(image: Gray, grid: Floats) -> bool:
    """Whether the square outside the first corner is darker than its neighbors."""
    x, y = grid[0, 1] - grid[0, 0], grid[1, 0] - grid[0, 0]
    around = grid[0, 0] + 0.5 * np.array([-x - y, x - y, x + y, y - x])
    edge = np.array(image.shape[::-1]) - 1
    u, v = np.clip(np.round(around).astype(int), 0, edge).T
    levels = image[v, u].astype(float)
    return bool(levels[0] + levels[2] < levels[1] + levels[3])
