"""The documents that commands print as JSON; each states its format and version."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np

from calib_pin.control.compensation import Compensation
from calib_pin.estimation.evidence import Finding
from calib_pin.io.json_text import Json, format_keys, merged, plain
from calib_pin.io.results import model_name
from calib_pin.io.targets import Targets
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.monte_carlo import Outlook, Study
from calib_pin.monte_carlo.summary import LEVELS
from calib_pin.planning.plan import Plan
from calib_pin.planning.suggestions import Suggestion
from calib_pin.setup import LimitSetup
from calib_pin.validation.acceptance import Acceptance, judged
from calib_pin.validation.comparison import BOUND, Comparison, faults
from calib_pin.validation.result import CalibrationResult, Evaluation, Identification


def comparison_document(found: Comparison) -> Json:
    """The numbers of a comparison, in SI units; B is the second calibration.

    `drifted` is null where the noise is unknown, orientations where rows do not tell
    them.
    """
    tips = {name: _tip(found, name) for name in found.drifts}
    differences = [
        plain(d) | {"difference": d.change, "significance": d.significance}
        for d in found.differences
    ]
    moved = {frame.frame: frame for frame in found.displacements}
    return {
        **format_keys("calib-pin/comparison"),
        "a": _record(found.first),
        "b": _record(found.second),
        "same": {
            "nominal_robot": found.same_nominal,
            "parameters": found.same_parameters,
            "measurements": found.same_rows,
        },
        "findings": faults(found),
        "drifted": found.drifted,
        "changed": found.changed,
        "chain": found.chain,  # Of `tip`, that which drifted most.
        "tip": tips[found.chain],
        "tips": tips,
        "displacements": {"base": None, "tool": None, **moved},
        "bound": BOUND,
        "parameters": [d for d in differences if not d["terms"]],
        "coupled": [d | {"expression": d["name"]} for d in differences if d["terms"]],
        "parameters_alone": dict(zip("ab", found.alone, strict=True)),
        "coupled_alone": dict(zip("ab", found.sums_alone, strict=True)),
    }


def _record(record: CalibrationResult) -> Json:
    """A calibration, and how accurate it is."""
    return {
        "file": record.provenance.file,
        "created": record.provenance.created,
        "verdict": {"status": record.verdict, "reason": record.reason},
        "findings": record.findings,
        "model": model_name(record.model),
        "parameters": record.model.setup.parameters,
        "residual_model": record.model.setup.learned,
        "training": len(record.fitted),
        "validation": record.validation.method,
        "errors": {
            error.name: {
                "unit": error.unit,
                "training": error.after,
                "validation": error.validation_after,
            }
            for error in record.errors
        },
    }


def _tip(found: Comparison, chain: str) -> Json:
    position, orientation = found.drifts[chain].explained or (None, None)
    drift = found.drifts[chain]
    farthest = drift.farthest
    turned = {**plain(drift.orientation), "explained": orientation}
    return {
        "configurations": len(drift.q),
        "fitted_away": drift.absorbed,
        "position": {**plain(drift.position), "explained": position},
        "orientation": turned if drift.oriented else None,
        "largest": {
            "drift": drift.drift[farthest],
            "tip": drift.points[farthest],
            "configuration": drift.q[farthest],
        },
    }


def acceptance_document(tests: Mapping[str, Acceptance], limit: LimitSetup) -> Json:
    """The numbers of an acceptance test, in SI units."""
    *_, last = tests.values()
    return {
        **format_keys("calib-pin/acceptance"),
        "limits": [
            {"quantity": name, "status": status, "limit": allowed, "unit": unit}
            for name, status, _, allowed, unit in judged(last, limit)
        ],
        "tests": tests,
    }


def outlook_document(study: Study, found: Sequence[Outlook], limit: LimitSetup) -> Json:
    """Outlooks of a Monte Carlo study, in SI units; quantiles are those of `levels`."""
    return {
        **format_keys("calib-pin/monte-carlo"),
        "robot": study.chains.robot.name,
        "model": model_name(study.truth),
        "seed": study.seed,
        "limit": limit,
        "levels": LEVELS,
        "outlooks": found,
    }


def identification_document(
    found: Identification,
    suggestions: Sequence[Suggestion],
    verdict: str,
    reason: str,
    findings: Sequence[Finding] = (),
) -> Json:
    """The identifiability of a robot.

    Args:
        found: It.
        suggestions: Suggested measurements.
        verdict: Verdict of the fit that it is of; `good` without one.
        reason: Why; empty where there is nothing to say.
        findings: Defects of the measurements.
    """
    # A fit has found more than this.
    own = {part.name: getattr(found, part.name) for part in fields(Identification)}
    return merged(
        format_keys("calib-pin/identification"),
        plain(Identification(**own)),
        {
            "identifiability": {"remedies": suggestions},
            "verdict": {"status": verdict, "reason": reason},
            "findings": findings,
        },
    )


def evaluation_document(found: Evaluation) -> Json:
    """The accuracy of a robot on measurements."""
    errors = {n: {"unit": unit, **plain(size)} for n, unit, size in found.errors}
    head = format_keys("calib-pin/evaluation")
    return {**head, **plain(found), "errors": errors}


def plan_document(plan: Plan) -> Json:
    """A plan: its configurations, what they reach, and the expected result."""
    expected, blocked = plan.predicted, plan.blocked
    return merged(
        format_keys("calib-pin/plan"),
        {"joints": plan.problem.chains.joints, "target": plan.target},
        plain(plan),
        {
            "collisions": {
                "checked": blocked is not None,
                "blocked_moves": blocked or (),
            },
            "predicted": {
                "rank": expected.directions.count,
                "structural_rank": expected.rank,
            },
        },
    )


def compensation_document(
    found: Compensation,
    chain: Chain,
    asked: Targets,
    doubt: str,
    output: Path | None,
    accuracy: Mapping[str, Mapping[str, object]],
    ways: tuple[int, Sequence[int]] | None = None,
    hasty: Sequence[int] = (),
) -> Json:
    """The summary of a compensation.

    Args:
        found: The commands.
        chain: The nominal chain.
        asked: The targets.
        doubt: Why the calibration must not be trusted; empty where it may.
        output: File that the commands were written to; None for none.
        accuracy: Accuracy of the calibration, by quantity.
        ways: Number of via configurations, and lines to which no way is free; None
            where collisions are not looked at.
        hasty: Lines to which a joint would move faster than it can.
    """
    lines, reached, motion = asked.lines, found.reached, asked.T is None
    errors = {"position": ("m", found.position_before, found.position)}
    if found.oriented:
        errors["orientation"] = "rad", found.orientation_before, found.orientation
    corrections = np.abs(found.corrections).T
    missed = zip(
        lines[~reached], *(e[2][~reached] for e in errors.values()), strict=True
    )
    return {
        **format_keys("calib-pin/compensation"),
        "verdict": {
            "status": "untrusted" if doubt else "good",
            "reason": doubt,
        },
        "kind": "motion" if motion else "targets",
        "rows": len(found),
        "reached": reached.sum(),
        "too_fast": hasty,
        "collisions": ways
        and {
            "vias": ways[0],
            "colliding": lines[found.collides],
            "blocked": ways[1],
        },
        "unreachable": [
            dict(zip(("line", *errors), row, strict=True)) for row in missed
        ],
        "corrections": {
            name: {"unit": "rad" if turns else "m", **(_spread(column) or {})}
            for name, turns, column in zip(
                chain.joints, chain.revolute, corrections, strict=True
            )
        },
        "errors": {
            name: {
                "unit": unit,
                "nominal": _spread(before[reached]),
                "compensated": _spread(after[reached]),
            }
            for name, (unit, before, after) in errors.items()
        },
        "at_limit": lines[reached & found.at_limit],
        "outside_trained_region": lines[reached & found.outside],
        "jumps": lines[found.jumps] if motion else [],
        "written": None if output is None else str(output),
        "model_errors": accuracy,
    }


def _spread(values: Floats) -> dict[str, float] | None:
    """Mean and largest of the known values; None where none is known."""
    known = values[np.isfinite(values)]
    return {"mean": known.mean(), "max": known.max()} if len(known) else None
