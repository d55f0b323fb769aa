"""Errors that grow in the course of the measurements: a drift of instrument or robot.

The further columns are those of a displacement in proportion to the place in the files.
What no parameter describes is smooth along a path, and so is a drift; it must explain
more than other curves of about the same smoothness do, cosines of two half waves and
more over the files.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial

import numpy as np

from calib_pin.estimation.evidence import Finding, Severity
from calib_pin.estimation.identifiability import column_space
from calib_pin.estimation.problem import EXACT, error_table
from calib_pin.estimation.statistics.distributions import f_tail
from calib_pin.estimation.terms import FRAME
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import declared
from calib_pin.parameterizations.base import expected_size
from calib_pin.parameterizations.drift import InstrumentDrift
from calib_pin.setup import AXES
from calib_pin.units import DISPLAY
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.quick_fit import Score
from calib_pin.validation.findings.setup_lines import written

CHANCE = 1e-5
"""Probability by chance below which a drift is looked at closely."""

LEFT = 0.85
"""Part of the errors that it leaves at most.

What bends in real robots leaves 0.88 and more, drifts that cost twice the noise less
than 0.8.
"""

AMONG = 3e-3
"""Probability that a smooth curve explains so much more than others do."""

WAVES = range(2, 10)
"""Half waves of the curves that it is compared with."""

SIMPLER = 30.0
"""Gain of a drift of more parts on a simpler one, in terms of likelihood."""

LEAST = 2.0
"""Least displacement that is told, by the noise."""

LARGE = 0.3
"""Errors that it causes, in expected sizes, from which it takes the trust."""

SURE = 0.6
"""Part of the errors that it leaves at most then."""

NORMAL = 1.96
"""Half of the 95 % interval, in standard deviations."""

PARTS = (
    "measure the job in parts, each with an entry of its own in a column 'station', or "
    "when everything is warm"
)


def drift(case: Case) -> Iterator[Finding]:
    """A drift of the instrument or of the joints, whichever explains more."""
    if not (case.informed and case.fit.rms > EXACT):
        return
    found = []
    for k, (tell, columns) in enumerate(_drifts(case)):
        score = _stands_out(case, columns)
        if score is None:
            continue
        errors = _errors(case, columns)
        if errors["rms_after"] > LEFT * errors["rms_before"]:
            continue
        cost = case.fit.left * np.log(max(score.left, 1e-300)) + k * SIMPLER
        found.append((cost, tell, score, errors))
    if found:
        _, tell, score, errors = min(found, key=lambda one: one[0])
        yield from tell(case, score, errors)


def _remedy(case: Case) -> str:
    """How to measure without it, or how to let a walk of the instrument be fitted."""
    names, kind = case.setup.parameters, InstrumentDrift.name
    if kind in names:
        return PARTS
    lines = written({"parameters": [*names, kind]})
    timed = all(len(block.conditions.time) for block in case.data.blocks)
    state = "" if timed else " and a column 'time' [s]"
    return f"{PARTS}; or estimate it, with the setup lines {lines}{state}"


Errors = Mapping[str, float]
Told = Callable[[Case, Score, Errors], Iterator[Finding]]


def _drifts(case: Case) -> Iterator[tuple[Told, Floats]]:
    """The kinds of drift: its finding, and the columns of its displacement."""
    fit, problem = case.fit, case.fit.problem
    terms = [*problem.terms.values()]
    own, first = terms[0].index[:FRAME], _first_columns(case)
    if len({term.frames.station for term in terms}) == 1:
        if problem.parameters.free[own].all():
            if first == {AXES}:
                J = fit.linear[1][:, own[:3]] / problem.parameters.scales[own[:3]]
                yield _of_values, J @ terms[0].error.base.rotation.T
            yield _of_instrument, fit.linear[1][:, own]
        elif first == {("distance",)}:
            yield _of_values, 1.0 / problem.sigma[:, None]
    if len(case.data.joints) > 1:
        # Of few measurements one joint may stand out, but not six.
        X, (_, r) = case.fit.beyond(_linear(case, fit.by_joints)), fit.unexplained
        along = np.abs(r @ X) / np.maximum(np.linalg.norm(X, axis=0), 1e-300)
        joint = int(np.argmax(along))
        yield partial(_of_joints, first=joint), fit.by_joints[:, [joint]]
    yield _of_joints, fit.by_joints


def _first_columns(case: Case) -> set[tuple[str, ...]]:
    """The columns of what drifts, of all models."""
    return {tuple(declared(model).columns)[:3] for model in case.data.models}


def _stands_out(case: Case, columns: Floats) -> Score | None:
    """The gain of a drift that some columns describe; None where it may be chance."""
    linear, time = _linear(case, columns), _time(case)
    found = case.fit.score(linear)
    if found.chance > CHANCE:
        return None
    curves = [columns * np.cos(np.pi * k * time)[:, None] for k in WAVES]
    others = found.left - case.fit.score(np.hstack([linear, *curves])).left
    if others < 0.0:
        return None  # There are too few measurements to compare.
    # What is bent may err in one direction only: a curve counts as one value.
    ratio = (1.0 - found.left) / max(others / len(WAVES), 1e-300)
    return found if f_tail(ratio, 1, len(WAVES)) < AMONG else None


def _time(case: Case) -> Floats:
    """Place of each measured value in the order of the files, 0 to 1, shape (M,)."""
    return np.asarray(case.rank / max(int(case.rank.max()), 1))[
        case.fit.problem.layout.row
    ]


def _linear(case: Case, columns: Floats) -> Floats:
    return columns * _time(case)[:, None]


def _of_values(
    case: Case, score: Score, errors: Mapping[str, float]
) -> Iterator[Finding]:
    """A displacement of what is measured, which can be taken out."""
    problem = case.fit.problem
    sigma = float(np.median(problem.sigma[problem.layout.component == 0]))
    size = float(np.linalg.norm(score.values))
    along = float(np.linalg.norm(score.values / size * score.deviations))
    if size < LEAST * case.fit.rms * sigma:
        return
    unit, factor = DISPLAY["m"]
    shown = (size, size - NORMAL * along, size + NORMAL * along)
    drift, low, high = (f"{factor * x:.2g} {unit}" for x in shown)
    names = AXES if len(score.values) == len(AXES) else ("distance",)
    lines = {"reading": {"drift": [float(f"{v:.3g}") for v in score.values]}}
    yield Finding(
        "instrument-drift",
        _severity(case, errors),
        f"the measured values drift by {drift} (95 %: {low} to {high}) from the first "
        "measurement to the last",
        {
            **dict(zip(names, score.values.tolist(), strict=True)),
            "drift": size,
            "sigma": along,
            **errors,
        },
        f"{_remedy(case)}; or state in the setup file: {written(lines)}",
        lines,
        "residuals-over-order",
    )


def _of_instrument(
    case: Case, score: Score, errors: Mapping[str, float]
) -> Iterator[Finding]:
    """A drift of an instrument that also turns, or sees more than positions."""
    before, after = errors.values()
    yield Finding(
        "instrument-drift",
        _severity(case, errors),
        "the instrument drifts against the robot from the first measurement to the "
        f"last: without it {100 * after / before:.0f} % of the errors are left",
        errors,
        _remedy(case),
        figure="residuals-over-order",
    )


def _of_joints(
    case: Case, score: Score, errors: Mapping[str, float], first: int = 0
) -> Iterator[Finding]:
    """Joint positions that drift, as those of a robot that grows warm, from one on."""
    worst = int(np.argmax(np.abs(score.values) / score.deviations))
    value, deviation = float(score.values[worst]), float(score.deviations[worst])
    joint = case.data.joints[first + worst]
    before, after = errors.values()
    turning = dict(zip(case.chains.joints, case.chains.revolute, strict=True))
    unit, factor = DISPLAY["rad" if turning.get(joint, True) else "m"]
    yield Finding(
        "robot-drift",
        _severity(case, errors),
        "the joint positions drift from the first measurement to the last, most of all "
        f"'{joint}' by {factor * value:.2g} +- {factor * deviation:.1g} {unit}: "
        f"without it {100 * after / before:.0f} % of the errors are left",
        {
            "joint": joint,
            "drift": value,
            "sigma": deviation,
            **errors,
        },
        "let the robot warm up before it is measured",
        figure="residuals-over-order",
    )


def _severity(case: Case, errors: Errors) -> Severity:
    before, after = errors.values()
    unit = case.fit.problem.layout.quantities[0].unit
    caused = np.sqrt(max(before**2 - after**2, 0.0))
    large = caused > LARGE * expected_size(unit) and after < SURE * before
    return "error" if large else "warning"


def _errors(case: Case, columns: Floats) -> dict[str, float]:
    """Errors now, and without a drift, rms in the unit of the first quantity."""
    fit, (_, r) = case.fit, case.fit.unexplained
    problem = fit.problem
    U = column_space(case.fit.beyond(_linear(case, columns)))
    first = np.flatnonzero(problem.layout.component == 0)
    left = np.linalg.norm((r - U @ (U.T @ r))[first]) / np.linalg.norm(r[first])
    sizes = problem.layout.quantities[0].errors(error_table(problem, fit.theta))
    before = float(np.sqrt(np.mean(sizes[np.isfinite(sizes)] ** 2)))
    return {"rms_before": before, "rms_after": before * float(left)}
