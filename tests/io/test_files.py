"""Sets of files: whatever fails or kills at whatever step, it is the old or the new."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from calib_pin.errors import InputError, OptionError, OutputError
from calib_pin.io.files import (
    COMMIT,
    locked,
    read_bytes,
    settled,
    write_atomically,
    write_files,
)

OLD = {"a.json": b"old a", "b.urdf": b"old b", "gone.json": b"old gone"}
NEW = {"a.json": b"new a", "b.urdf": b"new b", "figures/c.png": b"new c"}
OUTSIDE = Path("outside.png")


class Killed(BaseException):
    """The process is no more; nothing of it runs any further."""


class System:
    """The system's calls that write, of which one does not succeed."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.fail(-1, "")
        patch.setattr(os, "fsync", lambda _: None)  # It takes the longest.
        for name in ("fsync", "replace", "unlink", "mkdir", "rmdir", "open"):
            patch.setattr(os, name, self.counted(getattr(os, name)))

    def counted(self, call: Callable[..., Any]) -> Callable[..., Any]:
        def count(*about: Any, **more: Any) -> Any:
            self.count += 1
            failing = self.count - 1 == self.failing
            self.dead |= failing and self.kind == "kill"
            if self.dead:
                raise Killed
            if failing:
                raise OSError(28, "No space left on device")
            return call(*about, **more)

        return count

    def fail(self, step: int, kind: str) -> None:
        self.failing, self.kind, self.count, self.dead = step, kind, 0, False


@pytest.fixture
def system(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> System:
    monkeypatch.chdir(tmp_path)
    return System(monkeypatch)


def content(folder: Path) -> dict[str, bytes]:
    """All files but hidden ones, and but that of somebody else, which stays."""
    found = {
        name: path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and (name := path.relative_to(folder).as_posix())[0] != "."
    }
    assert found.pop("mine.txt", b"mine") == b"mine"
    return found


def start(folder: Path) -> None:
    folder.mkdir()
    for name, data in {**OLD, "mine.txt": b"mine"}.items():
        (folder / name).write_bytes(data)
    OUTSIDE.unlink(missing_ok=True)


def write_new(folder: Path) -> None:
    contents = {folder / name: data for name, data in NEW.items()}
    contents[OUTSIDE] = b"new outside"
    gone = [folder / "gone.json"]
    with write_files(contents, force=True, folder=folder, removed=gone):
        assert content(folder) in (OLD, NEW)


def read_as_a_reader(folder: Path) -> dict[str, bytes]:
    with settled(folder):
        return content(folder)


@pytest.mark.parametrize("kind", ["full", "kill"])
def test_whatever_fails_it_is_the_old_set_or_the_new(kind, system, tmp_path):
    """At every call; a full disk leaves nothing, and the next run clears up."""
    found, umask = list[bool](), os.umask(0)
    os.umask(umask)
    for step in range(200):
        folder = tmp_path / f"{kind}-{step}"
        start(folder)
        system.fail(step, kind)
        try:
            write_new(folder)
            finished = True
        except (OutputError, Killed):
            finished = False
        calls = system.count
        system.fail(-1, "")
        if kind == "full" and content(folder) == OLD:
            assert {p.name for p in folder.iterdir()} == {*OLD, "mine.txt"}
            assert not OUTSIDE.exists()
            assert not list(tmp_path.glob(".calib-pin-*"))
        seen = read_as_a_reader(folder)  # Which completes what was decided.
        assert seen in (OLD, NEW)
        assert seen == NEW or not finished
        found.append(seen == NEW)
        write_new(folder)
        assert content(folder) == NEW and OUTSIDE.read_bytes() == b"new outside"
        assert not list(tmp_path.rglob(".calib-pin-*"))
        mode = (folder / "a.json").stat().st_mode & 0o777
        assert mode == 0o666 & ~umask, "others may read it as elsewhere"
        if calls <= step:
            break
    assert finished
    assert kind == "full" or found == sorted(found), "once decided, it stays"
    assert 5 < sum(found) < len(found) - 5


def test_loose_files_are_all_complete_or_none(system, tmp_path):
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
        new = {name: b"new" for name in names}
        assert content(folder) == (new if done[-1] else {"a": b"old", "b": b"old"})
        assert not list(folder.rglob(".calib-pin-*"))
        assert done[-1] or not (folder / "new").exists()
    assert done[-1] and done.count(False) > 5


def test_what_fails_leaves_nothing(tmp_path):
    name = "x" * 255
    with (
        pytest.raises(ZeroDivisionError),
        write_files({tmp_path / "a" / "b" / name: b"1"}, force=False),
    ):
        (staged,) = (tmp_path / "a" / "b").glob(f"*/{name}")
        assert staged.read_bytes() == b"1"
        raise ZeroDivisionError
    assert not list(tmp_path.iterdir())
    # Nor is any written where one exists, or cannot be.
    (tmp_path / "b").write_bytes(b"old")
    contents = {tmp_path / "new" / "a": b"1", tmp_path / "b": b"2"}
    with pytest.raises(OptionError) as caught, write_files(contents, force=False):
        pass
    assert caught.value.file == str(tmp_path / "b")
    for bad in ("b/x.csv", "b/y/x.csv", "a\0b", "x" * 300, "."):
        with pytest.raises((OptionError, OutputError)):
            write_atomically(tmp_path / bad, b"y", force=True)
    assert [path.name for path in tmp_path.iterdir()] == ["b"]


def test_a_hostile_folder_changes_nothing_outside(tmp_path):
    (tmp_path / "mine").mkdir()
    for name in ("gone", "other"):
        (tmp_path / "mine" / name).write_bytes(b"mine")
    commit = tmp_path / "out" / COMMIT / "link"
    commit.mkdir(parents=True)
    (tmp_path / "out" / "link").symlink_to(tmp_path / "mine")
    (commit / "gone").touch()
    (commit / "other").write_bytes(b"new")
    with settled(tmp_path / "out"):
        assert content(tmp_path / "mine") == {"gone": b"mine", "other": b"mine"}
    # What cannot be put in place is one line.
    (tmp_path / COMMIT).mkdir()
    (tmp_path / COMMIT / "mine").write_bytes(b"new")
    with pytest.raises(OutputError), settled(tmp_path):
        pass


def test_two_runs_and_a_reader_of_one_folder(tmp_path):
    """None clears away what another has not put in place, or writes while one reads."""
    contents = {tmp_path / "a": b"1"}
    with (
        write_files(contents, force=True, folder=tmp_path),
        write_files({tmp_path / "a": b"2"}, force=True, folder=tmp_path),
    ):
        assert len(list(tmp_path.glob(".calib-pin-*"))) == 2
    with settled(tmp_path), locked(tmp_path, wait=False) as writer:
        assert not writer and content(tmp_path) == {"a": b"1"}
    assert not list(tmp_path.glob(".calib-pin-*"))


def test_where_there_are_no_locks(tmp_path, monkeypatch):
    def refuse(*_: object) -> None:
        raise OSError(9, "Bad file descriptor")

    monkeypatch.setattr("fcntl.flock", refuse)
    monkeypatch.chdir(tmp_path)
    start(tmp_path / "done")
    write_new(tmp_path / "done")
    assert read_as_a_reader(tmp_path / "done") == NEW


def test_only_regular_files_are_read(tmp_path):
    os.mkfifo(tmp_path / COMMIT)
    with settled(tmp_path), settled(tmp_path / COMMIT):
        pass
    (tmp_path / "device").symlink_to("/dev/tty")
    (tmp_path / "endless").symlink_to("/dev/zero")
    for name in (COMMIT, "device", "endless"):
        with pytest.raises(InputError):
            read_bytes(tmp_path / name)


def test_size_is_limited(tmp_path):
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
