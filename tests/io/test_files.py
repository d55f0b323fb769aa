"""Sets of files: whatever fails or kills at whatever step, it is the old or the new."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from calib_pin.errors import InputError, OptionError, OutputError
from calib_pin.io.files import read_bytes, write_files, write_folder
from calib_pin.io.journal import settled, temporary

OLD = {"a.json": b"old a", "b.urdf": b"old b", "gone.json": b"old gone"}
NEW = {"a.json": b"new a", "b.urdf": b"new b", "figures/c.png": b"new c"}
OUTSIDE = Path("outside.png")


class Killed(BaseException):
    """The process is no more; nothing of it runs any further."""


class System:
    """The system's calls that write, of which one does not succeed."""

    CALLS = ("fsync", "replace", "unlink", "mkdir", "rmdir", "link", "open")

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
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }
    assert found.pop("mine.txt", b"mine") == b"mine"
    return found


@contextmanager
def new_set(folder: Path, said: list[str]) -> Iterator[None]:
    contents = {folder / name: data for name, data in NEW.items()}
    contents[OUTSIDE] = b"new outside"
    with write_folder(
        folder, contents, [folder / "gone.json"], force=True, notice=said.append
    ):
        yield


def read_as_a_reader(folder: Path) -> dict[str, bytes]:
    with settled(folder) as waiting:
        assert not waiting
    return content(folder)


def steps(system: System, kind: str, tmp_path: Path) -> Iterator[tuple[Path, Any]]:
    """A folder for every call that can fail, until none does."""
    for step in range(200):
        folder = tmp_path / f"{kind}-{step}"
        start(folder)
        OUTSIDE.unlink(missing_ok=True)
        said: list[str] = []

        def run(step: int = step, folder: Path = folder, said: Any = said) -> bool:
            system.fail(step, kind)
            try:
                with new_set(folder, said):
                    pass
            except (OutputError, Killed):
                return False
            finally:
                run.calls = system.recover()  # type: ignore[attr-defined]
            return not said

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
            assert sorted(p.name for p in folder.iterdir()) == [
                *sorted(OLD),
                "mine.txt",
            ]
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
        read = read_as_a_reader(folder)
        # What was not decided on may still be there, under names that nobody reads.
        seen = {k: v for k, v in read.items() if not k.endswith(".tmp")}
        assert seen in (OLD, NEW)
        assert seen == NEW or not finished
        found.append(seen == NEW)
        if seen == NEW:
            assert OUTSIDE.read_bytes() == b"new outside"
        with new_set(folder, []):
            pass
        assert content(folder) == NEW
        assert not list(tmp_path.glob(".calib-pin-*"))
    assert found == sorted(found), "once decided, it stays"
    assert 10 < sum(found) < len(found) - 10


@pytest.mark.slow
def test_a_writer_completes_what_was_decided_on(
    system: System, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another file in the same folder must not clear away what waits there."""
    monkeypatch.chdir(tmp_path)
    for folder, run in steps(system, "kill", tmp_path):
        run()
        with write_files({folder / "plan.csv": b"q"}, force=False):
            pass
        found = content(folder)
        assert found.pop("plan.csv") == b"q"
        # What is below belongs to whoever writes there next.
        assert {k: v for k, v in found.items() if not k.endswith(".tmp")} in (OLD, NEW)
        assert not [path for path in folder.iterdir() if path.name[0] == "."]


# --- files of their own ------------------------------------------------------------


@pytest.mark.parametrize("links", [True, False])
def test_loose_files_are_all_there_or_none(
    links: bool, system: System, tmp_path: Path
) -> None:
    """A call that fails at the end only clears up later than it should."""
    paths = [tmp_path / name for name in ("a", "b", "new/c")]
    done, names = [], {"a", "b"}
    for step in range(100):
        for path in paths[:2]:
            path.write_bytes(b"old")
        for path in (tmp_path / "new").glob("c"):
            path.unlink()
            path.parent.rmdir()
        system.fail(step, "full")
        with pytest.MonkeyPatch.context() as patch:
            if not links:
                patch.setattr(Path, "hardlink_to", lambda *_: os.link("/", "/"))
            try:
                with write_files(dict.fromkeys(paths, b"new"), force=True):
                    pass
                done.append(True)
            except OutputError:
                done.append(False)
        calls = system.recover()
        if done[-1]:
            assert [path.read_bytes() for path in paths] == [b"new"] * 3
        else:
            assert {
                p.name: p.read_bytes() for p in tmp_path.iterdir()
            } == dict.fromkeys(names, b"old")
        if calls <= step:
            break
    assert done[-1] and done.count(False) > 10


def test_what_fails_leaves_nothing(tmp_path: Path) -> None:
    name = "x" * 255  # Temporary names are no longer.
    with (
        pytest.raises(ZeroDivisionError),
        write_files({tmp_path / "a" / "b" / name: b"1"}, force=False),
    ):
        assert temporary(tmp_path / "a" / "b" / name).read_bytes() == b"1"
        raise ZeroDivisionError
    assert not list(tmp_path.iterdir())
    # Nor is any written where one exists.
    (tmp_path / "b").write_bytes(b"old")
    contents = {tmp_path / "new" / "a": b"1", tmp_path / "b": b"2"}
    with pytest.raises(OptionError) as caught, write_files(contents, force=False):
        pass
    assert caught.value.file == str(tmp_path / "b")
    assert [path.name for path in tmp_path.iterdir()] == ["b"]


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
