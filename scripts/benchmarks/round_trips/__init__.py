"""Robots at random, there and back: calibrated, exported, read back, compensated.

A robot of the module `robots` is measured, and the commands are run on its files:
`init`, `calibrate`, `export` to each format that applies, `compensate` with targets and
with a motion, to tables and to messages. Files are read by others: yourdfpy, MuJoCo,
xacro, a page of arithmetic. Commands are replayed on the true robot, in the columns of
its controller.

A step is right where the tip is as the corrected robot has it (commands: where the
target is, within three times the error that the calibration promises); told where a
sentence says what is missing, or a verdict is not trusted; refused where one line
refuses it; silent where it is none of these; internal where the program fails.

    scripts/benchmark round-trips [--count 200] [--first 0] [--workers 2] [--only NAMES]
        [--keep DIR] [--show]
"""

from benchmarks.round_trips.running import main

__all__ = ["main"]
