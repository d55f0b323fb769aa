"""`calib-pin identify`: the identifiability of a robot's parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import calib_pin.cli.options as options
from calib_pin.cli.files import (
    open_measurements,
    require_distinct,
    stated_blocks,
    tell_limits,
)
from calib_pin.cli.printing import progress_bar, say_json, show
from calib_pin.cli.request import SEED, Told

if TYPE_CHECKING:
    from calib_pin.observations import BlockKey


@dataclass(frozen=True, kw_only=True)
class Identify(options.OfRobot):
    """A question for the parameters of a robot.

    Attributes:
        measurements: CSV or Parquet files; without them identifiability is structural.
        seed: Random seed.
    """

    measurements: Annotated[list[Path] | None, Told("[MEASUREMENTS...]")] = None
    parameters: options.Parameters = None
    station_per_file: options.StationPerFile = False
    seed: Annotated[int, Told("N", parse=SEED)] = 0
    details: options.Details = False
    json: options.Json = False


@options.spread
def identify(asked: Identify) -> int:
    """Print which parameters are identifiable, and which only in combinations.

    Without measurements: structural identifiability, from the robot and the measurement
    model alone. With measurements: practical identifiability. No file is written.
    """
    from functools import partial

    from calib_pin.calibration import calibrate as run
    from calib_pin.cli.documents import identification_document
    from calib_pin.estimation.evidence import TRUSTED
    from calib_pin.io.urdf import other_robots
    from calib_pin.planning.suggestions import calibrated_setup, suggestions
    from calib_pin.report.identification import identified
    from calib_pin.report.trust import below, findings, judged
    from calib_pin.validation.assessment import identify as structural
    from calib_pin.validation.result import Identification

    stated, measurements = asked.stated(), asked.measurements
    found: Identification
    keys: Sequence[BlockKey]
    if measurements:
        require_distinct(measurements)
        # What is learned has no parameters that could be known.
        stated = replace(stated, learned=None)
        with progress_bar() as bar:
            chains, rows = open_measurements(
                measurements,
                asked.chains(stated),
                stated,
                station_per_file=asked.station_per_file,
                bar=bar,
            )
            result = run(
                chains,
                rows,
                stated,
                validate=False,
                seed=asked.seed,
                progress=bar,
                others=partial(other_robots, chains, stated),
            )
        stated, keys = calibrated_setup(result.model), rows.keys
        found, verdict, reason = result, result.verdict, result.reason
        faults = result.findings
    else:
        keys = stated_blocks(stated)
        chains = asked.chains(stated, keys)
        found = structural(chains, keys, stated, seed=asked.seed)
        verdict, reason, faults = "good", "", ()
    tell_limits(chains)
    better = suggestions(chains, keys, stated, found, seed=asked.seed)
    if asked.json:
        say_json(identification_document(found, better, verdict, reason, faults))
    else:
        said = judged(below(reason, faults), verdict)
        doubts = [] if verdict in TRUSTED else [said]
        told = identified(
            found, fitted=bool(measurements), suggestions=better, details=asked.details
        )
        show([*doubts, *findings(faults, reason), *told])
    return 0 if verdict in TRUSTED else 2
