"""Options within their limits, and how solvers end."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from calib_pin.errors import OptionError
from calib_pin.solvers import DifferentialEvolution, Status

GOOD = (
    DifferentialEvolution(
        "rand/1",
        np.int64(4),  # type: ignore[arg-type]
        **{"mutation": 2, "recombination": 0, "maxiter": 1, "target": -np.inf},
        **{"tol": 0, "atol": np.inf, "init": "random"},
    ),
    DifferentialEvolution(mutation=1e-300, recombination=np.float32(1)),  # type: ignore[arg-type]
)
"""At their limits: nothing is refused where this module is read."""

BAD: dict[Any, dict[str, tuple[object, ...]]] = {
    DifferentialEvolution: {
        "strategy": ("rand1", None),
        "init": ("latinhypercub",),
        "population_size": (3, 10.0, True, np.nan, 100_001),
        "maxiter": (0, 1.5),
        "mutation": (0.0, 2.001, (0.5, 1), True, np.nan),
        "recombination": (-1e-9, 1.1, "0.5"),
        "target": (np.nan, np.inf, None),
        "tol": (-1e-300, np.nan),
        "atol": (-1.0,),
    },
}


@pytest.mark.parametrize("kind", BAD, ids=lambda kind: kind.__name__)
def test_options_that_cannot_be_used(kind: Any) -> None:
    for name, values in BAD[kind].items():
        for value in values:
            with pytest.raises(OptionError) as caught:
                kind(**{name: value})
            if not isinstance(value, str) and value is not None:
                found = caught.value.value
                assert found is value or found == value, (name, value)
            assert caught.value.allowed or name in ("strategy", "init")


def test_every_status_gives_advice_of_its_own() -> None:
    assert not any(status.advice.endswith(".") for status in Status)
    assert len({status.advice for status in Status}) == len(Status)
