"""`scripts/reproduce NAME`: hand over to the study of that name."""

from __future__ import annotations

import sys
from importlib import import_module

from calib_pin.errors import CalibPinError

STUDIES = ("aoyagi2010", "klimchik", "liu2012", "liu2022")
"""Modules with a function `main(words)` that tells whether all conditions are met."""

HELP = """usage: reproduce NAME [--full] [-o DIR] [options]

Repeats a published study, prints its figures beside the published ones, and writes
tables and pictures to a folder (default: out/NAME). Without --full it takes about a
minute. The exit status is 2 if a figure is not met. 'reproduce NAME --help' lists all
options of a study.
"""


def main() -> None:
    """Run the study that the first argument names; status 2 if a condition fails."""
    name, *words = sys.argv[1:] or [""]
    if name in ("-h", "--help"):
        print(HELP)
        for study in STUDIES:
            print(f"  {study:12}{import_module(f'studies.{study}').SOURCE}")
        return
    if name not in STUDIES:
        problem = f"unknown study '{name}'" if name else "name a study"
        sys.exit(f"reproduce: {problem}; there is {', '.join(STUDIES)}")
    try:
        met = import_module(f"studies.{name}").main(words)
    except CalibPinError as error:
        sys.exit(f"reproduce: {error}")
    if not met:
        sys.exit(2)


if __name__ == "__main__":
    main()
