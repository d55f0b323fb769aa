"""`scripts/benchmark [NAMES]`: run the benchmarks that are named, or all."""

from __future__ import annotations

import sys

from benchmarks import (
    basic,
    beyond,
    camera,
    evolution,
    guard,
    planning,
    reading,
    recovery,
    report,
    rows,
    startup,
)

BENCHMARKS = {
    "fit": basic.fit_talos,
    "jacobian": basic.jacobian,
    "commands": basic.commands,
    "startup": startup.main,
    "evolution": evolution.main,
    "rows": rows.main,
    "camera": camera.main,
    "planning": planning.main,
    "beyond": beyond.main,
    "reading": reading.main,
    "recovery": recovery.main,
    "report": report.main,
    "guard": guard.main,
}


def main() -> None:
    """Run the benchmarks that are named, or all."""
    named = [word for word in sys.argv[1:] if word != guard.RECORD]
    chosen = named or list(BENCHMARKS)
    unknown = [name for name in chosen if name not in BENCHMARKS]
    if unknown:
        sys.exit(f"unknown benchmark {unknown[0]}; there are {', '.join(BENCHMARKS)}")
    for name in chosen:
        BENCHMARKS[name]()


if __name__ == "__main__":
    main()
