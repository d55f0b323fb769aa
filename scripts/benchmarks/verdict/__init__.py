"""The quality of the verdict: eight criteria on jobs whose truth is known.

    scripts/benchmark verdict                        # a tenth of the jobs
    scripts/benchmark verdict --full                 # all of them
    scripts/benchmark verdict --only clean,trust     # some of the criteria
    scripts/benchmark verdict --only trust --job 417 # one job, told in full

Jobs are numbered; the number and a fixed seed make the job, so that each that fails
can be run again by itself. Processes share the jobs (`--workers`, `--cluster`).
"""

from benchmarks.verdict.running import main

__all__ = ["main"]
