"""The list that decides, when the run that wrote it is no more."""

from __future__ import annotations

import hashlib
import json
import os
import signal
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from calib_pin.errors import InputError, OutputError
from calib_pin.io.files import write_files, write_folder
from calib_pin.io.journal import JOURNAL, locked, settled, signals_deferred, temporary

OLD = {"a.json": b"old a", "b.urdf": b"old b", "gone.json": b"old gone"}
NEW = {"a.json": b"new a", "b.urdf": b"new b"}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, data in OLD.items():
        (tmp_path / name).write_bytes(data)
    return tmp_path


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_a_folder_that_cannot_be_written_is_read_as_decided(folder: Path) -> None:
    """As on a medium that is mounted for reading, after a kill."""
    files = {}
    for name in NEW:
        temporary(folder / name).write_bytes(NEW[name])
        files[name] = hashlib.sha256(NEW[name]).hexdigest()
    journal = {"files": files, "remove": ["gone.json"]}
    (folder / JOURNAL).write_text(json.dumps(journal))
    with pytest.MonkeyPatch.context() as patch:

        def refuse(*_: object) -> None:
            raise PermissionError(30, "Read-only file system")

        patch.setattr(os, "replace", refuse)
        patch.setattr(os, "unlink", refuse)
        with settled(folder) as waiting:
            for name in files:
                assert waiting[folder / name].read_bytes() == NEW[name]
    with settled(folder) as waiting:
        assert waiting == {}
    assert content(folder) == NEW


@pytest.mark.parametrize(
    "journal",
    [
        b"",
        b'{"files": {}}',
        b'{"files": {"../x": ""}, "remove": []}',
        b'{"files": {}, "remove": ["/etc/passwd"]}',
    ],
)
def test_lists_that_reach_out_of_their_folder(journal: bytes, folder: Path) -> None:
    (folder / JOURNAL).write_bytes(journal)
    with pytest.raises(InputError) as caught, settled(folder):
        pass
    assert caught.value.file == str(folder / JOURNAL)


def test_what_waits_was_damaged(folder: Path) -> None:
    temporary(folder / "a.json").write_bytes(b"cut off")
    journal = {"files": {"a.json": "0" * 64}, "remove": ["b.urdf"]}
    (folder / JOURNAL).write_text(json.dumps(journal))
    with pytest.raises(InputError) as caught, settled(folder):
        pass
    assert caught.value.file == str(temporary(folder / "a.json"))
    # A new set does not need it.
    contents = {folder / "a.json": b"new"}
    with write_folder(folder, contents, force=True, notice=print):
        pass
    assert content(folder) == {**OLD, "a.json": b"new"}


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
    def work() -> bool:
        with signals_deferred():
            return True

    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(work).result()


def test_readers_share_a_folder_and_writers_do_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("calib_pin.io.journal.PATIENCE", 0.0)
    with locked(tmp_path, shared=True) as one, locked(tmp_path, shared=True) as other:
        assert one and other
        for writer in (
            locked(tmp_path),
            write_files({tmp_path / "a": b""}, force=False),
        ):
            with pytest.raises(OutputError), writer:
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


def test_nobody_waits_for_a_pipe(folder: Path) -> None:
    os.mkfifo(folder / JOURNAL)
    with settled(folder) as waiting:
        assert waiting == {}
    with write_files({folder / "a.json": b"new a"}, force=True):
        pass
    assert (folder / "a.json").read_bytes() == b"new a"
    (folder / JOURNAL).unlink()
    os.mkfifo(temporary(folder / "a.json"))
    journal = {"files": {"a.json": "0" * 64}, "remove": []}
    (folder / JOURNAL).write_text(json.dumps(journal))
    with pytest.raises(InputError), settled(folder):
        pass
    with settled(folder / JOURNAL) as waiting:  # A file, not a folder.
        assert waiting == {}
    with settled(temporary(folder / "a.json")) as waiting:
        assert waiting == {}
