"""The reference of the commands, from what they print with `--help`."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator

from calib_pin.cli import main
from calib_pin.cli.asked import COMMANDS

INTRODUCTION = """\
# Commands

ROBOT is a URDF, a xacro file with its arguments, MuJoCo's MJCF, the name of a bundled
robot, or `example:<name>` ([robots](robots.md)). MEASUREMENTS are CSV or Parquet files
([measurement files](measurements.md)). Options win over the [setup file](../setup.md).

| exit status | |
|---|---|
| 0 | good |
| 1 | the input or an option is wrong: one line says where, and nothing is written |
| 2 | it ran, but the result must not be trusted or could not be checked |
| 130, 143 | ended by Ctrl-C, by SIGTERM |

Results go to standard output, remarks and progress to standard error. `NO_COLOR` is
respected, and what is piped is plain text of 80 columns. `--json` prints the same
numbers in SI units; other commands have them in the files that they write.
`eval "$(_CALIB_PIN_COMPLETE=bash_source calib-pin)"` in `~/.bashrc` completes commands
and options (`zsh_source` and `fish_source` as well). This page is made by
`scripts/document` from the commands.
"""


def text() -> str:
    """The text of docs/reference/commands.md."""
    return "\n".join([INTRODUCTION, *_sections()])


def _sections() -> Iterator[str]:
    for name in COMMANDS:
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            main([name, "--help"])
        lines = [line.rstrip() for line in printed.getvalue().strip().splitlines()]
        session = "\n".join(lines)
        yield (
            f"## {name}\n\n{lines[2].strip()}\n\n"
            f"```console\n$ calib-pin {name} --help\n{session}\n```\n"
        )
