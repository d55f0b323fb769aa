"""The quality of findings: defects named rightly and repaired, clean jobs left alone.

    scripts/benchmark findings                              # a tenth of the jobs
    scripts/benchmark findings --full                       # all of them
    scripts/benchmark findings --only moved,clean           # some of the criteria
    scripts/benchmark findings --only moved --count 30      # the first jobs
    scripts/benchmark findings --only moved --job 4         # one job, told in full

Each defect is a criterion, and so are `clean` and `time`. Jobs take turns among the
measurement models and the three sizes of a defect; the number makes the job.
"""

from benchmarks.findings.running import main

__all__ = ["main"]
