"""`scripts/fuzz --minutes N [--seed S] [--cases N] [--jobs J]`: see the script."""

from __future__ import annotations

import argparse
import io
import os
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import redirect_stdout
from itertools import count

from tests.fuzz.cases import Case, Outcome, fault, make_case, outcomes
from tests.fuzz.corpus import written


def main() -> int:
    """Run cases and tell those that fail."""
    parser = argparse.ArgumentParser(prog="fuzz", description=__doc__)
    parser.add_argument("--minutes", type=float, help="end after this time")
    parser.add_argument("--cases", type=int, help="end after so many cases")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    options = parser.parse_args()
    if options.minutes is None and options.cases is None:
        parser.error("--minutes or --cases is needed")
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        with redirect_stdout(io.StringIO()):
            corpus = written()
        status = run(options, corpus)
        os.chdir("/")
    return status


def run(options: argparse.Namespace, corpus: Mapping[str, bytes]) -> int:
    """The cases that the options ask for."""
    end = time.monotonic() + 60.0 * (options.minutes or 1e9)

    def cases() -> Iterator[Case]:
        for number in count(options.first):
            if number - options.first == options.cases or time.monotonic() > end:
                return
            yield make_case(options.seed, number, corpus)

    faults, statuses = Counter[str](), Counter[int | None]()
    slowest, largest = 0.0, 0
    for case, outcome in outcomes(cases(), options.jobs):
        statuses[outcome.status] += 1
        slowest = max(slowest, outcome.seconds)
        largest = max(largest, outcome.memory)
        if what := fault(case, outcome):
            faults[what] += 1
            tell(case, outcome, what)
    print(
        f"{statuses.total()} cases, {faults.total()} failures {dict(faults)}, "
        f"status {dict(statuses)}, longest {slowest:.1f} s, "
        f"most memory {largest / 2**30:.2f} GB"
    )
    return int(bool(faults))


def tell(case: Case, outcome: Outcome, what: str) -> None:
    """Print a case that failed."""
    print(f"{case.name}: {what}: {case.words} ({case.file}: {case.how})")
    for line in outcome.err.splitlines()[:5]:
        print(f"  {line[:400]}")
    if outcome.changed:
        print(f"  changed: {', '.join(outcome.changed)}")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
