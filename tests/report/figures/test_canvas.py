"""SVG made part of a page."""

from __future__ import annotations

from xml.etree import ElementTree

from calib_pin.report.figures.canvas import inlined

FILE = b"""<?xml version="1.0"?>
<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"
 width="5pt" height="4pt" viewBox="0 0 5 4"><metadata><a/></metadata>
<defs><style>* {fill: red}</style><path id="m" d="M 0.123456 1.5 L 2 3.999999"/></defs>
<g clip-path="url(#p)" id="g" style="fill: #112233; stroke: #445566">
<use xlink:href="#m" x="1.23456" y="7" style="fill: #112233"/>
<text style="font: bold 9.5px 'A', sans-serif; fill: #112233">
id="m" url(#p) #112233</text>
<text style="font-size: 8px; font-family: 'A'; text-anchor: end">1.23456</text>
</g></svg>"""


def test_only_what_means_something_is_changed() -> None:
    svg = inlined(FILE, "figure", "A & B", {"#112233": "ink"})
    root = ElementTree.fromstring(svg)
    assert root.get("aria-label") == "A & B" and root.get("width") is None
    assert "metadata" not in svg and "fill: red" not in svg
    ns = "{http://www.w3.org/2000/svg}"
    path = next(root.iter(f"{ns}path"))
    assert path.get("id") == "figure-m" and path.get("d") == "M 0.12 1.5 L 2 4"
    group = next(root.iter(f"{ns}g"))
    assert group.get("clip-path") == "url(#figure-p)"
    assert group.get("style") == "fill: var(--ink); stroke: #445566"
    use = next(root.iter(f"{ns}use"))
    assert use.get("href") == "#figure-m" and use.get("x") == "1.23"
    first, second = root.iter(f"{ns}text")
    assert (first.text or "").strip() == 'id="m" url(#p) #112233', "text is not code"
    assert first.get("style") == "font-size: 9.5px; fill: var(--ink)"
    assert second.text == "1.23456"
    assert second.get("style") == "font-size: 8px; text-anchor: end"
