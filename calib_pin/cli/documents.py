"""The documents that commands print as JSON; each states its format and version."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from calib_pin.control.compensation import Compensation
from calib_pin.estimation.evidence import Finding
from calib_pin.io.calibrated_model import model_name
from calib_pin.io.json_text import Json, format_keys, plain
from calib_pin.io.results import identification_parts
from calib_pin.io.targets import Targets
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.monte_carlo import Outlook, Study
from calib_pin.monte_carlo.summary import LEVELS
from calib_pin.planning.plan import Plan
from calib_pin.planning.suggestions import Suggestion
from calib_pin.setup import LimitSetup
from calib_pin.validation.acceptance import Acceptance, judged
from calib_pin.validation.comparison import BOUND, Comparison, Difference, faults
from calib_pin.validation.result import CalibrationResult, Evaluation, Identification


def comparison_document(found: Comparison) -> Json:
    """The numbers of a comparison, in SI units; B is the second calibration.

    `drifted` is null where the noise is unknown, orientations where rows do not tell
    them.
    """
    moved: Json = {"base": None, "tool": None}
    for entry in map(plain, found.displacements):
        del entry["of_tool"]
        moved[entry.pop("frame")] = entry
    tips: Json = {}
    if len(found.drifts) > 1:  # `tip` is that which drifted most.
        by_chain = {name: _tip(found, name) for name in found.drifts}
        tips = {"chain": found.chain, "tips": by_chain}
    return {
        **format_keys("calib-pin/comparison"),
        "a": _record(found.first),
        "b": _record(found.second),
        "same": {
            "nominal_robot": found.same_nominal,
            "parameters": found.same_parameters,
            "measurements": found.same_rows,
        },
        "findings": plain(faults(found)),
        "drifted": found.drifted,
        "changed": found.changed,
        "tip": _tip(found, found.chain),
        **tips,
        "displacements": moved,
        "bound": BOUND,
        "parameters": [
            {"name": d.name, **_difference(d)} for d in found.differences if not d.terms
        ],
        "coupled": [
            {"expression": d.name, **_difference(d), "terms": plain(d.terms)}
            for d in found.differences
            if d.terms
        ],
        "parameters_alone": dict(zip("ab", map(list, found.alone), strict=True)),
        "coupled_alone": dict(zip("ab", found.sums_alone, strict=True)),
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
        "tests": {name: plain(test) for name, test in tests.items()},
    }


def outlook_document(study: Study, found: Sequence[Outlook], limit: LimitSetup) -> Json:
    """Outlooks of a Monte Carlo study, in SI units; quantiles are those of `levels`."""
    return {
        **format_keys("calib-pin/monte-carlo"),
        "robot": study.chains.robot.name,
        "model": model_name(study.truth),
        "seed": study.seed,
        "limit": plain(limit),
        "levels": list(LEVELS),
        "outlooks": plain(found),
    }


def _record(record: CalibrationResult) -> Json:
    return {
        "file": record.provenance.file,
        "created": record.provenance.created,
        "verdict": {"status": record.verdict, "reason": record.reason},
        "findings": plain(record.findings),
        "model": model_name(record.model),
        "parameters": list(record.model.setup.parameters),
        "residual_model": record.model.setup.learned,
        "training": len(record.fitted),
        "validation": record.validation.method,
        "errors": {
            error.name: {
                "unit": error.unit,
                "training": plain(error.after),
                "validation": plain(error.validation_after),
            }
            for error in record.errors
        },
    }


def _tip(found: Comparison, chain: str) -> Json:
    position, orientation = found.explained_at(chain) or (None, None)
    drift = found.drifts[chain]
    farthest = drift.farthest
    return {
        "configurations": len(drift.q),
        "fitted_away": list(drift.absorbed),
        "position": {**plain(drift.position), "explained": position},
        "orientation": (
            {**plain(drift.orientation), "explained": orientation}
            if found.oriented
            else None
        ),
        "largest": {
            "drift": float(drift.drift[farthest]),
            "tip": drift.points[farthest].tolist(),
            "configuration": drift.q[farthest].tolist(),
        },
    }


def _difference(found: Difference) -> Json:
    return {
        "unit": found.unit,
        "a": found.first,
        "b": found.second,
        "difference": found.change,
        "sigma": found.sigma,
        "significance": found.significance,
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
    return {
        **format_keys("calib-pin/identification"),
        **identification_parts(found, suggestions),
        "verdict": {"status": verdict, "reason": reason},
        "findings": plain(findings),
    }


def evaluation_document(found: Evaluation) -> Json:
    """The accuracy of a robot on measurements."""
    return {
        **format_keys("calib-pin/evaluation"),
        "rows": found.rows,
        "registered": found.registered,
        "outside_trained_region": found.outside,
        "placed": list(found.located),
        "verdict": {"status": found.verdict, "reason": found.reason},
        "findings": plain(found.findings),
        "errors": {
            name: {"unit": unit, **plain(accuracy)}
            for name, unit, accuracy in found.errors
        },
    }


def plan_document(plan: Plan) -> Json:
    """A plan: its configurations, what they reach, and the expected result."""
    predicted = plan.predicted
    return {
        **format_keys("calib-pin/plan"),
        "joints": list(plan.problem.chains.joints),
        "configurations": plan.q.tolist(),
        "target": list(plan.target),
        "criterion": {"name": plan.criterion, "value": plan.value},
        "random": plan.random,
        "method": plan.method,
        "status": plan.status.value,
        "measured": plan.measured,
        "candidates": plan.candidates,
        "collisions": {
            "checked": plan.blocked is not None,
            "blocked_moves": list(plan.blocked or ()),
        },
        "steps": plain(plan.steps),
        "predicted": {
            "rank": predicted.directions.count,
            "structural_rank": predicted.rank,
            "position": predicted.position,
            "orientation": predicted.orientation,
            "parameters": [
                {"name": p.name, "unit": p.unit, "sigma": p.sigma, "status": p.status}
                for p in plan.parameters
            ],
            "coupled": plain(plan.groups),
            "robot_errors": plain(predicted.robot_errors),
        },
    }


def compensation_document(
    found: Compensation,
    chain: Chain,
    asked: Targets,
    doubts: Sequence[str],
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
        doubts: Why the calibration must not be trusted; empty where it may.
        output: File that the commands were written to; None for none.
        accuracy: Accuracy of the calibration, by quantity.
        ways: Number of via configurations, and lines to which no way is free; None
            where collisions are not looked at.
        hasty: Lines to which a joint would move faster than it can.
    """
    lines, reached = asked.lines, found.reached
    errors = {"position": ("m", found.position_before, found.position)}
    if found.oriented:
        errors["orientation"] = "rad", found.orientation_before, found.orientation
    corrections = np.abs(found.corrections)
    return {
        **format_keys("calib-pin/compensation"),
        "verdict": {
            "status": "untrusted" if doubts else "good",
            "reason": doubts[0] if doubts else "",
        },
        "kind": "motion" if asked.T is None else "targets",
        "rows": len(found),
        "reached": int(reached.sum()),
        "too_fast": list(hasty),
        "collisions": ways
        and {
            "vias": ways[0],
            "colliding": lines[found.collides].tolist(),
            "blocked": [int(line) for line in ways[1]],
        },
        "unreachable": [
            {
                "line": int(lines[k]),
                **{name: float(after[k]) for name, (_, _, after) in errors.items()},
            }
            for k in np.flatnonzero(~reached)
        ],
        "corrections": {
            name: {"unit": "rad" if turns else "m", **(_spread(column) or {})}
            for name, turns, column in zip(
                chain.joints, chain.revolute, corrections.T, strict=True
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
        "at_limit": lines[reached & found.at_limit].tolist(),
        "outside_trained_region": lines[reached & found.outside].tolist(),
        "jumps": lines[found.jumps].tolist() if asked.T is None else [],
        "written": None if output is None else str(output),
        "model_errors": dict(accuracy),
    }


def _spread(values: Floats) -> dict[str, float] | None:
    """Mean and largest of the known values; None where none is known."""
    known = values[np.isfinite(values)]
    if not len(known):
        return None
    return {"mean": float(known.mean()), "max": float(known.max())}
