"""Corners of calibration boards and tags in images, found by OpenCV, which is an extra.

The decoders of images are foreign code: only formats of cameras get to them, and
headers that promise more than a large sensor has are refused before anything is
decoded.
"""

from __future__ import annotations

import io
import os
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import InputError, OptionError
from calib_pin.io.board_fit import (
    Lines,
    dictionary_of,
    drawn_board,
    lines_of,
    restated_lines,
    restated_tags,
    tags_of,
)
from calib_pin.io.files import read_bytes
from calib_pin.observations.corners import (
    corner_sigmas,
    marker_corners,
    noise_of,
    sampled,
)
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
Floats = NDArray[np.float64]

GRIDS = ("chessboard", "circles")
"""Types of boards without markers."""

FORM = (
    "TYPE:COLUMNSxROWS:SQUARE[:MARKER or GAP][:DICTIONARY][:first=N][:legacy], such as "
    "charuco:7x5:0.03:0.022:DICT_4X4_50"
)

WORD = re.compile(
    r"(?P<type>[^:]*):(?P<columns>[^:x]*)x(?P<rows>[^:]*):(?P<square>[^:]*)"
    r"(:(?P<size>[\d.][^:]*))?(:(?P<dictionary>DICT_[^:]*))?(:first=(?P<first>[^:]*))?"
    r"(:(?P<legacy>legacy))?"
)
"""The same, in the same order."""

WINDOWS = (2, 7)
"""Least and largest half width of the window in which a corner is refined [px]."""

STEPS = 60, 1e-4
"""Most steps of a refinement, and the one after which it ends [px]."""

OFF_CENTER = 0.08
"""Standard deviation of the center of a circle [px]: perspective draws the middle of an
ellipse off it, by 0.065 px in rendered images, whatever their noise."""

SAMPLE = 4
"""Images of which a better statement of the board is taken."""

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

NOISE, MOST = 30.0, (1.0, 3.0)
"""Rms of corners about a camera that is an error: in standard deviations of a corner,
as paper bends and lenses are no polynomials, but between these [px]."""


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


def board_of(word: str) -> BoardSetup:
    """The board that a word such as `charuco:7x5:0.03:0.022` states.

    Raises:
        OptionError: If it states none.
    """
    if (match := WORD.fullmatch(word)) is None:
        raise OptionError("--board is no board", value=word, allowed=FORM)
    stated = {key: text for key, text in match.groupdict().items() if text}
    if size := stated.pop("size", ""):
        stated["marker" if stated.get("type") == "charuco" else "gap"] = size
    about = stated | ({"legacy": True} if "legacy" in stated else {})
    try:
        board: BoardSetup = Taker().taken(about, BoardSetup)
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


def ambiguous(board: BoardSetup) -> bool:
    """Whether a board looks the same from two sides."""
    even = (board.columns + board.rows) % 2 == 0
    return board.type == "circles" or (board.type == "chessboard" and even)


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
        levels = image.astype(float)
        search = self._grid if self.board.type in GRIDS else self._tags
        found = search(image, levels)
        if not found.names or self.board.type == "circles":
            return found
        half, rough = self._half(found), found.pixels
        if self.board.type in TAGS:
            met = [found.tags[int(name[:-2])] for name in found.names[::4]]
            fine, sigma = (np.concatenate(part) for part in zip(*met, strict=True))
        else:
            cv2, start = self._cv2, np.array(rough[:, None], np.float32, order="C")
            criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, *STEPS)
            fine = cv2.cornerSubPix(image, start, (half, half), (-1, -1), criteria)
            fine = np.asarray(fine, float).reshape(-1, 2)
            sigma = corner_sigmas(levels, fine, half, noise_of(levels))
        # A corner that ran away was none; one at the edge of the image has no window.
        edge = np.array(image.shape[::-1]) - 1.0 - half
        kept = np.hypot(*(fine - rough).T) < half
        kept &= ((fine >= half) & (fine <= edge)).all(axis=1)
        names = tuple(np.array(found.names)[kept].tolist())
        return replace(found, names=names, pixels=fine[kept], sigma=sigma[kept])

    def drawn(self, pixels: int) -> Gray:
        """A board to print, so many pixels to a square.

        Raises:
            OptionError: If OpenCV draws no such board.
        """
        board = self.board
        if board.type in GRIDS:
            raise OptionError("--draw draws boards with markers only", value=board.type)
        size = np.round(self.extent * (pixels / board.square)).astype(int).tolist()
        return np.asarray(self._drawn.generateImage(size), np.uint8)

    @property
    def extent(self) -> Floats:
        """Width and height of the printed board [m]."""
        counts = np.array([self.board.columns, self.board.rows], float)
        gap = self.board.gap or 0.0
        return np.asarray(counts * (self.board.square + gap) - gap)

    def _tags_search(self) -> Any:
        """The search for tags by OpenCV's own board."""
        board, aruco, last = self.board, self._cv2.aruco, tags_of(self.board)[-1]
        name, settings = dictionary_of(board), aruco.DetectorParameters()
        known = aruco.getPredefinedDictionary(getattr(aruco, name))
        if board.type == "charuco" and board.marker is None:
            raise OptionError("a charuco board is found by the edge of its 'marker'")
        if last >= (count := len(known.bytesList)):
            reason, allowed = f"the board has tags up to {last}", f"more than {count}"
            raise OptionError(reason, value=name, allowed=f"a dictionary of {allowed}")
        self._cells, self._drawn = known.markerSize + 2, drawn_board(board)
        if board.type == "charuco":
            search = aruco.CharucoDetector(self._drawn, detectorParams=settings)
            return search.detectBoard
        settings.cornerRefinementMethod = aruco.CORNER_REFINE_SUBPIX
        return aruco.ArucoDetector(known, settings).detectMarkers

    def _tags(self, image: Gray, levels: Floats) -> Found:
        charuco = self.board.type == "charuco"
        *corners, around, ids = self._search(image)[: 4 if charuco else 2]
        every = np.ravel([] if ids is None else ids).tolist()
        # A tag that is there twice tells nothing.
        rough = {
            k: np.asarray(four, float).reshape(4, 2)
            for k, four in zip(every, around or (), strict=True)
            if every.count(k) == 1
        }
        cells = self._cells
        met = {k: marker_corners(levels, four, cells) for k, four in rough.items()}
        if charuco:
            # OpenCV numbers them as the model does, row by row from 0.
            names = [str(k) for k in np.ravel([] if corners[1] is None else corners[1])]
            pixels = corners[0] if names else ()
        else:
            own = [k for k in rough if k in tags_of(self.board)]
            names = [f"{k}/{n}" for k in own for n in range(4)]
            pixels = [rough[k] for k in own]
        return Found(tuple(names), np.array(pixels, float).reshape(-1, 2), tags=met)

    def _grid(self, image: Gray, levels: Floats) -> Found:
        cv2, board = self._cv2, self.board
        chess = board.type == "chessboard"
        size = (board.columns - chess, board.rows - chess)
        if chess:
            flags = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
            seen, points = cv2.findChessboardCornersSB(image, size, flags=flags)
        else:
            seen, points = cv2.findCirclesGrid(image, size)
        if not seen:
            return Found()
        grid = np.asarray(points, float).reshape(size[1], size[0], 2)
        lines = lines_of(levels, grid, not chess)
        if not lines.whole:
            return Found(lines=lines)
        if np.linalg.det([grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]]) < 0.0:
            grid = grid[:, ::-1]  # As it is seen from the front.
        ways = [np.rot90(grid, k) for k in range(4)]
        ways = [way for way in ways if way.shape == grid.shape]
        ways = [w for w in ways if chess and _first_is_dark(levels, w)] or ways
        chosen = min(ways, key=lambda way: float(way[0, 0].sum()))
        across = chosen[0, -1] - chosen[0, 0]
        if len(ways) > 1 and across[0] < abs(across[1]):
            # A right angle further, it is clear which corner is the upper left one.
            lines = replace(lines, columns=lines.rows, rows=lines.columns)
            return Found(lines=lines)
        pixels = chosen.reshape(-1, 2)
        names, sigma = tuple(map(str, range(len(pixels)))), np.full((1, 2), OFF_CENTER)
        return Found(names, pixels, sigma.repeat(len(pixels), axis=0), lines=lines)

    def _half(self, found: Found) -> int:
        """Half width of the window of a corner, in which there is no other edge."""
        sites = np.array([self.points[name][:2] for name in found.names])
        apart = np.linalg.norm(sites[:, None] - sites, axis=2)
        seen = np.linalg.norm(found.pixels[:, None] - found.pixels, axis=2)
        near = (apart > 0.0) & (apart < 1.5 * self.board.square)
        scale = float((seen[near] / apart[near]).min()) if near.any() else 0.0
        free = 0.4 * self.board.square
        if self.board.type == "charuco":
            # To the corner of the marker in the square, along each axis.
            free = 0.9 * 0.5 * (self.board.square - (self.board.marker or 0.0))
        elif self.board.type in TAGS:
            free = 0.9 * self.board.square / self._cells
        return int(np.clip(scale * free, *WINDOWS))


def _first_is_dark(levels: Floats, grid: Floats) -> bool:
    """Whether the square outside the first corner is darker than its neighbors."""
    x, y = grid[0, 1] - grid[0, 0], grid[1, 0] - grid[0, 0]
    at = grid[0, 0] + 0.5 * np.array([-x - y, x - y, x + y, y - x])
    a, b, c, d = sampled(levels, *at.T)
    return bool(a + c < b + d)


def find_board(
    detector: Detector, paths: Sequence[Path], tell: Callable[[float], None] | None
) -> tuple[tuple[int, int], list[Found]]:
    """Width and height of the images of one camera [px], and the board in each.

    Args:
        detector: The board.
        paths: The images.
        tell: Told the part that is done, 0 to 1.

    Raises:
        InputError: If one cannot be read, or is of another size.
    """
    size, found = (0, 0), list[Found]()
    for k, path in enumerate(paths):
        image = read_image(path)
        height, width = image.shape
        size = size if k else (width, height)
        if (width, height) != size:
            raise InputError(
                f"is not of the size of {paths[0]}: one camera has one",
                file=path,
                value=f"{width} x {height}",
                allowed=f"{size[0]} x {size[1]}",
            )
        found.append(detector.find(image))
        if tell is not None:
            tell((k + 1) / len(paths))
    return size, found


def restated(board: BoardSetup, images: Sequence[Found]) -> BoardSetup | None:
    """The board as images show it.

    Returns:
        The stated one, if nothing speaks against it; None where images do not show
        enough to tell.
    """
    if board.type not in GRIDS:
        tags = [{k: four for k, (four, _) in image.tags.items()} for image in images]
        return restated_tags(board, tags)
    lines = [image.lines for image in images if image.lines]
    fit = restated_lines(board, lines)
    return fit if fit != board or any(one.sure for one in lines) else None


def require_stated(
    board: BoardSetup, images: Sequence[Found], paths: Sequence[Path]
) -> bool:
    """Refuse a board that images do not show, and say which one they do.

    Args:
        board: The board as stated.
        images: What was found in the images.
        paths: The images.

    Returns:
        Whether images show enough to tell.

    Raises:
        InputError: If they show another, or none.
    """
    fit, seen = restated(board, images), any(image.names for image in images)
    if seen and fit in (None, board):
        return fit is not None
    some = [read_image(path) for path in paths[:: len(paths) // SAMPLE + 1]]
    for other in [fit] if fit and board.type not in GRIDS else _near(board, some):
        with suppress(OptionError):  # The dictionary may have fewer tags.
            found = [Detector(other).find(image) for image in some]
            if restated(other, found) == other and any(one.names for one in found):
                reason = f"the images do not show {word_of(board)}"
                if other == replace(board, legacy=True):
                    reason = "its markers are found, its corners are not: a board of "
                    reason += "OpenCV before 4.6? add ':legacy'"
                raise InputError(f"{reason}; this fits: --board {word_of(other)}")
    raise InputError(
        f"no image shows the board as stated ({board.type}, {board.columns} x "
        f"{board.rows}); are its type, numbers and dictionary right?"
        f"{_markers(board, some[:MARKED])}"
    )


def _near(board: BoardSetup, images: Sequence[Gray]) -> list[BoardSetup]:
    """Boards of squares or circles with a few more or fewer, where a part is seen."""
    cv2, flags, least = vision(), vision().CALIB_CB_LARGER, 2
    if board.type == "chessboard":
        # Images without a part of one are slow to search.
        seen = [cv2.findChessboardCornersSB(i, (3, 3), flags=flags)[0] for i in images]
        least = 4 if any(seen) else max(board.columns, board.rows) + 2
    sizes = [(board.columns + i, board.rows + j) for i in NEAR for j in NEAR][1:]
    sizes = [*sizes, (board.rows, board.columns)] if board.type in GRIDS else []
    return [replace(board, columns=c, rows=r) for c, r in sizes if min(c, r) >= least]


def _markers(board: BoardSetup, images: Sequence[Gray]) -> str:
    """The markers of one dictionary, that with most of them, in images."""
    aruco, seen = vision().aruco, list[tuple[int, str]]()
    for name in (dictionary_of(board), *DICTIONARIES):
        dictionary = aruco.getPredefinedDictionary(getattr(aruco, name))
        search = aruco.ArucoDetector(dictionary)
        met = [search.detectMarkers(image)[1] for image in images]
        if ids := {int(k) for found in met if found is not None for k in found.ravel()}:
            said = f"; seen: {len(ids)} markers of {name}, {min(ids)} to {max(ids)}"
            seen.append((len(ids), said))
    return max(seen, default=(0, ""), key=lambda found: found[0])[1]


@dataclass(frozen=True)
class Start:
    """A camera to start from.

    Attributes:
        camera: Its intrinsics.
        assumed: Whether images do not determine its focal lengths.
        rms: Rms of the corners about the camera that fits them [px]; None where there
            are too few.
    """

    camera: CameraSetup
    assumed: bool
    rms: float | None


def start_camera(
    mount: Any,
    board: Detector,
    size: tuple[int, int],
    images: Mapping[str, Found],
) -> Start:
    """Intrinsics to start from.

    Args:
        mount: `hand` or `world`.
        board: The board.
        size: Width and height of the images [px].
        images: The corners in each, by its name.

    Raises:
        InputError: If they are not those of one flat board before a camera.
    """
    cv2, largest = vision(), max(size)
    center = ((size[0] - 1) / 2.0, (size[1] - 1) / 2.0)
    focal = (ASSUMED * largest, ASSUMED * largest)
    assumed = CameraSetup(mount, focal, center, size=size, estimate=True)
    usable = {n: found for n, found in images.items() if len(found.names) >= CORNERS}
    sites, pixels = [], []
    for one in usable.values():
        sites.append(np.array([board.points[n] for n in one.names], np.float32))
        pixels.append(one.pixels.astype(np.float32))
    # The sixth power of the radius is left to the calibration.
    K, flags = np.diag([*focal, 1.0]), cv2.CALIB_FIX_K3
    K[:2, 2] = center
    if len(usable) < VIEWS:
        flags += cv2.CALIB_USE_INTRINSIC_GUESS + cv2.CALIB_FIX_ASPECT_RATIO
        flags += cv2.CALIB_FIX_PRINCIPAL_POINT + cv2.CALIB_ZERO_TANGENT_DIST
        flags += cv2.CALIB_FIX_K2
    try:
        _, K, lens, _, _, spread, _, each = cv2.calibrateCameraExtended(
            sites, pixels, size, K, None, flags=flags
        )
    except cv2.error:  # None is usable, or corners are on a line.
        return Start(assumed, True, None)
    rms = _require_flat(usable, np.ravel(each))
    numbers = np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *np.ravel(lens)[:5]])
    sane = (0.1 * largest < numbers[:2]) & (numbers[:2] < 100.0 * largest)
    sane &= np.ravel(spread)[:2] < UNKNOWN * numbers[:2]
    if len(usable) < VIEWS or not (np.isfinite(numbers).all() and sane.all()):
        return Start(assumed, True, rms)
    # A start needs no more digits.
    fx, fy, cx, cy = numbers[:4].round(3).tolist()
    lens = tuple(numbers[4:].round(6).tolist())
    camera = CameraSetup(mount, (fx, fy), (cx, cy), lens, size, estimate=True)
    return Start(camera, False, rms)


def _require_flat(images: Mapping[str, Found], rms: Floats) -> float:
    """Rms of the corners of all images about their camera, by those of each [px].

    Raises:
        InputError: If they are not those of one flat board before a camera.
    """
    counts = [len(found.names) for found in images.values()]
    total = float(np.sqrt(np.average(rms**2, weights=counts)))
    sigma = float(np.median(np.concatenate([f.sigma for f in images.values()])))
    worst, name = max(zip(rms.tolist(), images, strict=True))
    if total > np.clip(NOISE * sigma, *MOST) or worst > MOST[1]:
        raise InputError(
            f"corners do not fit the board: rms {total:.3g} px with a noise of "
            f"{sigma:.2g} px, {worst:.3g} px in {name}; is the board flat, and as "
            "stated?"
        )
    return total
