"""Axes of positions that are exchanged, negated or mirrored."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calib_pin.measurement_models.readings import read_otherwise
from calib_pin.observations import Observations
from calib_pin.setup import FrameSetup, ReadingSetup, Setup
from calib_pin.validation.findings.axes import axes
from calib_pin.validation.findings.explanations import explain
from calib_pin.validation.findings.hypotheses import finding

Job = Callable[..., Any]


def held(data: Observations, names: Sequence[str]) -> Observations:
    """Measurements whose columns x, y and z hold other axes."""
    (block,) = data.blocks
    values = block.values.copy()
    for column, name in enumerate(names):
        sign = -1.0 if name.startswith("-") else 1.0
        values[:, column] = sign * block.values[:, "xyz".index(name[-1])]
    return Observations.of(replace(block, values=values))


@pytest.fixture(scope="module")
def found(quick_case: Job) -> Job:
    """The findings of a job's measurements."""

    def find(job: Any, data: Observations, setup: Setup | None = None) -> list[Any]:
        case = quick_case(job.chain, data, setup)
        explanation = explain(case, (axes,))
        return [] if explanation is None else list(finding(case, explanation))

    return find


@pytest.mark.parametrize("names", [("y", "x", "z"), ("x", "-y", "z")])
def test_a_left_handed_frame(found: Job, moved_job: Job, names: Sequence[str]) -> None:
    """Without orientations one mirrored frame is as good as another one."""
    job = moved_job((), (), 40)
    spoiled = held(job.plain, names)
    (one,) = found(job, spoiled)
    assert (one.code, one.severity) == ("left-handed-frame", "error")
    reading = ReadingSetup(axes=tuple(one.setup["reading"]["axes"]))
    again = read_otherwise(spoiled, reading).only.values
    a, b = (v - v.mean(axis=0) for v in (again, job.plain.only.values))
    # A rotation brings one to the other, and no mirror is needed.
    assert np.linalg.det(a.T @ b) > 0.0


def test_a_turned_frame_of_positions_is_no_fault(found: Job, moved_job: Job) -> None:
    job = moved_job((), (), 40)
    assert found(job, held(job.plain, ("y", "z", "x"))) == []


@pytest.mark.parametrize(
    ("names", "code"),
    [
        (("y", "z", "x"), "axes-exchanged"),
        (("-x", "-y", "z"), "axes-negated"),
        (("y", "x", "z"), "axes-exchanged"),
        (("-x", "-y", "-z"), "left-handed-frame"),
    ],
)
def test_orientations_tell_the_axes(
    found: Job, moved_job: Job, names: Sequence[str], code: str
) -> None:
    job = moved_job((), (), 30, model="pose")
    (one,) = found(job, held(job.plain, names))
    assert one.code == code and one.setup == {"reading": {"axes": list(names)}}
    assert ", ".join(names) in one.message or code == "left-handed-frame"


def test_a_known_base_tells_the_axes(found: Job, moved_job: Job) -> None:
    job = moved_job((), (), 30)
    where = job.truth.stations["s0"]
    setup = Setup(base_frame=FrameSetup(where.xyz, where.rpy, estimate=False))
    (one,) = found(job, held(job.plain, ("y", "z", "x")), setup)
    assert one.setup == {"reading": {"axes": ["y", "z", "x"]}}
