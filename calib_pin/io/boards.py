"""Corners of calibration boards and tags in images, found by OpenCV."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import OptionError
from calib_pin.io.images import Gray, vision
from calib_pin.observations.corners import corner_sigmas, marker_corners, noise_of
from calib_pin.setup import BoardSetup, CameraSetup
from calib_pin.setup.references import TAGS

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

    kind, *rest = word.split(":")
    stated: dict[str, object] = {"type": kind}
    try:
        columns, _, rows = rest[0].partition("x")
        stated |= {"columns": float(columns), "rows": float(rows)}
        stated["square"] = float(rest[1])
        for part in rest[2:]:
            if part.startswith("DICT_"):
                stated["dictionary"] = part
            elif part == "legacy":
                stated["legacy"] = True
            else:
                stated["marker" if kind == "charuco" else "gap"] = float(part)
        board = setup_of({"board": stated}).board
    except (ValueError, IndexError):
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
        if kind == "charuco":
            found = self._charuco(image)
        elif kind in TAGS:
            found = self._tags(image)
        else:
            found = self._grid(image)
        if found is None:
            return None
        names, pixels = found
        half = self._half(names, pixels)
        levels = image.astype(float)
        if kind == "circles":
            return Found(names, pixels, np.full(pixels.shape, OFF_CENTER))
        if kind in TAGS:
            met = [
                marker_corners(levels, four, self._cells)
                for four in np.split(pixels, len(pixels) // 4)
            ]
            fine, sigma = (np.concatenate(part) for part in zip(*met, strict=True))
        else:
            rough = np.ascontiguousarray(pixels, np.float32).reshape(-1, 1, 2)
            cv2 = self._cv2
            criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, *STEPS)
            fine = cv2.cornerSubPix(image, rough, (half, half), (-1, -1), criteria)
            fine = np.asarray(fine, float).reshape(-1, 2)
            sigma = corner_sigmas(levels, fine, half, noise_of(levels))
        # A corner that ran away was none; one at the edge of the image has no window.
        edge = np.array(image.shape[::-1]) - 1.0 - half
        kept = np.hypot(*(fine - pixels).T) < half
        kept &= ((fine >= half) & (fine <= edge)).all(axis=1)
        if not kept.any():
            return None
        names = tuple(n for n, keep in zip(names, kept, strict=True) if keep)
        return Found(names, fine[kept], sigma[kept])

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
        board, aruco = self.board, self._cv2.aruco
        usual = "DICT_APRILTAG_36h11" if board.type == "apriltag" else "DICT_4X4_50"
        name = board.dictionary or usual
        dictionary = aruco.getPredefinedDictionary(getattr(aruco, name))
        size = (board.columns, board.rows)
        tags = board.columns * board.rows
        if board.type == "charuco":
            if board.marker is None:
                raise OptionError(
                    "a charuco board is found by the edge of its 'marker'"
                )
            # The white squares: of an odd number of squares the first one is black.
            tags //= 2
        last = board.first + tags - 1
        if last >= len(dictionary.bytesList):
            raise OptionError(
                f"the board has tags up to {last}",
                value=name,
                allowed=f"a dictionary of more than {len(dictionary.bytesList)}",
            )
        ids = np.arange(board.first, last + 1, dtype=np.int32)
        self._cells = dictionary.markerSize + 2
        settings = aruco.DetectorParameters()
        if board.type == "charuco":
            self._board = aruco.CharucoBoard(
                size, board.square, board.marker, dictionary, ids
            )
            self._board.setLegacyPattern(board.legacy)
            return aruco.CharucoDetector(self._board, detectorParams=settings)
        settings.cornerRefinementMethod = aruco.CORNER_REFINE_SUBPIX
        gap = board.gap or board.square
        self._board = aruco.GridBoard(size, board.square, gap, dictionary, ids)
        return aruco.ArucoDetector(dictionary, settings)

    def _charuco(self, image: Gray) -> tuple[tuple[str, ...], Floats] | None:
        corners, ids, _, _ = self._search.detectBoard(image)
        if ids is None or len(ids) == 0:
            return None
        # OpenCV numbers them as the model does, row by row from 0.
        names = tuple(str(k) for k in np.ravel(ids))
        return names, np.asarray(corners, float).reshape(-1, 2)

    def _tags(self, image: Gray) -> tuple[tuple[str, ...], Floats] | None:
        corners, ids, _ = self._search.detectMarkers(image)
        names, pixels = list[str](), list[Floats]()
        for k, around in zip(
            np.ravel(ids if ids is not None else []), corners, strict=True
        ):
            # A tag that is there twice, or is none of the board, tells nothing.
            if f"{k}/0" in self.points and np.sum(np.ravel(ids) == k) == 1:
                names += [f"{k}/{n}" for n in range(4)]
                pixels += list(np.asarray(around, float).reshape(4, 2))
        return (tuple(names), np.array(pixels)) if names else None

    def _grid(self, image: Gray) -> tuple[tuple[str, ...], Floats] | None:
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
            return None
        given = np.asarray(points, float).reshape(size[1], size[0], 2)
        ways = [np.rot90(grid, k) for grid in (given, given[::-1]) for k in range(4)]
        ways = [w for w in ways if w.shape == given.shape and _turn(w) > 0.0]
        if chess:
            dark = [w for w in ways if _first_is_dark(image, w)]
            ways = dark or ways
        chosen = min(ways, key=lambda way: float(way[0, 0].sum()))
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
    cv2 = vision()
    center = ((size[0] - 1) / 2.0, (size[1] - 1) / 2.0)
    usable = [image for image in images if len(image.names) >= CORNERS]
    K, lens = np.zeros((3, 3)), np.zeros(5)
    rms = None
    if len(usable) >= VIEWS:
        sites = [
            np.array([board.points[n] for n in i.names], np.float32) for i in usable
        ]
        pixels = [image.pixels.astype(np.float32) for image in usable]
        # The sixth power of the radius is left to the calibration.
        try:
            rms, K, lens, *_ = cv2.calibrateCamera(
                sites, pixels, size, None, None, flags=cv2.CALIB_FIX_K3
            )
        except cv2.error:  # Corners on a line.
            rms = None
    lens = np.ravel(lens)[:5]
    focal = (float(K[0, 0]), float(K[1, 1]))
    sane = all(0.1 * max(size) < f < 100.0 * max(size) for f in focal)
    if rms is None or not sane or not np.isfinite(lens).all():
        guess = ASSUMED * max(size)
        camera = CameraSetup(mount, (guess, guess), center, size=size, estimate=True)
        return camera, None
    # A start needs no more digits.
    k_1, k_2, p_1, p_2, k_3 = (round(float(number), 6) for number in lens)
    focal = (round(focal[0], 3), round(focal[1], 3))
    center = (round(float(K[0, 2]), 3), round(float(K[1, 2]), 3))
    lens_of = (k_1, k_2, p_1, p_2, k_3)
    return CameraSetup(mount, focal, center, lens_of, size, True), float(rms)


def _turn(grid: Floats) -> float:
    """Positive where rows run as they do on a board that is seen from the front."""
    x, y = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    return float(x[0] * y[1] - x[1] * y[0])


def _first_is_dark(image: Gray, grid: Floats) -> bool:
    """Whether the square outside the first corner is darker than its neighbors."""
    x, y = grid[0, 1] - grid[0, 0], grid[1, 0] - grid[0, 0]
    levels = []
    for across, down in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)):
        u, v = np.round(grid[0, 0] + across * x + down * y).astype(int)
        v = int(np.clip(v, 0, image.shape[0] - 1))
        u = int(np.clip(u, 0, image.shape[1] - 1))
        levels.append(float(image[v, u]))
    return levels[0] + levels[2] < levels[1] + levels[3]
