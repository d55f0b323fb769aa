"""Images of few colors: a picture in a page takes a third of its bytes."""

from __future__ import annotations

import base64
import heapq
import io
from typing import NamedTuple

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
    a color that is hardly opaque counts as little as it is seen.
    """
    codes = np.ascontiguousarray(image).view(np.uint32).ravel()
    known, place, counts = np.unique(codes, return_inverse=True, return_counts=True)
    colors = known.view(np.uint8).reshape(-1, 4).astype(float)
    opacity = colors[:, 3:] / 255.0
    seen = np.concatenate([colors[:, :3] * opacity, colors[:, 3:]], axis=1)
    weight = counts.astype(float) ** RARE
    # What is not there is a color of its own, or all else would get a tint.
    groups = [_group(seen, weight, np.flatnonzero(opacity[:, 0] > 0.0))]
    while len(groups) < COUNT - 1 and groups[0].loss < 0.0:
        _, _, axis, members = heapq.heappop(groups)
        along = seen[members, axis]
        low = along <= np.average(along, weights=weight[members])
        for part in (members[low], members[~low]):
            heapq.heappush(groups, _group(seen, weight, part))
    result = np.zeros((len(known), 4), np.uint8)
    for members in (group.members for group in groups if len(group.members)):
        mean = np.average(seen[members], axis=0, weights=weight[members])
        mean[:3] *= 255.0 / max(mean[3], 1.0)
        result[members] = np.clip(mean, 0.0, 255.0).round()
    return result[place.reshape(image.shape[:2])]


class _Group(NamedTuple):
    """Colors that one stands for, in the order in which they are split.

    Attributes:
        loss: What that loses along the longest axis, negative.
        first: The first of them, of which no other group has the same.
        axis: That axis.
        members: Their numbers.
    """

    loss: float
    first: int
    axis: int
    members: NDArray[np.intp]


def _group(seen: Floats, weight: Floats, members: NDArray[np.intp]) -> _Group:
    """A group of colors (n, 4) with weights (n,)."""
    if len(members) == 0:
        return _Group(0.0, -1, 0, members)
    own, colors = weight[members, None], seen[members]
    mean = (own * colors).sum(axis=0) / own.sum()
    squares = (own * (colors - mean) ** 2).sum(axis=0)
    axis = int(np.argmax(squares))
    same = colors[:, axis].min() == colors[:, axis].max()
    return _Group(
        0.0 if same else -float(squares[axis]), int(members[0]), axis, members
    )


def with_palette(address: str) -> str:
    """A picture in an address, with a palette if that makes it shorter.

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
    shorter = PNG + base64.b64encode(stream.getvalue()).decode()
    return min(shorter, address, key=len)
