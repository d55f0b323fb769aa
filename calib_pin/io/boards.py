"""Corners of calibration boards and tags in images, found by OpenCV, which is an extra.

The decoders of images are foreign code: only formats of cameras get to them, and
headers that promise more than a large sensor has are refused before anything is
decoded.
"""

from __future__ import annotations

import io
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import InputError, OptionError
from calib_pin.io.board_fit import (
    Lines,
    compared,
    lines_of,
    restated_lines,
    restated_tags,
    tags_of,
)
from calib_pin.io.files import read_bytes
from calib_pin.observations.corners import corner_sigmas, marker_corners, noise_of
from calib_pin.setup import DICTIONARIES, TAGS, BoardSetup, CameraSetup
from calib_pin.setup.arguments import Refused, Taker

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

GRIDS = ("chessboard", "circles")
"""Types of boards without markers."""


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
    "TYPE:COLUMNSxROWS:SQUARE[:MARKER or GAP][:DICTIONARY][:first=N][:legacy], such as "
    "charuco:7x5:0.03:0.022:DICT_4X4_50"
)

WINDOWS = (2, 7)
"""Least and largest half width of the window in which a corner is refined [px]."""

STEPS = 60, 1e-4
"""Most steps of a refinement, and the one after which it ends [px]."""

OFF_CENTER = 0.08
"""Standard deviation of the center of a circle [px]: perspective draws the middle of an
ellipse off it, by 0.065 px in rendered images, whatever their noise."""

TRIES = 4
"""Times that a board is restated until images agree with it."""

NEAR = (0, 1, -1)
"""By how many columns and rows a grid may be stated wrong."""

MARKED = 2
"""Images in which markers of other dictionaries are looked for."""

VIEWS = 3
"""Images from which intrinsics are estimated."""

CORNERS = 8
"""Corners that each of them has at least."""

ASSUMED = 1.2
"""Focal length that is assumed without them, in widths or heights of the image."""

UNKNOWN = 0.1
"""Standard deviation of a focal length, as part of it, that images do not determine."""


@dataclass(frozen=True)
class Found:
    """The corners of a board in one image.

    Attributes:
        names: Names of the corners.
        pixels: Corners (u, v), pixel centers at whole numbers, shape (N, 2) [px].
        sigma: Standard deviations, shape (N, 2) [px].
        tags: Corners and their standard deviations, shape (4, 2) each [px], of all tags
            of its dictionary, whether they are of the board or not.
        lines: The lines of a grid, if one was found.
    """

    names: tuple[str, ...] = ()
    pixels: Floats = field(default_factory=lambda: np.empty((0, 2)))
    sigma: Floats = field(default_factory=lambda: np.empty((0, 2)))
    tags: Mapping[int, tuple[Floats, Floats]] = field(default_factory=dict)
    lines: Lines | None = None


Seen = tuple[tuple[str, ...], Floats, Found]
"""Names and rough pixels of corners (N, 2), and what else was found."""


def board_of(word: str) -> BoardSetup:
    """The board that a word such as `charuco:7x5:0.03:0.022` states.

    Raises:
        OptionError: If it states none.
    """
    kind, grid, square, *rest = f"{word}::".split(":")
    columns, _, rows = grid.partition("x")
    stated: dict[str, object] = {"type": kind, "columns": columns, "rows": rows}
    stated["square"] = square
    for part in filter(None, rest):
        name = "marker" if kind == "charuco" else "gap"
        if part.startswith(("DICT_", "first=", "legacy")):
            name = part.partition("=")[0] if part[0] != "D" else "dictionary"
        value = True if part == "legacy" else part.removeprefix("first=")
        if name in stated:
            raise OptionError(f"--board states its {name} twice", value=word)
        stated[name] = value
    try:
        board: BoardSetup = Taker().taken(stated, BoardSetup)
        return board
    except Refused as error:
        allowed = error.allowed if error.shown else FORM
        raise OptionError("--board is no board", value=word, allowed=allowed) from None


def word_of(board: BoardSetup) -> str:
    """The word that states a board.

    Examples:
        >>> word_of(board_of("marker:2x3:0.03:0.009:first=4"))
        'marker:2x3:0.03:0.009:first=4'
    """
    parts = [board.type, f"{board.columns}x{board.rows}", f"{board.square:.9g}"]
    parts += [f"{size:.9g}" for size in (board.marker, board.gap) if size]
    parts += [board.dictionary] if board.dictionary else []
    parts += [f"first={board.first}"] if board.first else []
    return ":".join([*parts, "legacy"] if board.legacy else parts)


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
        if board.type not in GRIDS:
            self._search = self._tags_search()
        elif board.type == "chessboard" and min(board.columns, board.rows) < 4:
            size = f"{board.columns}x{board.rows}"
            allowed = "4x4 squares or more"
            raise OptionError("a chessboard is too small", value=size, allowed=allowed)

    def find(self, image: Gray) -> Found:
        """The board in an image; without names where it is not there."""
        kind, levels = self.board.type, image.astype(float)
        search = self._grid if kind in GRIDS else self._tags
        names, pixels, found = search(image, levels)
        if not names:
            return found
        if kind == "circles":
            sigma = np.full(pixels.shape, OFF_CENTER)
            return replace(found, names=names, pixels=pixels, sigma=sigma)
        half = self._half(names, pixels)
        if kind in TAGS:
            met = [found.tags[int(name[:-2])] for name in names[::4]]
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
        return replace(found, names=names, pixels=fine[kept], sigma=sigma[kept])

    def drawn(self, pixels: int) -> Gray:
        """A board to print, so many pixels to a square.

        Raises:
            OptionError: If OpenCV draws no such board.
        """
        board = self.board
        if board.type in GRIDS:
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
        name, size = dictionary_of(board), (board.columns, board.rows)
        dictionary = aruco.getPredefinedDictionary(getattr(aruco, name))
        charuco, known = board.type == "charuco", len(dictionary.bytesList)
        if charuco and board.marker is None:
            raise OptionError("a charuco board is found by the edge of its 'marker'")
        last = tags_of(board)[-1]
        if last >= known:
            reason, allowed = f"the board has tags up to {last}", f"more than {known}"
            raise OptionError(reason, value=name, allowed=f"a dictionary of {allowed}")
        ids = np.array(tags_of(board), np.int32)
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

    def _tags(self, image: Gray, levels: Floats) -> Seen:
        charuco = self.board.type == "charuco"
        search = self._search.detectBoard if charuco else self._search.detectMarkers
        *corners, around, ids = search(image)[: 4 if charuco else 2]
        every = np.ravel([] if ids is None else ids).tolist()
        # A tag that is there twice tells nothing.
        rough = {
            k: np.asarray(four, float).reshape(4, 2)
            for k, four in zip(every, around or (), strict=True)
            if every.count(k) == 1
        }
        cells = self._cells
        met = {k: marker_corners(levels, four, cells) for k, four in rough.items()}
        found = Found(tags=met)
        if charuco:
            # OpenCV numbers them as the model does, row by row from 0.
            names = [str(k) for k in np.ravel([] if corners[1] is None else corners[1])]
            pixels = np.array(corners[0] if names else [], float)
        else:
            own = [k for k in rough if k in tags_of(self.board)]
            names = [f"{k}/{n}" for k in own for n in range(4)]
            pixels = np.array([rough[k] for k in own])
        return tuple(names), pixels.reshape(-1, 2), found

    def _grid(self, image: Gray, levels: Floats) -> Seen:
        cv2, board = self._cv2, self.board
        chess = board.type == "chessboard"
        size = (board.columns - chess, board.rows - chess)
        if chess:
            flags = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
            seen, points = cv2.findChessboardCornersSB(image, size, flags=flags)
        else:
            seen, points = cv2.findCirclesGrid(image, size)
        if not seen:
            return (), np.empty((0, 2)), Found()
        given = np.asarray(points, float).reshape(size[1], size[0], 2)
        lines = lines_of(levels, given, not chess)
        if not lines.whole:
            return (), np.empty((0, 2)), Found(lines=lines)
        ways = [np.rot90(grid, k) for grid in (given, given[::-1]) for k in range(4)]
        ways = [w for w in ways if w.shape == given.shape and _turn(w) > 0.0]
        ways = [w for w in ways if chess and _first_is_dark(image, w)] or ways
        chosen = min(ways, key=lambda way: float(way[0, 0].sum()))
        along = chosen[0, -1] - chosen[0, 0]
        if len(ways) > 1 and along[0] < abs(along[1]):
            # A right angle further, it is clear which corner is the upper left one.
            lines = replace(lines, columns=lines.rows, rows=lines.columns)
            return (), np.empty((0, 2)), Found(lines=lines)
        pixels = chosen.reshape(-1, 2)
        return tuple(map(str, range(len(pixels)))), pixels, Found(lines=lines)

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


def restated(board: BoardSetup, images: Sequence[Found]) -> BoardSetup:
    """The board as images show it; the stated one, if nothing speaks against it."""
    if board.type in GRIDS:
        return restated_lines(board, [i.lines for i in images if i.lines])
    return restated_tags(board, _corners(images))


def checked(board: BoardSetup, images: Sequence[Found]) -> bool:
    """Whether images show enough of a board to tell whether it is stated well."""
    if board.type in GRIDS:
        return any(image.lines and image.lines.sure for image in images)
    return compared(board, _corners(images))


def fitting(board: BoardSetup, images: Sequence[Gray]) -> tuple[BoardSetup | None, str]:
    """A board like the stated one that images show, and the markers in them.

    Returns:
        The board, None where none is found; markers in words, empty where they were
        not asked for, or there are none.
    """
    seen, tried = "", [board]
    if board.type in GRIDS and any(_has_grid(board, image) for image in images):
        sizes = [(board.columns + i, board.rows + j) for i in NEAR for j in NEAR]
        tried = [replace(board, columns=c, rows=r) for c, r in sizes if min(c, r) > 1]
    if not checked(board, [Detector(board).find(image) for image in images]):
        name, ids = _markers(board, images[:MARKED])
        if ids:
            seen = f"{len(ids)} markers of {name}, {min(ids)} to {max(ids)}"
        if name != dictionary_of(board) and board.type not in GRIDS:
            tried = [replace(board, dictionary=name)]
    stated = board
    for better in tried:
        with suppress(OptionError):
            for _ in range(TRIES):
                board, detector = better, Detector(better)
                found = [detector.find(image) for image in images]
                better = restated(board, found)
                fits = better == board and any(image.names for image in found)
                # A part of a board says nothing of its size.
                if fits and (board == stated or checked(board, found)):
                    return board, seen
    return None, seen


def _corners(images: Sequence[Found]) -> list[dict[int, Floats]]:
    return [{k: four for k, (four, _) in image.tags.items()} for image in images]


def _has_grid(board: BoardSetup, image: Gray) -> bool:
    """Whether an image shows a part of a grid: others are slow to search."""
    cv2 = vision()
    if board.type == "circles":
        return True
    flags = cv2.CALIB_CB_LARGER
    return bool(cv2.findChessboardCornersSB(image, (3, 3), flags=flags)[0])


def _markers(board: BoardSetup, images: Sequence[Gray]) -> tuple[str, set[int]]:
    """The dictionary with most markers in images, and their numbers."""
    aruco = vision().aruco
    seen: dict[str, set[int]] = {}
    for name in (dictionary_of(board), *DICTIONARIES):
        search = aruco.ArucoDetector(
            aruco.getPredefinedDictionary(getattr(aruco, name))
        )
        met = [search.detectMarkers(image)[1] for image in images]
        seen[name] = {int(k) for ids in met if ids is not None for k in np.ravel(ids)}
    return max(seen.items(), key=lambda item: len(item[1]))


def dictionary_of(board: BoardSetup) -> str:
    """The dictionary of a board with markers, or that of most boards."""
    usual = "DICT_APRILTAG_36h11" if board.type == "apriltag" else "DICT_4X4_50"
    return board.dictionary or usual


def ambiguous(board: BoardSetup) -> bool:
    """Whether a board looks the same from two sides."""
    if board.type == "circles":
        return True
    return board.type == "chessboard" and (board.columns + board.rows) % 2 == 0


@dataclass(frozen=True)
class Start:
    """A camera to start from.

    Attributes:
        camera: Its intrinsics.
        assumed: Whether images do not determine its focal lengths.
        rms: Rms of the corners of each image about the camera that fits them [px], NaN
            where there are too few.
    """

    camera: CameraSetup
    assumed: bool
    rms: Floats


def start_camera(
    mount: Literal["hand", "world"],
    board: Detector,
    size: tuple[int, int],
    images: list[Found],
) -> Start:
    """Intrinsics to start from.

    Args:
        mount: `hand` or `world`.
        board: The board.
        size: Width and height of the images [px].
        images: The corners in each.
    """
    cv2, largest = vision(), max(size)
    center = ((size[0] - 1) / 2.0, (size[1] - 1) / 2.0)
    focal = (ASSUMED * largest, ASSUMED * largest)
    rms = np.full(len(images), np.nan)
    assumed = CameraSetup(mount, focal, center, size=size, estimate=True)
    usable = [k for k, image in enumerate(images) if len(image.names) >= CORNERS]
    sites = [
        np.array([board.points[n] for n in images[k].names], np.float32) for k in usable
    ]
    pixels = [images[k].pixels.astype(np.float32) for k in usable]
    # The sixth power of the radius is left to the calibration.
    K, flags = None, cv2.CALIB_FIX_K3
    if len(usable) < VIEWS:
        K = np.diag([*focal, 1.0])
        K[:2, 2] = center
        flags += cv2.CALIB_USE_INTRINSIC_GUESS + cv2.CALIB_FIX_ASPECT_RATIO
        flags += cv2.CALIB_FIX_PRINCIPAL_POINT + cv2.CALIB_ZERO_TANGENT_DIST
        flags += cv2.CALIB_FIX_K2
    try:
        _, K, lens, _, _, spread, _, each = cv2.calibrateCameraExtended(
            sites, pixels, size, K, None, flags=flags
        )
    except cv2.error:  # None is usable, or corners are on a line.
        return Start(assumed, True, rms)
    rms[usable] = np.ravel(each)
    numbers = np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *np.ravel(lens)[:5]])
    sane = (0.1 * largest < numbers[:2]) & (numbers[:2] < 100.0 * largest)
    sane &= np.ravel(spread)[:2] < UNKNOWN * numbers[:2]
    if len(usable) < VIEWS or not (np.isfinite(numbers).all() and sane.all()):
        return Start(assumed, True, rms)
    # A start needs no more digits.
    fx, fy, cx, cy = (round(float(number), 3) for number in numbers[:4])
    k_1, k_2, p_1, p_2, k_3 = (round(float(number), 6) for number in numbers[4:])
    lens = (k_1, k_2, p_1, p_2, k_3)
    camera = CameraSetup(mount, (fx, fy), (cx, cy), lens, size, estimate=True)
    return Start(camera, False, rms)


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
