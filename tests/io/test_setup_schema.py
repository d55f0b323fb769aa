"""The schema of setup files, and the documents that are made from it."""

from __future__ import annotations

from dataclasses import fields
from types import SimpleNamespace
from typing import Any

import pytest

from calib_pin.estimation.solve import SOLVERS
from calib_pin.io import setup as setup_files
from calib_pin.io.setup import SetupFile, json_schema, known_keys, setup_of
from calib_pin.measurement_models import MEASUREMENT_MODELS, Quantity
from calib_pin.parameterizations import PARAMETERIZATIONS
from calib_pin.setup import Setup
from calib_pin.setup.constraints import meanings
from calib_pin.solvers import DifferentialEvolution
from documentation.setup_reference import schema_text


def test_the_names_that_there_are_stand_in_the_schema() -> None:
    keys = json_schema()["properties"]
    assert keys["model"]["anyOf"][0]["enum"] == list(MEASUREMENT_MODELS)
    assert keys["parameters"]["items"]["enum"] == list(PARAMETERIZATIONS)
    assert keys["solver"]["properties"]["name"]["enum"] == list(SOLVERS)
    assert "registered" not in schema_text()


def test_the_solver_has_the_options_of_the_evolution() -> None:
    options = [option.name for option in fields(DifferentialEvolution)]
    assert known_keys(("solver", "popsize")) == ["name", *options]


def test_the_noise_of_a_quantity_of_another_package(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    angle = SimpleNamespace(quantities=[Quantity("angle", "rad", slice(0, 2), 1e-5)])
    models = {**MEASUREMENT_MODELS, "theodolite": SimpleNamespace(declaration=angle)}
    monkeypatch.setattr(setup_files, "MEASUREMENT_MODELS", models)
    setup_files.adapter.cache_clear()
    try:
        assert known_keys(("noise", "x"))[-2:] == ["pixel", "angle"]
        assert setup_of({"noise": {"angle": 1e-5}}).noise == {"angle": 1e-5}
    finally:
        setup_files.adapter.cache_clear()


def test_every_key_has_a_meaning() -> None:
    def described(part: Any, path: str) -> None:
        for key, value in part.get("properties", {}).items():
            if not path.endswith(".noise"):  # Its keys are the quantities.
                assert value.get("description"), f"{path}.{key}"
            described(value, f"{path}.{key}")
        for key in ("items", "additionalProperties"):
            if isinstance(part.get(key), dict):
                described(part[key], f"{path}.{key}")

    schema = json_schema()
    described(schema, "")
    for name, part in schema["$defs"].items():
        described(part, name)


def test_the_keys_of_a_setup_and_of_its_file() -> None:
    ours = {field.name for field in fields(Setup)} - {"file"}
    theirs = {field.name for field in fields(SetupFile)}
    assert ours ^ theirs == {"base_frame", "tool_frame", "frames"}
    assert set(meanings(Setup)) == ours | {"file"}
