"""Where residual components belong: measurement, noise, column of a table."""

from __future__ import annotations

import numpy as np
import pytest

from calib_pin.estimation.layout import Layout
from calib_pin.measurement_models import declared
from calib_pin.observations import BlockKey, Measurements, Observations


def block(key: BlockKey, count: int) -> Measurements:
    width = len(declared(key.model).values)
    q = np.arange(float(count))[:, None]
    return Measurements(("j",), q, values=np.zeros((count, width)), **key._asdict())


def layout(*keys: BlockKey, more: tuple[BlockKey, ...] = ()) -> Layout:
    """The layout of three measurements of each block, and of blocks without any."""
    data = Observations(tuple(block(key, 3) for key in keys))
    return Layout.of(data, {key: declared(key.model).quantities for key in keys + more})


POSE, POINT = BlockKey("pose"), BlockKey("position")


def test_one_block() -> None:
    found = layout(POSE)
    assert found.row.tolist() == [0] * 6 + [1] * 6 + [2] * 6
    assert found.column.tolist() == list(range(6)) * 3
    assert found.component.tolist() == [0, 0, 0, 1, 1, 1] * 3
    assert [c.name for c in found.components] == ["position", "orientation"]
    assert found.quantities == declared("pose").quantities and found.width == 6


def test_models_stand_side_by_side() -> None:
    found = layout(POSE, POINT, BlockKey("plane-contact"))
    assert [(q.name, q.columns) for q in found.quantities] == [
        ("position (pose)", slice(0, 3)),
        ("orientation", slice(3, 6)),
        ("position (position)", slice(6, 9)),
        ("contact", slice(9, 10)),
    ]
    assert found.row.tolist()[18:] == [3, 3, 3, 4, 4, 4, 5, 5, 5, 6, 7, 8]
    assert found.column.tolist()[18:] == [6, 7, 8] * 3 + [9] * 3
    flat = np.arange(30.0)
    table = found.table(flat, 9)
    assert table.shape == (9, 10) and np.isnan(table).sum() == 60
    np.testing.assert_array_equal(table[~np.isnan(table)], flat)
    np.testing.assert_array_equal(table[4], [np.nan] * 6 + [21, 22, 23] + [np.nan])
    assert found.table(flat, 9, absent=0.0)[0, 6] == 0.0


@pytest.mark.parametrize(
    ("keys", "names"),
    [
        ([POINT, POINT._replace(tool="b")], ["position"]),
        (
            [POINT._replace(station=s) for s in ("one", "two")],
            ["position (one)", "position (two)"],
        ),
        (
            [
                POINT._replace(station="one"),
                POSE._replace(station="one"),
                POSE._replace(station="two"),
            ],
            [
                "position (position)",
                "position (pose, one)",
                "orientation (one)",
                "position (pose, two)",
                "orientation (two)",
            ],
        ),
    ],
)
def test_each_instrument_at_each_station_has_noise_of_its_own(
    keys: list[BlockKey], names: list[str]
) -> None:
    found = layout(*keys)
    assert [c.name for c in found.components] == names
    # What is shown is one table of each model.
    models = {key.model for key in keys}
    shown = sum(len(declared(model).quantities) for model in models)
    assert len(found.quantities) == shown


def test_blocks_without_measurements_count() -> None:
    """The units of a fit belong to components, whichever measurements there are."""
    found = layout(POSE, more=(POINT,))
    assert len(found.components) == 3 and found.width == 9
    assert found.of_keys[POINT].tolist() == [2, 2, 2]
    assert found.table(np.zeros(18), 3).shape == (3, 9)
