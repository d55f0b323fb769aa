"""Images of few colors: a picture in a page takes a third of its bytes."""

from __future__ import annotations

import base64
import io

from PIL import Image

PNG = "data:image/png;base64,"


def with_palette(address: str) -> str:
    """A picture in an address, with a palette if that makes it shorter.

    Args:
        address: The `data:` address of a PNG file; any other is left alone.
    """
    if not address.startswith(PNG):
        return address
    stream = io.BytesIO()
    with Image.open(io.BytesIO(base64.b64decode(address[len(PNG) :]))) as picture:
        few = picture.convert("RGBA").quantize(256, Image.Quantize.FASTOCTREE)
        few.save(stream, format="png", optimize=True)
    shorter = PNG + base64.b64encode(stream.getvalue()).decode()
    return min(shorter, address, key=len)
