"""`scripts/document [--site]`: write what is made from declarations, build the site."""

from __future__ import annotations

import argparse
import sys

from documentation import (
    api_reference,
    board_pictures,
    command_reference,
    format_reference,
    setup_reference,
    watch_picture,
)
from documentation.site import build


def main() -> None:
    """Write the generated documents, and with `--site` the site from all of them."""
    parser = argparse.ArgumentParser(prog="document", description=__doc__)
    parser.add_argument("--site", action="store_true", help="build out/site as well")
    words = parser.parse_args()
    for name, text in documents().items():
        (setup_reference.DOCS / name).write_text(text)
    if words.site:
        try:
            print(f"wrote {build() / 'index.html'}")
        except RuntimeError as error:
            sys.exit(str(error))


def documents() -> dict[str, str]:
    """Name in docs/ and text of every document that is made from declarations."""
    return {
        "setup.schema.json": setup_reference.schema_text(),
        "setup.md": setup_reference.reference_text(),
        "reference/commands.md": command_reference.text(),
        "reference/formats.md": format_reference.text(),
        "reference/api.md": api_reference.text(),
        "pictures/boards.svg": board_pictures.text(),
        "pictures/watch.svg": watch_picture.text(),
    }


if __name__ == "__main__":
    main()
