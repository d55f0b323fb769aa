"""Members of families from other packages."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import calib_pin
from calib_pin.errors import CalibPinError
from calib_pin.io.dialects import DIALECTS, Dialect
from calib_pin.parameterizations import PARAMETERIZATIONS
from calib_pin.plugins import Members, extensions

GROUP = "calib_pin.tests"


@pytest.fixture(autouse=True)
def fresh() -> Iterator[None]:
    extensions.cache_clear()
    yield
    extensions.cache_clear()


def install(folder: Path, package: str, entries: str, code: str = "") -> None:
    """A package with entry points, as pip would leave it in a folder."""
    info = folder / f"{package}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Name: {package}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[{GROUP}]\n{entries}\n")
    (folder / f"{package}.py").write_text(code)


def test_bundled_members_come_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, "outside_a", "b = outside_a:B\na = outside_a:A", "A, B = 1, 2\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert dict(Members(GROUP, {"z": 0})) == {"z": 0, "a": 1, "b": 2}
    assert list(Members(GROUP, {"z": 0})) == ["z", "a", "b"]
    assert len(Members(GROUP, {})) == 2 and "c" not in Members(GROUP, {})


def test_nothing_is_loaded_before_it_is_looked_at(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, "outside_lazy", "x = outside_lazy", "")
    monkeypatch.syspath_prepend(tmp_path)
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
def test_a_broken_plugin_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: str, reason: str
) -> None:
    name = f"broken_{reason.strip(chr(39))}"
    install(tmp_path, name, f"x = {name}:X", code)
    monkeypatch.syspath_prepend(tmp_path)
    family = Members(GROUP, {"z": 0})
    with pytest.raises(CalibPinError, match=reason) as caught:
        list(family)
    assert "'x'" in str(caught.value) and "\n" not in str(caught.value)
    assert family["z"] == 0


@pytest.mark.parametrize("names", [("z",), ("x", "x")])
def test_names_are_taken_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, names: tuple[str, ...]
) -> None:
    """By a bundled member, or by one of two packages."""
    for k, name in enumerate(names):
        package = f"outside_{name}_{k}"
        install(tmp_path, package, f"{name} = {package}:X", "X = 1\n")
    monkeypatch.syspath_prepend(tmp_path)
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
