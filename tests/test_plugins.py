"""Members of families from other packages."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import calib_pin
from calib_pin.errors import CalibPinError
from calib_pin.io.dialects import DIALECTS, Dialect
from calib_pin.parameterizations import PARAMETERIZATIONS
from calib_pin.plugins import Members

GROUP = "calib_pin.tests"


Install = Callable[..., None]


@pytest.fixture
def install(installed: Callable[..., Path]) -> Install:
    """Leaves a package with members of the family: `install(name, entries, code)`."""

    def make(package: str, entries: str, code: str = "") -> None:
        folder = installed(package, GROUP, entries)
        (folder / f"{package}.py").write_text(code)

    return make


def test_bundled_members_come_first(install: Install) -> None:
    install("outside_a", "b = outside_a:B\na = outside_a:A", "A, B = 1, 2\n")
    assert dict(Members(GROUP, {"z": 0})) == {"z": 0, "a": 1, "b": 2}
    assert list(Members(GROUP, {"z": 0})) == ["z", "a", "b"]
    assert len(Members(GROUP, {})) == 2 and "c" not in Members(GROUP, {})


def test_nothing_is_loaded_before_it_is_looked_at(install: Install) -> None:
    install("outside_lazy", "x = outside_lazy", "")
    family = Members(GROUP, {"z": 0})
    assert family["z"] == 0
    assert "outside_lazy" not in sys.modules
    assert "x" in family and "outside_lazy" in sys.modules


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        ("raise RuntimeError('no\\nlicense')", "RuntimeError"),
        ("import not_there_at_all", "ModuleNotFoundError"),
        ("", "'X'"),
    ],
)
def test_a_broken_plugin_is_one_line(install: Install, code: str, reason: str) -> None:
    name = f"broken_{reason.strip(chr(39))}"
    install(name, f"x = {name}:X", code)
    family = Members(GROUP, {"z": 0})
    with pytest.raises(CalibPinError, match=reason) as caught:
        list(family)
    assert "'x'" in str(caught.value) and "\n" not in str(caught.value)
    assert family["z"] == 0


@pytest.mark.parametrize("names", [("z",), ("x", "x")])
def test_names_are_taken_once(install: Install, names: tuple[str, ...]) -> None:
    """By a bundled member, or by one of two packages."""
    for k, name in enumerate(names):
        package = f"outside_{name}_{k}"
        install(package, f"{name} = {package}:X", "X = object()\n")
    with pytest.raises(CalibPinError, match=f"'{names[0]}'"):
        list(Members(GROUP, {"z": 0}))


def test_a_script_registers_members() -> None:
    """Of a family; faults are those of entry points."""

    class Shouting(Dialect):
        """A dialect of one's own."""

    class Offsets(PARAMETERIZATIONS["joint-offset"]):
        """A family of parameters of one's own."""

        name = "zeros"

    calib_pin.register("dialects", "shouting", Shouting)
    calib_pin.register("parameterizations", "zeros", Offsets)
    assert DIALECTS["shouting"] is Shouting and list(DIALECTS)[-1] == "shouting"
    found = calib_pin.identify(
        calib_pin.load_chain("space6"), "pose", {"parameters": ["zeros"]}
    )
    assert any(".zeros" in p.name for p in found.parameters)
    for words, reason in (
        (("dialects", "shouting", Shouting), "have a member 'shouting'"),
        (("dialects", "vicon", Shouting), "have a member 'vicon'"),
        (("dialects", "other", Offsets), "it is no Dialect"),
        (("parameterizations", "other", Shouting), "it is no Parameterization"),
        (("measurement_models", "other", Shouting), "it is no MeasurementModel"),
        (("verdicts", "other", Shouting), "unknown family 'verdicts'"),
    ):
        with pytest.raises(CalibPinError, match=reason):
            calib_pin.register(*words)
