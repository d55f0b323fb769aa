"""Whole days in the field: a robot, an instrument, and a mishap that nobody noticed.

    scripts/benchmark field                                   # two jobs a mishap
    scripts/benchmark field --count 300 --seed 7              # fresh jobs
    scripts/benchmark field --only remounted,camera           # mishaps, instruments
    scripts/benchmark field --only remounted --job 4 --tell   # one job, told in full
    scripts/benchmark field --away --count 200                # promises away

Each job is calibrated twice, with its mishap and without: the clean twin. What counts
is the tool point over the workspace beside the truth. Trust is false where a robot may
be used whose tool point is half as far off again as that of the twin, and neither is a
cause named nor does the sentence tell the size. `--away` measures clean jobs in one
region, and compares what is promised elsewhere with what is true there.
"""

from benchmarks.field.running import main

__all__ = ["main"]
