"""The next content of a folder: a list that decides, and those who complete it.

A run leaves its files, complete, beside their destinations, and then puts a list of
them into the folder. From that moment on the new set stands: whoever comes next, be it
a reader or a writer, puts in place what the run that wrote the list did not live to.
"""

from __future__ import annotations

import hashlib
import json
import os
import signal
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath

from calib_pin.errors import InputError, OutputError

PATIENCE = 30.0
"""How long a folder may stay locked [s]; runs hold it while they write, not longer."""


@contextmanager
def signals_deferred() -> Iterator[None]:
    """Let Ctrl-C and SIGTERM wait for the end of the block.

    Python handles signals in the main thread alone; elsewhere nothing has to wait.

    Examples:
        >>> seen = []
        >>> before = signal.signal(signal.SIGTERM, lambda *_: seen.append("signal"))
        >>> with signals_deferred():
        ...     signal.raise_signal(signal.SIGTERM)
        ...     seen.append("all of it")
        >>> _ = signal.signal(signal.SIGTERM, before)
        >>> seen
        ['all of it', 'signal']
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    caught: list[int] = []
    handlers = {
        number: signal.signal(number, lambda found, _: caught.append(found))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield
    finally:
        for number, handler in handlers.items():
            # None stands for a handler that was not set from Python.
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
        for found in caught:
            signal.raise_signal(found)


@contextmanager
def locked(folder: Path, *, shared: bool = False) -> Iterator[bool]:
    """Keep the other runs out of a folder.

    The lock is one of the system on the folder itself: no file stands for it, and it
    ends with the process whatever happens to that.

    Args:
        folder: The folder.
        shared: Keep out only those that write.

    Yields:
        Whether there is such a lock; some file systems, and Windows, know none.

    Raises:
        OutputError: If another program does not let go of the folder.
    """
    try:
        import fcntl

        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except (ImportError, OSError, ValueError):
        yield False
        return
    kind = (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB
    deadline = time.monotonic() + PATIENCE
    try:
        while True:
            try:
                fcntl.flock(descriptor, kind)
                held = True
                break
            except BlockingIOError as error:
                if time.monotonic() > deadline:
                    reason = "another program has kept it locked"
                    raise OutputError(f"{folder}: {reason}") from error
                time.sleep(0.01)
            except OSError:
                held = False
                break
        yield held
    finally:
        os.close(descriptor)


JOURNAL = ".calib-pin-commit.json"
"""Name of the list of what a folder is about to hold."""

_PREFIX, _SUFFIX = ".calib-pin-", ".tmp"


def temporary(path: Path, kind: str = "new") -> Path:
    """Where a file is complete before it is put in place.

    It is short whatever the name, and always the same, so that nothing piles up.

    Examples:
        >>> temporary(Path("out", "arm.urdf")).parent.name
        'out'
    """
    name = hashlib.sha256(os.fsencode(path.name)).hexdigest()[:16]
    return path.parent / f"{_PREFIX}{name}.{kind}{_SUFFIX}"


@contextmanager
def settled(folder: Path) -> Iterator[Mapping[Path, Path]]:
    """A folder of results for reading, with what a killed run decided on in place.

    Args:
        folder: The folder, in which nobody writes while the block lasts.

    Yields:
        Where those files are read that cannot be put in place: the folder may be one
        that this user must not change.

    Raises:
        InputError: If what was decided on is not there any more.
        OutputError: If another program does not let go of the folder.
    """
    with locked(folder, shared=True):
        if not (folder / JOURNAL).is_file():
            yield {}
            return
    with locked(folder):
        with signals_deferred():
            waiting = complete(folder)
        yield waiting


def settle(folder: Path, held: bool) -> None:
    """Bring to an end what dead runs have begun in a folder.

    Args:
        folder: The folder.
        held: Whether its lock is ours: then nothing in it is of a living run.
    """
    try:
        waiting = complete(folder)
    except InputError:
        return  # What cannot be completed stays for a look; a new set replaces it.
    for path in waiting:
        if path.is_relative_to(folder):
            raise OutputError(f"{path}: cannot be replaced")
    if held:
        for left in folder.glob(f"{_PREFIX}*{_SUFFIX}"):
            discard(left)


def complete(folder: Path) -> dict[Path, Path]:
    """Put in place what a run had decided to; as often as one likes.

    Returns:
        Where those files are that cannot be put in place.

    Raises:
        InputError: If one of them is damaged.
    """
    journal = folder / JOURNAL
    files, removed = _decided(journal)
    waiting = {}
    for name, content in files.items():
        path = folder / name
        source = temporary(path)
        try:
            data = _read(source)
        except (FileNotFoundError, NotADirectoryError):
            continue  # It is in place already.
        except OSError:
            data = b""
        if sha256(data) == content:
            try:
                source.replace(path)
            except OSError:
                waiting[path] = source
        elif inside(name):
            reason = "damaged or unreadable before it could be put in place"
            raise InputError(f"{reason}; calibrate again with --force", file=source)
    if not any(path.is_relative_to(folder) for path in waiting):
        with suppress(OSError):  # Then the list stays, and whoever comes next goes on.
            for name in removed:
                (folder / name).unlink(missing_ok=True)
            for place in {(folder / name).parent for name in files}:
                sync(place)
            journal.unlink(missing_ok=True)
    return waiting


def _read(path: Path) -> bytes:
    """The bytes of a regular file: nobody waits for a pipe."""
    if path.exists() and not path.is_file():
        raise OSError(f"{path} is not a regular file")
    return path.read_bytes()


def _decided(journal: Path) -> tuple[dict[str, str], list[str]]:
    """Files that are to be put in place, with their hashes, and those that go.

    A list may come from anywhere. It can remove nothing outside its folder, and put
    nothing there but what a run has left beside its destination.

    Raises:
        InputError: If it is no such list.
    """
    try:
        found = json.loads(_read(journal))
        files, removed = dict(found["files"]), list(found["remove"])
        known = all(inside(name) or Path(name).is_absolute() for name in files)
        known &= all(map(inside, removed))
    except FileNotFoundError:
        return {}, []
    except (OSError, ValueError, KeyError, TypeError):
        known = False
    if not known:
        raise InputError("no list of files to put in place; remove it", file=journal)
    return files, removed


def listed(path: Path, folder: Path) -> str:
    """Name of a file within a folder; the whole path of one that lies elsewhere."""
    place, home = path.parent.resolve() / path.name, folder.resolve()
    if place.is_relative_to(home):
        return place.relative_to(home).as_posix()
    return str(place)


def inside(name: str) -> bool:
    """Whether a name of a list is one within the folder of the list."""
    path = PurePosixPath(name)
    return not path.is_absolute() and path.name != "" and ".." not in path.parts


def sha256(data: bytes) -> str:
    """Hexadecimal SHA-256 of bytes."""
    return hashlib.sha256(data).hexdigest()


def sync(folder: Path) -> None:
    """Make the names in a folder last, where the system lets us ask for that."""
    try:
        descriptor = os.open(folder, os.O_RDONLY)
    except (PermissionError, FileNotFoundError, NotADirectoryError):
        return
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def discard(path: Path) -> None:
    """Remove what a failed write left; the reason of the failure comes first."""
    with suppress(OSError, ValueError):
        path.unlink(missing_ok=True)
