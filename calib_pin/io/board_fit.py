"""Which statement of a board agrees with its tags, or the lines of its grid, in images.

Nothing here needs a camera: tags of an image lie as a plane is seen, and lines go on or
end.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib_pin.observations.corners import sampled
from calib_pin.setup import BOARDS, BoardSetup

Floats = NDArray[np.float64]
Tags = Mapping[int, Floats]
"""Corners of tags by number, clockwise from the upper left one, shape (4, 2) [px]."""

CORNERS = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
"""Corners of a tag in its edges, from its center."""

PLACE = 0.3
"""Distance from a place of the grid within which a tag lies there, in its pitch."""

MOST = 0.8
"""Part of the tags that lie where the right board has them, whatever the lens."""

SAMPLE = 4
"""Images that boards are compared with, those with the most tags."""

WIDEST = 40
"""Most columns of these."""

BESIDE = 1.5
"""Distance of neighbors, at most [pitch]."""

PRINT = 2e-4, 5e-3
"""Error of an edge that printers make: in m, and as part of the pitch."""

FINE, SHIFT = 20.0, 0.6
"""Edge of a tag below which its cells blur into its border, by which amount [px]."""

LINE = 0.75
"""Contrast of a line of the grid in that of a full one: outside the last corners of a
chessboard it is half."""


@dataclass(frozen=True)
class Lines:
    """The lines of a grid in an image.

    Attributes:
        columns: Number of columns of points.
        rows: Number of rows of points.
        whole: Whether they are those that were found.
        sure: Whether the image goes on where the next lines would be.
    """

    columns: int
    rows: int
    whole: bool
    sure: bool


def lines_of(levels: Floats, grid: Floats, circles: bool) -> Lines:
    """The lines of the board of which a grid was found.

    Outside the last corners of a chessboard the contrast is half that of a corner, and
    outside the last circles there is none.

    Args:
        levels: Gray levels, shape (height, width).
        grid: Corners of squares or centers of circles, shape (rows, columns, 2) [px].
        circles: Whether they are centers.
    """
    # One line more on every side, as perspective and lens go on.
    for _ in range(2):
        a, b = grid[:3], grid[: -len(grid) - 1 : -1][:3]
        ends = (
            3.0 * (e[0] - e[1]) + e[2] if len(e) > 2 else 2.0 * e[0] - e[1]
            for e in (a, b)
        )
        grid = np.stack([next(ends), *grid, next(ends)]).swapaxes(0, 1)
    reach = 0.5 if circles else 0.3
    x, y = (reach * np.gradient(grid, axis=k) for k in (1, 0))
    at = np.array([grid - x - y, grid + x - y, grid + x + y, grid - x + y, grid])
    around = sampled(levels, at[..., 0], at[..., 1])
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
    rims = (inside[0], inside[-1], inside[:, 0], inside[:, -1])
    return Lines(
        columns=int(full[0].sum()),
        rows=int(full[1].sum()),
        whole=all(part[1:-1].all() and not part[[0, -1]].any() for part in full),
        sure=all(rim.mean() > 0.5 for rim in rims),
    )


def restated_lines(board: BoardSetup, images: Sequence[Lines]) -> BoardSetup:
    """The chessboard, or board of circles, of as many columns and rows as most show."""
    fewer, stated = BOARDS[board.type], (board.columns, board.rows)
    counts = Counter(
        (lines.columns + fewer, lines.rows + fewer)
        for lines in [i for i in images if i.sure] or images
    )
    most = max(counts, key=lambda c: (counts[c], c == stated), default=stated)
    return replace(board, columns=most[0], rows=most[1])


def tags_of(board: BoardSetup) -> range:
    """Numbers of the tags of a board with tags."""
    cells = board.columns * board.rows
    # The white squares: of an odd number of squares the first one is black.
    count = cells // 2 if board.type == "charuco" else cells
    return range(board.first, board.first + count)


def dictionary_of(board: BoardSetup) -> str:
    """The dictionary of a board with markers, or that of most boards."""
    usual = "DICT_APRILTAG_36h11" if board.type == "apriltag" else "DICT_4X4_50"
    return board.dictionary or usual


def drawn_board(board: BoardSetup) -> Any:
    """A board with tags as OpenCV has it."""
    from cv2 import aruco

    size, ids = (board.columns, board.rows), np.array(tags_of(board), np.int32)
    known = aruco.getPredefinedDictionary(getattr(aruco, dictionary_of(board)))
    if board.type != "charuco":
        return aruco.GridBoard(
            size, board.square, board.gap or board.square, known, ids
        )
    drawn = aruco.CharucoBoard(size, board.square, board.marker, known, ids)
    drawn.setLegacyPattern(board.legacy)
    return drawn


def restated_tags(board: BoardSetup, images: Sequence[Tags]) -> BoardSetup | None:
    """The board with tags that images show.

    Args:
        board: The board as it was stated.
        images: The tags of its dictionary in each image.

    Returns:
        The stated board, if nothing speaks against it; None where no two of its tags,
        nor its only one, are seen.
    """
    images = sorted(images, key=len)[-SAMPLE:]
    seen = sorted(set().union(*images))
    if len(own := tags_of(board)) == 1:
        if own[0] in seen or len(seen) != 1:
            return board if own[0] in seen else None
        return replace(board, first=seen[0])
    (right, of_board), most = _hits(board, images), MOST * sum(map(len, images))
    if len(seen) > 1 and right < most:
        rivals = {other: _hits(other, images)[0] for other in _others(board, seen)}
        best = max(rivals, key=lambda r: (rivals[r], -r.columns * r.rows))
        # Where its own lie right, other tags are of another board or of a larger one.
        least = max(right, most if right >= MOST * of_board else 0.0)
        board = best if rivals[best] > least else board
    right, of_board = _hits(board, images)
    return _with_edge(board, images) if right >= MOST * of_board else None


def _others(board: BoardSetup, seen: Sequence[int]) -> Iterator[BoardSetup]:
    """Boards that the tags which are seen may be of."""
    per = 2 if board.type == "charuco" else 1
    firsts = {board.first, 0, seen[0]}
    for columns, first, turned in product(range(per, WIDEST), firsts, range(per)):
        rows = max(per * (seen[-1] - first) // columns + 1, per)
        other = replace(board, columns=columns, rows=rows, first=first)
        yield replace(other, legacy=board.legacy != bool(turned))


def _hits(board: BoardSetup, images: Sequence[Tags]) -> tuple[int, int]:
    """Number of tags that lie where a board has them, and of all that it has."""
    right, count = 0, 0
    for centers, corners in _flat(board, images):
        far = np.abs(corners.mean(axis=1) - centers).max(axis=1)
        right, count = right + int(np.sum(far < PLACE)), count + len(far)
    return right, count


def _edge(board: BoardSetup) -> float:
    """Edge of a tag as it is stated, in the pitch of the grid."""
    if board.type == "charuco":
        return (board.marker or 0.0) / board.square
    return board.square / (board.square + (board.gap or 0.0))


def _flat(board: BoardSetup, images: Sequence[Tags]) -> Iterator[tuple[Floats, Floats]]:
    """Tags of a board in images: centers as it is stated, corners as they are seen.

    Yields:
        Shapes (n, 2) and (n, 4, 2), both in the plane of the board [pitch].
    """
    import cv2

    drawn, pitch = drawn_board(board), board.square + (board.gap or 0.0)
    ids, places = drawn.getIds().ravel(), np.array(drawn.getObjPoints())
    sites = dict(zip(ids.tolist(), places[..., :2].mean(axis=1) / pitch, strict=True))
    for tags in images:
        own = [k for k in tags if k in sites]
        if len(own) > 1:
            centers, pixels = np.array([sites[k] for k in own]), [tags[k] for k in own]
            corners = centers[:, None] + _edge(board) * CORNERS
            seen = np.concatenate(pixels)
            H, _ = cv2.findHomography(seen, corners.reshape(-1, 2))
            yield centers, cv2.perspectiveTransform(seen[None], H).reshape(-1, 4, 2)


def _with_edge(board: BoardSetup, images: Sequence[Tags]) -> BoardSetup | None:
    """The board with the size of markers, or gap, that images show; None for none."""
    found = list[float]()
    for centers, corners in _flat(board, images):
        size = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean(
            axis=1
        )
        stated, seen = (
            np.linalg.norm(at[:, None] - at, axis=2)
            for at in (centers, corners.mean(axis=1))
        )
        # The scale of a lens is that of neighbors.
        i, j = np.nonzero((stated > 0.0) & (stated < BESIDE))
        found += (np.sqrt(size[i] * size[j]) * stated[i, j] / seen[i, j]).tolist()
    if not found:
        return None
    charuco, square, edge = board.type == "charuco", board.square, np.median(found)
    edges = [np.linalg.norm(t[0] - t[1]) for tags in images for t in tags.values()]
    blurred = SHIFT / np.median(edges) if np.median(edges) < FINE else 0.0
    pitch = square + (board.gap or 0.0)
    if abs(edge - _edge(board)) <= PRINT[0] / pitch + PRINT[1] + blurred:
        return board
    exact = float(square * (edge if charuco else 1.0 / edge - 1.0))
    size = round(exact, 4) or exact
    return replace(board, marker=size) if charuco else replace(board, gap=size)
