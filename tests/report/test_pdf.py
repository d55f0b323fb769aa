"""Reports as PDF: nothing overlaps or leaves its page, and nothing is cut."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import pytest
from matplotlib.figure import Figure

from calib_pin.report.blocks import (
    Block,
    Cell,
    Code,
    Column,
    Facts,
    Line,
    Names,
    Table,
    columns,
)
from calib_pin.report.cover import Cover
from calib_pin.report.figures import Drawn
from calib_pin.report.pdf import laid_out, pdf_report
from calib_pin.report.sheets import (
    HEIGHT,
    LEFT,
    RIGHT,
    WIDTH,
    Area,
    Item,
    Words,
)
from calib_pin.report.tiles import Step, Tile
from calib_pin.setup import ReportSetup

LONG = "left_arm_shoulder_lift_joint_with_a_name_of_sixty_characters"
DESCENT = 0.24
"""Part of the size that letters reach below their line."""


def row_of(*words: str) -> list[Cell]:
    return [Cell(word) for word in words]


def cover_of(**changed: object) -> Cover:
    entries = ReportSetup("KR 7", "ACME", date="2026-11-23")
    plain = Cover(
        title="Acceptance test",
        status="PASS",
        tone="good",
        said=[Line("All stated limits are met.")],
        robot="arm",
        facts=[("robot", "arm"), ("limit", "AP 0.5 mm"), ("operator", "")],
        numbers=Table("", columns("", ("found",)), [row_of("AP", "0.1")]),
        remark="A remark.",
        figures=[Drawn("f", "Figure", "Look at it.", Figure(figsize=(7.2, 3.0)))],
        entries=entries,
    )
    return replace(plain, **changed)


BLOCKS: Sequence[Block] = [
    Line("GOOD: " + "it is as it should be " * 12, "good"),
    Line(LONG * 4, "note", indent=True),
    Table(
        "Long table",
        columns("parameter", ("value", "std. dev.", "unit")),
        [row_of(f"{LONG}.{k}", f"{k}.5", "0.1", "mm") for k in range(120)],
        emphasized=(3,),
    ),
    Table(
        "Wide table",
        columns("name", [f"column {k} [mm]" for k in range(14)]),
        [row_of(LONG, *(f"{k}234.5678" for k in range(14)))] * 3,
    ),
    Table(
        "Remarks",
        (Column("a", "name"), Column("b", "remark"), Column("c", "word")),
        [row_of(LONG * 2, "some words " * 60, "word"), row_of("", "", "")],
    ),
    Table("Tall row", (Column("", "remark"),), [row_of("many words " * 2000)]),
    Code("Lines of a file", "tip: tool0\nframes:\n  " + LONG * 3),
    Facts("Facts", [(LONG, LONG * 3), ("", "goes on"), ("short", "1\n2")]),
    Names("names:", [LONG * 3, "short"]),
]


def box_of(item: Item) -> tuple[float, float, float, float]:
    """Left, upper, right and lower end."""
    if isinstance(item, Words):
        top, bottom = item.y - 0.76 * item.size, item.y + DESCENT * item.size
        return item.x, top, item.x + item.width, bottom
    return item.x, item.y, item.x + item.width, item.y + item.height


def check(sheet: Sequence[Item]) -> None:
    """Nothing overlaps or leaves the page."""
    for item in sheet:
        left, top, right, bottom = box_of(item)
        assert LEFT - 0.1 <= left <= right <= RIGHT + 0.1
        assert 20.0 <= top <= bottom <= HEIGHT - 20.0
    solid = [item for item in sheet if not isinstance(item, Area)]
    for first, second in combinations(solid, 2):
        a, b = box_of(first), box_of(second)
        # Letters of neighboring lines may touch by a hair.
        across = min(a[2], b[2]) - max(a[0], b[0])
        down = min(a[3], b[3]) - max(a[1], b[1])
        assert min(across, down) <= 0.2, (first, second)


@pytest.mark.parametrize(
    "cover",
    [
        cover_of(),
        cover_of(
            robot=LONG,
            status="A VERDICT OF MANY WORDS THAT DO NOT FIT",
            said=[Line("a reason " * 200, "bad")],
            facts=[(name, LONG + LONG[:20]) for name in "abcdefghij"],
            entries=ReportSetup(LONG + LONG[:20], date="2026-11-23"),
        ),
    ],
    ids=["plain", "long"],
)
def test_nothing_overlaps_or_leaves_its_page(cover):
    sheets = laid_out(cover, BLOCKS).sheets
    assert len(sheets) > 4
    for sheet in sheets:
        check(sheet)


@pytest.mark.parametrize("count", [1, 3])
def test_the_headline_is_on_cards(count):
    sizes = [
        Step(name, Cell("0.76"), Cell("0.40"), "-47 %") for name in ("alone", "all")
    ]
    tile = Tile("mean error " * 3, (sizes[0],), "mm", "95 % below 0.7 mm")
    tiles = [replace(tile, steps=tuple(sizes)), *[tile] * (count - 1)]
    (first, *_) = laid_out(cover_of(headline=tiles, robot=LONG), []).sheets
    check(first)
    texts = [item.text for item in first if isinstance(item, Words)]
    assert texts.count("0.76") == texts.count("mm (-47 %)") == count + 1


def test_nothing_is_cut():
    """All letters of the blocks are somewhere, in their order."""
    sheets = laid_out(cover_of(), BLOCKS).sheets
    words = [i.text for sheet in sheets[1:] for i in sheet if isinstance(i, Words)]
    text = "".join("".join(words).split())
    assert text.count("many") == 2000
    assert text.count("some") == 60 and text.count("words") == 2060
    for k in range(14):
        assert text.count(f"{k}234.5678") >= 3
    for k in range(120):
        assert f"{LONG}.{k}" in text


def test_headings_are_on_every_page_of_a_table():
    sheets = laid_out(cover_of(), [BLOCKS[2]]).sheets[1:]
    assert len(sheets) >= 3
    for sheet in sheets:
        texts = [item.text for item in sheet if isinstance(item, Words)]
        assert texts.count("std. dev.") == 1
        continued = "Long table, continued" in texts
        assert continued == (sheet is not sheets[0])


def test_no_row_is_alone_on_a_page():
    for count in range(44, 50):  # Around a full page.
        rows = [row_of(f"row {k}", "1") for k in range(count)]
        last = laid_out(cover_of(), [Table("", columns("", ("b",)), rows)]).sheets[-1]
        texts = [item.text for item in last if isinstance(item, Words)]
        assert sum(text.startswith("row ") for text in texts) >= 2


@pytest.mark.needs("pdf-reading")
def test_every_page_has_its_number_and_what_it_is_of():
    pages = texts_of(pdf_report(cover_of(), BLOCKS))
    for k, text in enumerate(pages):
        assert f"{k + 1} / {len(pages)}" in text and "2026-11-23" in text
        assert "arm" in text and "KR 7" in text
    assert "PASS" in pages[0] and "AP 0.5 mm" in pages[0]
    every = "".join(pages)
    for title in ("Long table", "Wide table", "Remarks", "Tall row", "Facts"):
        assert title in every


def texts_of(data: bytes) -> list[str]:
    """The text of each page."""
    import pypdf

    reader = pypdf.PdfReader(io.BytesIO(data))
    for page in reader.pages:
        assert float(page.mediabox.width) == pytest.approx(WIDTH, abs=0.1)
        assert float(page.mediabox.height) == pytest.approx(HEIGHT, abs=0.1)
    return [page.extract_text() for page in reader.pages]


def test_the_same_report_is_the_same_bytes():
    one, two = (pdf_report(cover_of(), BLOCKS[6:]) for _ in range(2))
    assert one == two and one.startswith(b"%PDF")


def test_what_a_font_lacks_is_no_remark(capfd):
    """Nor does a name steer anything."""
    name = "机器人\x1b[2J\u202e\n\udcff"
    blocks = [Line(name), Line(""), Table("", columns("a", ("b",)), []), Facts("", [])]
    assert pdf_report(cover_of(robot=name), blocks).startswith(b"%PDF")
    assert capfd.readouterr() == ("", "")
    sheet = laid_out(cover_of(robot=name), blocks).sheets[1]
    texts = "".join(item.text for item in sheet if isinstance(item, Words))
    assert "\\x1b[2J\\u202e" in texts
