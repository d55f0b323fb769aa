"""A prior holds for robots of its type with its parameters, and for no others."""

from __future__ import annotations

from dataclasses import replace

import calib_pin
from calib_pin.errors import OptionError
from calib_pin.estimation.formulation import make_problem, nominal_problem
from calib_pin.setup import Setup


def test_a_prior_of_another_type(fleet, refused) -> None:
    prior = replace(fleet.population.prior(), file="fleet.json")
    chain = calib_pin.load_chain("pa10")
    with refused(OptionError, reason="other robots, 'space6'", file="fleet.json"):
        nominal_problem(chain, "position", Setup(prior=prior))


def test_a_prior_of_other_parameters(fleet, refused) -> None:
    """Of fewer parameters it is no prior, of more it is."""
    prior, chain = fleet.population.prior(), fleet.problem.chains[""]
    more = Setup(prior=prior, parameters=("placement", "transmission"))
    with refused(OptionError, reason=".transmission.gain"):
        nominal_problem(chain, "position", more)
    gears = replace(more, fixed=("*.transmission.*",))
    assert nominal_problem(chain, "position", gears).further.priors == 36


def test_stated_noise_wins(fleet) -> None:
    prior = fleet.population.prior()
    data, _ = fleet.measured(500, 10)
    setup = Setup(prior=prior, noise={"position": 3e-3})
    problem = make_problem(fleet.problem.chains[""], data, setup)
    assert problem.setup.noise["position"] == 3e-3
