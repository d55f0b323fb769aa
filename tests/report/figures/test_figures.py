"""All figures together: which there are, that they are part of a page, and last."""

from __future__ import annotations

import re
from importlib.resources import files
from xml.etree import ElementTree

import matplotlib as mpl
import numpy as np
import pytest

from calib_pin.report.figures import NAMES, Drawn
from calib_pin.report.figures import drawn as draw_all
from calib_pin.report.figures.canvas import AFTER, BEFORE, GROUPS, STYLE
from calib_pin.report.figures.errors import residuals_by_joint
from calib_pin.report.figures.robot_errors import robot_errors
from calib_pin.validation.result import CalibrationResult
from tests.report.results import solve, with_errors, without

COLORS = {
    "ink": STYLE["text.color"],
    "muted": STYLE["axes.edgecolor"],
    "grid": STYLE["grid.color"],
    "paper": STYLE["figure.facecolor"],
    "before": BEFORE,
    "after": AFTER,
}
"""Colors of figures by their names in the style sheet of pages."""

LINK = "{http://www.w3.org/1999/xlink}href"


def whole(element: ElementTree.Element) -> bytes:
    return ElementTree.tostring(element).strip()


def words_of(svg: str | bytes) -> str:
    return "".join(ElementTree.fromstring(svg).itertext())


def test_all_figures_are_there_in_order(drawn):
    assert [figure.name for figure in drawn] == [*NAMES["calibration"]]
    assert sum(map(len, NAMES.values())) <= 12, "each answers a question of a user"
    for figure in drawn:
        assert figure.title and "\n" not in figure.reading
        assert figure.reading.endswith(".") and "  " not in figure.reading


def test_pictures_have_a_heading_and_say_what_to_look_for(drawn, inline):
    """In a page they stand around the figure, which has to be as it was."""
    figure = drawn[-1]
    picture = figure.picture("svg")
    assert picture.startswith(b"<?xml") and picture == figure.picture("svg")
    words = words_of(picture)
    assert figure.title in words
    assert all(word in words for word in figure.reading.split())
    assert Drawn.svg(figure) == inline[figure.name]
    assert figure.reading[:20] not in words_of(inline[figure.name])


def test_figures_are_part_of_a_page(drawn, inline):
    """What is used is there, and what has a name is the same wherever it has it."""
    named: dict[str, bytes] = {}
    for figure in drawn:
        svg = inline[figure.name]
        root = ElementTree.fromstring(svg)
        assert svg.startswith("<svg ") and root.get("viewBox")
        found = {e.get("id", ""): whole(e) for e in root.iter()}
        for name, content in found.items():
            assert name == "" or named.setdefault(name, content) == content
        links = [e.get(LINK, "") for e in root.iter()]
        used = {link[1:] for link in links if link.startswith("#")}
        used |= set(re.findall(r"url\(#([^)]*)\)", svg))
        assert used and used <= set(found)


def test_the_style_sheet_gives_figures_another_color_in_the_dark(inline):
    style = (files("calib_pin.report") / "page" / "style.css").read_text()
    for name, color in COLORS.items():
        for kind in ("fill", "stroke"):
            rule = f'[style*="{kind}: {color}"] {{ {kind}: var(--{name}) !important; }}'
            assert rule in style
        assert re.search(rf"--{name}: light-dark\(#\w+, #\w+\)", style)
    for svg in inline.values():
        assert "<text" in svg and "metadata" not in svg, "text stays text"
        links = re.findall(r'(?:href|src)="([^"]*)"', svg)
        assert all(link.startswith(("#", "data:image/png;base64,")) for link in links)
    shades = re.findall(r"(?:fill|stroke): (#\w+)", inline["residuals-by-joint"])
    assert {*shades} <= {*COLORS.values(), *GROUPS, "#000000"}


def test_the_style_of_others_is_left_alone(calibrated):
    before = dict(mpl.rcParams)
    figure = next(draw_all("calibration", calibrated))
    assert dict(mpl.rcParams) == before
    figure.svg()
    assert dict(mpl.rcParams) == before


HOSTILE = "$\\a^{2$_<b>&\"']]>\u4e2d\u202e" + 180 * "x" + "end"
"""The name of a joint."""


@pytest.fixture(scope="module")
def hostile() -> CalibrationResult:
    escaped = HOSTILE.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")
    result = solve(("arm", "j1", escaped, "j3"), "position", validate=False)
    assert any(HOSTILE in p.name for p in result.parameters if p.sigma)
    return result


def test_names_are_taken_as_they_are(hostile, draw):
    shown = words_of(draw(residuals_by_joint, hostile).svg())
    assert "$\\a^{2$_<" in shown
    assert "\u202e" not in shown and HOSTILE[:20] not in shown


@pytest.mark.slow
def test_so_do_pictures_of_them_which_are_the_same_bytes(hostile, draw):
    one, two = (draw(robot_errors, hostile).svg() for _ in range(2))
    assert one == two
    for kind, start in (("png", b"\x89PNG"), ("pdf", b"%PDF")):
        one, two = (draw(residuals_by_joint, hostile).picture(kind) for _ in range(2))
        assert one.startswith(start) and one == two


def test_any_errors_can_be_drawn_and_what_says_nothing_is_left_out(calibrated):
    count = len(calibrated.fitted)
    sizes = [1e-3, np.inf, 1e-300, np.nan, 0.0]
    before, after = (np.resize(sizes[k:] + sizes[:k], (count, 1)) for k in (0, 1))
    drawn = draw_all(
        "calibration", with_errors(without(calibrated), before=before, after=after)
    )
    found = {figure.name: ElementTree.fromstring(figure.svg()) for figure in drawn}
    assert [*found] == [
        *("robot-errors", "cumulative-errors"),
        *("errors-per-measurement", "residuals-over-order", "residuals-by-joint"),
    ]
