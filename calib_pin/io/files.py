"""Whole files in and out, with errors that name the file and the reason."""

from __future__ import annotations

import difflib
from collections.abc import Iterator
from pathlib import Path

from calib_pin.errors import InputError
from calib_pin.io.staging import reason_of, write_files


def read_bytes(path: str | Path) -> bytes:
    """Read a file.

    Args:
        path: The file.

    Returns:
        Its bytes.

    Raises:
        InputError: If there is no such file, or it cannot be read.

    Example:
        >>> read_bytes("/no/such/arm.urdf")
        Traceback (most recent call last):
        calib_pin.errors.InputError: /no/such/arm.urdf: no such file
    """
    # Joining one block copies nothing.
    return b"".join(read_blocks(path, -1))


def read_blocks(path: str | Path, size: int) -> Iterator[bytes]:
    """Read a file block by block, so that it need not fit into memory.

    Args:
        path: The file.
        size: Bytes of a block; -1 for all of them.

    Raises:
        InputError: If there is no such file, or it cannot be read.
    """
    path = Path(path)
    try:
        with path.open("rb") as stream:
            while block := stream.read(size):
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
        path: The file; folders that are missing above it are made.
        data: What it shall contain.
        force: Replace an existing file.

    Raises:
        OptionError: If the file exists and `force` is false.
        OutputError: If it cannot be written.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_atomically(Path(folder, "a", "b.csv"), b"x,y", force=False)
        ...     read_bytes(Path(folder, "a", "b.csv"))
        b'x,y'
    """
    with write_files({path: data}, force=force):
        pass


def _nearest_sibling(path: Path) -> str:
    """A hint at a file of a similar name; the same ending alone is no similarity."""
    try:
        stems = {file.stem: file.name for file in path.parent.iterdir()}
    except (OSError, ValueError):
        return ""
    match = difflib.get_close_matches(path.stem, stems, n=1, cutoff=0.6)
    return f" (did you mean '{stems[match[0]]}'?)" if match else ""
