"""Which effects of gears and compliance are looked for, and how large they may be."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.statistics.variance_components import candidates
from calib_pin.observations import Conditions, Observations
from calib_pin.setup import FrameSetup, Payload, Setup

TOOL = FrameSetup((0.05, 0.08, 0.12), (0.2, -0.3, 0.1))


def problem_of(robot: str, setup: Setup | None = None, payload: str = "") -> Problem:
    chain = calib_pin.load_chain(robot)
    setup = replace(setup or Setup(), tool_frame=TOOL)
    problem = nominal_problem(chain, "position", setup)
    rows = replace(
        problem.data.only, conditions=Conditions((payload,) * len(problem.data))
    )
    return replace(problem, data=Observations.of(rows))


def names(problem: Problem) -> list[str]:
    found = candidates(problem)
    if found is None:
        return []
    return list(found.names)


def test_what_is_estimated_is_no_random_effect() -> None:
    assert len(names(problem_of("pa10"))) == 7 * 5
    gears = replace(Setup(), parameters=("placement", "transmission"))
    assert {name.split(".")[1] for name in names(problem_of("pa10", gears))} == {
        "compliance"
    }
    both = replace(Setup(), parameters=("transmission", "compliance"))
    assert names(problem_of("pa10", both)) == []


def test_what_has_no_mass_does_not_give() -> None:
    assert {name.split(".")[1] for name in names(problem_of("space6"))} == {
        "transmission"
    }
    carried = Setup(payloads={"p": Payload(5.0, (0.0, 0.0, 0.0))})
    assert any(n.endswith("k") for n in names(problem_of("space6", carried)))
    # Of what these rows carry nothing is known.
    assert not any(n.endswith("k") for n in names(problem_of("pa10", payload="p")))


@pytest.mark.parametrize("model", ["position", "fixed-point", "relative-distance"])
def test_rows_are_those_of_the_parameters(model: str) -> None:
    """A column is the residual that its effect adds, by central differences."""
    from benchmarks.recovery import CASES

    setup = CASES[model].setup
    chain = calib_pin.load_chain("space6")
    plain = nominal_problem(chain, model, setup)
    more = replace(setup, parameters=("transmission",))
    true = nominal_problem(chain, model, more)
    rng = np.random.default_rng(0)
    zero = np.zeros(len(true.parameters))
    rows = calib_pin.simulate(true, zero, rng, count=12, noise=0.0)
    effects = candidates(replace(plain, data=rows))
    assert effects is not None
    plain, true = replace(plain, data=rows), replace(true, data=rows)
    X = effects.rows(plain, np.zeros(len(plain.parameters)))
    for k, name in enumerate(effects.names):
        moved = np.zeros(len(true.parameters))
        moved[true.parameters.names.index(name)] = effects.sizes[k]
        change = 0.5 * (true.errors(moved) - true.errors(-moved)) / true.sigma
        # The amplitude of 3e-4 rad is the step: its square is left.
        np.testing.assert_allclose(X[:, k], change, atol=1e-5)


FORK = """<robot name="fork">
<link name="base"/><link name="arm"/><link name="hand"/><link name="wheel"/>
<joint name="elbow" type="revolute"><parent link="base"/><child link="arm"/>
<origin xyz="0.2 0 0.1"/><axis xyz="0 0 1"/>
<limit lower="-2" upper="2" effort="9" velocity="9"/></joint>
<joint name="wrist" type="revolute"><parent link="arm"/><child link="hand"/>
<origin xyz="0.3 0 0"/><axis xyz="0 1 0"/><mimic joint="drive" multiplier="0.5"/>
<limit lower="-2" upper="2" effort="9" velocity="9"/></joint>
<joint name="drive" type="revolute"><parent link="base"/><child link="wheel"/>
<axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="9" velocity="9"/></joint>
</robot>"""


def test_a_leader_outside_of_the_chain_has_no_effects(tmp_path: Path) -> None:
    file = tmp_path / "fork.urdf"
    file.write_text(FORK)
    chain = calib_pin.load_chain(file, tip="hand")
    found = names(nominal_problem(chain, "position", Setup(tool_frame=TOOL)))
    assert found and {name.split(".")[0] for name in found} == {"elbow"}
