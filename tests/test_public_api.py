"""The public names: sorted, all there, documented, and imported when first used."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
from importlib import import_module

import pytest

import calib_pin

FILES = {"pandas", "pydantic", "scipy", "yaml"}
"""What reads and checks files, once there is one."""

LAZY = {
    "dir(calib_pin); calib_pin.CalibPinError": FILES
    | {"numba", "numpy", "pinocchio", "click", "rich"},
    "import calib_pin.validation.result": {
        *("calib_pin.solvers", "calib_pin.estimation.fit", "matplotlib"),
        *("calib_pin.estimation.solve", "scipy.optimize"),
    },
    "calib_pin.Chain": {"click", "rich", "scipy", "yaml"},
    "import calib_pin.io.setup, calib_pin.io.measurements": FILES,
}
"""What may not be loaded yet, after the lines before and this one."""


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
    assert 12 <= len(calib_pin.__all__) <= 29


def test_every_name_is_there_and_documented() -> None:
    """Also by `from calib_pin import *`; functions describe all their arguments."""
    given: dict[str, object] = {}
    exec("from calib_pin import *", given)
    for name in calib_pin.__all__:
        value = given[name]
        if inspect.ismodule(value):
            # The package `report` was imported before and stands for its function.
            value = getattr(import_module(f"calib_pin.{calib_pin._HOMES[name]}"), name)
        assert value.__name__ == name
        homes = {"calib_pin", f"calib_pin.{calib_pin._HOMES[name]}"}
        assert value.__module__ in homes  # Under the former functions are pickled.
        members = [(name, value)]
        if inspect.isclass(value):
            members += [
                (f"{name}.{key}", getattr(value, key))
                for key in vars(value)
                if not key.startswith("_") and callable(getattr(value, key))
            ]
        for label, member in members:
            text = inspect.getdoc(member) or ""
            assert len(text.split("\n")[0]) > 10, f"{label} has no docstring"
            if inspect.isfunction(member):
                hints = inspect.signature(member)
                assert hints.return_annotation is not inspect.Signature.empty, label
        if inspect.isfunction(value) and "Args:" in text:
            section = re.split(r"Returns:|Raises:|Example", text.split("Args:")[1])[0]
            described = re.findall(r"^    (\w+):", section, re.MULTILINE)
            assert described == list(inspect.signature(value).parameters), name
    with pytest.raises(AttributeError, match="calibrat"):
        calib_pin.calibrat  # noqa: B018


def test_import_is_lazy() -> None:
    """First use loads what it needs; looking at the names loads nothing."""
    lines = [f"{line}; print(*sys.modules)" for line in LAZY]
    told = python("\n".join(["import calib_pin, sys", *lines])).splitlines()
    loaded = dict(zip(LAZY, map(str.split, told), strict=True))
    for line, heavy in LAZY.items():
        assert heavy.isdisjoint(loaded[line]), line
    assert "pinocchio" in loaded["calib_pin.Chain"]


def test_a_calibration_loads_quantiles_and_no_more_of_scipy_nor_what_draws() -> None:
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
    heavy = {"sklearn", "numba", "matplotlib", "jinja2", "viser"}
    assert heavy.isdisjoint(loaded)
    assert "calib_pin.report.html" not in loaded
    scipy = {".".join(name.split(".")[:2]) for name in loaded if "scipy." in name}
    rooms = {name for name in scipy if not name.startswith("scipy._")}
    # From scipy 1.18 on its functions come with those of linalg.
    assert rooms <= {"scipy.special", "scipy.version", "scipy.linalg"}


def test_report_can_be_called_whatever_was_imported_before() -> None:
    import_module("calib_pin.report.text")
    with pytest.raises(calib_pin.CalibPinError):
        calib_pin.report("/no/such/folder/c.json", "page.html")
