"""`calib-pin evaluate`: accuracy on measurements that were not fitted."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import calib_pin.cli.options as options
from calib_pin.cli.files import (
    open_calibration,
    open_measurements,
    require_distinct,
    require_file,
)
from calib_pin.cli.printing import notice, progress_bar, say_json, show, stage
from calib_pin.cli.request import Told
from calib_pin.errors import require_known


@dataclass(frozen=True, kw_only=True)
class Evaluate(options.OfRobot):
    """A question for the accuracy of a robot.

    Attributes:
        measurements: CSV or Parquet files.
        register: Register the frames and the instrument of a calibration on these
            measurements.
    """

    robot: options.RobotOrCalibration
    measurements: Annotated[list[Path], Told("MEASUREMENTS...")]
    chain: options.ChainName = None
    station_per_file: options.StationPerFile = False
    register: Annotated[bool, Told()] = False
    json: options.Json = False


@options.spread
def evaluate(asked: Evaluate) -> int:
    """Print the accuracy of a robot or a calibration on measurements.

    A URDF knows neither base nor tool: they are registered on these measurements, and
    the output says so. A calibration is used as it is unless --register is given. Exit
    status 2: the measurements are too few, or the calibration must not be trusted.
    """
    from functools import partial

    from calib_pin.cli.documents import evaluation_document
    from calib_pin.io.results import used_files
    from calib_pin.io.urdf import other_robots
    from calib_pin.kinematics.chains import Chains
    from calib_pin.report.accuracy import evaluated
    from calib_pin.validation.calibrated_model import CalibratedModel
    from calib_pin.validation.evaluation import evaluate as run

    stated, robot, chain = asked.stated(), asked.robot, asked.chain
    measurements = asked.measurements
    subject: Chains | CalibratedModel
    doubts: list[str] = []
    require_file(robot, ", or a robot")
    if robot.endswith(".json"):
        subject, stated = open_calibration(robot, asked.setup, stated, doubts.append)
        chains = subject.chains
        sockets = [reference.name for reference in subject.references.values()]
        if chain is not None:
            require_known("chain", chain, subject.measured_chains)
        for file in used_files(robot, measurements):
            notice(f"{file}: the calibration has used it already, to fit or to check")
    else:
        chains, sockets = asked.chains(stated, chain), []
    require_distinct(measurements)
    with progress_bar() as bar:
        measured, rows = open_measurements(
            measurements,
            chains,
            stated,
            chain=chain,
            station_per_file=asked.station_per_file,
            sockets=sockets,
            bar=bar,
        )
        if not robot.endswith(".json"):
            subject = measured
        stage(bar, "evaluate")
        others = partial(other_robots, chains, stated)
        evaluation = run(
            subject, rows, stated, registration=asked.register, others=others
        )
    if doubts:
        evaluation = replace(evaluation, verdict="untrusted", reason=doubts[0])
    if asked.json:
        say_json(evaluation_document(evaluation))
    else:
        show(evaluated(evaluation))
    return 0 if evaluation.verdict == "good" else 2
