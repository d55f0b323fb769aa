"""Numbers within their limits."""

from __future__ import annotations

from numbers import Integral, Real

import numpy as np
import pytest

from calib_pin.errors import OptionError
from calib_pin.solvers.options import (
    FRACTION,
    LIMIT,
    TARGET,
    TOLERANCE,
    Limits,
    require_numbers,
)


@pytest.mark.parametrize(
    ("limits", "good", "bad"),
    [
        (LIMIT, [1, np.int64(3), 10**9], [0, -1, 1.0, True, "1", None]),
        (FRACTION, [0, 1, 0.5, np.float32(0.25)], [-1e-9, 1.1, np.nan, True, "0.5"]),
        (TARGET, [-np.inf, -5, 1e300], [np.inf, np.nan, None]),
        (TOLERANCE, [0, 1e-9, np.inf], [-1e-300, np.nan, (1,)]),
        (Limits(Integral, 2, 5, "2 to 5"), [2, 5], [1, 6, 2.5]),
        (Limits(Real, 2, 5, "2 to 5"), [2, 2.5, 5], [1, 6, False]),
    ],
)
def test_what_is_within_limits(
    limits: Limits, good: list[object], bad: list[object]
) -> None:
    for value in good:
        require_numbers({"number": value, "other": "text"}, {"number": limits})
    for value in bad:
        with pytest.raises(OptionError) as caught:
            require_numbers({"number": value, "other": "text"}, {"number": limits})
        expected = "number cannot be used"
        assert caught.value.reason == expected
        assert (caught.value.value, caught.value.allowed) == (value, limits.words)
