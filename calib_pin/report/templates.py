"""HTML pages, each one file without references."""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup


def rendered(template: str, **values: Any) -> bytes:
    """A page as UTF-8 text, with the style sheet and the script of all pages.

    Args:
        template: Its file in the folder `page`.
        values: What it shows; texts are escaped.
    """
    page = (
        _pages()
        .get_template(template)
        .render(
            **values,
            style=Markup(_file("style.css")),
            script=Markup(_file("script.js")),
        )
    )
    return page.encode("utf-8", "backslashreplace")


@cache
def _pages() -> Environment:
    environment = Environment(
        loader=PackageLoader("calib_pin.report", "page"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    environment.filters["kind"] = lambda block: type(block).__name__
    environment.filters["exact"] = repr
    return environment


def _file(name: str) -> str:
    return (files("calib_pin.report") / "page" / name).read_text("utf-8")
