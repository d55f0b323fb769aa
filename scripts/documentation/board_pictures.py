"""Where the origin of each board is: a picture of the points that the package has."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

from calib_pin.setup import BOARDS, TAGS, BoardSetup

SHOWN = (
    BoardSetup("charuco", 5, 4, 1.0, 0.7),
    BoardSetup("chessboard", 5, 4, 1.0),
    BoardSetup("circles", 5, 4, 1.0),
    BoardSetup("apriltag", 3, 2, 1.0, gap=0.5),
    BoardSetup("marker", 1, 1, 1.6),
)
"""A board of each type, with lengths for the picture."""

SCALE, EDGE, ROW = 40.0, 30.0, 215.0
"""Pixels of a unit of length, of the margin, and height of a row of boards."""

COLUMNS, WIDTH = 3, 270.0
"""Boards in a row, and the width of each [px]."""

STYLE = (
    "text{font:11px sans-serif}.name{font-weight:bold;font-size:13px}"
    ".point{fill:#d55e00}.x{stroke:#c00;fill:#c00}.y{stroke:#080;fill:#080}"
    ".z{stroke:#00c;fill:none}.dark{fill:#444}.tag{fill:#999}"
    ".sheet{fill:#fff;stroke:#444}.xname{fill:#c00}.yname{fill:#080}.zname{fill:#00c}"
    ".label{paint-order:stroke;stroke:#fff;stroke-width:3px}"
)


def text() -> str:
    """The text of docs/pictures/boards.svg."""
    rows = -(-len(SHOWN) // COLUMNS)
    size = f'width="{COLUMNS * WIDTH:g}" height="{rows * ROW:g}"'
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" {size}>',
        f"<style>{STYLE}</style>",
        '<rect width="100%" height="100%" fill="#fff"/>',
    ]
    for k, board in enumerate(SHOWN):
        left, top = WIDTH * (k % COLUMNS), ROW * (k // COLUMNS)
        lines += _board(board, left + EDGE, top + EDGE + 12.0)
    return "\n".join([*lines, "</svg>", ""])


def _board(board: BoardSetup, left: float, top: float) -> Iterator[str]:
    """A board with its points and the axes at its origin."""
    pitch, edge = board.square + (board.gap or 0.0), board.square
    tags, dots = board.type in TAGS, board.type == "circles"
    # From the corner of the sheet to the first point.
    first = 0.0 if tags else edge * (0.5 if dots else BOARDS[board.type])

    def at(x: float, y: float) -> tuple[float, float]:
        return left + SCALE * (x + first), top + SCALE * (y + first)

    yield f'<text class="name" x="{left:g}" y="{top - 16:g}">{board.type}</text>'
    extent = [
        SCALE * (n * pitch - (board.gap or 0.0)) for n in (board.columns, board.rows)
    ]
    yield _square("sheet", (left, top), *extent)
    for row, column in product(range(board.rows), range(board.columns)):
        corner = at(pitch * column - first, pitch * row - first)
        if dots:
            x, y = at(pitch * column, pitch * row)
            yield f'<circle class="dark" cx="{x:g}" cy="{y:g}" r="{SCALE / 4:g}"/>'
        elif tags or (row + column) % 2 == 0:
            yield _square("dark", corner, SCALE * edge, SCALE * edge)
        elif board.marker:
            inset = 0.5 * SCALE * (edge - board.marker)
            place = corner[0] + inset, corner[1] + inset
            yield _square("tag", place, SCALE * board.marker, SCALE * board.marker)
    for name, point in board.points.items():
        assert point.xyz is not None
        x, y = at(*point.xyz[:2])
        yield f'<circle class="point" cx="{x:g}" cy="{y:g}" r="3"/>'
        yield f'<text class="label" x="{x + 4:g}" y="{y - 4:g}">{name}</text>'
    yield from _axes(*at(0.0, 0.0))


def _square(kind: str, place: tuple[float, float], width: float, height: float) -> str:
    x, y = place
    size = f'width="{width:g}" height="{height:g}"'
    return f'<rect class="{kind}" x="{x:g}" y="{y:g}" {size}/>'


def _axes(x: float, y: float) -> Iterator[str]:
    """X to the right, y down, z away from who looks at the board."""
    far, wing = 1.4 * SCALE, 4.0
    for axis, (u, v) in {"x": (1.0, 0.0), "y": (0.0, 1.0)}.items():
        a, b = x + far * u, y + far * v
        left, right = (
            f"{a - 9 * u + side * wing * v:g} {b - 9 * v + side * wing * u:g}"
            for side in (1.0, -1.0)
        )
        line = f"M{x:g} {y:g}L{a:g} {b:g}L{left}L{right}L{a:g} {b:g}"
        yield f'<path class="{axis}" stroke-width="2.5" d="{line}"/>'
        place = f'x="{a + 6 * v:g}" y="{b - 6 * u:g}"'
        yield f'<text class="label {axis}name" {place}>{axis}</text>'
    yield f'<circle class="z" stroke-width="2" cx="{x:g}" cy="{y:g}" r="7"/>'
    cross = f"M{x - 5:g} {y - 5:g}l10 10m0 -10l-10 10"
    yield f'<path class="z" stroke-width="2" d="{cross}"/>'
    yield f'<text class="label zname" x="{x - 20:g}" y="{y - 8:g}">z</text>'
