"""Numbers in cells, to the last bit those of Python's `float`, and headers."""

from __future__ import annotations

import numpy as np
import pytest

from calib_pin.io.columns import split_header
from calib_pin.io.table import read_numbers


def test_numbers_are_those_of_float():
    rng = np.random.default_rng(0)
    bits = rng.integers(0, 2**64, 3000, np.uint64).view(np.float64)
    bits = bits[np.isfinite(bits)]
    metric = rng.uniform(-4.0, 4.0, 3000)
    for cells in (
        [*map(repr, bits.tolist()), "5e-324", "-0.0", "1.7976931348623157e308"],
        [f"{value:.25e}" for value in bits],
        [*map(repr, metric.tolist())],
        [f"{1e3 * value:.6f}" for value in metric],
    ):
        expected = np.array([float(cell) for cell in cells])
        assert read_numbers(cells).tobytes() == expected.tobytes()


NUMBERS = [
    *(" 1.5", "2.5 ", "\t1\u2003", "+1", ".5", "5.", "1e5", "1E-5", "-0", "-00.0"),
    *("007", "1e-400", "1e400", "inf", "-Infinity", "nan", "NaN", "9007199254740993"),
    *("123456789012345678901234567890",),
]
# Digits of other scripts are no numbers, whatever Python thinks.
OTHERS = [
    *("\u0663.5", "\uff11", "1\u0660", "1.\uff15e1", "", " ", "1_000", "1_0.5", "1d5"),
    *("1j", "1.5#", "true", "null", '"1.5"', "1.5,2.5", "[1.5]", "{}", "1.5]", "ball"),
    *("--1.0", "0x1p3", "1e", "-"),
]


@pytest.mark.parametrize("cell", NUMBERS + OTHERS)
def test_odd_cells(cell):
    expected = float(cell) if cell in NUMBERS else np.nan
    # Two numbers in one cell do not make up for a cell that holds none.
    for cells in ([cell], ["0.25", cell], [cell, "1", "x"], ["1.5,2", cell, ""]):
        found = read_numbers(cells)
        assert found.shape == (len(cells),)
        np.testing.assert_array_equal(found[cells.index(cell)], expected)
        assert np.signbit(found[cells.index(cell)]) == np.signbit(expected)


@pytest.mark.parametrize(
    ("cell", "expected"),
    [
        (" x [mm] ", ("x", "mm")),
        ("x[ mm ]", ("x", "mm")),
        ("[mm]", ("", "mm")),
        ("a [b] [c]", ("a [b]", "c")),
        ("x []", ("x", None)),
        *((cell, (cell, None)) for cell in ("x", "x [mm", "x mm]", "x [a]]", "[a] b")),
        # Once this took minutes.
        (f"{'[' * 50_000}{' ' * 50_000}x", (f"{'[' * 50_000}{' ' * 50_000}x", None)),
    ],
)
def test_headers(cell, expected):
    assert split_header(cell) == expected
