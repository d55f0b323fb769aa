"""Effects that model selection finds: those that a robot has, and no others."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.observations import Observations
from calib_pin.residual_models import RESIDUAL_MODELS
from calib_pin.setup import FrameSetup, Setup
from calib_pin.validation.model_selection import select_model

TOOL = FrameSetup((0.05, 0.08, 0.12))


@pytest.fixture(autouse=True)
def no_residual_models(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    # The last one first, so that they come back in their order.
    for name in reversed(list(RESIDUAL_MODELS)):
        monkeypatch.delitem(RESIDUAL_MODELS, name)  # type: ignore[arg-type]
    yield


def chosen(kinds: tuple[str, ...], seeds: range) -> Counter[str]:
    """Names of the candidates that are chosen for robots with errors of some kinds.

    Sixty positions each with a noise of 0.05 mm, in the order of measuring.
    """
    chain = calib_pin.load_chain("pa10")
    setup = Setup(parameters=kinds, tool_frame=TOOL)
    found: Counter[str] = Counter()
    for seed in seeds:
        problem, rng = nominal_problem(chain, "position", setup), np.random.default_rng
        generator = rng(seed)
        truth = calib_pin.draw_errors(problem.parameters, generator)
        rows = calib_pin.simulate(problem, truth, generator, count=60, noise=5e-5).only
        sides = np.sign(np.diff(rows.q, axis=0, prepend=rows.q[:1])).astype(np.int8)
        conditions = replace(rows.conditions, direction=sides)
        data = Observations.of(replace(rows, conditions=conditions))
        selection = select_model(chain, data, Setup(), seed).selection
        found[selection.candidates[selection.chosen].name] += 1
    return found


def test_a_robot_with_errors_of_its_geometry_alone() -> None:
    assert chosen(("placement",), range(2)) == {"geometric": 2}


@pytest.mark.slow
def test_none_is_invented() -> None:
    """At most 5 % of the jobs: 200 of them had 1."""
    assert chosen(("placement",), range(40))["geometric"] >= 38


@pytest.mark.slow
@pytest.mark.parametrize("effect", ["transmission", "compliance", "cross-compliance"])
def test_what_there_is_is_found(effect: str) -> None:
    found = chosen(("placement", effect), range(10))
    assert found[f"+ {effect}"] >= 9
    assert sum(effect in name for name in found.elements()) == 10
