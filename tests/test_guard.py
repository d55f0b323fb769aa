"""The guard of speed: what it lets pass, and what it names."""

from __future__ import annotations

import time

import pytest

from benchmarks import guard
from benchmarks.races import RACES, Race


def work(units: int) -> None:
    """Keep the processor busy; sleeping takes none of its time."""
    end = time.process_time() + 1e-3 * units
    while time.process_time() < end:
        pass


def test_every_race_has_a_recorded_ratio() -> None:
    assert list(guard.RECORDED) == list(RACES)


@pytest.mark.parametrize(("units", "slow"), [(10, False), (80, True)])
def test_a_slow_path_is_named(units, slow, monkeypatch, capsys):
    races = {
        "even": lambda: Race(lambda: work(10), lambda: work(10)),
        "fit": lambda: Race(lambda: work(units), lambda: work(10)),
    }
    monkeypatch.setattr(guard, "RACES", races)
    monkeypatch.setattr(guard, "RECORDED", dict.fromkeys(races, 1.0))
    monkeypatch.setattr("sys.argv", ["benchmarks", "guard"])
    if not slow:
        guard.main()
    else:
        with pytest.raises(SystemExit, match=r"guard: 'fit' takes [678]\.\d times"):
            guard.main()
    assert capsys.readouterr().out.count("x recorded") == 2


def test_ratios_are_recorded(monkeypatch, capsys):
    race = Race(lambda: work(30), lambda: work(10))
    monkeypatch.setattr(guard, "RACES", {"fit": lambda: race})
    monkeypatch.setattr("sys.argv", ["benchmarks", "guard", guard.RECORD])
    guard.main()
    name, ratio = capsys.readouterr().out.strip().rstrip(",").split(": ")
    assert name == '"fit"'
    assert 2.0 < float(ratio) < 4.0
