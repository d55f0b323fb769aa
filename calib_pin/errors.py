"""Errors that calib-pin raises on purpose.

Every error a user can cause derives from `CalibPinError` and carries the location
(file, line, column), the offending value and the allowed ones, so that the command
line can print it as one line and a program can read the parts.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from itertools import accumulate
from pathlib import Path
from typing import Self

VALUE = 60
"""Longest value in a message, in characters."""

MESSAGE = 280
"""Longest message, in characters."""

PATH = 120
"""Longest path in a message, of which the end is shown."""

ALLOWED = 120
"""Characters that a list of what is allowed may take from a long reason."""

# Not the apostrophe of a word.
_QUOTED = re.compile(r"(?<!\w)'[^']*'(?!\w)")


def printable(text: str) -> str:
    r"""A text with control and bidirectional characters as escapes, but for line ends.

    Examples:
        >>> printable("\x1b[2J\u202egnp.exe")
        '\\x1b[2J\\u202egnp.exe'
    """
    return "".join(
        c if c.isprintable() or c == "\n" else c.encode("unicode_escape").decode()
        for c in text
    )


def one_line(message: str) -> str:
    """A message on one line, with names and values in quotes shortened."""
    line = printable(re.sub(r"[ \t\r\n]+", " ", message).strip())
    return _cut(_QUOTED.sub(lambda match: _cut(match[0], VALUE), line), MESSAGE)


def words_of(error: BaseException) -> str:
    """The message of an error of foreign code in a line, or its kind if it has none."""
    return " ".join(str(error).split()) or type(error).__name__


def enumerated(names: Iterable[str], room: int = ALLOWED) -> str:
    """Names with commas between them, and the number of those that find no room.

    Examples:
        >>> enumerated(["elbow", "wrist", "flange"], room=15)
        'elbow, wrist and 1 more'
    """
    names = [_cut(name, VALUE) for name in names]
    ends = accumulate(len(name) + 2 for name in names)
    count = max(sum(end <= room + 2 for end in ends), 1)
    more = f" and {len(names) - count} more" if count < len(names) else ""
    return ", ".join(names[:count]) + more


def counted(count: int, noun: str) -> str:
    """A number of things.

    Examples:
        >>> counted(1, "joint"), counted(2, "joint")
        ('1 joint', '2 joints')
    """
    return f"{count} {noun}{'s' * (count != 1)}"


def _cut(text: str, room: int) -> str:
    """The start of a text that is too long; a quote at its end stays."""
    if len(text) <= room:
        return text
    end = f"...{text[-1]}" if text[-1] in "'\"" else "..."
    return text[: room - len(end)] + end


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
        place = "" if self.file is None else _cut(self.file[::-1], PATH)[::-1]
        if line is not None:
            place += f":{line}" if place else f"line {line}"
        message = f"{place}: {reason}" if place else reason
        details = [f"column '{column}'"] * (column is not None)
        details += [f"value {_cut(repr(value), VALUE)}"] * (value is not None)
        if details:
            message += f" ({', '.join(details)})"
        if allowed:  # Of what has no name nothing could be listed.
            head = one_line(message)
            room = MESSAGE - len("; allowed:  and 1000 more")
            if len(head) + len(allowed) > room:
                head = _cut(head, MESSAGE - ALLOWED)
                allowed = enumerated(allowed.split(", "), room - len(head))
            message = f"{head}; allowed: {allowed}"
        super().__init__(one_line(message))

    def within(self, file: str) -> Self:
        """The same error, in a file where one is named."""
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


@contextmanager
def in_file(file: str) -> Iterator[None]:
    """Name the file of mistakes that it states and only later work can recognize."""
    try:
        yield
    except InputError as error:
        if error.file is not None:
            raise
        raise error.within(file) from None


def require_package(
    name: str, need: str, extra: str, file: str | Path | None = None
) -> None:
    """Refuse work for which a package is missing that an extra installs.

    Args:
        name: The package, as it is imported.
        need: What needs it, before the rest of the sentence.
        extra: The extra of calib-pin.
        file: The file that is worked on, if any.

    Raises:
        OptionError: If it is missing.
    """
    if find_spec(name) is None:
        remedy = f"pip install 'calib-pin[{extra}]'"
        raise OptionError(f"{need}, which is missing: {remedy}", file=file)


def nearest(name: str, candidates: Iterable[str]) -> str:
    """Phrase the nearest known name as a hint.

    Args:
        name: The name that was not found.
        candidates: The names that exist.

    Returns:
        `` (did you mean 'x'?)`` with a leading space, or an empty string when
        nothing is close.

    Examples:
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
        reason = f"unknown {what} '{name}'{nearest(str(name), names)}"
        raise OptionError(reason, allowed=", ".join(names))
