"""`calib-pin compare`: the difference between two calibrations of a robot."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from calib_pin.cli import files, options, results
from calib_pin.cli.options import SEED, Told


@dataclass(frozen=True, kw_only=True)
class Compare(options.Answer, options.Pictured):
    """A question for the difference of two calibrations.

    Attributes:
        first: A calibration of a robot.
        second: A later one, or another model of the robot.
        seed: Random seed of the configurations that are compared.
    """

    first: Annotated[Path, Told("A.json", "")]
    second: Annotated[Path, Told("B.json", "")]
    seed: Annotated[int, Told("N", "Workspace", SEED)] = 0


@options.spread
def compare(asked: Compare) -> int:
    """Print the difference between two calibrations, beyond their uncertainty.

    Tool points are compared in the base link. Where base and tool were estimated, a
    displacement of them is removed by a fit: a tracker at another station is no drift
    of the robot, nor is another tool. Parameters and combinations are listed where they
    differ by more than three standard deviations. Exit status 2: one of the
    calibrations must not be trusted, or they are of different robots.
    """
    from calib_pin.cli.documents import comparison_document
    from calib_pin.estimation.evidence import TRUSTED
    from calib_pin.io.results import read_result
    from calib_pin.report.comparison import comparison_report
    from calib_pin.validation.comparison import compare as run
    from calib_pin.validation.comparison import faults

    both = (asked.first, asked.second)
    for file in both:
        files.require_file(file)
    files.require_distinct(both)
    pictures = results.figure_files(asked.figures, asked.figure_format, "comparison")
    files.check_outputs(pictures, both, asked.force)
    A, B = map(read_result, both)
    found = run(A, B, seed=asked.seed)
    drawn = results.draw("comparison", found.drift, None) if pictures else []
    contents = results.figure_contents(drawn, pictures)
    asked.give(
        contents,
        lambda: comparison_document(found),
        comparison_report(found),
        results.told_figures(contents, pictures),
    )
    trusted = {A.verdict, B.verdict} <= set(TRUSTED)
    different = any(fault.severity == "error" for fault in faults(found))
    return 0 if trusted and not different else 2
