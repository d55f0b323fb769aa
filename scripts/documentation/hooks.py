"""What the site does to a page before it is Markdown: formulas become MathML.

A reader on GitHub sees them there, and a reader of the site without a network, since
browsers draw MathML themselves.
"""

from __future__ import annotations

import re
from typing import Any

from latex2mathml.converter import convert

BLOCK = re.compile(r"^```math\n(.*?)^```$", re.MULTILINE | re.DOTALL)
INLINE = re.compile(r"\$`([^`\n]+)`\$")


def with_formulas(markdown: str) -> str:
    """A page whose formulas, as GitHub writes them, are MathML."""
    blocks = BLOCK.sub(lambda found: convert(found[1], display="block"), markdown)
    return INLINE.sub(lambda found: convert(found[1]), blocks)


def on_page_markdown(markdown: str, **_: Any) -> str:
    """The event of mkdocs before a page is rendered."""
    return with_formulas(markdown)
