"""`calib-pin evaluate`: accuracy on measurements that were not fitted."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from calib_pin.cli.asked import Evaluate
from calib_pin.cli.files import open_subject, open_tested
from calib_pin.cli.printing import notice, progress_bar, stage
from calib_pin.io.json_text import Json, format_keys, plain
from calib_pin.io.results import used_files
from calib_pin.io.urdf import other_robots
from calib_pin.report.accuracy import evaluated
from calib_pin.validation.evaluation import evaluate as run
from calib_pin.validation.evaluation import no_longer_holds
from calib_pin.validation.result import Evaluation


def evaluate(asked: Evaluate) -> int:
    """Do what `Evaluate` asks for."""
    subject = open_subject(asked)
    calibrated, setup = subject.calibration, subject.setup
    for used in used_files(subject.file, asked.measurements) if subject.file else ():
        notice(f"{used}: the calibration has used it already, to fit or to check")
    with progress_bar() as bar:
        measured, rows = open_tested(asked, asked.measurements, subject, bar)
        stage(bar, "evaluate")
        model = measured if calibrated is None else calibrated.model
        others = partial(other_robots, subject.chains, setup)
        result = run(model, rows, setup, registration=asked.register, others=others)
    if calibrated is not None:
        changed = no_longer_holds(calibrated, result)
        result = replace(result, findings=(*result.findings, *changed))
        if doubt := subject.doubt:
            result = replace(result, verdict=calibrated.verdict, reason=doubt)
    asked.show(lambda: evaluation_document(result), evaluated(result))
    return 0 if result.verdict == "good" else 2


def evaluation_document(evaluation: Evaluation) -> Json:
    """The accuracy of a robot on measurements."""
    errors = {n: {"unit": unit, **plain(size)} for n, unit, size in evaluation.errors}
    head = format_keys("calib-pin/evaluation")
    return {**head, **plain(evaluation), "errors": errors}
