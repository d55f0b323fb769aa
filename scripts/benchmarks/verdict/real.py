"""Real robots: not worse than before robust estimation, and as far off as predicted.

The data are not part of the repository: `CALIB_PIN_DATA`, else `../shared/data`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

import calib_pin
from benchmarks.criterion import Criterion, Line, between, missing
from benchmarks.timing import DATA
from calib_pin.setup import DistanceSetup, Setup
from calib_pin.validation.result import CalibrationResult

SAME = 1.01
"""Error by the one before that is not worse: what other weights of good measurements
may do."""

WITHIN = 1.15
"""Found by predicted error of held-out measurements, either way."""

DOUBTFUL = "high"
"""The place of Panda 2 whose measurements do not go with the others."""

SOCKETS = 0.05
"""Distance of two sockets of a place of the Pandas [m]."""

BLOCKS = 5
"""Stretches into which a file is cut."""


def _read(
    file: str, chain: calib_pin.Chain, model: str | None = None
) -> calib_pin.Measurements:
    return calib_pin.read_measurements(DATA / file, chain, model=model).only


def _ur10() -> calib_pin.Chain:
    return calib_pin.load_chain("example:ur10_robot", base="base_link", tip="tool0")


def _held_out(name: str, result: CalibrationResult, before: float) -> Iterator[Line]:
    """Verdict, error on held-out measurements, and the one that was predicted."""
    after = result.errors[0].validation_after
    error = np.nan if after is None else 1e3 * after.rms
    yield between(f"{name}, held out, rms [mm]", error, -np.inf, SAME * before)
    good = result.verdict == "good"
    told = result.verdict if good else f"{result.verdict}: {result.reason}"
    yield Line(f"{name}, verdict", told, "good", good)
    yield _predicted(name, result)


def _predicted(name: str, result: CalibrationResult) -> Line:
    """Error on held-out measurements by the one that was predicted."""
    text = f"{name}, found by predicted error"
    ratios = [
        g.ratio for g in result.statistics.gains if g.quantity in ("all", "position")
    ]
    return between(text, ratios[0], 1.0 / WITHIN, WITHIN) if ratios else missing(text)


def ur10() -> Iterator[Line]:
    """500 measurements of a T-Mac, 2 000 others of the same day."""
    chain = _ur10()
    train, unseen = (
        _read(f"ur10_tmac/{part}.csv", chain, "position")
        for part in ("train", "validate")
    )
    result = calib_pin.calibrate(chain, train, validation=unseen)
    yield from _held_out("UR10", result, TODAY["UR10"])


def ur5() -> Iterator[Line]:
    """A grid of 1 000 measurements, 20 others at random."""
    chain = calib_pin.load_chain("example:ur5_robot", base="base_link", tip="tool0")
    train, unseen = (
        _read(f"ur5_tracker/{part}.csv", chain) for part in ("train", "validate")
    )
    result = calib_pin.calibrate(chain, train, validation=unseen)
    yield from _held_out("UR5", result, TODAY["UR5"])


def talos() -> Iterator[Line]:
    """61 measurements of a marker, nine joints."""
    chain = calib_pin.load_chain("example:talos_reduced", tip="gripper_left_base_link")
    rows = _read("talos_left_arm/measurements.csv", chain)
    results = [calib_pin.calibrate(chain, rows, seed=seed) for seed in range(3)]
    found = [result.errors[0].validation_after for result in results]
    rms = 1e3 * float(np.mean([np.nan if a is None else a.rms for a in found]))
    yield from list(_held_out("TALOS", results[0], np.inf))[1:]
    limit = SAME * TODAY["TALOS"]
    yield between("TALOS, five folds, rms [mm]", rms, -np.inf, limit)


def tiago() -> Iterator[Line]:
    """37 measurements, 62 of another day."""
    chain = calib_pin.load_chain("example:tiago_no_hand", tip="wrist_ft_tool_link")
    train, unseen = (
        _read(f"tiago/{part}.csv", chain) for part in ("train", "validate")
    )
    result = calib_pin.calibrate(chain, train, validation=unseen)
    yield from _held_out("TIAGo", result, TODAY["TIAGo"])


def known_distances(rows: calib_pin.Measurements) -> Setup:
    """What is known of the sockets of all places that rows name."""
    places = dict.fromkeys(name.partition("/")[0] for name in rows.target)
    pairs = (DistanceSetup((f"{p}/0", f"{p}/1"), SOCKETS, 1e-5) for p in places)
    return Setup(distances=tuple(pairs))


def panda_1() -> Iterator[Line]:
    """Fitted at one place, two others; then at all but one after the other."""
    chain = calib_pin.load_chain("example:panda", tip="panda_link8")
    rows = _read("mukca_panda/panda_1.csv", chain, "fixed-point")
    elsewhere = np.array([not name.startswith("front") for name in rows.target])
    rows = replace(rows, validate=elsewhere)
    result = calib_pin.calibrate(chain, rows, known_distances(rows))
    error, verdict, ratio = _held_out("Panda 1", result, TODAY["Panda 1"])
    yield from (error, verdict)
    # Two places say nothing of a third that is a meter away; it is shown as it is.
    yield Line("Panda 1, two places from one, found by predicted error", ratio.figure)
    everything = replace(rows, validate=np.zeros(len(rows), bool))
    result = calib_pin.calibrate(chain, everything, known_distances(rows))
    yield _predicted("Panda 1, one place after the other", result)


def panda_2() -> Iterator[Line]:
    """All places with the doubtful one, and without it."""
    chain = calib_pin.load_chain("example:panda", tip="panda_link8")
    rows = _read("mukca_panda/panda_2.csv", chain, "fixed-point")
    doubtful = np.array([name.startswith(f"{DOUBTFUL}/") for name in rows.target])
    others = rows.rows(~doubtful)
    everything = calib_pin.calibrate(chain, rows, known_distances(rows))
    alone = calib_pin.calibrate(chain, others, known_distances(others))
    errors = []
    for result in (everything, alone):
        ((_, _, accuracy),) = calib_pin.evaluate(result.model, others).errors
        errors.append(accuracy.rms)
    text = "Panda 2, other places, error with by without 'high'"
    yield between(text, errors[0] / errors[1], -np.inf, 1.03)
    count = sum(bool(doubtful[o.row]) for o in everything.statistics.outliers)
    most = 2 * count > len(everything.statistics.outliers)
    shown = f"{count} of {len(everything.statistics.outliers)} outliers are there"
    yield Line("Panda 2, 'high' is out", shown, "most", most)
    yield Line("Panda 2, verdict", f"{everything.verdict} {everything.reason}")
    yield from list(_held_out("Panda 2 without 'high'", alone, np.inf))[1:]


def blocks() -> Iterator[Line]:
    """The prediction of model selection beside the error on held-out stretches."""
    chain = _ur10()
    rows = _read("ur10_tmac/train.csv", chain, "position")
    promised, found = [], []
    for block in np.array_split(np.arange(len(rows)), BLOCKS):
        held = np.zeros(len(rows), bool)
        held[block] = True
        result = calib_pin.calibrate(chain, rows.rows(~held), ladder=True)
        assert result.model_selection is not None
        rung = result.model_selection.candidates[result.model_selection.chosen]
        promised.append(next(e.mean for e in rung.errors if e.name == "position"))
        ((_, _, accuracy),) = calib_pin.evaluate(result.model, rows.rows(held)).errors
        found.append(accuracy.mean)
    ratio = float(np.mean(found) / np.mean(promised))
    text = "UR10, held-out stretches by predicted error"
    yield between(text, ratio, 1.0 / 1.5, 1.5)


CHECKS: tuple[Callable[[], Iterator[Line]], ...] = (
    ur10,
    ur5,
    talos,
    tiago,
    panda_1,
    panda_2,
    blocks,
)

TODAY = {
    "UR10": 0.447,
    "UR5": 0.104,
    "TALOS": 0.792,
    "TIAGo": 3.042,
    "Panda 1": 0.755,
}
"""Errors on held-out measurements before robust estimation, rms [mm]."""


def run(number: int) -> tuple[Line, ...]:
    """Lines about one robot."""
    check = CHECKS[number]
    if not DATA.is_dir():
        reason = f"no real measurements in {DATA} (CALIB_PIN_DATA)"
        return (Line(check.__name__, reason),)
    try:
        return tuple(check())
    except Exception as error:
        return (Line(check.__name__, f"{type(error).__name__}: {error}", "", False),)


def judge(found: Sequence[tuple[Line, ...]]) -> Iterator[Line]:
    """All lines."""
    for lines in found:
        yield from lines


CRITERION = Criterion(7, "Real data", len(CHECKS), run, judge, least=len(CHECKS) - 1)
