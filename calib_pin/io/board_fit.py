"""Which statement of a board agrees with its tags, or the lines of its grid, in images.

Nothing here needs a camera. What lies beside each other in an image is compared, so
that a lens does not matter.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from calib_pin.observations.corners import sampled
from calib_pin.setup import BoardSetup
from calib_pin.setup.references import BOARDS

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Tags = Mapping[int, Floats]
"""Corners of tags by number, clockwise from the upper left one, shape (4, 2) [px]."""

CORNERS = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]], np.float32)
"""Corners of a tag in its edges, from its center."""

BESIDE = 1.5
"""Distance from a tag, in that of the nearest one, up to which others lie beside it."""

PLACE = 0.3
"""Distance from a place of the grid within which a tag lies there, in its pitch."""

SURPLUS = 0.02
"""Part of the pairs by which another grid has to explain more than the stated one."""

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


def restated_tags(board: BoardSetup, images: Sequence[Tags]) -> BoardSetup | None:
    """The board with tags that images show.

    Args:
        board: The board as it was stated.
        images: The tags of its dictionary in each image.

    Returns:
        The stated board, if nothing speaks against it; None where no two of its tags,
        nor its only one, are seen.
    """
    pairs, own = _pairs(images, board), tags_of(board)
    if len(own) == 1:
        seen = list(set().union(*images))
        if own[0] in seen:
            return board
        return replace(board, first=seen[0]) if len(seen) == 1 else None
    some = np.isin(pairs.ids, own).any(axis=1)
    near = _Pairs(*(part[some | ~some.any()] for part in vars(pairs).values()))
    if not len(near.ids):
        return None

    def rank(grid: BoardSetup) -> tuple[int, float]:
        """Number of pairs that lie as they do on a board, and minus its rows."""
        rows = np.nanmax(_cells(grid, near.ids)[..., 1], initial=0.0)
        return int(near.on(grid).sum()), -float(rows)

    fit, count = _with_rows(board, board, pairs), len(near.ids)
    longer, hits = fit.rows > board.rows, rank(board)[0]
    if hits < count or longer:
        rival = max(_others(board, near), key=rank)
        more = rank(rival)[0] - hits
        if more > max(SURPLUS * count, 1.0) or (more >= 0 and longer):
            fit = _with_rows(board, rival, pairs)
    return _with_edge(fit, near)


@dataclass(frozen=True)
class _Pairs:
    """Tags that lie beside each other.

    Attributes:
        ids: Their numbers, shape (N, 2).
        step: Columns and rows from the first to the second, shape (N, 2).
        edge: Edge of a tag in the pitch of the grid, shape (N,).
        size: Edge of the first, shape (N,) [px].
    """

    ids: Ints
    step: Ints
    edge: Floats
    size: Floats

    def on(self, board: BoardSetup) -> NDArray[np.bool_]:
        """Which of them lie as they do on a board, shape (N,)."""
        step = np.diff(_cells(board, self.ids), axis=1)[:, 0]
        return np.asarray((step == self.step).all(axis=1))


def _pairs(images: Sequence[Tags], board: BoardSetup) -> _Pairs:
    """Pairs of tags that lie beside each other in an image, both ways."""
    import cv2

    found = [(np.zeros((0, 2), int), np.zeros((0, 2)), np.zeros(0), np.zeros(0))]
    for tags in (tags for tags in images if len(tags) > 1):
        corners = np.array(list(tags.values()), np.float32)
        H = np.array([cv2.getPerspectiveTransform(four, CORNERS) for four in corners])
        h = (H[:, None] @ np.linalg.inv(H)[:, :, 2:])[..., 0]
        # From center to center, in edges of the first; behind the horizon is nothing.
        seen = h[..., :2] / np.where(h[..., 2:] > 0.0, h[..., 2:], 1e-9)
        far = np.linalg.norm(seen, axis=2)
        np.fill_diagonal(far, np.inf)
        near = far < BESIDE * far.min(axis=1, keepdims=True)
        i, j = np.nonzero(near & near.T)
        size = np.linalg.norm(corners[:, 0] - corners[:, 1], axis=1)[i]
        ids = np.array(list(tags))[np.column_stack([i, j])]
        # Perspective cancels in the mean of both views.
        found.append((ids, seen[i, j], np.sqrt(far[i, j] * far[j, i]), size))
    ids, offset, apart, size = map(np.concatenate, zip(*found, strict=True))
    # The nearest tags of a charuco board are diagonal neighbors.
    pitch = np.median(apart[apart < 1.2 * apart.min()]) if len(ids) else 1.0
    pitch /= np.sqrt(2.0) if board.type == "charuco" else 1.0
    step = np.round(offset / pitch)
    good = (np.abs(offset / pitch - step) < PLACE).all(axis=1) & step.any(axis=1)
    edge = np.hypot(*step.T) / apart
    return _Pairs(ids[good], step[good].astype(int), edge[good], size[good])


def _cells(board: BoardSetup, ids: Ints) -> Floats:
    """Column and row of tags of a board that goes on downwards, shape (..., 2).

    They are NaN below its first.
    """
    index, columns = ids - board.first, board.columns
    count = int(index.max(initial=0)) + 1
    y, x = np.mgrid[: 2 * count // columns + 3, :columns]
    first = 1 - _shift(board)
    on = (x + y) % 2 == first if board.type == "charuco" else x >= 0
    places = np.argwhere(on)[:, ::-1].astype(float)
    return np.where((index >= 0)[..., None], places[np.maximum(index, 0)], np.nan)


def _shift(board: BoardSetup) -> int:
    """1 where the first square of a charuco board has a tag."""
    return int(board.legacy and board.rows % 2 == 0)


def _others(board: BoardSetup, pairs: _Pairs) -> Iterator[BoardSetup]:
    """Boards that tags may lie on, the likely ones first."""
    low, apart = int(pairs.ids.min()), np.abs(np.diff(pairs.ids, axis=1)).ravel()
    # Below each other, or in a charuco board two rows below.
    below = apart[pairs.step[:, 0] == 0]
    sizes = [board.columns, board.rows, *np.unique(below), int(np.ptp(pairs.ids)) + 1]
    charuco = board.type == "charuco"
    for columns in dict.fromkeys(int(size) for size in sizes if size > charuco):
        back = range(low, max(low - columns, -1), -1)
        for first, turned in product(dict.fromkeys((board.first, 0, *back)), (0, 1)):
            # Only with an even number of rows the first square may have a tag.
            legacy = charuco and _shift(board) != turned
            rows = board.rows + legacy * (board.rows % 2)
            about = {"columns": columns, "rows": rows, "first": first}
            yield replace(board, **about, legacy=legacy)


def _with_rows(board: BoardSetup, grid: BoardSetup, pairs: _Pairs) -> BoardSetup:
    """A board, numbered as another, with as many rows as its tags need."""
    joined = pairs.ids[pairs.on(grid)]
    own = np.intersect1d(joined, tags_of(board))
    own, count = own if len(own) else np.unique(joined), 0
    while len(own) > count:
        # Tags beside those of the board are of the board.
        count = len(own)
        own = np.union1d(own, joined[np.isin(joined, own).any(axis=1)])
    needed = int(_cells(grid, own)[:, 1].max(initial=0.0)) + 1
    rows = max(needed, board.rows if grid.columns == board.columns else 0)
    rows += _shift(grid) * (rows % 2)
    legacy = bool(_shift(grid)) or (board.legacy and rows % 2 == 1)
    return replace(grid, rows=rows, legacy=legacy)


def _with_edge(board: BoardSetup, pairs: _Pairs) -> BoardSetup:
    """The board with the size of markers, or gap, of which an edge is a part."""
    on, charuco, square = pairs.on(board), board.type == "charuco", board.square
    if not on.any():
        return board
    edge, pixels = np.median(pairs.edge[on]), np.median(pairs.size[on])
    size = (board.marker if charuco else board.gap) or 0.0
    pitch = square if charuco else square + size
    blurred = SHIFT / pixels if pixels < FINE else 0.0
    stated = (size if charuco else square) / pitch
    if abs(edge - stated) <= PRINT[0] / pitch + PRINT[1] + blurred:
        return board
    exact = float(square * (edge if charuco else 1.0 / edge - 1.0))
    found = round(exact, 4) or exact
    return replace(board, marker=found) if charuco else replace(board, gap=found)
