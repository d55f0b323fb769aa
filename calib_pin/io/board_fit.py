"""Which statement of a board agrees with its tags, or the lines of its grid, in images.

Nothing here needs a camera. What lies beside each other in an image is compared, so
that a lens does not matter.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.observations.corners import sampled
from calib_pin.setup import BOARDS, BoardSetup
from calib_pin.setup.values import MOST

Floats = NDArray[np.float64]
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
class _Pairs:
    """Tags that lie beside each other.

    Attributes:
        ids: Their numbers, shape (N, 2).
        offset: From the center of the first to that of the second, in edges of the
            first and along its axes, shape (N, 2).
        apart: Length of the offset, the mean of both views, in which perspective
            cancels, shape (N,).
        size: Edge of the first, shape (N,) [px].
    """

    ids: NDArray[np.int64]
    offset: Floats
    apart: Floats
    size: Floats

    def of(self, kept: NDArray[np.bool_]) -> _Pairs:
        """Some of the pairs."""
        return _Pairs(*(part[kept] for part in vars(self).values()))


@dataclass(frozen=True)
class _Grid:
    """A way in which tags are numbered along a grid.

    Attributes:
        charuco: Whether they lie in every second square.
        columns: Squares or tags in a row.
        first: Number of the first tag.
        shift: 1 where the first square has a tag, of a charuco board.
    """

    charuco: bool
    columns: int
    first: int
    shift: int

    def cells(self, ids: NDArray[np.int64]) -> Floats:
        """Column and row of tags, NaN below the first, shape (..., 2)."""
        index = ids - self.first
        count = int(index.max(initial=0)) + 1
        y, x = np.mgrid[: 2 * count // self.columns + 3, : self.columns]
        on = (x + y + self.shift) % 2 == 1 if self.charuco else x >= 0
        places = np.argwhere(on)[:, ::-1].astype(float)
        return np.where((index >= 0)[..., None], places[np.maximum(index, 0)], np.nan)

    def part(self, pairs: _Pairs) -> tuple[float, NDArray[np.bool_]]:
        """Edge of a tag in pitches, and which pairs lie as they do on this grid."""
        step = np.diff(self.cells(pairs.ids), axis=1)[:, 0]
        known = np.isfinite(step[:, 0])
        ratios = np.hypot(*step[known].T) / pairs.apart[known]
        edge = float(np.median(ratios)) if known.any() else 0.0
        near = (np.abs(edge * pairs.offset - step) < PLACE).all(axis=1)
        return edge, np.asarray(near & (0.0 < edge < 1.0))

    def rank(self, pairs: _Pairs) -> tuple[int, float]:
        """Number of pairs that lie as they do on this grid, and minus its rows."""
        rows = np.nanmax(self.cells(pairs.ids)[..., 1], initial=0.0)
        return int(self.part(pairs)[1].sum()), -float(rows)


def tags_of(board: BoardSetup) -> range:
    """Numbers of the tags of a board with tags."""
    cells = board.columns * board.rows
    # The white squares: of an odd number of squares the first one is black.
    count = cells // 2 if board.type == "charuco" else cells
    return range(board.first, board.first + count)


def compared(board: BoardSetup, images: Sequence[Tags]) -> bool:
    """Whether tags of a board are seen beside each other, or its only one is."""
    own = tags_of(board)
    if len(own) == 1:
        return any(own[0] in tags for tags in images)
    return bool(np.isin(_pairs(images).ids, own).all(axis=1).any())


def restated_tags(board: BoardSetup, images: Sequence[Tags]) -> BoardSetup:
    """The board with tags that images show.

    Args:
        board: The board as it was stated.
        images: The tags of its dictionary in each image.

    Returns:
        The stated board, if nothing speaks against it.
    """
    pairs, own = _pairs(images), tags_of(board)
    if len(own) == 1:
        seen = list(set().union(*images))
        other = len(seen) == 1 and seen[0] not in own
        return replace(board, first=seen[0]) if other else board
    if not len(pairs.ids):
        return board
    some = np.asarray(np.isin(pairs.ids, own).any(axis=1))
    near = pairs.of(some) if some.any() else pairs
    shift = int(board.legacy and board.rows % 2 == 0)
    stated = _Grid(board.type == "charuco", board.columns, board.first, shift)
    best = _with_rows(board, stated, pairs)
    (hits, _), count = stated.rank(near), len(near.ids)
    if hits < count or best.rows > board.rows:
        rival = max(_others(board, stated, near), key=lambda grid: grid.rank(near))
        more = rival.rank(near)[0] - hits
        if more > max(SURPLUS * count, 1.0) or (more >= 0 and best.rows > board.rows):
            stated, best = rival, _with_rows(board, rival, pairs)
    return _with_edge(best, stated, near)


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


def restated_lines(board: BoardSetup, images: Sequence[Lines]) -> BoardSetup:
    """The chessboard, or board of circles, of as many columns and rows as most show."""
    fewer = BOARDS[board.type]
    counts = Counter(
        (lines.columns + fewer, lines.rows + fewer)
        for lines in [i for i in images if i.sure] or images
    )
    stated = board.columns, board.rows
    most = max(counts, key=lambda c: (counts[c], c == stated), default=stated)
    return replace(board, columns=most[0], rows=most[1])


def lines_of(levels: Floats, grid: Floats, circles: bool) -> Lines:
    """The lines of the board of which a grid was found.

    Outside the last corners of a chessboard the contrast is half that of a corner, and
    outside the last circles there is none.

    Args:
        levels: Gray levels, shape (height, width).
        grid: Corners of squares or centers of circles, shape (rows, columns, 2) [px].
        circles: Whether they are centers.
    """
    grid = _extended(_extended(grid).swapaxes(0, 1)).swapaxes(0, 1)
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
    spread = np.ptp(around, axis=0)
    # Noise alone has no contrast.
    value /= np.maximum(spread, PLACE * np.median(spread[1:-1, 1:-1]) + 1e-9)
    value *= np.sign(np.median(value[1:-1, 1:-1]))
    # At the edge of the image, a point that was found is one, and others are not.
    value[~inside] = 0.0
    value[1:-1, 1:-1][~inside[1:-1, 1:-1]] = 1.0
    full = [np.median(part, axis=0) > LINE for part in (value[1:-1], value[:, 1:-1].T)]
    ends = [inside[0], inside[-1], inside[:, 0], inside[:, -1]]
    return Lines(
        columns=int(full[0].sum()),
        rows=int(full[1].sum()),
        whole=all(part[1:-1].all() and not part[[0, -1]].any() for part in full),
        sure=all(end.mean() > 0.5 for end in ends),
    )


def _extended(grid: Floats) -> Floats:
    """Lines of points with one more before and after, as perspective and lens go on."""
    start, end = (
        2.0 * a[0] - a[1] + (a[0] - 2.0 * a[1] + a[2] if len(a) > 2 else 0.0)
        for a in (grid, grid[::-1])
    )
    return np.concatenate([start[None], grid, end[None]])


def _others(board: BoardSetup, stated: _Grid, pairs: _Pairs) -> Iterator[_Grid]:
    """Grids that tags may lie on, the likely ones first."""
    low, high = int(pairs.ids.min()), int(pairs.ids.max())
    c, r, charuco = board.columns, board.rows, stated.charuco
    widest = min(MOST, 2 * (high - low + 1) + 1)
    for columns in dict.fromkeys((c, r, c + 1, *range(1 + charuco, widest + 1))):
        back = range(low, max(low - columns, -1), -1)
        for first in dict.fromkeys((stated.first, 0, *back)):
            for shift in (stated.shift, 1 - stated.shift)[: 1 + charuco]:
                yield _Grid(charuco, columns, first, shift)


def _with_rows(board: BoardSetup, grid: _Grid, pairs: _Pairs) -> BoardSetup:
    """The board with another grid, and as many rows as its tags need."""
    joined = pairs.ids[grid.part(pairs)[1]]
    own = np.intersect1d(joined, tags_of(board))
    own, count = own if len(own) else np.unique(joined), 0
    while len(own) > count:
        # Tags beside those of the board are of the board.
        count = len(own)
        own = np.union1d(own, joined[np.isin(joined, own).any(axis=1)])
    needed = int(grid.cells(own)[:, 1].max(initial=0.0)) + 1
    rows = max(needed, board.rows if grid.columns == board.columns else 0)
    rows += grid.shift * (rows % 2)
    legacy = bool(grid.shift) or (board.legacy and rows % 2 == 1)
    return replace(
        board, columns=grid.columns, rows=rows, first=grid.first, legacy=legacy
    )


def _with_edge(board: BoardSetup, grid: _Grid, pairs: _Pairs) -> BoardSetup:
    """The board with the size of markers, or gap, of which an edge is a part."""
    charuco, square = board.type == "charuco", board.square
    size = (board.marker if charuco else board.gap) or 0.0
    pitch = square if charuco else square + size
    stated = (size if charuco else square) / pitch
    edge, hits = grid.part(pairs)
    if not hits.any():
        return board
    pixels = float(np.median(pairs.size[hits]))
    allowed = PRINT[0] / pitch + PRINT[1] + (SHIFT / pixels if pixels < FINE else 0.0)
    if abs(edge - stated) <= allowed:
        return board
    exact = square * (edge if charuco else 1.0 / edge - 1.0)
    found = round(exact, 4) or exact
    return replace(board, marker=found) if charuco else replace(board, gap=found)


def _pairs(images: Sequence[Tags]) -> _Pairs:
    """Pairs of tags that lie beside each other in an image, both ways."""
    import cv2

    found = [(np.zeros((0, 2), int), np.zeros((0, 2)), np.zeros(0), np.zeros(0))]
    for tags in images:
        if len(tags) < 2:
            continue
        corners = np.array(list(tags.values()), np.float32)
        H = np.array([cv2.getPerspectiveTransform(four, CORNERS) for four in corners])
        center = np.linalg.inv(H)[:, :, 2:]
        h = (H[:, None] @ center)[..., 0]
        # Behind the horizon there is nothing.
        seen = h[..., :2] / np.where(h[..., 2:] > 0.0, h[..., 2:], 1e-9)
        far = np.linalg.norm(seen, axis=2)
        np.fill_diagonal(far, np.inf)
        near = far < BESIDE * far.min(axis=1, keepdims=True)
        i, j = np.nonzero(near & near.T)
        ids = np.array(list(tags))[np.column_stack([i, j])]
        size = np.linalg.norm(corners[:, 0] - corners[:, 1], axis=1)
        found.append((ids, seen[i, j], np.sqrt(far[i, j] * far[j, i]), size[i]))
    return _Pairs(*map(np.concatenate, zip(*found, strict=True)))
