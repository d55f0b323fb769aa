"""`calib-pin compare`: the difference between two calibrations of a robot."""

from __future__ import annotations

from calib_pin.cli import files
from calib_pin.cli.asked import Compare
from calib_pin.cli.printing import show
from calib_pin.estimation.evidence import TRUSTED
from calib_pin.io.results import document_file, read_result
from calib_pin.report.comparison import comparison_report
from calib_pin.validation.comparison import compare as run
from calib_pin.validation.comparison import faults


def compare(asked: Compare) -> int:
    """Do what `Compare` asks for."""
    both = document_file(asked.first), document_file(asked.second)
    files.require_distinct(both)
    A, B = map(read_result, both)
    comparison = run(A, B, seed=asked.seed)
    show(comparison_report(comparison))
    trusted = {A.verdict, B.verdict} <= set(TRUSTED)
    different = any(fault.severity == "error" for fault in faults(comparison))
    return 0 if trusted and not different else 2
