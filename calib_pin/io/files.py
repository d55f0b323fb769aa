"""Read and write whole files, with errors that name the file and the reason."""

from __future__ import annotations

import difflib
import errno
import json
import os
import shutil
import stat
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from calib_pin.errors import InputError, OptionError, OutputError
from calib_pin.io.journal import (
    JOURNAL,
    complete,
    discard,
    listed,
    locked,
    settle,
    sha256,
    signals_deferred,
    sync,
    temporary,
)


@contextmanager
def write_files(contents: Mapping[Path, bytes], *, force: bool) -> Iterator[None]:
    """Write all files if the block succeeds, and none of them otherwise.

    Args:
        contents: Content by file; missing folders are made.
        force: Replace existing files.

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
    with _staged(contents, force):
        yield
        with signals_deferred():
            _put_in_place(list(contents))


@contextmanager
def write_folder(
    folder: Path,
    contents: Mapping[Path, bytes],
    removed: Iterable[Path] = (),
    *,
    force: bool,
    notice: Callable[[str], None],
) -> Iterator[None]:
    """As `write_files`, for a folder, and safe if the process is killed meanwhile.

    Args:
        folder: The folder; a journal in it completes the set after a crash.
        contents: As for `write_files`; some may lie outside the folder.
        removed: Files of the folder to remove.
        force: Replace existing files.
        notice: Called with one sentence for each file that could not be replaced yet.

    Raises:
        OptionError: If one exists and `force` is false.
        OutputError: If one cannot be written.
    """
    journal = folder / JOURNAL
    decided = {
        "files": {
            listed(path, folder): sha256(data) for path, data in contents.items()
        },
        "remove": [listed(path, folder) for path in removed],
    }
    staged = {**contents, journal: json.dumps(decided).encode()}
    with _staged(staged, force) as pending:
        yield
        with signals_deferred():
            with _writing(journal):
                temporary(journal).replace(journal)
            # The commit point: whatever fails from here on, the new set stands.
            pending.clear()
            with suppress(OSError):
                sync(folder)
            for path, source in complete(folder).items():
                notice(f"{path} cannot be replaced; what it shall hold is in {source}")


def reason_of(error: Exception) -> str:
    """Message of a system error without the error number and the file names."""
    if isinstance(error, FileExistsError):
        return "a file stands in the place of its folder"
    return (error.strerror if isinstance(error, OSError) else None) or str(error)


@contextmanager
def _staged(contents: Mapping[Path, bytes], force: bool) -> Iterator[set[Path]]:
    """Write complete files beside their destinations, and lock their folders.

    Yields:
        The destinations; the staged files of those still among them at the end are
        discarded.
    """
    pending, made = set[Path](), list[Path]()
    with ExitStack() as locks:
        try:
            folders = set()
            for path in contents:
                with _writing(path):
                    made += _make(path)
                    folders.add(path.parent.resolve())
            for folder in sorted(folders):  # One order for all runs: no deadlock.
                settle(folder, locks.enter_context(locked(folder)))
            for path, data in contents.items():
                with _writing(path):
                    if path.exists() and not force and path.name != JOURNAL:
                        reason = "exists already; --force replaces it"
                        raise OptionError(reason, file=path)
                    pending.add(path)
                    _write(temporary(path), data)
            for folder in folders:
                with _writing(folder):
                    sync(folder)
            yield pending
        finally:
            with signals_deferred():
                for path in pending:
                    discard(temporary(path))
                for folder in reversed(made):
                    with suppress(OSError):
                        folder.rmdir()


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """Turn system errors into an `OutputError` that names the file."""
    try:
        yield
    except (OSError, ValueError) as error:
        raise OutputError(f"{path}: cannot be written: {reason_of(error)}") from error


def _make(path: Path) -> list[Path]:
    """Make the folders above a file; returns the new ones, outermost first."""
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, "it is a directory")
    missing = [folder for folder in path.parents if not folder.exists()]
    path.parent.mkdir(parents=True, exist_ok=True)
    return missing[::-1]


def _write(path: Path, data: bytes) -> None:
    path.unlink(missing_ok=True)
    # Not tempfile: its files are private (0600), and the mode survives a rename.
    with path.open("xb") as stream:
        stream.write(data)
        stream.flush()
        os.fsync(stream.fileno())


def _put_in_place(paths: Sequence[Path]) -> None:
    """Rename all staged files; undo everything if one cannot be renamed.

    Raises:
        OutputError: If one cannot be renamed.
    """
    done: list[tuple[Path, Path | None]] = []
    try:
        for path in paths:
            with _writing(path):
                before = _kept(path) if len(paths) > 1 else None
                temporary(path).replace(path)
            done.append((path, before))
    except OutputError:
        for path, before in reversed(done):
            with suppress(OSError):
                path.unlink() if before is None else before.replace(path)
        raise
    finally:
        for path in paths:
            discard(temporary(path, "old"))


def _kept(path: Path) -> Path | None:
    """A second link to the existing file, to restore it; None if there is none."""
    if not (path.exists() or path.is_symlink()):
        return None
    second = temporary(path, "old")
    second.unlink(missing_ok=True)
    try:
        second.hardlink_to(path)
    except OSError:  # Some file systems have no hard links.
        shutil.copy2(path, second, follow_symlinks=False)
    return second


DATA = 1 << 30
"""Bytes of the largest file of measurements, or of anything made by a program."""

BLOCK = 1 << 20
"""Bytes that are read at a time."""

TEXT = 1 << 26
"""Bytes of the largest description of a robot, whose tree takes many times as much."""


def read_bytes(path: str | Path, largest: int = DATA) -> bytes:
    """Read a file.

    Args:
        path: The file; no pipe and no device.
        largest: Bytes that it may have.

    Returns:
        Its bytes.

    Raises:
        InputError: If there is no such file, or it is too large or cannot be read.

    Examples:
        >>> read_bytes("/no/such/arm.urdf")
        Traceback (most recent call last):
        calib_pin.errors.InputError: /no/such/arm.urdf: no such file
    """
    return b"".join(read_blocks(path, BLOCK, largest))


def read_blocks(path: str | Path, size: int, largest: int = DATA) -> Iterator[bytes]:
    """Read a file block by block, so that it need not fit into memory.

    Args:
        path: The file; no pipe and no device.
        size: Bytes of a block.
        largest: Bytes that the file may have.

    Raises:
        InputError: If there is no such file, or it is too large or cannot be read.
    """
    path, read = Path(path), 0
    try:
        # Before it is opened: that alone can wait for ever, or make a device act.
        about = path.stat()
        mode, known = about.st_mode, about.st_size
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
            raise InputError("is not a regular file", file=path)
        with path.open("rb") as stream:
            while block := stream.read(size):
                read += len(block)
                if max(read, known) > largest:
                    limit = f"{largest >> 20} MiB"
                    raise InputError("is too large", file=path, allowed=limit)
                yield block
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
    """A hint at a file of a similar name, compared without the endings; or empty."""
    try:
        stems = {file.stem: file.name for file in path.parent.iterdir()}
    except (OSError, ValueError):
        return ""
    match = difflib.get_close_matches(path.stem, stems, n=1, cutoff=0.6)
    return f" (did you mean '{stems[match[0]]}'?)" if match else ""
