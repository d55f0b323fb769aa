"""Images of few colors: a picture in a page takes a third of its bytes."""

from __future__ import annotations

import base64
import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from calib_pin.kinematics.spatial import Floats

Bytes = NDArray[np.uint8]

PNG = "data:image/png;base64,"

COUNT = 256
"""Colors that a palette holds."""

RARE = 0.5
"""Power of its number of pixels that a color weighs: the rare ones count as well."""


def with_few_colors(image: Bytes) -> Bytes:
    """The image (h, w, 4) in the colors that stand for its own with the least error.

    The colors are split where they vary most, until there are enough groups (S. J. Wan,
    P. Prusinkiewicz, S. K. M. Wong, "Variance-based color image quantization", 1990);
    what is hardly opaque counts as little as it is seen.
    """
    codes = np.ascontiguousarray(image).view(np.uint32).ravel()
    known, place, counts = np.unique(codes, return_inverse=True, return_counts=True)
    colors = known.view(np.uint8).reshape(-1, 4).astype(float)
    opacity = colors[:, 3:] / 255.0
    seen = np.concatenate([colors[:, :3] * opacity, colors[:, 3:]], axis=1)
    weight = counts**RARE
    # What is not there is a color of its own, or all else would get a tint.
    groups = [np.flatnonzero(opacity[:, 0] > 0.0)]
    losses = [_loss(seen, weight, groups[0])]
    while len(groups) < COUNT - 1:
        worst = int(np.argmax([loss for loss, _ in losses]))
        if losses[worst][0] <= 0.0:
            break
        axis, group = losses[worst][1], groups[worst]
        along = seen[group, axis]
        low = along <= np.average(along, weights=weight[group])
        parts = group[low], group[~low]
        groups[worst : worst + 1] = parts
        losses[worst : worst + 1] = [_loss(seen, weight, part) for part in parts]
    result = np.zeros((len(known), 4), np.uint8)
    for group in filter(len, groups):
        mean = np.average(seen[group], axis=0, weights=weight[group])
        mean[:3] *= 255.0 / max(mean[3], 1.0)
        result[group] = np.clip(mean, 0.0, 255.0).round()
    return result[place.reshape(image.shape[:2])]


def _loss(seen: Floats, weight: Floats, group: NDArray[np.intp]) -> tuple[float, int]:
    """What one color for a group loses along its longest axis, and that axis."""
    if len(group) == 0:
        return 0.0, 0
    own, colors = weight[group], seen[group]
    mean = np.average(colors, axis=0, weights=own)
    squares = (own[:, None] * (colors - mean) ** 2).sum(axis=0)
    axis = int(np.argmax(squares))
    return (float(squares[axis]) if np.ptp(colors[:, axis]) > 0.0 else 0.0), axis


def with_palette(address: str) -> str:
    """A picture in an address, with a palette if its colors fit into one.

    Args:
        address: The `data:` address of a PNG file; any other is left alone.
    """
    if not address.startswith(PNG):
        return address
    with Image.open(io.BytesIO(base64.b64decode(address[len(PNG) :]))) as picture:
        image = np.asarray(picture.convert("RGBA"))
    codes = np.ascontiguousarray(image).view(np.uint32).ravel()
    known, place = np.unique(codes, return_inverse=True)
    if len(known) > COUNT:
        return address
    indexed = Image.fromarray(place.reshape(image.shape[:2]).astype(np.uint8), "P")
    colors = known.view(np.uint8).reshape(-1, 4)
    indexed.putpalette(colors[:, :3].tobytes())
    stream = io.BytesIO()
    indexed.save(
        stream, format="png", optimize=True, transparency=colors[:, 3].tobytes()
    )
    return PNG + base64.b64encode(stream.getvalue()).decode()
