"""`scripts/benchmark [NAMES] [OPTIONS]`: run the benchmarks that are named, or all.

Options belong to the benchmark that knows them, such as `verdict`
and `accuracy`.
"""

from __future__ import annotations

import sys

from benchmarks import (
    acceptance,
    accuracy,
    camera,
    candidates,
    corners,
    evolution,
    field,
    findings,
    fit,
    fleet,
    fleet_prior,
    guard,
    holdout,
    jobs,
    learned,
    planning,
    python,
    reading,
    recalibration,
    recovery,
    relatives,
    report,
    round_trips,
    rows,
    servo,
    startup,
    verdict,
    watch,
)

BENCHMARKS = {
    "fit": fit.main,
    "startup": startup.main,
    "evolution": evolution.main,
    "rows": rows.main,
    "servo": servo.main,
    "jobs": jobs.main,
    "learned": learned.main,
    "camera": camera.main,
    "planning": planning.main,
    "python": python.main,
    "candidates": candidates.main,
    "corners": corners.main,
    "reading": reading.main,
    "recalibration": recalibration.main,
    "recovery": recovery.main,
    "relatives": relatives.main,
    "report": report.main,
    "round-trips": round_trips.main,
    "guard": guard.main,
    "holdout": holdout.main,
    "fleet": fleet.main,
    "verdict": verdict.main,
    "field": field.main,
    "findings": findings.main,
    "fleet-prior": fleet_prior.main,
    "accuracy": accuracy.main,
    "acceptance": acceptance.main,
    "watch": watch.main,
}


def main() -> None:
    """Run the benchmarks that are named, or all."""
    words = sys.argv[1:]
    if words[:1] in (["-h"], ["--help"]):
        print(f"usage: benchmark [NAMES] [OPTIONS]; NAMES are {', '.join(BENCHMARKS)}")
        return
    first = next((k for k, word in enumerate(words) if word[:1] == "-"), len(words))
    named = words[:first]
    chosen = named or list(BENCHMARKS)
    unknown = [name for name in chosen if name not in BENCHMARKS]
    if unknown:
        sys.exit(f"unknown benchmark {unknown[0]}; there are {', '.join(BENCHMARKS)}")
    for name in chosen:
        BENCHMARKS[name]()


if __name__ == "__main__":
    main()
