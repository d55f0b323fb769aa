"""A defect of a user's data, and the measurements that it spoils."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.verdict.jobs import ROBOTS, Job, draw
from calib_pin.estimation.evidence import Finding
from calib_pin.io.measurements import write_measurements
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Measurements, Observations
from calib_pin.setup import Setup

ROBOT = "example:ur10_robot"
"""A robot like the one of the issue."""

CONFIGURATIONS = 60
"""Fewest measured configurations, as many as in the issue."""

NOISE = 1e-4
"""Standard deviation of lengths [m] and angles [rad], as in the issue."""

FILE = "measured.csv"
"""Name of the only file."""

MEASURED = "measured_"
"""Beginning of the names of columns that hold the true joint positions."""

PIXEL = 0.1
"""The same of an image [px]."""


@dataclass(frozen=True)
class Input:
    """What a user hands over.

    Attributes:
        files: Measurements, or the text of a file, by its name.
        setup: The user's setup.
        validation: Further files, for validation.
        right: Whether a finding with a right code also says the right thing, such as
            the joint, the line or the factor.
        robot: Another robot than that of the job.
        columns: What the joint columns hold, by joint positions of shape (N, n).
    """

    files: Mapping[str, Measurements | Observations | str]
    setup: Setup
    validation: Mapping[str, Measurements | Observations | str] = field(
        default_factory=dict
    )
    right: Callable[[Finding], bool] = lambda finding: True
    robot: str = ROBOT
    columns: Callable[[Floats], Floats] = lambda q: q


def usual(job: Job, rng: np.random.Generator) -> Measurements:
    """Measurements at random configurations, enough of them."""
    return job.measured(rng, max(CONFIGURATIONS, 3 * job.minimal))


def half_range(job: Job, rng: np.random.Generator) -> Measurements:
    """Measurements at random configurations in the middle half of every joint's range.

    Sums of joint positions then stay within the two turns that files may state.
    """
    count, chain = max(CONFIGURATIONS, 3 * job.minimal), job.chain
    middle, half = (chain.lower + chain.upper) / 2, (chain.upper - chain.lower) / 4
    shape = (count, len(chain.joints))
    return job.measured(rng, q=middle + half * rng.uniform(-1.0, 1.0, shape))


def one_path(job: Job, rng: np.random.Generator) -> Measurements:
    """Measurements along smooth motions through the workspace."""
    count = max(2 * CONFIGURATIONS, 5 * job.minimal)
    chain, t = job.chain, np.linspace(0.0, 1.0, count)[:, None]
    wave = np.zeros((count, len(chain.joints)))
    for turns in (1.0, 2.0, 3.0):
        phase = rng.uniform(0.0, 2.0 * np.pi, wave.shape[1])
        wave += 0.3 * np.sin(2.0 * np.pi * turns * t + phase)
    middle, half = (chain.lower + chain.upper) / 2, (chain.upper - chain.lower) / 2
    return job.measured(rng, q=middle + half * wave)


@dataclass(frozen=True)
class Defect:
    """A defect of three sizes.

    Attributes:
        name: Its name.
        sizes: Three sizes by how they are told, such as `5 mm`.
        models: Measurement models that can have it.
        codes: Codes of findings that name it rightly, of any severity; `refused` where
            the reader may refuse it with a message that satisfies `Input.right`.
        spoil: Input with the defect, by the job, its clean measurements, a random
            generator and the size.
        also: Codes of other findings that are true then as well.
        measured: Clean measurements of a job.
        cost: The cost of a size in standard deviations of the noise, where the robot
            that is calibrated does not show it.
    """

    name: str
    sizes: Mapping[str, Any]
    models: tuple[str, ...]
    codes: tuple[str, ...]
    spoil: Callable[[Job, Measurements, np.random.Generator, Any], Input]
    also: tuple[str, ...] = ()
    measured: Callable[[Job, np.random.Generator], Measurements] = usual
    cost: Callable[[Job, Any], float] | None = None

    @property
    def cells(self) -> tuple[tuple[str, str], ...]:
        """Models and sizes that take turns."""
        return tuple((model, size) for size in self.sizes for model in self.models)


@cache
def job_of(seed: int, model: str) -> Job:
    """The job of a seed: the robot of the issue, 3 mm off, with an instrument."""
    noise = PIXEL if model == "camera" else NOISE
    job = draw(
        seed, robot=ROBOT, model=model, size=1.0, noise=noise, stated=False, least=60
    )
    base, tip = ROBOTS[ROBOT]
    return replace(job, setup=replace(job.setup, model=model, base=base, tip=tip))


def given(
    job: Job,
    rows: Measurements | Observations | str,
    right: Callable[[Finding], bool] = lambda finding: True,
) -> Input:
    """One file, and the setup of a job."""
    return Input({FILE: rows}, job.setup, right=right)


def told(*words: str) -> Callable[[Finding], bool]:
    """Whether a finding says all words, in its sentence, numbers or setup lines."""

    def right(finding: Finding) -> bool:
        text = f"{finding.message} {finding.evidence} {finding.remedy} {finding.setup}"
        return all(word in text for word in words)

    return right


def line(measurement: int, rows: Measurements | None = None) -> int:
    """Line of a measurement in its file, by its number from 0; a header precedes.

    And where each target is measured from, if measurements are relative.
    """
    begun = 0
    if rows is not None and rows.start.size:
        begun = len(set(rows.target[: measurement + 1]))
    return measurement + 2 + begun


def text_of(rows: Measurements | Observations) -> str:
    """Measurements as the text of a file."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "rows.csv"
        write_measurements(path, rows)
        return path.read_text(encoding="utf-8")
