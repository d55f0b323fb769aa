"""Priors of fleets as files: whole and exact, or refused in one line."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import pytest

from calib_pin.errors import InputError, OptionError
from calib_pin.io.population_prior import (
    prior_document,
    read_population_prior,
    write_population_prior,
)
from calib_pin.io.setup import read_setup, setup_document, setup_of
from calib_pin.setup import PopulationPrior, Setup
from calib_pin.setup.population import JointType, ParameterPrior, RobotType

PRIOR = PopulationPrior(
    RobotType("arm", (JointType("a", (0.0, 0.0, 1.0), ()),)),
    (
        ParameterPrior("a.placement.x", "m", 1e-3, 1e-4, 3e-4, 11.5),
        ParameterPrior("a.placement.rz", "rad", -1 / 3e3, 1e-4, 1e-4, 0.1),
    ),
    ((1e-7, 2e-8), (2e-8, 4e-8)),
    {"position": 1.1e-4},
    robots=12,
)


def test_it_comes_back(tmp_path) -> None:
    file = tmp_path / "fleet.json"
    write_population_prior(PRIOR, file)
    assert read_population_prior(file) == replace(PRIOR, file=str(file))
    document = json.loads(file.read_text())
    assert document["format"] == "calib-pin/fleet-prior" and document["version"] == 1
    with pytest.raises(OptionError):
        write_population_prior(PRIOR, file)


def test_a_setup_names_it(tmp_path, monkeypatch) -> None:
    """By a path that counts from the setup file."""
    (tmp_path / "sub").mkdir()
    write_population_prior(PRIOR, tmp_path / "fleet.json")
    setup = tmp_path / "sub" / "setup.yaml"
    setup.write_text("prior: ../fleet.json\n")
    monkeypatch.chdir(tmp_path / "sub")
    found = read_setup("setup.yaml").prior
    assert isinstance(found, PopulationPrior) and found.covariance == PRIOR.covariance


def test_a_result_holds_it() -> None:
    """The setup in a result needs no other file."""
    document = json.loads(json.dumps(setup_document(Setup(prior=PRIOR, tip="x"))))
    assert setup_of(document) == Setup(prior=PRIOR, tip="x")


def changed(**values: Any) -> dict[str, Any]:
    return {**prior_document(PRIOR), **values}


TWICE = [prior_document(PRIOR)["parameters"][0]] * 2
BAD = [
    {"format": "calib-pin/plan"},
    changed(version=2),
    {k: v for k, v in changed().items() if k != "covariance"},
    changed(covariance=[[1.0]]),
    changed(covariance=[[1e-7, 2e-8], [3e-8, 4e-8]]),
    changed(covariance=[[1e-7, 1e-7], [1e-7, 4e-8]]),
    changed(covariance=[[1e-7, None], [None, 1.0]]),
    changed(covariance=["a", "b"]),
    changed(robots="many"),
    changed(parameters=TWICE),
    changed(noise={"position": -1.0}),
    changed(robot=[]),
]


def test_what_is_none(tmp_path, refused) -> None:
    file = tmp_path / "fleet.json"
    for text in ("{", *map(json.dumps, BAD)):
        file.write_text(text)
        with refused(InputError, file=str(file)):
            read_population_prior(file)


def test_a_setup_that_names_none(tmp_path, refused) -> None:
    file = tmp_path / "setup.yaml"
    for text, line in (("base: b\nprior: 3", 2), ("prior: ''", 1), ("prior: [a]", 1)):
        file.write_text(text)
        with refused(InputError, file=str(file), line=line):
            read_setup(file)
    file.write_text("prior: none.json")
    with refused(InputError):
        read_setup(file)
