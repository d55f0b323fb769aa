"""Corners of calibration boards and tags in images, found by OpenCV, which is an extra.

An image that promises more pixels than a large sensor has is refused before anything is
decoded.
"""

from __future__ import annotations

import io
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import calib_pin.observations.corners as corners
from calib_pin.errors import InputError, OptionError, require_package
from calib_pin.io.files import read_bytes
from calib_pin.setup import DICTIONARIES, TAGS, BoardSetup, CameraSetup
from calib_pin.setup.arguments import parse

PIXELS = 1 << 27
"""Most pixels of an image."""

LARGEST = 1 << 30
"""Most bytes of an image file."""

Gray = NDArray[np.uint8]
Floats = NDArray[np.float64]
Tags = Mapping[int, Floats]
"""Corners of tags by number, clockwise from the upper left one, shape (4, 2) [px]."""

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
"""Images that other boards are compared with."""

NEAR = (0, 1, -1)
"""By how many columns and rows a grid may be stated wrong."""

PLACE = 0.3
"""Distance from a place of the grid within which a tag lies there, in its pitch."""

RIGHT = 0.8
"""Part of the tags that lie where the right board has them, whatever the lens."""

WIDEST = 40
"""Most columns of a board that is looked for."""

BESIDE = 1.5
"""Distance of neighbors, at most [pitch]."""

PRINT = 2e-4, 5e-3
"""Error of an edge that printers make: in m, and as part of the pitch."""

FINE, SHIFT = 20.0, 0.6
"""Edge of a tag below which its cells blur into its border, by which amount [px]."""

LINE = 0.75
"""Contrast of a line of the grid in that of a full one: outside the last corners of a
chessboard it is half."""

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
    # It reads these where it is loaded.
    os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(PIXELS))
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
    require_package("cv2", "images need OpenCV", "vision")
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
    flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    image = None
    with suppress(cv2.error, MemoryError):
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    if image is None:
        reason = "cannot be read: it is no image or damaged, or has more than "
        reason += f"{PIXELS} pixels"
        raise InputError(reason, file=path, allowed="PNG, JPEG, BMP, TIFF, PGM, PPM")
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
    parts: dict[str, Any] = {k: text for k, text in match.groupdict().items() if text}
    if size := parts.pop("size", ""):
        parts["marker" if parts.get("type") == "charuco" else "gap"] = size
    parts["legacy"] = "legacy" in parts
    try:
        board: BoardSetup = parse("--board", parts, BoardSetup)
    except OptionError as error:
        raise OptionError(error.reason, value=word, allowed=error.allowed) from None
    return board


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
class View:
    """The corners of a board in one image.

    Attributes:
        names: Names of the corners.
        pixels: Corners (u, v), pixel centers at whole numbers, shape (N, 2) [px].
        sigma: Standard deviations, shape (N, 2) [px].
        tags: Corners and their standard deviations, shape (4, 2) each [px], of all tags
            of its dictionary, whether they are of the board or not.
        sure: Whether the image shows what is around the grid that was found.
    """

    names: tuple[str, ...] = ()
    pixels: Floats = field(default_factory=lambda: np.empty((0, 2)))
    sigma: Floats = field(default_factory=lambda: np.empty((0, 2)))
    tags: Mapping[int, tuple[Floats, Floats]] = field(default_factory=dict)
    sure: bool = False


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
        self._free = 0.4 * board.square
        if board.type == "chessboard" and min(board.columns, board.rows) < 4:
            value, allowed = f"{board.columns}x{board.rows}", "4x4 squares or more"
            raise OptionError("a chessboard is too small", value=value, allowed=allowed)
        if board.type in GRIDS:
            return
        known, last, aruco = dictionary_of(board), tags_of(board)[-1], self._cv2.aruco
        if last >= (count := len(known.bytesList)):
            reason, allowed = f"the board has tags up to {last}", f"more than {count}"
            raise OptionError(reason, allowed=f"a dictionary of {allowed}")
        self._cells, self._drawn = known.markerSize + 2, drawn_board(board)
        if board.type == "charuco":
            # To the corner of the marker in the square, along each axis.
            self._free = 0.9 * 0.5 * (board.square - (board.marker or 0.0))
            self._search = aruco.CharucoDetector(self._drawn).detectBoard
        else:
            settings = aruco.DetectorParameters()
            settings.cornerRefinementMethod = aruco.CORNER_REFINE_SUBPIX
            self._free = 0.9 * board.square / self._cells
            self._search = aruco.ArucoDetector(known, settings).detectMarkers

    def find(self, image: Gray) -> View:
        """The board in an image; without names where it is not there."""
        levels, cv2 = image.astype(float), self._cv2
        search = self._grid if self.board.type in GRIDS else self._tags
        detection = search(image, levels)
        if not detection.names or self.board.type == "circles":
            return detection
        half, rough = self._half_width(detection), detection.pixels
        if self.board.type in TAGS:
            tags = [detection.tags[int(name[:-2])] for name in detection.names[::4]]
            fine, sigma = (np.concatenate(part) for part in zip(*tags, strict=True))
        else:
            start = np.array(rough[:, None], np.float32, order="C")
            criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, *STEPS)
            fine = cv2.cornerSubPix(image, start, (half, half), (-1, -1), criteria)
            fine = np.asarray(fine, float).reshape(-1, 2)
            noise = corners.noise_of(levels)
            sigma = corners.corner_sigmas(levels, fine, half, noise)
        # A corner that ran away was none; one at the edge of the image has no window.
        edge = np.array(image.shape[::-1]) - 1.0 - half
        kept = np.hypot(*(fine - rough).T) < half
        kept &= ((fine >= half) & (fine <= edge)).all(axis=1)
        names = tuple(np.array(detection.names)[kept].tolist())
        return replace(detection, names=names, pixels=fine[kept], sigma=sigma[kept])

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
        counts, gap = np.array([self.board.columns, self.board.rows]), self.board.gap
        return np.asarray(counts * _pitch(self.board) - (gap or 0.0))

    def _tags(self, image: Gray, levels: Floats) -> View:
        charuco, cells = self.board.type == "charuco", self._cells
        *inner, around, ids = self._search(image)[: 4 if charuco else 2]
        all_ids = np.ravel([] if ids is None else ids).tolist()
        # A tag that is there twice tells nothing.
        rough = {
            k: np.asarray(four, float).reshape(4, 2)
            for k, four in zip(all_ids, around or (), strict=True)
            if all_ids.count(k) == 1
        }
        tags = {k: corners.marker_corners(levels, c, cells) for k, c in rough.items()}
        if charuco:
            # OpenCV numbers them as the model does, row by row from 0.
            names = [str(k) for k in np.ravel([] if inner[1] is None else inner[1])]
            pixels = inner[0] if names else ()
        else:
            numbers = [k for k in rough if k in tags_of(self.board)]
            names = [f"{k}/{n}" for k in numbers for n in range(4)]
            pixels = [rough[k] for k in numbers]
        return View(tuple(names), np.array(pixels, float).reshape(-1, 2), tags=tags)

    def _grid(self, image: Gray, levels: Floats) -> View:
        cv2, board = self._cv2, self.board
        chess = board.type == "chessboard"
        size = (board.columns - chess, board.rows - chess)
        if chess:
            flags = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
            seen, points = cv2.findChessboardCornersSB(image, size, flags=flags)
        else:
            seen, points = cv2.findCirclesGrid(image, size)
        if not seen:
            return View()
        grid = np.asarray(points, float).reshape(size[1], size[0], 2)
        whole, sure = whole_grid(levels, grid, not chess)
        if np.linalg.det([grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]]) < 0.0:
            grid = grid[:, ::-1]  # As it is seen from the front.
        ways = [np.rot90(grid, k) for k in range(4)]
        ways = [view for view in ways if view.shape == grid.shape]
        ways = [w for w in ways if chess and corners.first_is_dark(levels, w)] or ways
        chosen = min(ways, key=lambda view: float(view[0, 0].sum()))
        across = chosen[0, -1] - chosen[0, 0]
        # A right angle further, it is clear which corner is the upper left one.
        if not whole or (len(ways) > 1 and across[0] < abs(across[1])):
            return View(sure=sure)
        pixels = chosen.reshape(-1, 2)
        names, sigma = map(str, range(len(pixels))), np.full_like(pixels, OFF_CENTER)
        return View(tuple(names), pixels, sigma, sure=sure)

    def _half_width(self, detection: View) -> int:
        """Half width of the window of a corner, in which there is no other edge."""
        sites = np.array([self.points[name][:2] for name in detection.names])
        both = sites, detection.pixels
        apart, seen = (np.linalg.norm(at[:, None] - at, axis=2) for at in both)
        near = (apart > 0.0) & (apart < 1.5 * self.board.square)
        scale = float((seen[near] / apart[near]).min()) if near.any() else 0.0
        return int(np.clip(scale * self._free, *WINDOWS))


def whole_grid(levels: Floats, grid: Floats, circles: bool) -> tuple[bool, bool]:
    """Whether a grid has no more lines than were found, and whether that is sure.

    Outside the last corners of a chessboard the contrast is half that of a corner, and
    outside the last circles there is none. It is sure where the image goes on there.

    Args:
        levels: Gray levels, shape (height, width).
        grid: Corners of squares or centers of circles, shape (rows, columns, 2) [px].
        circles: Whether they are centers.
    """
    # One line more on every side, as far away as the last one.
    beside = (1, 1), (1, 1), (0, 0)
    grid = np.pad(grid, beside, mode="reflect", reflect_type="odd")
    reach = 0.5 if circles else 0.3
    x, y = (reach * np.gradient(grid, axis=k) for k in (1, 0))
    at = np.array([grid - x - y, grid + x - y, grid + x + y, grid - x + y, grid])
    around = corners.sampled(levels, at[..., 0], at[..., 1])
    inside = (at == at.clip(0.0, np.array(levels.shape[::-1]) - 1.0)).all(axis=(0, -1))
    if circles:
        value = around[:4].mean(axis=0) - around[4]
    else:
        value = 0.5 * (around[0] - around[1] + around[2] - around[3])
        value *= (-1.0) ** np.indices(value.shape).sum(axis=0)
    spread, inner = np.ptp(around, axis=0), (slice(1, -1), slice(1, -1))
    # Noise alone has no contrast.
    value /= np.maximum(spread, PLACE * np.median(spread[inner]) + 1e-9)
    value *= np.sign(np.median(value[inner]))
    # At the edge of the image, a point that was found is one, and others are not.
    value[~inside] = 0.0
    value[inner][~inside[inner]] = 1.0
    full = [np.median(part, axis=0) > LINE for part in (value[1:-1], value[:, 1:-1].T)]
    whole = all(part[1:-1].all() and not part[[0, -1]].any() for part in full)
    rims = inside[0], inside[-1], inside[:, 0], inside[:, -1]
    return whole, all(rim.mean() > 0.5 for rim in rims)


def find_board(
    detector: Detector, paths: Sequence[Path], tell: Callable[[float], None] | None
) -> tuple[tuple[int, int], list[View]]:
    """Width and height of the images of one camera [px], and the board in each.

    Args:
        detector: The board.
        paths: The images.
        tell: Told the part that is done, 0 to 1.

    Raises:
        InputError: If one cannot be read, or is of another size.
    """
    detections, sizes = list[View](), list[tuple[int, int]]()
    for k, path in enumerate(paths):
        image = read_image(path)
        sizes.append((image.shape[1], image.shape[0]))
        if sizes[k] != sizes[0]:
            reason = f"is not of the size of {paths[0]}: one camera has one"
            value, allowed = ("{} x {}".format(*sizes[i]) for i in (k, 0))
            raise InputError(reason, file=path, value=value, allowed=allowed)
        detections.append(detector.find(image))
        if tell is not None:
            tell((k + 1) / len(paths))
    return sizes[0], detections


# --- whether images show the board as it is stated ----------------------------------


def require_stated(
    board: BoardSetup, images: Sequence[View], paths: Sequence[Path]
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
    agreement = agrees(board, images)
    if agreement is not False:
        return bool(agreement)
    sample = [read_image(path) for path in paths[:: len(paths) // SAMPLE + 1]]
    grid = board.type in GRIDS
    others = _near_sizes(board, sample) if grid else [fit_board(board, images)]
    for other in filter(None, others):
        with suppress(OptionError):  # The dictionary may have fewer tags.
            if agrees(other, [*map(Detector(other).find, sample)]):
                reason = f"the images do not show {word_of(board)}"
                raise InputError(f"{reason}; this fits: --board {word_of(other)}")
    raise InputError(
        f"no image shows the board as stated ({board.type}, {board.columns} x "
        f"{board.rows}); are its type, numbers and dictionary right, and the images "
        f"not mirrored?{_markers(board, sample[:MARKED])}"
    )


def agrees(board: BoardSetup, images: Sequence[View]) -> bool | None:
    """Whether images show a board as it is stated; None where they do not tell how."""
    if not any(one.names for one in images):
        return False
    if board.type in GRIDS:
        whole = [bool(one.names) for one in images if one.sure]
        return 2 * sum(whole) >= len(whole) if whole else None
    fit = fit_board(board, images)
    return None if fit is None else fit == board


def _near_sizes(board: BoardSetup, images: Sequence[Gray]) -> list[BoardSetup]:
    """Boards of squares or circles with a few more or fewer, where a part is seen."""
    flags, search = vision().CALIB_CB_LARGER, vision().findChessboardCornersSB
    parts = (search(image, (3, 3), flags=flags)[0] for image in images)
    # Images without a part of one are slow to search.
    if board.type == "chessboard" and not any(parts):
        return []
    sizes = [(board.columns + i, board.rows + j) for i in NEAR for j in NEAR][1:]
    sizes.append((board.rows, board.columns))
    return [replace(board, columns=c, rows=r) for c, r in sizes if min(c, r) > 1]


def _markers(board: BoardSetup, images: Sequence[Gray]) -> str:
    """The markers of one dictionary, that with most of them, in images."""
    seen = dict[str, set[int]]()
    for name in DICTIONARIES:
        known = dictionary_of(replace(board, dictionary=name))
        search = vision().aruco.ArucoDetector(known).detectMarkers
        met = [ids for image in images if (ids := search(image)[1]) is not None]
        seen[name] = {int(k) for ids in met for k in ids.ravel()}
    name, ids = max(seen.items(), key=lambda of: len(of[1]))
    if not ids:
        return ""
    return f"; seen: {len(ids)} markers of {name}, {min(ids)} to {max(ids)}"


def tags_of(board: BoardSetup) -> range:
    """Numbers of the tags of a board with tags."""
    cells = board.columns * board.rows
    # The white squares: of an odd number of squares the first one is black.
    count = cells // 2 if board.type == "charuco" else cells
    return range(board.first, board.first + count)


def dictionary_of(board: BoardSetup) -> Any:
    """OpenCV's dictionary of a board with tags, or that of most boards."""
    usual = "DICT_APRILTAG_36h11" if board.type == "apriltag" else "DICT_4X4_50"
    aruco = vision().aruco
    return aruco.getPredefinedDictionary(getattr(aruco, board.dictionary or usual))


def drawn_board(board: BoardSetup) -> Any:
    """A board with tags as OpenCV has it.

    Raises:
        OptionError: If it does not say all.
    """
    aruco, size, ids = vision().aruco, (board.columns, board.rows), tags_of(board)
    charuco, edge = board.type == "charuco", board.marker
    if charuco and edge is None:
        raise OptionError("a charuco board is found by the edge of its 'marker'")
    make = aruco.CharucoBoard if charuco else aruco.GridBoard
    inner = edge if charuco else board.gap or board.square
    known = dictionary_of(board)
    drawn = make(size, board.square, inner, known, np.array(ids, np.int32))
    if charuco:
        drawn.setLegacyPattern(board.legacy)
    return drawn


def fit_board(board: BoardSetup, detections: Sequence[View]) -> BoardSetup | None:
    """The board with tags that images show.

    Nothing here needs a camera: tags of an image lie as a plane is seen.

    Args:
        board: The board as it was stated.
        detections: What was found in the images.

    Returns:
        The stated board, if nothing speaks against it; None where no two of its tags,
        nor its only one, are seen.
    """
    tags = ({k: four for k, (four, _) in one.tags.items()} for one in detections)
    images = sorted(tags, key=len)[-SAMPLE:]
    seen, numbers = sorted(set().union(*images)), tags_of(board)
    if len(numbers) == 1:
        if numbers[0] in seen or len(seen) != 1:
            return board if numbers[0] in seen else None
        return replace(board, first=seen[0])
    (right, of_board), most = _hits(board, images), RIGHT * sum(map(len, images))
    if len(seen) > 1 and right < most:
        rivals = {other: _hits(other, images) for other in _candidates(board, seen)}
        best = max(rivals, key=lambda r: (rivals[r][0], -r.columns * r.rows))
        # Where its own lie right, other tags are of another board or of a larger one.
        if rivals[best][0] > max(right, most if right >= RIGHT * of_board else 0.0):
            board, (right, of_board) = best, rivals[best]
    return _with_edge(board, images) if right >= RIGHT * of_board else None


def _candidates(board: BoardSetup, seen: Sequence[int]) -> Iterator[BoardSetup]:
    """Boards that the tags which are seen may be of."""
    per = 2 if board.type == "charuco" else 1
    firsts = {board.first, 0, seen[0]}
    for columns, first, turned in product(range(per, WIDEST), firsts, range(per)):
        rows = max(per * (seen[-1] - first) // columns + 1, per)
        other = replace(board, columns=columns, rows=rows, first=first)
        yield replace(other, legacy=board.legacy != bool(turned))


def _flat(board: BoardSetup, images: Sequence[Tags]) -> Iterator[tuple[Floats, Floats]]:
    """Corners of the tags of a board in each image: as stated, and as they are seen.

    Yields:
        Shapes (n, 4, 2), both in the plane of the board [pitch].
    """
    cv2, drawn = vision(), drawn_board(board)
    places = np.array(drawn.getObjPoints())[..., :2] / _pitch(board)
    sites = dict(zip(drawn.getIds().ravel().tolist(), places, strict=True))
    for tags in images:
        numbers = [k for k in tags if k in sites]
        if len(numbers) > 1:
            nominal, seen = (np.array([of[k] for k in numbers]) for of in (sites, tags))
            H, _ = cv2.findHomography(seen.reshape(-1, 2), nominal.reshape(-1, 2))
            yield nominal, cv2.perspectiveTransform(seen, H)


def _pitch(board: BoardSetup) -> float:
    """Distance of neighboring cells of a board [m]."""
    return board.square + (board.gap or 0.0)


def _hits(board: BoardSetup, images: Sequence[Tags]) -> tuple[int, int]:
    """Number of tags that lie where a board has them, and of all that it has."""
    apart = [(seen - nominal).mean(axis=1) for nominal, seen in _flat(board, images)]
    far = np.abs(np.concatenate([np.empty((0, 2)), *apart])).max(axis=1)
    return int(np.sum(far < PLACE)), len(far)


def _with_edge(board: BoardSetup, images: Sequence[Tags]) -> BoardSetup | None:
    """The board with the size of markers, or gap, that images show; None for none."""
    estimates, pitch = list[float](), _pitch(board)
    for both in _flat(board, images):
        (nominal, at), (sizes, seen) = map(_sizes, both)
        # The scale of a lens is that of neighbors.
        i, j = np.nonzero((at > 0.0) & (at < BESIDE))
        estimates += (np.sqrt(sizes[i] * sizes[j]) * at[i, j] / seen[i, j]).tolist()
    if not estimates:
        return None
    edges = [np.linalg.norm(t[0] - t[1]) for tags in images for t in tags.values()]
    blurred = SHIFT / np.median(edges) if np.median(edges) < FINE else 0.0
    edge = float(np.median(estimates))
    if abs(edge - nominal[0]) <= PRINT[0] / pitch + PRINT[1] + blurred:
        return board
    charuco = board.type == "charuco"
    exact = board.square * (edge if charuco else 1.0 / edge - 1.0)
    size = round(exact, 4) or exact
    return replace(board, marker=size) if charuco else replace(board, gap=size)


def _sizes(tags: Floats) -> tuple[Floats, Floats]:
    """Edges of tags (n, 4, 2), and how far their centers are apart, (n,) and (n, n)."""
    edges = np.linalg.norm(tags - np.roll(tags, 1, axis=1), axis=2).mean(axis=1)
    centers = tags.mean(axis=1)
    return edges, np.linalg.norm(centers[:, None] - centers, axis=2)


# --- the camera ---------------------------------------------------------------------


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
    mount: Any, board: Detector, size: tuple[int, int], images: Mapping[str, View]
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
    focal, center = (ASSUMED * largest,) * 2, ((size[0] - 1) / 2.0, (size[1] - 1) / 2.0)
    assumed = CameraSetup(mount, focal, center, size=size, estimate=True)
    usable = {n: image for n, image in images.items() if len(image.names) >= CORNERS}
    lists = [image.names for image in usable.values()]
    sites = [np.array([board.points[n] for n in names], np.float32) for names in lists]
    pixels = [image.pixels.astype(np.float32) for image in usable.values()]
    # The sixth power of the radius is left to the calibration.
    K, flags = np.diag([*focal, 1.0]), cv2.CALIB_FIX_K3
    K[:2, 2] = center
    if few := len(usable) < VIEWS:
        flags += cv2.CALIB_USE_INTRINSIC_GUESS + cv2.CALIB_FIX_ASPECT_RATIO
        flags += cv2.CALIB_FIX_PRINCIPAL_POINT + cv2.CALIB_ZERO_TANGENT_DIST
        flags += cv2.CALIB_FIX_K2
    try:
        rms, K, lens, _, _, spread, _, each = cv2.calibrateCameraExtended(
            sites, pixels, size, K, None, flags=flags
        )
    except cv2.error:  # None is usable, or corners are on a line.
        return Start(assumed, True, None)
    sigma = float(np.median(np.concatenate([one.sigma for one in usable.values()])))
    worst, name = max(zip(np.ravel(each).tolist(), usable, strict=True))
    if rms > np.clip(NOISE * sigma, *MOST) or worst > MOST[1]:
        raise InputError(
            f"corners do not fit the board: rms {rms:.3g} px with a noise of "
            f"{sigma:.2g} px, {worst:.3g} px in {name}; is the board flat, and as "
            "stated?"
        )
    numbers = np.array([*K[[0, 1], [0, 1]], *K[:2, 2], *np.ravel(lens)[:5]])
    sane = (0.1 * largest < numbers[:2]) & (numbers[:2] < 100.0 * largest)
    sane &= np.ravel(spread)[:2] < UNKNOWN * numbers[:2]
    if few or not (np.isfinite(numbers).all() and sane.all()):
        return Start(assumed, True, rms)
    # A start needs no more digits.
    fx, fy, cx, cy = numbers[:4].round(3).tolist()
    intrinsics = (fx, fy), (cx, cy), tuple(numbers[4:].round(6).tolist()), size
    return Start(CameraSetup(mount, *intrinsics, estimate=True), False, rms)
