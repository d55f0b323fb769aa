"""Sets of files that appear together or not at all.

Every file is written, complete, beside its destination before one of them is put in
place. If one of them cannot be put in place, those before it are taken back; a folder
of results has a list instead, see `io.journal`, and so withstands a kill as well.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from calib_pin.errors import OptionError, OutputError
from calib_pin.io.interruptions import locked, signals_deferred
from calib_pin.io.journal import (
    JOURNAL,
    complete,
    discard,
    listed,
    settle,
    sha256,
    sync,
    temporary,
)


@contextmanager
def write_files(contents: Mapping[Path, bytes], *, force: bool) -> Iterator[None]:
    """Put files in place when the block ends well, and none of them otherwise.

    Args:
        contents: What each of them shall contain; folders that are missing are made.
        force: Replace those that exist.

    Raises:
        OptionError: If one exists and `force` is false.
        OutputError: If one cannot be written.

    Example:
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
    """The same for the files of one folder, whatever kills the process meanwhile.

    Args:
        folder: The folder.
        contents: As for `write_files`; some may lie outside the folder.
        removed: Files of the folder that go.
        force: Replace those that exist.
        notice: Told what could not be put in place yet.

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
            # This was the decision: whatever fails from here on, the new set stands.
            pending.clear()
            with suppress(OSError):
                sync(folder)
            for path, source in complete(folder).items():
                notice(f"{path} cannot be replaced; what it shall hold is in {source}")


def reason_of(error: Exception) -> str:
    """The system's words without the error number and the file names."""
    if isinstance(error, FileExistsError):
        return "a file stands in the place of its folder"
    return (error.strerror if isinstance(error, OSError) else None) or str(error)


@contextmanager
def _staged(contents: Mapping[Path, bytes], force: bool) -> Iterator[set[Path]]:
    """Files complete beside their destinations, in folders that no other run writes to.

    Yields:
        These files; those that are still among them at the end are discarded.
    """
    pending, made = set[Path](), list[Path]()
    with ExitStack() as locks:
        try:
            folders = set()
            for path in contents:
                with _writing(path):
                    made += _make(path)
                    folders.add(path.parent.resolve())
            for folder in sorted(folders):  # Two runs wait in the same order.
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
    """Name the file that cannot be written."""
    try:
        yield
    except (OSError, ValueError) as error:
        raise OutputError(f"{path}: cannot be written: {reason_of(error)}") from error


def _make(path: Path) -> list[Path]:
    """Make the folders above a file; those that were missing, outermost first."""
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
    """Rename, and take everything back where one cannot be renamed.

    Raises:
        OutputError: If one cannot be.
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
    """A second name for what is in the place of a file; None where nothing is."""
    if not (path.exists() or path.is_symlink()):
        return None
    second = temporary(path, "old")
    second.unlink(missing_ok=True)
    try:
        second.hardlink_to(path)
    except OSError:  # Some file systems have no such names.
        shutil.copy2(path, second, follow_symlinks=False)
    return second
