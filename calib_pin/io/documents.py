"""The documents that commands print as JSON; each states its format and version."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from calib_pin.control.compensation import Compensation
from calib_pin.io.json_text import Json, plain
from calib_pin.io.targets import Targets
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.planning.plan import Plan
from calib_pin.planning.suggestions import Suggestion
from calib_pin.validation.result import Evaluation, Identification


def stated(kind: str, version: int = 1) -> Json:
    """The first keys of a document.

    Args:
        kind: What it is of, such as `plan`.
        version: Version of its format.
    """
    return {"format": f"calib-pin/{kind}", "version": version}


def identification_parts(
    found: Identification, suggestions: Sequence[Suggestion] = ()
) -> Json:
    """The parts `parameters` and `identifiability` of section 8 of the contract.

    Args:
        found: The identifiability of a robot.
        suggestions: Suggested measurements.
    """
    return {
        "parameters": plain(found.parameters),
        "identifiability": {
            **plain(found.identifiability),
            "coupled": plain(found.groups),
            "remedies": plain(suggestions),
        },
    }


def identification_document(
    found: Identification, suggestions: Sequence[Suggestion], verdict: str, reason: str
) -> Json:
    """The identifiability of a robot.

    Args:
        found: It.
        suggestions: Suggested measurements.
        verdict: Verdict of the fit that it is of; `good` without one.
        reason: Why; empty where there is nothing to say.
    """
    return {
        **stated("identification"),
        **identification_parts(found, suggestions),
        "verdict": {"status": verdict, "reason": reason},
    }


def evaluation_document(found: Evaluation) -> Json:
    """The accuracy of a robot on measurements."""
    return {
        **stated("evaluation"),
        "rows": found.rows,
        "registered": found.registered,
        "outside_trained_region": found.outside,
        "placed": list(found.located),
        "verdict": {"status": found.verdict, "reason": found.reason},
        "errors": {
            name: {"unit": unit, **asdict(accuracy)}
            for name, unit, accuracy in found.errors
        },
    }


def plan_document(plan: Plan) -> Json:
    """A plan: its configurations, what they reach, and the expected result."""
    predicted = plan.predicted
    return {
        **stated("plan"),
        "joints": list(plan.problem.error.chain.joints),
        "configurations": plan.q.tolist(),
        "target": list(plan.target),
        "criterion": {"name": plan.criterion, "value": plan.value},
        "random": plan.random,
        "method": plan.method,
        "status": plan.status.value,
        "measured": plan.measured,
        "candidates": plan.candidates,
        "collisions": {"checked": plan.checked, "blocked_moves": list(plan.blocked)},
        "steps": plain(plan.steps),
        "predicted": {
            "rank": predicted.directions.count,
            "structural_rank": plan.rank,
            "position": predicted.position,
            "orientation": predicted.orientation,
            "parameters": [
                {"name": p.name, "unit": p.unit, "sigma": p.sigma, "status": p.status}
                for p in plan.parameters
            ],
            "coupled": plain(plan.groups),
        },
    }


def compensation_document(
    found: Compensation,
    chain: Chain,
    asked: Targets,
    doubts: Sequence[str],
    output: Path | None,
    accuracy: Mapping[str, Mapping[str, object]],
) -> Json:
    """The summary of a compensation.

    Args:
        found: The commands.
        chain: The nominal chain.
        asked: The targets.
        doubts: Why the calibration must not be trusted; empty where it may.
        output: File that the commands were written to; None for none.
        accuracy: Accuracy of the calibration, see `io.results.read_accuracy`.
    """
    lines, reached = asked.lines, found.reached
    units = {"position": "m", "orientation": "rad"}
    parts = [part for part in units if part == "position" or found.oriented]
    sizes = {
        "position": (found.position_before, found.position),
        "orientation": (found.orientation_before, found.orientation),
    }
    corrections = np.abs(found.corrections)
    return {
        **stated("compensation"),
        "verdict": {
            "status": "untrusted" if doubts else "good",
            "reason": doubts[0] if doubts else "",
        },
        "kind": "motion" if asked.T is None else "targets",
        "rows": len(found),
        "reached": int(reached.sum()),
        "unreachable": [
            {"line": int(lines[k]), **{p: float(sizes[p][1][k]) for p in parts}}
            for k in np.flatnonzero(~reached)
        ],
        "corrections": {
            name: {"unit": "rad" if turns else "m", **(_spread(column) or {})}
            for name, turns, column in zip(
                chain.joints, chain.revolute, corrections.T, strict=True
            )
        },
        "errors": {
            p: {
                "unit": units[p],
                "nominal": _spread(sizes[p][0][reached]),
                "compensated": _spread(sizes[p][1][reached]),
            }
            for p in parts
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
