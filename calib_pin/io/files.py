"""Read and write whole files, with errors that name the file and the reason.

What a run writes is complete in a folder of its own, beside the destinations, before
any of it is put in place. That folder becomes what is decided, `COMMIT`, in one step:
from then on the new set stands, and whoever comes next, a reader or a writer, puts in
place what the run that decided did not live to.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import stat
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from uuid import uuid4

from calib_pin.errors import InputError, OptionError, OutputError, nearest

COMMIT = ".calib-pin-commit"
"""Name of the folder with what a folder is about to hold; empty files are to go."""

STAGED = ".calib-pin-new-"
"""Begin of the names of folders with what is not decided yet."""


@contextmanager
def write_files(
    contents: Mapping[Path, bytes],
    *,
    force: bool,
    folder: Path | None = None,
    removed: Iterable[Path] = (),
) -> Iterator[None]:
    """Write all files if the block succeeds, and none of them otherwise.

    Args:
        contents: Content by file, never empty; missing folders are made.
        force: Replace existing files.
        folder: Folder whose files belong together: of these there are all or none even
            if the process is killed meanwhile, as there are of files side by side.
        removed: Files of that folder that go.

    Raises:
        OptionError: If one exists and `force` is false.
        OutputError: If one cannot be written.

    Examples:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     file = Path(folder, "a", "b.csv")
        ...     with write_files({file: b"x,y"}, force=False):
        ...         early = file.exists()
        ...     early, file.read_bytes()
        (False, b'x,y')
    """
    homes: dict[Path, dict[str, bytes]] = {}
    for path, data in {**dict.fromkeys(removed, b""), **contents}.items():
        name = "" if folder is None else listed(path, folder)
        home = folder if folder is not None and name else path.parent
        homes.setdefault(home, {})[name or path.name] = data
    with ExitStack() as stack:
        enter = stack.enter_context
        staged = {home: enter(_staging(home, homes[home], force)) for home in homes}
        yield
        for home, new in staged.items():
            with _writing(home), settled(home):
                try:
                    new.replace(home / COMMIT)
                    complete(home)
                finally:  # Also where a signal comes in between.
                    complete(home)


@contextmanager
def settled(folder: Path) -> Iterator[None]:
    """A folder for reading, with what a killed run decided on in place.

    No run puts files in place while the block lasts.

    Raises:
        OutputError: If what was decided on cannot be put in place.
    """
    with locked(folder):
        complete(folder)
        yield


def complete(folder: Path) -> None:
    """Put in place what a run has decided on; as often as one likes.

    Raises:
        OutputError: If it cannot be done.
    """
    commit = folder / COMMIT
    if not commit.is_dir():
        return
    with _writing(folder):
        for source in sorted(p for p in commit.rglob("*") if p.is_file()):
            path = folder / source.relative_to(commit)
            if not listed(path, folder):  # No run has written that.
                continue
            if source.stat().st_size == 0:
                path.unlink(missing_ok=True)
                continue
            path.parent.mkdir(parents=True, exist_ok=True)
            source.replace(path)
        shutil.rmtree(commit)


@contextmanager
def locked(folder: Path, *, wait: bool = True) -> Iterator[bool]:
    """Keep other runs out of a folder.

    The lock is one of the system on the folder itself: no file stands for it, and it
    ends with the process whatever happens to that.

    Args:
        folder: The folder.
        wait: Wait for other runs.

    Yields:
        Whether there is such a lock; some file systems, and Windows, know none.
    """
    held = False
    with ExitStack() as stack:
        with suppress(ImportError, OSError, ValueError):
            import fcntl

            descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
            stack.callback(os.close, descriptor)
            fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            held = True
        yield held


def listed(path: Path, folder: Path) -> str:
    """Name of a file within a folder; empty for one that lies elsewhere."""
    place, home = path.parent.resolve() / path.name, folder.resolve()
    return str(place.relative_to(home)) if place.is_relative_to(home) else ""


def same_file(first: Path, second: Path) -> bool:
    """Whether two paths lead to one file; not where one leads to none."""
    with suppress(OSError, ValueError):
        return first.samefile(second)
    return False


def sha256(data: bytes) -> str:
    """Hexadecimal SHA-256 of bytes."""
    return hashlib.sha256(data).hexdigest()


def reason_of(error: Exception) -> str:
    """Message of a system error without the error number and the file names."""
    if isinstance(error, FileExistsError | NotADirectoryError):
        return "a file stands in the place of its folder"
    return (error.strerror if isinstance(error, OSError) else None) or str(error)


@contextmanager
def _staging(home: Path, contents: Mapping[str, bytes], force: bool) -> Iterator[Path]:
    """A new folder in a folder with complete files, which goes at the end.

    So do folders that had to be made, if nothing has come into them.
    """
    with ExitStack() as stack:
        for path in (home / name for name in contents):
            with _writing(path):
                if path.is_dir():
                    raise OptionError("is a folder, not a file", file=path)
                if path.exists() and not force:
                    reason = "exists already; --force replaces it"
                    raise OptionError(reason, file=path)
                for above in reversed([p for p in path.parents if not p.exists()]):
                    above.mkdir()
                    stack.callback(_discard, above)
        with _writing(home / next(iter(contents), "")), locked(home):
            for leftover in home.glob(f"{STAGED}*"):
                with locked(leftover, wait=False) as dead:
                    if dead:
                        shutil.rmtree(leftover, ignore_errors=True)
            staged = home / f"{STAGED}{uuid4().hex}"
            for _ in range(2):  # A signal may come in the midst of the first.
                stack.callback(shutil.rmtree, staged, ignore_errors=True)
            staged.mkdir()
            stack.enter_context(locked(staged))
        for name, data in contents.items():
            with _writing(home / name):
                (staged / name).parent.mkdir(parents=True, exist_ok=True)
                with (staged / name).open("xb") as stream:
                    stream.write(data)
                    stream.flush()
                    os.fsync(stream.fileno())
        yield staged


def _discard(folder: Path) -> None:
    """Remove a folder that is empty."""
    with suppress(OSError):
        folder.rmdir()


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """Turn system errors into an `OutputError` that names the file."""
    try:
        yield
    except (OSError, ValueError) as error:
        raise OutputError(f"{path}: cannot be written: {reason_of(error)}") from error


DATA = 1 << 30
"""Bytes of the largest file of measurements, or of anything made by a program."""

TEXT = 1 << 26
"""Bytes of the largest description of a robot, whose tree takes many times as much."""


def read_bytes(path: str | Path, largest: int = DATA, first: int = -1) -> bytes:
    """Read a file.

    Args:
        path: The file; no pipe and no device.
        largest: Bytes that it may have.
        first: How many of them to read; negative for all.

    Returns:
        Its bytes.

    Raises:
        InputError: If there is no such file, or it is too large or cannot be read.

    Examples:
        >>> read_bytes("/no/such/arm.urdf")
        Traceback (most recent call last):
        calib_pin.errors.InputError: /no/such/arm.urdf: no such file
    """
    path = Path(path)
    try:
        # Before it is opened: that alone can wait for ever, or make a device act.
        about = path.stat()
        if not (stat.S_ISREG(about.st_mode) or path.is_dir()):
            raise InputError("is not a regular file", file=path)
        if about.st_size > largest:
            limit = f"{largest >> 20} MiB"
            raise InputError("is too large", file=path, allowed=limit)
        with path.open("rb") as stream:
            return stream.read(first)
    except FileNotFoundError as error:
        reason = f"no such file{_nearest_sibling(path)}"
        raise InputError(reason, file=path) from error
    except IsADirectoryError as error:
        raise InputError("is a directory, not a file", file=path) from error
    except (OSError, ValueError) as error:
        raise InputError(f"cannot be read: {reason_of(error)}", file=path) from error


def write_atomically(path: Path, data: bytes, *, force: bool) -> None:
    """Write a file so that it is either complete or untouched.

    Args:
        path: The file; missing folders above it are made.
        data: Its content.
        force: Replace an existing file.

    Raises:
        OptionError: If the file exists and `force` is false.
        OutputError: If it cannot be written.

    Examples:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_atomically(Path(folder, "a", "b.csv"), b"x,y", force=False)
        ...     read_bytes(Path(folder, "a", "b.csv"))
        b'x,y'
    """
    with write_files({path: data}, force=force):
        pass


def _nearest_sibling(path: Path) -> str:
    """A hint at a file of a similar name; or empty."""
    with suppress(OSError, ValueError):
        return nearest(path.name, (file.name for file in path.parent.iterdir()))
    return ""
