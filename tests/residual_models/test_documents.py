"""What is stored restores exactly, and what is not one is refused with a reason."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from calib_pin.residual_models import RESIDUAL_MODELS, restore
from calib_pin.residual_models.base import ResidualModel
from calib_pin.residual_models.gaussian_process import (
    FORMS,
    GaussianProcessOptions,
    fit_gaussian_process,
)
from calib_pin.residual_models.network import NetworkOptions, fit_network


@pytest.fixture(scope="module", params=[*RESIDUAL_MODELS, "tip"])
def model(request: pytest.FixtureRequest, study: Callable[..., Any]) -> ResidualModel:
    rows, rng = study(shifts=2).rows(40, 5e-6, 0), np.random.default_rng(0)
    if request.param == "network":
        options = NetworkOptions(units=3, members=2, steps=(6, 2))
        return fit_network(rows, rng, options=options)
    forms = FORMS[2:] if request.param == "tip" else FORMS[1:2]
    return fit_gaussian_process(
        rows, rng, options=GaussianProcessOptions(searched=60, forms=forms)
    )


def test_restores_exactly(model: ResidualModel, study: Callable[..., Any]) -> None:
    found = restore(json.loads(json.dumps(model.document(), allow_nan=False)), 6)
    q = study().rows(20, 0.0, 7).q
    np.testing.assert_allclose(found(q), model(q), rtol=1e-12)
    np.testing.assert_array_equal(found.shift, model.shift)
    np.testing.assert_array_equal(found.region.weight(q), model.region.weight(q))
    assert (found.name, found.space) == (model.name, model.space)
    assert found.document() == model.document()


def test_every_key_is_needed(model: ResidualModel) -> None:
    document = model.document()
    for key in document:
        parts = {k: v for k, v in document.items() if k != key}
        with pytest.raises(ValueError, match=f"'{key}'"):
            restore(parts, 6)
        for wrong in (None, "__import__('os')", [[1.0], [2.0, 3.0]], {"a": 1}, True):
            with pytest.raises(ValueError, match=r"'\w[][\w .]*'"):
                restore({**document, key: wrong}, 6)


def changed(document: Any, path: str, value: Any) -> Any:
    """A document with another value at a path such as `region.reach`."""
    key, _, rest = path.partition(".")
    inner = changed(document[key], rest, value) if rest else value
    return {**document, key: inner}


def test_malformed_documents(model: ResidualModel) -> None:
    """Each is refused by the name of what is wrong."""
    nan, inf = float("nan"), float("inf")
    values: dict[str, tuple[Any, ...]] = {
        "kind": ("pickle", ["network"]),
        "region.angles": (None,),
        "region.reach": (0.0, nan, "0.3"),
        "region.anchors": ([], [[0.0] * 5]),
        "region.fade": ([1.0] * 5 + [10**400], [1.0] * 5 + [1e300]),
        "region.middle": ([0.0] * 5 + [None], [0.0] * 5 + [inf]),
        "shift": ([[1.0]],),
    }
    for path, wrong in values.items():
        key = path.rpartition(".")[2]
        for value in wrong:
            with pytest.raises(ValueError, match=f"{key}'"):
                restore(changed(model.document(), path, value), 6)
    with pytest.raises(ValueError, match="shape"):
        restore(model.document(), 7)  # Of another robot.
    for value in (None, [], "network", 3.0):
        with pytest.raises(ValueError, match="residual model"):
            restore(value, 6)
