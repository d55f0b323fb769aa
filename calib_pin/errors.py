"""Errors that calib-pin raises on purpose.

Every error a user can cause derives from `CalibPinError` and carries the location
(file, line, column), the offending value and the allowed ones, so that the command
line can print it as one line and a program can read the parts.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from pathlib import Path
from typing import Self


class CalibPinError(Exception):
    """Base of every error that calib-pin raises on purpose."""


class InputError(CalibPinError):
    """A value in an input file, or given by a caller, cannot be used.

    Attributes:
        reason: The fault, without its location.
        file: File in which it stands, if any.
        line: Line number, counted from 1, if known.
        column: Name of the column or key, if known.
        value: The offending value as it was written, if there is one.
        allowed: The values allowed instead, if they can be listed.
    """

    def __init__(
        self,
        reason: str,
        *,
        file: str | Path | None = None,
        line: int | None = None,
        column: str | None = None,
        value: object = None,
        allowed: str | None = None,
    ) -> None:
        """Compose the one-line message from its parts."""
        self.reason = reason
        self.file = None if file is None else str(file)
        self.line = line
        self.column = column
        self.value = value
        self.allowed = allowed
        place = "" if self.file is None else self.file
        if line is not None:
            place += f":{line}" if place else f"line {line}"
        message = f"{place}: {reason}" if place else reason
        details = []
        if column is not None:
            details.append(f"column '{column}'")
        if value is not None:
            details.append(f"value {value!r}")
        if details:
            message += f" ({', '.join(details)})"
        if allowed is not None:
            message += f"; allowed: {allowed}"
        super().__init__(" ".join(message.split()))

    def within(self, file: str) -> Self:
        """The same error, in a file where one is named.

        For mistakes that a file states and only later work can recognize.
        """
        return type(self)(
            self.reason,
            file=file or None,
            column=self.column,
            value=self.value,
            allowed=self.allowed,
        )


class RobotError(InputError):
    """The URDF cannot be read, or the chain asked for is not in it."""


class OptionError(InputError):
    """An option or argument has a value that is not allowed."""


class OutputError(CalibPinError):
    """A result cannot be written, or does not read back as it should."""


def nearest(name: str, candidates: Iterable[str]) -> str:
    """Phrase the nearest known name as a hint.

    Args:
        name: The name that was not found.
        candidates: The names that exist.

    Returns:
        `` (did you mean 'x'?)`` with a leading space, or an empty string when
        nothing is close.

    Example:
        >>> nearest("elbow_jiont", ["elbow_joint", "wrist_joint"])
        " (did you mean 'elbow_joint'?)"
    """
    match = difflib.get_close_matches(name, list(candidates), n=1, cutoff=0.6)
    return f" (did you mean '{match[0]}'?)" if match else ""


def require_known(what: str, name: object, known: Iterable[str]) -> None:
    """Refuse a name that does not exist.

    Args:
        what: The kind of name, such as `solver`.
        name: The name.
        known: The names that exist.

    Raises:
        OptionError: With the nearest name and all that exist.
    """
    names = list(known)
    if name not in names:
        raise OptionError(
            f"unknown {what} '{name}'{nearest(str(name), names)}",
            allowed=", ".join(names),
        )
