"""Reports as PDF: nothing overlaps or leaves its page, and nothing is cut."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations

import pypdf
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
from calib_pin.report.pdf import COLORS, laid_out, pdf_report
from calib_pin.report.sheets import (
    HEIGHT,
    LEFT,
    RIGHT,
    WIDTH,
    Area,
    Item,
    Picture,
    Words,
    broken,
    width_of,
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


def overlaps(sheet: Sequence[Item]) -> Iterator[tuple[Item, Item]]:
    solid = [item for item in sheet if not isinstance(item, Area)]
    for first, second in combinations(solid, 2):
        a, b = box_of(first), box_of(second)
        # Letters of neighboring lines may touch by a hair.
        across = min(a[2], b[2]) - max(a[0], b[0])
        down = min(a[3], b[3]) - max(a[1], b[1])
        if across > 0.2 and down > 0.2:
            yield first, second


@pytest.mark.parametrize(
    "cover",
    [
        cover_of(),
        cover_of(figures=[], remark="", facts=[]),
        cover_of(
            robot=LONG,
            status="A VERDICT OF MANY WORDS THAT DO NOT FIT",
            said=[Line("a reason " * 200, "bad")],
            facts=[(name, LONG + LONG[:20]) for name in "abcdefghij"],
            entries=ReportSetup(LONG + LONG[:20], date="2026-11-23"),
        ),
    ],
    ids=["plain", "bare", "long"],
)
def test_nothing_overlaps_or_leaves_its_page(cover):
    sheets = laid_out(cover, BLOCKS).sheets
    assert len(sheets) > 4
    for sheet in sheets:
        assert [*overlaps(sheet)] == []
        for item in sheet:
            left, top, right, bottom = box_of(item)
            assert LEFT - 0.1 <= left <= right <= RIGHT + 0.1
            assert 20.0 <= top <= bottom <= HEIGHT - 20.0


@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_the_headline_is_on_cards(count):
    sizes = [
        Step(name, Cell("0.76"), Cell("0.40"), "-47 %") for name in ("alone", "all")
    ]
    tile = Tile("mean error " * 3, (sizes[0],), "mm", "95 % below 0.7 mm")
    taller = replace(tile, steps=tuple(sizes))
    cover = cover_of(headline=[tile, taller, *[tile] * 3][:count], robot=LONG)
    (first, *_) = laid_out(cover, []).sheets
    assert [*overlaps(first)] == []
    texts = [item.text for item in first if isinstance(item, Words)]
    steps = count + (count > 1)
    assert texts.count("0.76") == texts.count("mm (-47 %)") == steps
    for item in first:
        left, _, right, _ = box_of(item)
        assert LEFT - 0.1 <= left <= right <= RIGHT + 0.1


def test_all_pictures_have_room_somewhere():
    pictures = [
        Drawn(name, name, "Look. " * 40, Figure(figsize=(7.2, 4.2))) for name in "abc"
    ]
    sheets = laid_out(cover_of(figures=pictures), BLOCKS).sheets
    found = [k for k, s in enumerate(sheets) for i in s if isinstance(i, Picture)]
    assert len(found) == 3 and found == sorted(found)
    for sheet in sheets:
        assert [*overlaps(sheet)] == []


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


@pytest.mark.parametrize("count", range(40, 60))
def test_no_row_is_alone_on_a_page(count):
    rows = [row_of(f"row {k}", "1") for k in range(count)]
    last = laid_out(cover_of(), [Table("", columns("", ("b",)), rows)]).sheets[-1]
    texts = [item.text for item in last if isinstance(item, Words)]
    assert sum(text.startswith("row ") for text in texts) >= 2


def test_a_table_that_is_too_wide_has_smaller_letters():
    def size(table: Block) -> float:
        sheet = laid_out(cover_of(), [table]).sheets[1]
        cells = [i for i in sheet if isinstance(i, Words) and i.text.endswith("5678")]
        return cells[0].size

    wide = BLOCKS[3]
    assert isinstance(wide, Table)
    narrow = Table("", wide.columns[:3], [row[:3] for row in wide.rows])
    assert size(wide) < size(narrow)


def test_every_page_has_its_number_and_what_it_is_of():
    data = pdf_report(cover_of(), BLOCKS)
    reader = pypdf.PdfReader(io.BytesIO(data))
    count = len(reader.pages)
    for k, page in enumerate(reader.pages):
        text = page.extract_text()
        assert f"{k + 1} / {count}" in text and "2026-11-23" in text
        assert "arm" in text and "serial number KR 7" in text
        assert float(page.mediabox.width) == pytest.approx(WIDTH, abs=0.1)
        assert float(page.mediabox.height) == pytest.approx(HEIGHT, abs=0.1)
    first = reader.pages[0].extract_text()
    for words in ("PASS", "AP 0.5 mm", "signature"):
        assert words in first
    every = "".join(page.extract_text() for page in reader.pages)
    for title in ("Long table", "Wide table", "Remarks", "Tall row", "Facts"):
        assert title in every


def test_the_same_report_is_the_same_bytes():
    one, two = (pdf_report(cover_of(), BLOCKS) for _ in range(2))
    assert one == two
    entries = replace(cover_of().entries, date="2026-11-24")
    assert pdf_report(cover_of(entries=entries), BLOCKS) != one


def test_what_a_font_lacks_is_no_remark(capfd):
    """Nor does a name steer anything."""
    name = "机器人\x1b[2J\u202e\n\udcff"
    empty = [Line(""), Table("", columns("a", ("b",)), []), Facts("", [])]
    data = pdf_report(cover_of(robot=name), [Line(name), *empty])
    assert capfd.readouterr() == ("", "")
    text = pypdf.PdfReader(io.BytesIO(data)).pages[1].extract_text()
    assert "\\x1b[2J\\u202e" in text


def test_a_verdict_has_its_color():
    red = cover_of(status="FAIL", tone="bad", said=[Line("Do not trust it.", "bad")])
    for item in laid_out(red, []).sheets[0]:
        if isinstance(item, Words) and item.text in ("FAIL", "Do not trust it."):
            assert item.color == COLORS["bad"]


def test_there_is_one_picture_and_it_keeps_its_shape():
    sheets = laid_out(cover_of(), BLOCKS).sheets
    (picture,) = [i for sheet in sheets for i in sheet if isinstance(i, Picture)]
    assert picture in sheets[0]
    assert picture.width / picture.height == pytest.approx(7.2 / 3.0, rel=1e-2)


def test_names_break_between_words_or_behind_a_sign():
    width = width_of("left_arm_shoulder_l", 8.0)
    assert broken("left_arm_shoulder_lift", width, 8.0) == [
        "left_arm_shoulder_",
        "lift",
    ]
    width = width_of("one two th", 8.0)
    assert broken("one two three", width, 8.0) == ["one two", "three"]
    assert broken("", width, 8.0) == [""]
