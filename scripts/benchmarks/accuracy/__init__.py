"""The accuracy on public measurements: every data set in one table.

    scripts/benchmark accuracy --data DIR                  # all that DIR holds
    scripts/benchmark accuracy --data DIR --only TALOS     # some of them
    scripts/benchmark accuracy --data DIR -o accuracy.json --figure accuracy.svg

DIR holds the repositories of the data sets as `git clone` leaves them, or measurement
files that were converted before (`--convert FOLDER` keeps them).
"""

from benchmarks.accuracy.running import main

__all__ = ["main"]
