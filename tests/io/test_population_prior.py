"""Priors of fleets as files: whole and exact, or refused in one line."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
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


def without(key: str) -> dict[str, Any]:
    document = prior_document(PRIOR)
    del document[key]
    return document


def changed(**values: Any) -> dict[str, Any]:
    return {**prior_document(PRIOR), **values}


TWICE = [prior_document(PRIOR)["parameters"][0]] * 2


@pytest.mark.parametrize(
    ("document", "words"),
    [
        ({"format": "calib-pin/plan"}, "not a fleet's prior of calib-pin"),
        (changed(version=2), "another version"),
        (without("covariance"), "'covariance' is missing"),
        (changed(covariance=[[1.0]]), "2 rows and columns"),
        (changed(covariance=[[1e-7, 2e-8], [3e-8, 4e-8]]), "not symmetric"),
        (changed(covariance=[[1e-7, 1e-7], [1e-7, 4e-8]]), "not positive definite"),
        (changed(covariance=[[1e-7, 0.0], [0.0, 0.0]]), "not positive"),
        (changed(covariance=[[1e-7, None], [None, 1.0]]), "missing, or infinite"),
        (changed(covariance=["a", "b"]), "in the place of a list"),
        (changed(robots="many"), "'many' stands in the place of a whole number"),
        (changed(robots=0), "of no robots"),
        (changed(parameters=TWICE), "two 'parameters' have one name"),
        (changed(noise={"position": -1.0}), "no noise of position"),
        (changed(robot=[]), "not of its type"),
    ],
)
def test_what_is_none(tmp_path, refused, document, words) -> None:
    file = tmp_path / "fleet.json"
    file.write_text(json.dumps(document))
    with refused(InputError, reason=words, file=str(file)):
        read_population_prior(file)


def test_what_is_no_json(tmp_path, refused) -> None:
    file = tmp_path / "fleet.json"
    file.write_text("{")
    with refused(InputError, reason="truncated", file=str(file)):
        read_population_prior(file)


@pytest.mark.parametrize(
    ("text", "fields"),
    [
        ("prior: none.json", {"reason": ("no such file",)}),
        ("base: b\nprior: 3", {"line": 2, "allowed": "the file of a fleet's prior"}),
        ("prior: ''", {"line": 1, "allowed": "the file of a fleet's prior"}),
        ("prior: [a]", {"line": 1, "allowed": "the file of a fleet's prior"}),
    ],
)
def test_a_setup_that_names_none(tmp_path, refused, text, fields) -> None:
    file = tmp_path / "setup.yaml"
    file.write_text(text)
    with refused(InputError, **fields):
        read_setup(file)
    assert Path(file).is_file()
