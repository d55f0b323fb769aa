"""Blocks are divided by names of their own without losing a measurement."""

from __future__ import annotations

import numpy as np
import pytest

from calib_pin.observations import Labels, Measurements, Observations, apart


@pytest.mark.parametrize("kind", ["station", "tool"])
def test_some_measurements_have_a_frame_of_their_own(kind) -> None:
    values = np.arange(12.0).reshape(4, 3)
    q = np.arange(4.0)[:, None]
    blocks = [
        Measurements(("j",), q + 4 * k, "position", values + k, **{kind: name})
        for k, name in enumerate(("", "door"))
    ]
    data = Observations.of(*blocks)
    names = Labels.of(["", "2", "", "2", "2", "2", "2", "2"])
    found, index = apart(data, kind, names)
    of_block = [getattr(block, kind) for block in found.blocks]
    # One without a name is called by its kind, as in a setup file.
    assert of_block == ["", f"{kind}2", "door2"]
    assert index.tolist() == [0, 2, 1, 3, 4, 5, 6, 7]
    np.testing.assert_array_equal(found.q, data.q[index])
