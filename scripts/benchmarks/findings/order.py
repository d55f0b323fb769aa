"""Defects of the order of measurements in time, outliers, repetitions and noise."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks.findings.defect import NOISE, Defect, Input, given, line, told
from benchmarks.verdict.defects import exchanged, spoil
from benchmarks.verdict.jobs import MODELS, Job
from calib_pin.estimation.evidence import Finding
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Measurements

ALL = tuple(MODELS)
"""All measurement models."""

FREE = ("position", "pose", "point-distance", "relative-distance")
"""Measurement models that measure at any configuration, once at each."""


def _way(rng: np.random.Generator, size: float) -> Floats:
    way = rng.normal(size=3)
    return np.asarray(size * way / np.linalg.norm(way))


def _moved(
    job: Job, rows: Measurements, rng: np.random.Generator, size: float
) -> Input:
    """The instrument moved by so much after a third to two thirds of the file."""
    first = int(rng.integers(len(rows) // 3, 2 * len(rows) // 3))
    values = rows.values.copy()
    values[first:, :3] += _way(rng, size)

    def right(finding: Finding) -> bool:
        return abs(int(finding.evidence["line"]) - line(first - 1)) <= 2

    return given(job, replace(rows, values=values), right)


def _other_station(
    job: Job, rows: Measurements, rng: np.random.Generator, size: float
) -> Input:
    """The validation file was measured from another station."""
    later = job.measured(rng, 30)
    values = later.values.copy()
    values[:, :3] += _way(rng, size)
    validation = {"later.csv": replace(later, values=values)}
    return replace(given(job, rows), validation=validation)


def _drifting(
    job: Job, rows: Measurements, rng: np.random.Generator, size: float
) -> Input:
    """Positions drift by so much from the first line to the last."""
    values = rows.values.copy()
    values[:, :3] += np.linspace(0.0, 1.0, len(rows))[:, None] * _way(rng, size)
    return given(job, replace(rows, values=values))


def _warming(
    job: Job, rows: Measurements, rng: np.random.Generator, size: float
) -> Input:
    """The zero of a joint drifts by so much."""
    joint, q = int(rng.integers(1, 4)), rows.q.copy()
    q[:, joint] += size * np.linspace(0.0, 1.0, len(rows))
    return given(job, replace(rows, q=q), told(rows.joints[joint]))


def _rehomed(
    job: Job, rows: Measurements, rng: np.random.Generator, size: float
) -> Input:
    """The zero of a joint is another one from some measurement on."""
    joint, q = int(rng.integers(1, 4)), rows.q.copy()
    first = int(rng.integers(len(rows) // 3, 2 * len(rows) // 3))
    q[first:, joint] += size

    def right(finding: Finding) -> bool:
        near = abs(int(finding.evidence["line"]) - line(first)) <= 2
        return near and finding.evidence["joint"] == rows.joints[joint]

    return given(job, replace(rows, q=q), right)


def _single(
    job: Job, rows: Measurements, rng: np.random.Generator, size: float, count: int = 1
) -> Input:
    """Some measurements are wrong by so much."""
    index = np.sort(rng.permutation(len(rows))[:count])
    spoiled = spoil(rows, index, np.full(count, size), rng)
    if rows.model == "relative-distance":
        spoiled = replace(spoiled, values=np.abs(spoiled.values))
    return given(job, spoiled, told(*(str(line(k, rows)) for k in index.tolist())))


def _target(
    job: Job, rows: Measurements, rng: np.random.Generator, size: float
) -> Input:
    """All measurements of one target are wrong, each in its own way."""
    names = sorted(set(rows.target))
    name = names[int(rng.integers(len(names)))]
    index = np.flatnonzero(rows.target.where(name))
    spoiled = spoil(rows, index, np.full(len(index), size), rng)
    named, lines = told(name), {str(line(k, rows)) for k in index.tolist()}

    def right(finding: Finding) -> bool:
        """Whether it names the target, or nothing but measurements of it."""
        out = finding.setup.get("reading", {}).get("without", ())
        return named(finding) or (len(out) > 0 and {*map(str, out)} <= lines)

    return given(job, spoiled, right)


def _exchanged(
    job: Job, rows: Measurements, rng: np.random.Generator, pairs: int
) -> Input:
    """Pairs of measurements with each other's joint positions."""
    index = rng.permutation(len(rows))[: 2 * pairs].reshape(-1, 2).tolist()
    for first, second in index:
        rows = exchanged(rows, first, second)
    lines = [{line(k, rows) for k in pair} for pair in index]

    def right(finding: Finding) -> bool:
        """Whether all that is said to be exchanged is; of a line there may be more."""
        found = finding.setup.get("reading", {}).get("exchanged", ())
        return all({int(place) for place in pair} in lines for pair in found)

    return given(job, rows, right)


def _copied(
    job: Job, rows: Measurements, rng: np.random.Generator, count: int
) -> Input:
    """Some measurements stand in the file twice."""
    index = np.sort(rng.permutation(len(rows))[:count])
    return given(job, rows.rows(np.concatenate([np.arange(len(rows)), index])))


def _validated_by_itself(
    job: Job, rows: Measurements, rng: np.random.Generator, count: int
) -> Input:
    """The validation file holds measurements that were fitted."""
    again = rows.rows(np.sort(rng.permutation(len(rows))[:count]))
    return replace(given(job, rows), validation={"again.csv": again})


def _repeated(
    job: Job, rows: Measurements, rng: np.random.Generator, count: int
) -> Input:
    """So few configurations, each measured many times."""
    q = job.chain.random_configurations(count, rng)
    return given(job, job.measured(rng, q=q, repeats=120 // count))


def _stated(
    job: Job, rows: Measurements, rng: np.random.Generator, factor: float
) -> Input:
    """The stated standard deviations are the true ones times a factor."""
    wide = 6 if job.model == "pose" else rows.values.shape[1]
    return given(
        job, replace(rows, sigma=np.full((len(rows), wide), factor * job.noise))
    )


def _remounted(
    job: Job, rows: Measurements, rng: np.random.Generator, size: float
) -> Input:
    """The tool was mounted again so far away."""
    first = int(rng.integers(len(rows) // 3, 2 * len(rows) // 3))
    part = job.problem.only
    tool = part.error.tool.copy()
    tool.translation = tool.translation + _way(rng, size)
    error = part.error.with_frames(part.error.base, tool)
    other = replace(job.problem, terms={part.key: replace(part, error=error)})
    later = replace(job, problem=other).measured(rng, q=rows.q[first:])
    both = replace(rows, values=np.concatenate([rows.values[:first], later.values]))

    def right(finding: Finding) -> bool:
        return abs(int(finding.evidence["line"]) - line(first - 1)) <= 2

    return given(job, both, right)


def _ruler(
    job: Job, rows: Measurements, rng: np.random.Generator, part: float
) -> Input:
    """A known distance that is longer than it is said to be."""
    first, *others = job.setup.distances
    wrong = replace(first, value=(1.0 + part) * first.value)
    setup = replace(job.setup, distances=(wrong, *others))
    return replace(given(job, rows, told(first.between[0])), setup=setup)


MOVES = {"0.5 mm": 5e-4, "5 mm": 5e-3, "3 m": 3.0}


def _by_size(job: Job, size: float) -> float:
    """The cost of what moves by so much [m]."""
    return size / NOISE


def _of_the_trust(job: Job, size: float) -> float:
    """The cost of what a validation that shows nothing hides."""
    return np.inf


DEFECTS = (
    Defect("moved", MOVES, ("position", "pose"), ("instrument-moved",), _moved),
    Defect(
        "other-station",
        MOVES,
        ("position", "pose"),
        ("moved-instrument",),
        _other_station,
        cost=_by_size,
    ),
    Defect(
        "remounted",
        {"0.5 mm": 5e-4, "5 mm": 5e-3, "5 cm": 0.05},
        ("position", "pose"),
        ("tool-remounted",),
        _remounted,
    ),
    Defect(
        "drift",
        {"0.2 mm": 2e-4, "1 mm": 1e-3, "1 cm": 1e-2},
        ("position", "pose"),
        ("instrument-drift",),
        _drifting,
    ),
    Defect(
        "robot-drift",
        {"0.2 mrad": 2e-4, "1 mrad": 1e-3, "1 deg": 0.017},
        FREE[:3],
        ("robot-drift",),
        _warming,
    ),
    Defect(
        "rehomed",
        {"1 mrad": 1e-3, "0.5 deg": 0.0087, "3 deg": 0.052},
        FREE[:3],
        ("joint-rehomed",),
        _rehomed,
    ),
    Defect(
        "outlier",
        {"2 mm": 2e-3, "2 cm": 0.02, "1 m": 1.0},
        ALL,
        ("outliers",),
        _single,
    ),
    Defect(
        "outliers",
        {"2 mm": 2e-3, "2 cm": 0.02, "1 m": 1.0},
        ALL,
        ("outliers",),
        partial(_single, count=6),
    ),
    Defect(
        "target",
        {"2 mm": 2e-3, "2 cm": 0.02, "1 m": 1.0},
        ("camera", "point-distance", "plane-distance"),
        ("target", "outliers", "refused"),
        _target,
    ),
    Defect(
        "lines-exchanged",
        {"1 pair": 1, "2 pairs": 2, "4 pairs": 4},
        (*FREE[:3], "plane-distance"),
        ("measurements-exchanged",),
        _exchanged,
        also=("outliers",),
    ),
    Defect(
        "copies",
        {"3": 3, "20": 20, "60": 60},
        (*FREE, "plane-distance", "camera"),
        ("copied-measurements",),
        _copied,
        cost=_of_the_trust,
    ),
    Defect(
        "copy-as-validation",
        {"20": 20, "40": 40, "60": 60},
        (*FREE, "plane-distance", "fixed-point"),
        ("repeated-validation",),
        _validated_by_itself,
        also=("copied-measurements",),
        cost=_of_the_trust,
    ),
    Defect(
        "repeats-only",
        {"3": 3, "6": 6, "12": 12},
        ("position", "pose"),
        ("few-configurations",),
        _repeated,
        ("joints-move-together",),
    ),
    Defect(
        "sigma",
        {"x 0.1": 0.1, "x 5": 5.0, "x 100": 100.0},
        FREE,
        ("noise",),
        _stated,
        cost=_of_the_trust,
    ),
    Defect(
        "ruler",
        {"1 %": 0.01, "4 %": 0.04, "20 %": 0.2},
        ("fixed-point",),
        ("known-distance", "scale"),
        _ruler,
    ),
)
