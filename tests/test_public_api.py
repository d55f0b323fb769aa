"""The public names: sorted, all there, documented, and imported when first used."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import calib_pin

HEAVY = ("numpy", "pinocchio", "scipy", "pydantic", "yaml", "rich", "typer", "numba")


def python(code: str) -> str:
    """What a fresh interpreter prints."""
    ran = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert ran.stderr == ""
    return ran.stdout.strip()


def test_all_is_sorted_and_complete() -> None:
    assert calib_pin.__all__ == sorted(set(calib_pin.__all__))
    assert set(calib_pin.__all__) == set(calib_pin._HOMES)
    assert dir(calib_pin) == calib_pin.__all__
    assert 12 <= len(calib_pin.__all__) <= 26


@pytest.mark.parametrize("name", calib_pin.__all__)
def test_every_name_is_there_and_documented(name: str) -> None:
    value = getattr(calib_pin, name)
    if inspect.ismodule(value):
        # The package `report` was imported before and stands for its function.
        value = getattr(import_module(f"calib_pin.{calib_pin._HOMES[name]}"), name)
    assert value.__name__ == name
    assert value.__module__ == f"calib_pin.{calib_pin._HOMES[name]}"
    text = inspect.getdoc(value)
    assert text and len(text.splitlines()[0]) > 10
    members = [(name, value)]
    if inspect.isclass(value):
        members += [
            (f"{name}.{key}", getattr(value, key))
            for key in vars(value)
            if not key.startswith("_") and callable(getattr(value, key))
        ]
    for label, member in members:
        assert inspect.getdoc(member), f"{label} has no docstring"
        if inspect.isfunction(member):
            hints = inspect.signature(member)
            assert hints.return_annotation is not inspect.Signature.empty, label


@pytest.mark.parametrize(
    "name", [n for n in calib_pin.__all__ if inspect.isfunction(getattr(calib_pin, n))]
)
def test_functions_name_their_errors_and_arguments(name: str) -> None:
    function = getattr(calib_pin, name)
    text = inspect.getdoc(function) or ""
    arguments = [p for p in inspect.signature(function).parameters if p != "self"]
    if "Args:" in text:
        section = text.split("Args:")[1].split("Returns:")[0].split("Raises:")[0]
        section = section.split("Example")[0]
        described = re.findall(r"^    (\w+):", section, re.MULTILINE)
        assert described == arguments


def test_unknown_name() -> None:
    with pytest.raises(AttributeError, match="no attribute 'calibrat'"):
        calib_pin.calibrat  # noqa: B018


def test_import_is_lazy() -> None:
    loaded = python("import calib_pin, sys; print(*sys.modules)").split()
    assert "calib_pin" in loaded
    assert not set(HEAVY) & set(loaded)
    # Looking at the names loads nothing either.
    loaded = python("import calib_pin, sys; dir(calib_pin); print(*sys.modules)")
    assert not set(HEAVY) & set(loaded.split())


def test_first_use_loads_what_it_needs() -> None:
    code = "import calib_pin, sys; calib_pin.{}; print(*sys.modules)"
    loaded = set(python(code.format("CalibPinError")).split())
    assert "calib_pin.errors" in loaded and not set(HEAVY) & loaded
    loaded = set(python(code.format("Chain")).split())
    assert "pinocchio" in loaded and not {"scipy", "yaml", "rich", "typer"} & loaded


def test_star_import() -> None:
    names = python("from calib_pin import *; print(*sorted(set(dir())))").split()
    assert set(calib_pin.__all__) <= set(names)


def test_every_module_is_documented() -> None:
    package = Path(calib_pin.__file__).parent
    for path in package.rglob("*.py"):
        assert path.read_text().lstrip().startswith('"""'), path


def test_a_calibration_loads_neither_scipy_nor_what_draws() -> None:
    loaded = python(
        "import sys, contextlib, io\n"
        "from calib_pin import robot_file\n"
        "from calib_pin.cli import main\n"
        "rows = str(robot_file('space7', 'measurements.csv'))\n"
        "setup = str(robot_file('space7', 'setup.yaml'))\n"
        "words = ['calibrate', 'space7', rows, '--setup', setup]\n"
        "with contextlib.redirect_stdout(io.StringIO()):\n"
        "    assert main([*words, '--quiet']) == 0\n"
        "print(*sys.modules)"
    ).split()
    heavy = {"scipy", "sklearn", "numba", "matplotlib", "jinja2", "viser"}
    assert heavy.isdisjoint(loaded)
    assert "calib_pin.report.html" not in loaded


@pytest.mark.parametrize("first", ["calib_pin.report", "import calib_pin.report.text"])
def test_report_can_be_called_whatever_was_imported_before(first: str) -> None:
    shown = python(
        f"import calib_pin\n{first}\n"
        "try:\n    calib_pin.report('/no/such/folder/c.json', 'page.html')\n"
        "except calib_pin.CalibPinError as error:\n    print(error)"
    )
    assert shown == "/no/such/folder/c.json: no such file"


def test_a_result_loads_no_solver() -> None:
    loaded = set(
        python("import calib_pin.validation.result, sys; print(*sys.modules)").split()
    )
    solvers = {
        "calib_pin.solvers",
        "calib_pin.estimation.fit",
        "calib_pin.estimation.solve",
    }
    assert not loaded & {*solvers, "scipy.optimize", "numba", "matplotlib"}
