"""Sets of files: whatever fails or kills at whatever step, it is the old or the new."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from calib_pin.errors import InputError, OptionError, OutputError
from calib_pin.io.files import (
    COMMIT,
    locked,
    read_bytes,
    settled,
    write_files,
    write_folder,
)

OLD = {"a.json": b"old a", "b.urdf": b"old b", "gone.json": b"old gone"}
NEW = {"a.json": b"new a", "b.urdf": b"new b", "figures/c.png": b"new c"}
OUTSIDE = Path("outside.png")


class Killed(BaseException):
    """The process is no more; nothing of it runs any further."""


class System:
    """The system's calls that write, of which one does not succeed."""

    CALLS = ("fsync", "replace", "unlink", "mkdir", "rmdir", "open")

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.failing, self.kind, self.count = -1, "", 0
        self.dead = False
        patch.setattr(os, "fsync", lambda _: None)  # It takes the longest.
        for name in self.CALLS:
            patch.setattr(os, name, self.counted(getattr(os, name)))
        self.writing = self.counted(lambda write, data: write(data))
        opened = Path.open

        def open_counted(path: Path, mode: str = "r", *more: Any, **kinds: Any) -> Any:
            stream = opened(path, mode, *more, **kinds)
            write = stream.write
            if "x" not in mode:
                return stream

            class Writer:
                def __enter__(self) -> Any:
                    return self

                def __exit__(self, *_: object) -> None:
                    stream.close()

                def __getattr__(_, name: str) -> Any:
                    return getattr(stream, name)

                def write(_, data: bytes) -> None:
                    write(data[:2])  # What is there when the disk is full.
                    stream.flush()
                    self.writing(write, data[2:])

            return Writer()

        patch.setattr(Path, "open", open_counted)

    def counted(self, call: Callable[..., Any]) -> Callable[..., Any]:
        def count(*about: Any, **more: Any) -> Any:
            if self.dead:
                raise Killed
            self.count += 1
            if self.count - 1 == self.failing:
                if self.kind == "kill":
                    self.dead = True
                    raise Killed
                raise OSError(28, "No space left on device")
            return call(*about, **more)

        return count

    def fail(self, step: int, kind: str) -> None:
        self.failing, self.kind, self.count, self.dead = step, kind, 0, False

    def recover(self) -> int:
        """Let everything succeed again; the number of calls until now."""
        count = self.count
        self.fail(-1, "")
        return count


@pytest.fixture
def system(monkeypatch: pytest.MonkeyPatch) -> System:
    return System(monkeypatch)


def start(folder: Path) -> None:
    """The old set, and a file of somebody else."""
    for name, data in {**OLD, "mine.txt": b"mine"}.items():
        folder.mkdir(exist_ok=True)
        (folder / name).write_bytes(data)


def content(folder: Path) -> dict[str, bytes]:
    found = {
        name: path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and (name := path.relative_to(folder).as_posix())[0] != "."
    }
    assert found.pop("mine.txt", b"mine") == b"mine"
    return found


def write_new(folder: Path) -> None:
    contents = {folder / name: data for name, data in NEW.items()}
    contents[OUTSIDE] = b"new outside"
    with write_folder(folder, contents, [folder / "gone.json"], force=True):
        assert content(folder) in (OLD, NEW)


def read_as_a_reader(folder: Path) -> dict[str, bytes]:
    with settled(folder):
        return content(folder)


def steps(system: System, kind: str, tmp_path: Path) -> Iterator[tuple[Path, Any]]:
    """A folder for every call that can fail, until none does."""
    for step in range(200):
        folder = tmp_path / f"{kind}-{step}"
        start(folder)
        OUTSIDE.unlink(missing_ok=True)

        def run(step: int = step, folder: Path = folder) -> bool:
            system.fail(step, kind)
            try:
                write_new(folder)
            except (OutputError, Killed):
                return False
            finally:
                run.calls = system.recover()  # type: ignore[attr-defined]
            return True

        yield folder, run
        if run.calls <= step:  # type: ignore[attr-defined]
            assert step > 30
            return
    raise AssertionError("too many calls")


# --- a folder ----------------------------------------------------------------------


def test_a_full_disk_at_every_call_leaves_the_old_set(
    system: System, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    failed = 0
    for folder, run in steps(system, "full", tmp_path):
        if run():
            assert read_as_a_reader(folder) == NEW
            assert OUTSIDE.read_bytes() == b"new outside"
            continue
        failed += 1
        if content(folder) == OLD:
            assert {p.name for p in folder.iterdir()} == {*OLD, "mine.txt"}
            assert not OUTSIDE.exists()
            assert not list(tmp_path.glob(".calib-pin-*"))
        else:  # After the decision nothing goes back; the next reader completes it.
            assert read_as_a_reader(folder) == NEW
    assert failed > 15


def test_a_kill_at_every_call_leaves_the_old_set_or_the_new(
    system: System, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    found = []
    for folder, run in steps(system, "kill", tmp_path):
        finished = run()
        seen = read_as_a_reader(folder)
        assert seen in (OLD, NEW)
        assert seen == NEW or not finished
        found.append(seen == NEW)
        write_new(folder)
        assert content(folder) == NEW and OUTSIDE.read_bytes() == b"new outside"
        assert not list(tmp_path.rglob(".calib-pin-*"))
    assert found == sorted(found), "once decided, it stays"
    assert 10 < sum(found) < len(found) - 10


# --- files of their own ------------------------------------------------------------


def test_loose_files_are_all_complete_or_none(system: System, tmp_path: Path) -> None:
    """A full disk is met before the first of them is put in place."""
    names, done = ("a", "b", "new/c"), []
    for step in range(100):
        folder = tmp_path / str(step)
        folder.mkdir()
        for name in names[:2]:
            (folder / name).write_bytes(b"old")
        system.fail(step, "full")
        try:
            with write_files({folder / n: b"new" for n in names}, force=True):
                system.failing = -1
            done.append(True)
        except OutputError:
            done.append(False)
        system.recover()
        new = {name: b"new" for name in names}
        assert content(folder) == (new if done[-1] else {"a": b"old", "b": b"old"})
        assert not list(folder.rglob(".calib-pin-*"))
        assert done[-1] or not (folder / "new").exists()
    assert done[-1] and done.count(False) > 5


def test_what_fails_leaves_nothing(tmp_path: Path) -> None:
    name = "x" * 255
    with (
        pytest.raises(ZeroDivisionError),
        write_files({tmp_path / "a" / "b" / name: b"1"}, force=False),
    ):
        (staged,) = (tmp_path / "a" / "b").glob(f"*/{name}")
        assert staged.read_bytes() == b"1"
        raise ZeroDivisionError
    assert not list(tmp_path.iterdir())
    # Nor is any written where one exists.
    (tmp_path / "b").write_bytes(b"old")
    contents = {tmp_path / "new" / "a": b"1", tmp_path / "b": b"2"}
    with pytest.raises(OptionError) as caught, write_files(contents, force=False):
        pass
    assert caught.value.file == str(tmp_path / "b")
    assert [path.name for path in tmp_path.iterdir()] == ["b"]


# --- who reads and writes at the same time -----------------------------------------


def test_what_cannot_be_put_in_place_is_one_line(tmp_path: Path) -> None:
    (tmp_path / COMMIT).mkdir()
    (tmp_path / COMMIT / "a").write_bytes(b"new")
    (tmp_path / "a" / "b").mkdir(parents=True)
    with pytest.raises(OutputError), settled(tmp_path):
        pass


def test_readers_share_a_folder_and_writers_do_not(tmp_path: Path) -> None:
    with (
        locked(tmp_path, shared=True) as one,
        locked(tmp_path, shared=True) as other,
        locked(tmp_path, wait=False) as writer,
    ):
        assert one and other and not writer


def test_two_runs_into_one_folder(tmp_path: Path) -> None:
    """Neither clears away what the other has not put in place yet."""
    with (
        write_folder(tmp_path, {tmp_path / "a": b"1"}, force=True),
        write_folder(tmp_path, {tmp_path / "a": b"2"}, force=True),
    ):
        assert len(list(tmp_path.glob(".calib-pin-*"))) == 2
    assert read_as_a_reader(tmp_path) == {"a": b"1"}
    assert not list(tmp_path.glob(".calib-pin-*"))


def test_where_there_are_no_locks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(9, "Bad file descriptor")

    monkeypatch.setattr("fcntl.flock", refuse)
    with locked(tmp_path) as held, locked(tmp_path / "none") as other:
        assert not held and not other
    (tmp_path / "done").mkdir()
    start(tmp_path / "done")
    monkeypatch.chdir(tmp_path)
    write_new(tmp_path / "done")
    assert read_as_a_reader(tmp_path / "done") == NEW


def test_nobody_waits_for_a_pipe(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / COMMIT)
    with settled(tmp_path), settled(tmp_path / COMMIT):
        pass


def test_only_regular_files_are_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "device").symlink_to("/dev/tty")
    (tmp_path / "endless").symlink_to("/dev/zero")
    for name in ("pipe", "device", "endless"):
        with pytest.raises(InputError):
            read_bytes(tmp_path / name)


def test_size_is_limited(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"12345")
    assert read_bytes(path, 5) == b"12345"
    with pytest.raises(InputError) as caught:
        read_bytes(path, 4)
    assert caught.value.file == str(path)
    # Nor is a file of holes read to its limit.
    with path.open("r+b") as stream:
        stream.truncate(1 << 40)
    with pytest.raises(InputError):
        read_bytes(path)
