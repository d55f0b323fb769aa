"""A guard for speed: every ratio of the races beside the one that was recorded.

A ratio is the processor time of a path of the product by that of its reference. They
alternate and the shortest of each counts, so that a busy machine slows down both or
neither. A path of more than FACTOR times its recorded ratio is measured once more, and
then fails.

    scripts/benchmark guard             # exit status 1 names the paths that are slow
    scripts/benchmark guard --record    # prints RECORDED anew
"""

from __future__ import annotations

import sys
import warnings

from benchmarks.races import RACES, Race
from benchmarks.timing import processor_time

RECORD = "--record"
"""Option that prints the ratios as they are."""

FACTOR = 2.0
"""How much slower than recorded a path may be.

On the machine where they were recorded, idle or with five times as many processes as
cores, ratios stayed between 0.8 and 1.25 times what they were; the rest is for other
processors, whose caches and vector instructions serve one side more than the other.
What the guard is for costs more: a loop over members or measurements in Python takes 5
to 100 times as long.
"""

ROUNDS = 3
"""Rounds of path and reference."""

RECORDED = {
    "calibrate --solver de, position": 0.019,
    "calibrate --solver de, pose": 0.039,
    "calibrate --solver de, plane distance": 0.021,
    "calibrate --solver de, known distance": 0.024,
    "calibrate --solver de, transmission": 0.075,
    # With ripples of motors and sides of joints sought in what a fit leaves.
    "calibrate": 0.25,
    "calibrate --solver two-step": 0.55,
    "calibrate, five folds": 1.8,
    "calibrate, 100 000 measurements": 38,
    "calibrate --learned gaussian-process": 16,
    "calibrate --learned network": 11,
    "Jacobian": 0.027,
    "identify": 7.6,
    # With the faults of the data, which are sought beside the accuracy.
    "evaluate": 17,
    "simulate": 8.9,
    "plan": 1.1,
    "compensate": 27,
    "reading": 0.76,
    # With the picture of the robot in three dimensions.
    "page": 12,
    "--help": 0.56,
}
"""Ratios of the path to its reference: two cores of an AMD EPYC with AVX-512, one BLAS
thread, Python 3.11, numpy 2."""


def main() -> None:
    """Print the ratios; exit with 1 where one is too large."""
    record, slow = RECORD in sys.argv, []
    # scikit-learn warns of what it makes of rows that are made up.
    warnings.simplefilter("ignore")
    for name, make in RACES.items():
        race = make()
        found = _ratio(race)
        if record:
            print(f'    "{name}": {found:.2g},', flush=True)
            continue
        most = FACTOR * RECORDED[name]
        if found > most:
            found = min(found, _ratio(race))
        times = found / RECORDED[name]
        print(f"{name:<40}{found:10.3g}{times:8.2f} x recorded", flush=True)
        if found > most:
            slow.append(f"'{name}' takes {times:.1f} times as long as recorded")
    if slow:
        sys.exit(f"guard: {'; '.join(slow)} ({FACTOR:g} times are allowed)")


def _ratio(race: Race) -> float:
    """Time of the path by that of the reference, the shortest of each."""
    race.path()  # Loads and compiles.
    jobs = race.reference, race.path
    times = [tuple(map(processor_time, jobs)) for _ in range(ROUNDS)]
    reference, path = map(min, zip(*times, strict=True))
    return path / reference / race.share
