"""Effects that model selection finds: those that a robot has, and no others."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.observations import Conditions, Observations, approached
from calib_pin.residual_models import RESIDUAL_MODELS
from calib_pin.setup import DriftSetup, FrameSetup, Payload, Setup, ThermalSetup
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


EVERYTHING = (
    "placement",
    "hysteresis",
    "motor-ripple",
    "cross-compliance",
    "thermal",
    "instrument-drift",
)


def everything(seed: int, count: int = 150) -> tuple[Setup, Observations, Observations]:
    """A robot with all of it: its setup, positions, and exact ones elsewhere.

    Three joints have a lost motion of 0.2 to 2 mrad; it grows warm, and the instrument
    drifts, while it is measured with a noise of 0.03 mm.
    """
    chain, rng = calib_pin.load_chain("pa10"), np.random.default_rng(seed)
    end = 20.0 * (count - 1)
    known = Setup(
        tool_frame=replace(TOOL, estimate=True),
        gear_ratios={chain.joints[1]: 80.0, chain.joints[3]: 101.0},
        payloads={"load": Payload(10.0, (0.1, 0.05, 0.15))},
        thermal=ThermalSetup(20.0),
    )
    true = replace(known, parameters=EVERYTHING, drift=DriftSetup({"base": (0.0, end)}))
    problem = nominal_problem(chain, "position", true)
    theta = calib_pin.draw_errors(problem.parameters, rng)
    playing = [chain.joints[k] for k in rng.choice(7, 3, replace=False)]
    for k, name in enumerate(problem.parameters.names):
        owner, kind, component = name.rsplit(".", 2)
        if kind == "hysteresis":
            play = np.exp(rng.uniform(*np.log([2e-4, 2e-3])))
            theta[k] = play if owner in playing else 0.0
        elif kind == "instrument-drift":
            theta[k] = rng.normal() * (2e-5 if component.startswith("r") else 5e-5)

    def measured(count: int, rng: np.random.Generator, noise: float) -> Observations:
        q = chain.random_configurations(count, rng)
        held = Conditions(
            payload=("load",) * count,
            direction=approached(q),
            temperature=np.linspace(17.0, 30.0, count),
            time=np.linspace(0.0, end, count),
        )
        return calib_pin.simulate(
            problem, theta, rng, q=q, conditions=held, noise=noise
        )

    elsewhere = measured(200, np.random.default_rng(seed + 1000), 0.0)
    return known, measured(count, rng, 3e-5), elsewhere


@pytest.mark.slow
def test_all_effects_together() -> None:
    """Each is found beside the others, no other is, and it is as good as the truth."""
    chain = calib_pin.load_chain("pa10")
    known, rows, elsewhere = everything(0)

    def error(result: calib_pin.CalibrationResult) -> float:
        off = result.model.predict(result.model.theta, elsewhere.only)
        return float(np.sqrt(np.mean((off - elsewhere.only.values) ** 2)))

    true = replace(known, parameters=EVERYTHING)
    right = calib_pin.calibrate(chain, rows, true, validate=False)
    start = replace(known, parameters=("placement", "instrument-drift"))
    found = calib_pin.calibrate(chain, rows, start, ladder=True)
    selection = found.model_selection
    assert selection is not None
    chosen = selection.candidates[selection.chosen]
    assert set(chosen.parameters) == set(EVERYTHING)
    assert error(found) < 1.2 * error(right)
