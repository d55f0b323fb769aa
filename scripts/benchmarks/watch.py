"""Watched jobs: wrong rows told before the next one, clean ones left alone, and plans.

    scripts/benchmark watch                              # a few jobs of each part
    scripts/benchmark watch --count 200 --seed 3
    scripts/benchmark watch --only position              # one instrument

Rows of a simulated job come one by one. `rows`: some are clean, then one is wrong, in a
way that takes turns, then clean ones follow. `jobs`: all of them are read wrong from
the first on; counted is the row after which the cause is named. `plan`: 20 rows where
`watch` proposes them against 30 random ones, by the error of the tool point over the
workspace against the truth.
"""

from __future__ import annotations

import argparse
import os
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.timing import processor_time
from benchmarks.verdict.jobs import Job, draw
from benchmarks.verdict.truth import WORKSPACE, position_error
from calib_pin.guidance import Event, Watch
from calib_pin.guidance.proposals import Proposals
from calib_pin.kinematics.chains import Chains
from calib_pin.observations import Measurements, Observations
from calib_pin.setup import Setup
from calib_pin.validation.calibrated_model import CalibratedModel

INSTRUMENTS = ("position", "camera", "point-distance", "fixed-point")
"""A tracker, a camera that sees a board, a ruler to fixed points, and sockets."""

NOISE = {"camera": 0.2, "point-distance": 5e-4}
"""Standard deviations of instruments [m, px]; of others a twentieth of a millimeter."""

CLEAN, AFTER = 3, 3
"""Clean rows before a wrong one that come one by one, and those behind it."""

LARGEST = 0.1
"""Largest displacement of a wrong row [m]."""

PLANNED, RANDOM = 20, 30

NAMED = 24
"""Most rows after which the cause of a job that is read wrong may be named."""

Rows = Measurements
Spoil = Callable[[Job, Rows, int, np.random.Generator], Rows]
"""The rows of a job of which one is wrong, by its position."""


class Trial:
    """A watched job whose rows are there as far as they were let out."""

    def __init__(self, job: Job, rows: Rows, folder: Path) -> None:
        """Begin with no rows."""
        self.chains, self.setup = Chains.of(job.chain), job.setup
        self.rows, self.file, self.looks = rows, folder / "rows", 0
        anywhere = Proposals(None, None, None, ())
        self.watch = Watch(self.read, [self.file], anywhere)

    def read(self) -> tuple[Chains, Setup, Observations]:
        """The rows that are there."""
        rows = Observations.of(self.rows.rows(np.arange(self.count)))
        return self.chains, self.setup, rows

    def look(self, count: int) -> list[Event]:
        """The events when so many rows are there."""
        self.count, self.looks = count, self.looks + 1
        self.file.write_text("\n" * self.looks)
        os.utime(self.file, (self.looks, self.looks))
        return [*self.watch.look()]


def _displaced(job: Job, rows: Rows, k: int, rng: np.random.Generator) -> Rows:
    """Five deviations of the prediction to a tenth of a meter, any order alike."""
    return rows  # See `_row`, which knows the prediction.


def _positions(change: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Spoil:
    """Joint positions by those of the row and of the row before."""

    def spoil(job: Job, rows: Rows, k: int, rng: np.random.Generator) -> Rows:
        q, size = rows.q.copy(), _unit(rows)
        q[k : k + size] = change(rows.q[k], rows.q[k - size])
        return replace(rows, q=q)

    return spoil


def _values(change: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Spoil:
    """Values by those of the row and of the row before."""

    def spoil(job: Job, rows: Rows, k: int, rng: np.random.Generator) -> Rows:
        values, size = rows.values.copy(), _unit(rows)
        own, before = slice(k, k + size), slice(k - size, k)
        values[own] = change(rows.values[own], rows.values[before])
        return replace(rows, values=values)

    return spoil


def _reversed(q: np.ndarray, _: np.ndarray) -> np.ndarray:
    """The third joint counts the other way."""
    signs = np.where(np.arange(len(q)) == 2, -1.0, 1.0)
    return signs * q


def _own_pose(job: Job, rows: Rows, k: int, rng: np.random.Generator) -> Rows:
    """The position that the controller computes."""
    values = rows.values.copy()
    values[k] = job.chain.poses(rows.q[k : k + 1])[0, :3, 3]
    return replace(rows, values=values)


def _duplicate(job: Job, rows: Rows, k: int, rng: np.random.Generator) -> Rows:
    """The same line twice."""
    size = _unit(rows)
    q, values = rows.q.copy(), rows.values.copy()
    q[k : k + size], values[k : k + size] = q[k - size : k], values[k - size : k]
    target = [*rows.target]
    target[k : k + size] = target[k - size : k]
    return replace(rows, q=q, values=values, target=target)


def _moved(job: Job, rows: Rows, k: int, rng: np.random.Generator) -> Rows:
    """The instrument moved by 5 mm before this row."""
    values = rows.values.copy()
    values[k:] += 5e-3 * _way(rng, values.shape[1])
    return replace(rows, values=values)


def _other_target(job: Job, rows: Rows, k: int, rng: np.random.Generator) -> Rows:
    """The name of another target, of all corners of an image the next one."""
    names = sorted(set(rows.target))
    target, size = [*rows.target], _unit(rows)
    for row in range(k, k + size):
        target[row] = names[(names.index(target[row]) + 1) % len(names)]
    return replace(rows, target=target)


def _way(rng: np.random.Generator, count: int) -> np.ndarray:
    way = rng.normal(size=count)
    return np.asarray(way / np.linalg.norm(way))


def _unit(rows: Rows) -> int:
    """Number of rows of a configuration."""
    return len(rows) // rows.configurations if rows.model == "camera" else 1


def _digits(own: np.ndarray, _: np.ndarray) -> np.ndarray:
    """Centimeters and millimeters typed in the other order."""
    centimeters, millimeters = (np.trunc(np.abs(own) / s) % 10 for s in (1e-2, 1e-3))
    return own + np.sign(own) * 9e-3 * (millimeters - centimeters)


LENGTHS = ("position", "point-distance")
NAMES = ("camera", "point-distance", "fixed-point")

KINDS: Mapping[str, tuple[tuple[str, ...], Spoil]] = {
    "displaced": (("position", "camera", "point-distance"), _displaced),
    "reversed joint": (INSTRUMENTS, _positions(_reversed)),
    "configuration before": (INSTRUMENTS, _positions(lambda q, before: before)),
    "half way": (INSTRUMENTS, _positions(lambda q, before: 0.9 * q + 0.1 * before)),
    "degrees for radians": (
        INSTRUMENTS,
        _positions(lambda q, _: np.remainder(np.degrees(q) + np.pi, 2 * np.pi) - np.pi),
    ),
    "joints exchanged": (
        INSTRUMENTS,
        _positions(lambda q, _: q[[0, 2, 1, *range(3, len(q))]]),
    ),
    "offset of 0.5 deg": (
        INSTRUMENTS,
        _positions(lambda q, _: q + np.radians(0.5) * (np.arange(len(q)) == 1)),
    ),
    "stale reading": (
        ("position", "camera", "point-distance"),
        _values(lambda own, before: before),
    ),
    "x, y exchanged": (("position",), _values(lambda own, _: own[:, [1, 0, 2]])),
    "sign of y": (("position",), _values(lambda own, _: own * [1, -1, 1])),
    "millimeters": (LENGTHS, _values(lambda own, _: 1e3 * own)),
    "inches": (LENGTHS, _values(lambda own, _: own / 0.0254)),
    "a digit lost": (LENGTHS, _values(lambda own, _: np.trunc(own * 10.0) / 10.0)),
    "digits exchanged": (LENGTHS, _values(_digits)),
    "zeros": (LENGTHS, _values(lambda own, _: 0.0 * own)),
    "reflector unseated 3 mm": (
        LENGTHS,
        _values(lambda own, _: own + 3e-3 / np.sqrt(own.shape[1])),
    ),
    "controller's own pose": (("position",), _own_pose),
    "another target": (NAMES, _other_target),
    "the line twice": (INSTRUMENTS, _duplicate),
    "instrument moved": (("position",), _moved),
}
"""Wrong rows by kind: instruments that can have them, and how they come about."""

LASTING = {"instrument moved"}
"""Kinds from which on all rows are wrong."""


@dataclass
class Count:
    """Wrong rows that were told, and clean ones that were accused.

    Rows that are off by less than five deviations of the prediction are apart.
    """

    told: int = 0
    wrong: int = 0
    small: int = 0
    accused: int = 0
    clean: int = 0


def _draw(number: int, model: str) -> Job:
    """A job with the usual errors of a robot, whose file states no deviations."""
    robots = ("example:ur10_robot", "space6", "pa10", "space7")
    noise = NOISE.get(model, 5e-5)
    robot = robots[number % len(robots)]
    return draw(number, robot=robot, model=model, size=1.0, noise=noise, stated=False)


def _row(number: int, model: str, kind: str, counts: Mapping[str, Count]) -> None:
    """A job with one wrong row."""
    rng, job = np.random.default_rng([47, number]), _draw(number, model)
    first = job.minimal + int(rng.integers(3, 25))
    rows = job.measured(rng, first + CLEAN + 1 + AFTER)
    size = _unit(rows)
    at = (first + CLEAN) * size
    with TemporaryDirectory() as folder:
        trial = Trial(job, rows, Path(folder))
        trial.look(first * size)
        for k in range(first + 1, first + CLEAN + 1):
            _clean(trial.look(k * size), k - 1, size, counts[kind], model)
        trial.rows = KINDS[kind][1](job, rows, at, rng)
        if kind == "displaced":
            own = slice(at, at + size)
            row = Observations.of(rows.rows(np.arange(at, at + size)))
            known = trial.watch._fitted.deviation(row)
            assert known is not None
            most = LARGEST * (900.0 if model == "camera" else 1.0)
            least = min(5.0 * known.sigma, most)
            length = float(np.exp(rng.uniform(*np.log([least, most]))))
            values = rows.values.copy()
            values[own] += length * _way(rng, values.shape[1])
            trial.rows = replace(rows, values=values)
        own = np.arange(at, at + size)
        found = trial.watch._fitted.deviation(Observations.of(trial.rows.rows(own)))
        told = _told(trial.look(at + size), at, size)
        if found is None or found.size >= 5.0 * found.sigma or kind == "the line twice":
            counts[kind].wrong += 1
            counts[kind].told += told
        else:
            counts[kind].small += 1
        if not told:
            print(f"  not told: job {number} {job.label}: {kind}, {found}", flush=True)
        for k in range(1, AFTER + 1) if kind not in LASTING else ():
            found = trial.look(at + (k + 1) * size)
            _clean(found, at // size + k, size, counts[kind], model)


def _told(events: list[Event], at: int, size: int) -> bool:
    """Whether a row, or the cause of its error, is told."""
    places = {f"row {at + k}" for k in range(size)}
    return any(
        (e.numbers.get("wrong") and e.numbers["place"] in places) or e.kind == "finding"
        for e in events
    )


def _clean(events: list[Event], k: int, size: int, count: Count, model: str) -> None:
    """Count a clean row, and whether it was accused."""
    count.clean += 1
    told = _told(events, k * size, size)
    count.accused += told
    if told:
        said = "; ".join(e.text for e in events if e.kind in ("row", "finding"))
        print(f"  accused: {model} row {k}: {said[:200]}", flush=True)


def _whole(number: int, model: str, kind: str, found: dict[str, list[str]]) -> None:
    """A job that is read wrong from the first row on."""
    rng, job = np.random.default_rng([48, number]), _draw(number, model)
    rows = job.measured(rng, NAMED)
    size, clean = _unit(rows), rows
    q, values = rows.q.copy(), rows.values.copy()
    for k in range(0, len(rows), size):
        one, own = KINDS[kind][1](job, clean, k, rng), slice(k, k + size)
        q[own], values[own] = one.q[own], one.values[own]
    rows = replace(rows, q=q, values=values)
    told = "not named"
    with TemporaryDirectory() as folder:
        trial = Trial(job, rows, Path(folder))
        for k in range(1, NAMED + 1):
            named = [e for e in trial.look(k * size) if e.kind == "finding"]
            if named:
                told = f"{named[0].numbers['code']} after {k}"
                break
    found[f"{model}: {kind}"].append(told)


WHOLE = (
    *("reversed joint", "joints exchanged", "x, y exchanged", "sign of y"),
    *("controller's own pose", "millimeters"),
)
"""Kinds that hold for all rows of a job."""


def _plan(number: int, model: str, planned_rows: int) -> tuple[float, float]:
    """Errors of rows where they were proposed, and of random ones [m]."""
    rng, job = np.random.default_rng([49, number]), _draw(number, model)
    start = max(5, -(-job.minimal // 3))
    rows = job.measured(rng, start)
    with TemporaryDirectory() as folder:
        trial = Trial(job, rows, Path(folder))
        for k in range(start, planned_rows + 1):
            trial.look(len(trial.rows))
            following = trial.watch.next
            if k == planned_rows:
                break
            q = None if following is None else following.q[None]
            new = job.measured(rng, 1, q)
            trial.rows = Measurements.concatenate([trial.rows, new])
        planned = trial.watch.fit
    with TemporaryDirectory() as folder:
        trial = Trial(job, job.measured(rng, RANDOM), Path(folder))
        trial.look(len(trial.rows))
        random = trial.watch.fit
    assert planned is not None and random is not None
    q = job.chain.random_configurations(WORKSPACE, np.random.default_rng(0))
    models = (CalibratedModel.create(f.problem, f.theta) for f in (planned, random))
    first, second = (position_error(job, model, q) for model in models)
    return first, second


def _speed() -> Iterator[str]:
    """Processor time of a new row."""
    for count in (30, 200, 2000):
        job = _draw(0, "position")
        with TemporaryDirectory() as folder:
            rows = job.measured(np.random.default_rng(1), count + 3)
            trial = Trial(job, rows, Path(folder))
            trial.look(count)
            looks = (partial(trial.look, count + k) for k in range(1, 4))
            times = [processor_time(look) for look in looks]
        yield f"a new row after {count}: {max(times):.2f} s"


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(prog="benchmark watch")
    parser.add_argument("--count", type=int, default=18)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=INSTRUMENTS)
    parser.add_argument("--planned", type=int, default=PLANNED)
    parser.add_argument("--part", choices=("rows", "jobs", "plan", "speed"))
    asked, _ = parser.parse_known_args(_words())
    models = [m for m in INSTRUMENTS if asked.only in (None, m)]
    numbers = range(asked.seed * 1000, asked.seed * 1000 + asked.count)
    if asked.part in (None, "rows"):
        _rows(numbers, models)
    if asked.part in (None, "jobs"):
        found: dict[str, list[str]] = defaultdict(list)
        cells = [(k, m) for k in WHOLE for m in models if m in KINDS[k][0]]
        for number in numbers:
            kind, model = cells[number % len(cells)]
            _whole(number, model, kind, found)
        for name, said in sorted(found.items()):
            print(f"{name:<36} {', '.join(said)}")
    if asked.part in (None, "plan"):
        for model in ("position", "camera"):
            if model in models:
                pairs = np.array(
                    [
                        _plan(n, model, asked.planned)
                        for n in numbers[: len(numbers) // 3 + 1]
                    ]
                )
                mean = 1e3 * pairs.mean(axis=0)
                print(
                    f"{model}: {asked.planned} proposed {mean[0]:.4f} mm, "
                    f"{RANDOM} random {mean[1]:.4f} mm, mean of {len(pairs)} jobs",
                    flush=True,
                )
    if asked.part in (None, "speed"):
        print(*_speed(), sep="\n")


def _rows(numbers: range, models: list[str]) -> None:
    """Wrong rows and clean ones."""
    counts: dict[str, Count] = defaultdict(Count)
    cells = [(k, m) for k, (own, _) in KINDS.items() for m in models if m in own]
    for number in numbers:
        kind, model = cells[number % len(cells)]
        _row(number, model, kind, counts)
    for kind, count in counts.items():
        print(
            f"{kind:<26} told {count.told} of {count.wrong}, clean rows accused "
            f"{count.accused} of {count.clean}, too small {count.small}"
        )
    every = [counts[kind] for kind in counts]
    told, wrong, accused, clean = (
        sum(getattr(c, name) for c in every)
        for name in ("told", "wrong", "accused", "clean")
    )
    print(f"all: told {told} of {wrong}, clean rows accused {accused} of {clean}")


def _words() -> list[str]:
    import sys

    return sys.argv[1:]
