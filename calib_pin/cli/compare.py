"""`calib-pin compare`: the difference between two calibrations of a robot."""

from __future__ import annotations

from calib_pin.cli import files, results
from calib_pin.cli.asked import Compare
from calib_pin.estimation.evidence import TRUSTED
from calib_pin.io.json_text import Json, format_keys, plain
from calib_pin.io.results import document_file, model_name, read_result
from calib_pin.report.comparison import comparison_report
from calib_pin.validation.comparison import BOUND, Comparison, faults
from calib_pin.validation.comparison import compare as run
from calib_pin.validation.result import CalibrationResult


def compare(asked: Compare) -> int:
    """Do what `Compare` asks for."""
    both = document_file(asked.first), document_file(asked.second)
    files.require_distinct(both)
    pictures = results.figure_files(asked, "comparison")
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
