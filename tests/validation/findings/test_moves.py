"""Moves are found in the order of the files, and nothing else passes for one."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.fit import fit_model
from calib_pin.kinematics.chain import Chain
from calib_pin.observations import Observations
from calib_pin.setup import Setup
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.moves import OPTIONS, moved

DATA = Path(
    os.environ.get("CALIB_PIN_DATA", Path(__file__).parents[2] / "shared" / "data")
)
needs_data = pytest.mark.skipif(
    not DATA.is_dir(), reason=f"no real measurements in {DATA} (CALIB_PIN_DATA)"
)


def found(chain: Chain, data: Observations) -> list[tuple[str, int]]:
    """Kind and place of each move, in their order."""
    fitted = fit_model(chain, data, Setup(), 0).fit
    pair = moved(Case.of(fitted, fitted.problem.chains))
    return [] if pair is None else sorted((m.kind, m.rank) for m in pair[1].moves)


@pytest.mark.parametrize("step", [None, 1e-3])
@pytest.mark.parametrize(
    ("stations", "tools"),
    [
        ((30, 60), (45,)),
        ((40,), ()),
        ((), (50,)),
        # Both at once.
        ((30, 60), (30,)),
        # Two tools in turn: no single one of their changes explains much.
        ((), (20, 40, 60)),
    ],
)
def test_moves_are_found(moved_job, stations, tools, step) -> None:
    job = moved_job(stations, tools, step=step)
    expected = [("station", k) for k in stations] + [("tool", k) for k in tools]
    assert found(job.chain, job.plain) == expected


def test_moves_of_poses_are_found(moved_job) -> None:
    job = moved_job((30,), (60,), model="pose")
    assert found(job.chain, job.plain) == [("station", 30), ("tool", 60)]


def test_what_is_said_is_not_found(moved_job) -> None:
    job = moved_job()
    assert found(job.chain, job.named) == []


def test_a_move_within_a_station_that_is_named(moved_job) -> None:
    job = moved_job((30, 60), ())
    blocks = [
        replace(block, station={"s0": "day1"}.get(block.station, "day2"), tool="")
        for block in job.named.blocks
    ]
    assert found(job.chain, Observations.of(*blocks)) == [("station", 60)]


def test_the_order_is_that_of_the_files(moved_job) -> None:
    job = moved_job((40,), ())
    order = np.random.default_rng(0).permutation(len(job.plain))
    mixed = Observations.of(job.plain.only.rows(order))
    assert found(job.chain, mixed) == [("station", 40)]


def test_few_configurations_are_no_part(moved_job) -> None:
    least = OPTIONS.configurations
    job = moved_job((60 - least + 1,), (), 60)
    assert ("station", 60 - least + 1) not in found(job.chain, job.plain)


def clean(moved_job, seed: int) -> tuple[Chain, Observations]:
    """A job without a move, but with one of the errors that real ones have."""
    rng = np.random.default_rng(seed)
    count = int(rng.choice([15, 30, 60, 120]))
    job = moved_job((), (), count, seed, model=("position", "pose")[seed % 2])
    block, lines = job.plain.only, np.arange(count) + 2
    if seed % 5 in (1, 3):  # Sorted, as jogged paths are.
        order = np.argsort(block.q[:, seed % 3])
        block = replace(block.rows(order), lines=lines)
    if seed % 5 in (2, 3):  # Gears that no parameter describes.
        waves = 2e-3 * rng.normal(size=6) * np.sin(2 * block.q + rng.uniform(0, 6, 6))
        block = replace(block, q=block.q + waves)
    if seed % 5 == 4:  # A drift, and outliers.
        values = block.values.copy()
        drift = np.linspace(0.0, 3.0, count)[:, None] * 5e-5 * rng.normal(size=3)
        values[:, :3] += drift
        values[rng.choice(count, count // 15), :3] += 0.05
        block = replace(block, values=values)
    return job.chain, Observations.of(block if seed % 3 else replace(block, sigma=None))


@pytest.mark.parametrize("seed", range(10))
def test_no_false_alarm(moved_job, seed: int) -> None:
    assert found(*clean(moved_job, seed)) == []


@pytest.mark.slow
def test_no_false_alarm_in_200_jobs(moved_job) -> None:
    assert [s for s in range(200) if found(*clean(moved_job, s))] == []


REAL = {
    "ur10_tmac/train.csv": ("ur10_robot", "base_link", "tool0"),
    "ur10_tmac_b/train.csv": ("ur10_robot", "base_link", "tool0"),
    "ur5_tracker/train.csv": ("ur5_robot", "base_link", "tool0"),
    "tiago/train.csv": ("tiago_no_hand", None, "wrist_ft_tool_link"),
    "talos_left_arm/measurements.csv": (
        "talos_reduced",
        None,
        "gripper_left_base_link",
    ),
    "mukca_panda/panda_1.csv": ("panda", None, "panda_link8"),
}


def measured(file: str) -> tuple[Chain, Observations]:
    robot, base, tip = REAL[file]
    chain = calib_pin.load_chain(f"example:{robot}", base=base, tip=tip)
    model = "fixed-point" if "panda" in file else "position"
    rows = calib_pin.read_measurements(DATA / file, chain, model=model)
    return chain, Observations.of(rows)


@needs_data
@pytest.mark.parametrize("file", REAL)
def test_no_false_alarm_on_real_robots(file: str) -> None:
    assert found(*measured(file)) == []


@needs_data
def test_a_real_tracker_that_stood_elsewhere() -> None:
    chain, first = measured("ur10_tmac/train.csv")
    _, second = measured("ur10_tmac_b/train.csv")
    fitted = fit_model(chain, Observations.of(first, second), Setup(), 0).fit
    pair = moved(Case.of(fitted, fitted.problem.chains))
    assert pair is not None
    (move,) = pair[1].moves
    # Every third or fourth measurement is looked at; findings name the very line.
    assert move.kind == "station" and 0 <= move.rank - len(first) < 4
