"""Signals that wait and folders that are locked."""

from __future__ import annotations

import signal
import threading
from pathlib import Path

import pytest

from calib_pin.errors import OutputError
from calib_pin.io.interruptions import locked, signals_deferred
from calib_pin.io.journal import temporary
from calib_pin.io.staging import write_files


def test_signals_wait_for_the_end_of_the_block() -> None:
    received: list[int] = []
    before = signal.signal(signal.SIGTERM, lambda number, _: received.append(number))
    try:
        with signals_deferred(), signals_deferred():
            signal.raise_signal(signal.SIGTERM)
            assert received == []
        assert received == [signal.SIGTERM]
    finally:
        signal.signal(signal.SIGTERM, before)


def test_other_threads_defer_nothing() -> None:
    done: list[bool] = []

    def work() -> None:
        with signals_deferred():
            done.append(True)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert done == [True]


def test_readers_share_a_folder_and_writers_do_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("calib_pin.io.interruptions.PATIENCE", 0.0)
    with (
        locked(tmp_path, shared=True) as one,
        locked(tmp_path, shared=True) as other,
    ):
        assert one and other
        with pytest.raises(OutputError, match="has kept it locked"), locked(tmp_path):
            pass
        with (
            pytest.raises(OutputError, match="has kept it locked"),
            write_files({tmp_path / "a": b"1"}, force=False),
        ):
            pass
    assert not list(tmp_path.iterdir())


def test_where_there_are_no_locks(tmp_path: Path) -> None:
    with locked(tmp_path / "none") as held:
        assert not held
    with pytest.MonkeyPatch.context() as patch:

        def refuse(*_: object) -> None:
            raise OSError(9, "Bad file descriptor")

        patch.setattr("fcntl.flock", refuse)
        with locked(tmp_path) as held:
            assert not held
        temporary(tmp_path / "a").write_bytes(b"left by a kill")
        temporary(tmp_path / "b").write_bytes(b"perhaps of a living run")
        with write_files({tmp_path / "a": b"1"}, force=False):
            pass
    assert {p.name for p in tmp_path.iterdir()} == {"a", temporary(Path("b")).name}
