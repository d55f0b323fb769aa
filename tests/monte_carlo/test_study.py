"""Simulated robots: their numbers are their own, and they are compared with a truth."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.errors import OptionError
from calib_pin.kinematics.chains import Chains
from calib_pin.monte_carlo import Study, Trial, outlooks, study_of, try_robot
from calib_pin.observations import BlockKey
from calib_pin.setup import FrameSetup, LimitSetup, MonteCarloSetup, Setup

FRAMES = {
    "base_frame": FrameSetup((1.5, -0.4, 0.3), (0.3, 0.2, 2.0), estimate=True),
    "tool_frame": FrameSetup((0.05, 0.08, 0.12), estimate=True),
}


def study(model: str = "position", asked: MonteCarloSetup | None = None, **more):
    chains = Chains.of(calib_pin.load_chain("space6"))
    setup = Setup(
        **FRAMES,
        monte_carlo=asked or MonteCarloSetup(configurations=(24, 12)),
        noise={"position": 5e-5, "orientation": 5e-5},
        **more,
    )
    return study_of(chains, [BlockKey(model)], setup)


def test_a_robot_is_the_same_whenever_it_is_drawn():
    found = study()
    assert found.counts == (12, 24)
    first = try_robot(found, 3)
    try_robot(found, 0)
    assert try_robot(found, 3) == first
    assert [trial.configurations for trial in first] == [12, 24]
    # The robot is one, however often it is measured.
    assert first[0].nominal == first[1].nominal
    other = try_robot(replace(found, seed=1), 3)
    assert other[0].nominal != first[0].nominal


def test_errors_are_those_of_the_tool():
    """Known frames, no noise to speak of: the fit finds the truth."""
    exact = replace(study("pose").setup, noise={"position": 1e-9, "orientation": 1e-9})
    found = study("pose")
    found = replace(
        found, setup=exact, truth=replace(found.truth, setup=exact), counts=(30,)
    )
    (trial,) = try_robot(found, 0)
    assert trial.nominal > 1e-3
    assert trial.position < 1e-7 and trial.orientation < 1e-7
    assert trial.position <= trial.position_share
    nothing = replace(found, sizes=0.0 * found.sizes)
    (trial,) = try_robot(nothing, 0)
    # Displacements of base and tool are fitted away to rounding.
    assert trial.nominal < 1e-9


def test_true_errors_have_the_stated_sizes():
    joint = calib_pin.load_chain("space6").joints[1]
    sizes = {"*.placement.*": 1e-5, f"{joint}.*": 1e-2}
    found = study(asked=MonteCarloSetup(errors=sizes))
    names = found.truth.parameters.names
    for name, size in zip(names, found.sizes, strict=True):
        frame = name.startswith(("base.", "tool."))
        expected = 0.0 if frame else 1e-2 if name.startswith(joint) else 1e-5
        assert size == expected, name
    with pytest.raises(OptionError, match="'elbow"):
        study(asked=MonteCarloSetup(errors={"elbow*": 1.0}))


def test_errors_that_the_fit_lacks_are_left():
    asked = MonteCarloSetup(
        configurations=(40,),
        parameters=("placement", "transmission"),
        errors={"*.transmission.*": 2e-3},
    )
    lacking = try_robot(study(asked=asked), 0)[0]
    fitted = study(asked=asked, parameters=("placement", "transmission"))
    having = try_robot(fitted, 0)[0]
    assert having.nominal == lacking.nominal
    assert lacking.position > 5.0 * having.position
    # What is not described counts in what the fit expects.
    assert 0.4 < lacking.position / lacking.expected < 2.5


def test_a_plan_is_measured_from_its_beginning():
    chains = Chains.of(calib_pin.load_chain("space6"))
    q = chains.random_configurations(24, np.random.default_rng(5))
    asked = MonteCarloSetup(configurations=(12,))
    setup, keys = replace(study().setup, monte_carlo=asked), [BlockKey("position")]
    planned = study_of(chains, keys, setup, q)
    assert try_robot(planned, 0) != try_robot(study(), 0)
    longer = study_of(chains, keys, setup, np.vstack([q, q[::-1]]))
    assert try_robot(longer, 0) == try_robot(planned, 0)
    with pytest.raises(OptionError, match="8"):
        study_of(chains, keys, setup, q[:8])


def test_too_few_measurements_are_told_and_stop_nothing():
    asked = MonteCarloSetup(configurations=(1, 24))
    few, enough = try_robot(study(asked=asked), 0)
    assert math.isnan(few.bound) or few.reason
    assert enough.reason == "" and enough.position < enough.nominal


def trial(**more: float) -> Trial:
    return replace(
        Trial(0, 10, 1e-3, 1e-4, 2e-4, 1e-3, 2e-3, 1e-4, 1.5e-4),
        **more,  # type: ignore[arg-type]
    )


def test_an_outlook_counts():
    trials = [
        *(trial(robot=k) for k in range(8)),
        trial(robot=8, position=2e-4, position_share=4e-4),
        replace(Trial(9, 10), reason="lost"),
    ]
    (found,) = outlooks(trials, LimitSetup(position=3e-4))
    assert (found.robots, found.failed) == (10, 1)
    assert found.coverage[0] == 8 / 9
    assert found.met[0] == 0.8  # Who cannot be calibrated does not meet it.
    assert found.met[1] < 0.8 < found.met[2]
    assert found.honesty == pytest.approx(math.sqrt((8 * 1.0 + 4.0) / 9))
    assert found.position[1] == 1e-4
    (open_,) = outlooks(trials, LimitSetup())
    assert math.isnan(open_.met[0])
    (both,) = outlooks(trials, LimitSetup(position=3e-4, orientation=1e-3))
    assert both.met[0] == 0.0


@pytest.mark.slow
def test_bounds_hold_for_as_many_robots_as_they_say():
    """Of 60 robots a 95 % bound fails for 3 +- 2."""
    found: Study = study(asked=MonteCarloSetup(configurations=(24,)))
    trials = [one for k in range(60) for one in try_robot(found, k)]
    (outlook,) = outlooks(trials, LimitSetup())
    assert outlook.coverage[1] < 0.95 < outlook.coverage[2]
    assert 0.8 < outlook.honesty < 1.2
