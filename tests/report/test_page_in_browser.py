"""The page of a calibration in a browser: alive, readable at any width, on paper."""

from __future__ import annotations

import io
import re
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from tests.report.test_html import page

__all__ = ["page"]

pytestmark = [pytest.mark.slow, pytest.mark.needs("browser")]


@pytest.fixture
def opened(page: tuple[bytes, dict[str, Any]], tmp_path: Path, browser: Any) -> Any:
    """The page as a tab, with what it complains about and asks for."""
    file = tmp_path / "report.html"
    file.write_bytes(page[0])
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    tab = context.new_page()
    tab.complaints, tab.asked = [], []
    tab.on("console", lambda message: tab.complaints.append(message.text))
    tab.on("pageerror", lambda error: tab.complaints.append(str(error)))
    tab.on("request", lambda request: tab.asked.append(request.url))
    tab.goto(file.as_uri())
    yield tab
    assert tab.complaints == []
    assert [url for url in tab.asked if not url.startswith("data:")] == [file.as_uri()]
    context.close()


def column(tab: Any, number: int) -> list[str]:
    rows = "#parameter-table tbody tr:not([hidden])"
    return list(
        tab.eval_on_selector_all(
            rows, f"rows => rows.map(row => row.cells[{number}].textContent)"
        )
    )


def test_tables_are_sorted_and_filtered(opened, calibrated):
    parameters = calibrated.parameters
    assert column(opened, 0) == [p.name for p in parameters]
    head = opened.locator("#parameter-table th", has_text="std. dev.")
    head.locator("button").click()
    assert head.get_attribute("aria-sort") == "ascending"
    # Millimeters and degrees do not mix.
    known = [
        sigma
        for unit in ("rad", "m")
        for sigma in sorted(p.sigma for p in parameters if p.sigma and p.unit == unit)
    ]
    first = "#parameter-table tbody tr td:nth-child(3)"
    values = opened.eval_on_selector_all(first, "c => c.map(c => c.dataset.value)")
    assert [float(v) for v in values if v is not None] == known
    assert values[len(known) :] == [None] * (len(parameters) - len(known))
    head.locator("button").click()
    assert head.get_attribute("aria-sort") == "descending"
    opened.fill("#filter", "JOINT_2 dx")
    assert column(opened, 0) == ["joint_2.link-transform.dx"]
    assert opened.inner_text("#count") == f"1 of {len(parameters)}"
    opened.fill("#filter", "")
    opened.select_option("#status", "coupled")
    assert set(column(opened, 4)) == {"coupled"}


def test_the_first_screen(opened):
    """Verdict, headline and both figures, without scrolling."""
    boxes = [
        opened.locator(name).first.bounding_box()
        for name in ("#verdict", ".tiles", "#figure-robot-errors", "nav")
    ]
    for above, below in pairwise(boxes):
        assert above["y"] + above["height"] <= below["y"]
    assert boxes[-1]["y"] < 900
    curves = opened.locator("#figure-cumulative-errors").bounding_box()
    assert curves["y"] == boxes[2]["y"] and curves["x"] > boxes[2]["x"]


def test_paper_has_page_numbers_and_no_zeros(opened):
    import pypdf

    data = opened.pdf(prefer_css_page_size=True)
    pages = [page.extract_text() for page in pypdf.PdfReader(io.BytesIO(data)).pages]
    for k, text in enumerate(pages):
        assert f"{k + 1} / {len(pages)}" in text
    text = "".join(pages)
    assert not re.search(r"\n\S+ [-+]?0\.0000 - (mm|deg)", text)


def test_every_figure_is_seen_and_nothing_sticks_out(opened, drawn):
    for name in (figure.name for figure in drawn):
        box = opened.locator(f"#figure-{name} svg").bounding_box()
        assert box["width"] > 400 and box["height"] > 150
        assert opened.locator(f"#figure-{name} figcaption").inner_text()
    for width in (1280, 400):
        opened.set_viewport_size({"width": width, "height": 900})
        assert opened.evaluate("document.documentElement.scrollWidth") <= width


def test_light_dark_and_paper(opened):
    """By the system's choice, by the button, and always light on paper."""

    def shade(what: str, selector: str = "body") -> float:
        code = f"e => getComputedStyle(e).{what}.match(/\\d+/g).map(Number)"
        return sum(opened.eval_on_selector(selector, code)[:3]) / 3

    ink = "#figure-errors-per-measurement svg text"
    assert shade("backgroundColor") > 230 and shade("fill", ink) < 90
    opened.click("#theme")
    assert shade("backgroundColor") < 50 and shade("fill", ink) > 200
    opened.click("#theme")
    opened.emulate_media(color_scheme="dark")
    opened.reload()
    assert shade("backgroundColor") < 50 and shade("color") > 200
    opened.asked.pop()
    opened.emulate_media(media="print", color_scheme="dark")
    assert shade("backgroundColor") > 230 and shade("color") < 50
    assert not opened.locator("#theme").is_visible()
