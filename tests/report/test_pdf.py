"""Reports as PDF: nothing leaves its page, nothing is cut, and no text is run."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread

from calib_pin.report.blocks import Block, Cell, Code, Facts, Line, Names, table
from calib_pin.report.cover import Cover
from calib_pin.report.figures import Drawn
from calib_pin.report.pdf import pdf_report, sources
from calib_pin.report.tiles import Step, Tile
from calib_pin.setup import ReportSetup

pytestmark = pytest.mark.needs("pdf")

LONG = "left_arm_shoulder_lift_joint_with_a_name_of_sixty_characters"
HOSTILE = (
    '#read("/etc/passwd") #{1+1} $x^2$ *b* _u_ `r` <l> @r // c /* = h \\ [~] -- "q" ...'
)
"""What would be code, markup or a comment in a template."""


def cover_of(**changed: object) -> Cover:
    entries = ReportSetup("KR 7", "ACME", date="2026-11-23")
    plain = Cover(
        title="Acceptance test",
        status="PASS",
        tone="good",
        sentences=[Line("All stated limits are met.")],
        robot="arm",
        facts=[("robot", "arm"), ("limit", "AP 0.5 mm"), ("operator", "")],
        numbers=table("", ("", "found"), [("AP", "0.1")]),
        remark="A remark.",
        figures=[Drawn("Figure", "Look at it.", Figure(figsize=(7.2, 3.0)), "f")],
        entries=entries,
    )
    return replace(plain, **changed)


BLOCKS: Sequence[Block] = [
    Line("GOOD: " + "it is as it should be " * 12, "good"),
    Line(LONG * 4, "note", indent=True),
    table(
        "Long table",
        ("parameter", "value", "std. dev.", "unit|word"),
        [(f"{LONG}.{k}", f"{k}.5", "0.1", "mm") for k in range(120)],
        emphasized=(3,),
    ),
    table(
        "Wide table",
        ("name", *(f"column {k} [mm]" for k in range(14))),
        [(LONG, *(f"{k}234.5678" for k in range(14)))] * 3,
    ),
    table(
        "Remarks",
        ("a", "b|remark", "c|word"),
        [(LONG * 2, "some words " * 60, "word"), ("", "", "")],
    ),
    table("Tall row", ("|remark",), [("many words " * 2000,)]),
    Code("Lines of a file", "tip: tool0\nframes:\n  " + LONG * 3),
    Facts("Facts", [(LONG, LONG * 3), ("", "goes on"), ("short", "1\n2")]),
    Names("names:", [LONG * 3, "short"]),
]

LONG_COVER = {
    "robot": LONG,
    "status": "A VERDICT OF MANY WORDS THAT DO NOT FIT",
    "sentences": [Line("a reason " * 200, "bad")],
    "facts": [(name, LONG + LONG[:20]) for name in "abcdefghijklmnopqrst"],
    "entries": ReportSetup(LONG + LONG[:20], date="2026-11-23"),
}


def pages_of(cover: Cover, blocks: Sequence[Block]) -> list[str]:
    """The text of each page."""
    from pypdf import PdfReader

    reader = PdfReader(io.BytesIO(pdf_report(cover, blocks)))
    return [page.extract_text() for page in reader.pages]


def letters(pages: Sequence[str]) -> str:
    """All letters, wherever lines end."""
    return "".join("".join(pages).split())


@pytest.mark.parametrize("changed", [{}, LONG_COVER], ids=["plain", "long"])
def test_nothing_leaves_its_page(changed):
    import typst

    files = sources(cover_of(**changed), BLOCKS)
    # A pixel is a point.
    pages = typst.compile(files, format="png", ppi=72.0, ignore_system_fonts=True)
    assert len(pages) > 4
    for page in pages:
        dark = imread(io.BytesIO(page))[..., :3].min(axis=2) < 0.9
        assert dark.shape == (842, 595)
        (rows,), (across,) = (np.nonzero(dark.any(axis=axis)) for axis in (1, 0))
        assert rows[0] >= 30 and rows[-1] < 842 - 30
        assert across[0] >= 40 and across[-1] < 595 - 40


@pytest.mark.parametrize("count", [1, 3])
def test_the_headline_is_on_cards(count):
    sizes = [
        Step(name, Cell("0.76"), Cell("0.40"), "-47 %") for name in ("alone", "all")
    ]
    tile = Tile("mean error " * 3, (sizes[0],), "mm", "95 % below 0.7 mm")
    tiles = [replace(tile, steps=tuple(sizes)), *[tile] * (count - 1)]
    first = pages_of(cover_of(headline=tiles, robot=LONG), [])[0]
    assert first.count("0.76") == first.count("mm (-47 %)") == count + 1


def test_nothing_is_cut():
    """Nor are letters added where a name is broken, and numbers stand apart."""
    pages = pages_of(cover_of(), BLOCKS)[1:]
    text = letters(pages)
    assert text.count("many") == 2000
    assert text.count("some") == 60 and text.count("words") == 2060
    numbers = " ".join(pages).split()
    for k in range(14):
        assert numbers.count(f"{k}234.5678") == 3
    for k in range(120):
        assert f"{LONG}.{k}" in text
    assert text.count(LONG * 3) == 4


def test_a_picture_without_room_is_on_the_next_page():
    for changed, page in (({}, 0), (LONG_COVER, 1)):
        pages = pages_of(cover_of(**changed), [])
        assert ["Look at it." in text for text in pages].index(True) == page


def test_headings_are_on_every_page_of_a_table_and_no_row_is_alone():
    annex = pages_of(cover_of(), [BLOCKS[2]])[1:]
    assert len(annex) >= 3
    for k, text in enumerate(annex):
        assert text.count("std. dev.") == 1
        assert ("Long table, continued" in text) == (k > 0)
    counts = []
    for count in range(48, 55):  # Around a full page.
        rows = table("", ("", "b"), [(f"row {k}", "1") for k in range(count)])
        annex = pages_of(cover_of(), [rows])[1:]
        assert annex[-1].count("row ") >= 2
        assert sum(text.count("row ") for text in annex) == count
        counts.append(len(annex))
    assert {*counts} == {1, 2}


def test_every_page_has_its_number_and_what_it_is_of():
    pages = pages_of(cover_of(), BLOCKS)
    for k, text in enumerate(pages):
        assert f"{k + 1} / {len(pages)}" in text and "2026-11-23" in text
        assert "arm" in text and "KR 7" in text
    assert "PASS" in pages[0] and "AP 0.5 mm" in pages[0]
    every = "".join(pages)
    for title in ("Long table", "Wide table", "Remarks", "Tall row", "Facts"):
        assert title in every


def test_the_same_report_is_the_same_bytes():
    one, two = (pdf_report(cover_of(), BLOCKS[6:]) for _ in range(2))
    assert one == two
    from pypdf import PdfReader

    told = PdfReader(io.BytesIO(one)).metadata
    assert told.title == "Acceptance test: arm" and told.author.startswith("calib-pin")
    assert told.creation_date.isoformat() == "2026-11-23T00:00:00+00:00"


def test_words_are_shown_and_never_run():
    """Wherever users may write."""
    step = Step(HOSTILE, Cell(HOSTILE), Cell(HOSTILE), HOSTILE)
    cover = cover_of(
        title=HOSTILE,
        status=HOSTILE[:20],
        sentences=[Line(HOSTILE)],
        robot=HOSTILE,
        facts=[(HOSTILE, HOSTILE)],
        remark=HOSTILE,
        figures=[Drawn(HOSTILE, HOSTILE, Figure(figsize=(7.2, 3.0)), "f")],
        entries=ReportSetup(HOSTILE, date="2026-11-23"),
        headline=[Tile(HOSTILE, (step,), HOSTILE, HOSTILE)],
    )
    blocks = [
        Line(HOSTILE),
        table(HOSTILE, (HOSTILE,), [(HOSTILE,)]),
        Code(HOSTILE, HOSTILE),
        Facts(HOSTILE, [(HOSTILE, HOSTILE)]),
        Names(HOSTILE, [HOSTILE]),
    ]
    whole = "".join(HOSTILE.split())
    first, *_, annex = (letters([page]) for page in pages_of(cover, blocks))
    assert annex.count(whole) == 12
    assert first.count(whole) >= 12 and "root:" not in first + annex


def test_what_a_font_lacks_is_no_remark(capfd):
    """Nor does a name steer anything."""
    name = "机器人\x1b[2J\u202e\n\udcff"
    beyond = "Ω μ → ≤ Ж ± °"
    blocks = [Line(name), Line(beyond), table("", ("a", "b"), []), Facts("", [])]
    annex = pages_of(cover_of(robot=name, figures=[]), blocks)[-1]
    assert capfd.readouterr() == ("", "") and beyond in annex
    assert "\\x1b[2J\\u202e" in letters([annex]) and "\\udcff" in annex
