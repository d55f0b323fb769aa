"""The errors of one data set, near the fitted configurations and away from them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import calib_pin
from benchmarks.accuracy.data_sets import DataSet, Term
from calib_pin.observations import Observations
from calib_pin.progress import Stages
from calib_pin.setup import Setup
from calib_pin.validation.result import (
    Accuracy,
    CalibrationResult,
    Candidate,
    Evaluation,
    QuantityError,
)
from calib_pin.workers.base import SERIAL, Workers

PLAIN: Mapping[str, tuple[str, ...]] = {
    "placement": ("placement",),
    "compliance": ("placement", "compliance"),
}
"""Models that are not chosen: geometry alone, and the plain physics."""

CHOSEN = "chosen"
NOMINAL = "nominal"
METHODS = (NOMINAL, *PLAIN, CHOSEN)


@dataclass(frozen=True)
class Errors:
    """Errors of a data set on measurements that were not fitted.

    Attributes:
        where: `near` the fitted configurations, or `away`.
        what: The measurements.
        count: Their number.
        errors: Errors of each of `METHODS` [m].
    """

    where: str
    what: str
    count: int
    errors: Mapping[str, Accuracy]


@dataclass(frozen=True)
class Measured:
    """What was found for a data set.

    Attributes:
        data_set: The data set.
        fitted: Number of fitted measurements.
        model: Name of the model that chose itself.
        verdict: Verdict of its calibration, with the reason.
        lines: Errors near, then those away.
        predicted: What the calibration says of the errors away; None where there are
            too few measurements to say it.
    """

    data_set: DataSet
    fitted: int
    model: str
    verdict: str
    lines: tuple[Errors, ...]
    predicted: QuantityError | None

    def predicted_beside(self, line: Errors) -> QuantityError | None:
        """What is predicted away, for lines away or, where there are none, near."""
        away = any(each.where == "away" for each in self.lines)
        return self.predicted if line.where == "away" or not away else None


def measure(
    data_set: DataSet,
    data: Path,
    seed: int = 0,
    progress: Stages | None = None,
    workers: Workers = SERIAL,
) -> Measured:
    """Calibrate with every model, and look at what was not fitted.

    Args:
        data_set: The data set.
        data: Folder of its measurement files.
        seed: Seed of the calibrations.
        progress: Told the stage and the part of it that is done.
        workers: Who fits folds and candidates.

    Raises:
        InputError: If a file is not one of measurements.
    """
    chain, model = data_set.chain(), data_set.model

    def read(part: Term) -> Observations:
        return part.read(data, chain, model)

    fitted = read(data_set.fitted)
    setup = data_set.setup(fitted)
    near = None if data_set.near is None else read(data_set.near)
    found: dict[str, CalibrationResult] = {}
    for name, kinds in PLAIN.items():
        if progress is not None:
            progress(name, 0.0)
        plain = replace(setup, parameters=kinds)
        found[name] = calib_pin.calibrate(
            chain, fitted, plain, validation=near, seed=seed, workers=workers
        )
    found[CHOSEN] = chosen = calib_pin.calibrate(
        *(chain, fitted, setup),
        validation=near,
        ladder=True,
        use="both",
        seed=seed,
        progress=progress,
        workers=workers,
    )
    lines = [_held_out(data_set, found, seed)]
    for part in data_set.away:
        if part.there(data):
            lines.append(_away(chain, fitted, setup, part, read(part), found, seed))
    candidate = _candidate(chosen)
    away = () if candidate.away is None else candidate.away.errors
    return Measured(
        data_set,
        len(fitted),
        " + ".join((*candidate.parameters, *filter(None, [candidate.learned]))),
        ": ".join(filter(None, (chosen.verdict, chosen.reason))),
        tuple(lines),
        next((each for each in away if each.name == "position"), None),
    )


def _candidate(result: CalibrationResult) -> Candidate:
    """The model that chose itself."""
    selection = result.model_selection
    assert selection is not None
    return selection.candidates[selection.chosen]


def _held_out(
    data_set: DataSet, found: Mapping[str, CalibrationResult], seed: int
) -> Errors:
    """Errors on the published validation file, or by cross-validation."""
    errors: dict[str, Accuracy] = {}
    for name, result in found.items():
        (position,) = (e for e in result.errors if e.name == "position")
        before, after = position.validation_before, position.validation_after
        assert before is not None and after is not None
        errors.setdefault(NOMINAL, before)
        errors[name] = after
    checked = found[CHOSEN].validation
    what = checked.method if data_set.near is None else data_set.near.name
    where = "away" if data_set.by_place else "near"
    return Errors(where, what, checked.count, errors)


def _away(
    chain: calib_pin.Chain,
    fitted: Observations,
    setup: Setup,
    part: Term,
    rows: Observations,
    found: Mapping[str, CalibrationResult],
    seed: int,
) -> Errors:
    """Errors on other motions, places or days."""
    if part.registered:
        errors = {NOMINAL: _position(calib_pin.evaluate(chain, rows, setup))}
    else:
        # Frames and tool of the nominal robot are those of the fitted measurements.
        same = calib_pin.calibrate(chain, fitted, setup, validation=rows, seed=seed)
        (position,) = (e for e in same.errors if e.name == "position")
        assert position.validation_before is not None
        errors = {NOMINAL: position.validation_before}
    for name, result in found.items():
        errors[name] = _position(
            calib_pin.evaluate(result.model, rows, registration=part.registered)
        )
    return Errors("away", part.name, len(rows), errors)


def _position(evaluation: Evaluation) -> Accuracy:
    return next(found for name, _, found in evaluation.errors if name == "position")
