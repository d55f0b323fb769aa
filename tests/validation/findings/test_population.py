"""A robot that is not like its fleet is told, others are not."""

from __future__ import annotations

import numpy as np

from calib_pin.estimation.fit import fit_model
from calib_pin.setup import Setup
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.plausibility import population


def found(fleet, seed: int, count: int, spreads: float, prior: bool = True):
    """Findings about a robot of which one error is so many spreads off."""
    chain = fleet.problem.chains[""]
    joint = chain.joints[2]
    name = f"{joint}.placement.rx"
    change = {name: spreads * fleet.spread[fleet.problem.parameters.index(name)]}
    data, _ = fleet.measured(seed, count, change)
    setup = Setup(prior=fleet.population.prior() if prior else {})
    fitted = fit_model(chain, data, setup, 0).fit
    return list(population(Case.of(fitted, fitted.problem.chains))), name


def test_one_of_them_and_one_without_a_prior(fleet) -> None:
    assert found(fleet, 300, 12, 0.0)[0] == []
    assert found(fleet, 300, 12, 30.0, prior=False)[0] == []


def test_a_bent_one(fleet) -> None:
    (finding,), name = found(fleet, 310, 12, 30.0)
    assert finding.code == "unlike-fleet"
    assert finding.evidence["chi2"] > 3.0 * finding.evidence["dof"]
    joint = name.split(".")[0]
    assert str(finding.evidence["parameter"]).startswith(joint)
    assert np.isfinite(finding.evidence["deviations"])


def test_a_prior_that_spoils_the_fit(fleet) -> None:
    """Far off, a few measurements look like noise to the prior."""
    (finding,), _ = found(fleet, 311, 10, 300.0)
    assert finding.severity == "error"
