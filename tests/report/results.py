"""Calibrations of every kind, and what tests change of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

import calib_pin
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.measurement_models import Quantity
from calib_pin.observations import BlockKey, Observations
from calib_pin.report.text import format_report
from calib_pin.setup import (
    AnchorSetup,
    CameraSetup,
    DistanceSetup,
    FrameSetup,
    Payload,
    PointSetup,
    Setup,
    SolverSetup,
    ToolSetup,
)
from calib_pin.validation.result import (
    CalibrationResult,
    Candidate,
    ModelSelection,
    QuantityError,
    Validation,
)
from tests.shared import chain_of, joint, simulated, urdf_of

OFFSETS = ("joint-offset",)

SEEN = Setup(
    parameters=OFFSETS,
    base_frame=FrameSetup((0.1, -0.2, 3.0), (0.3, -0.2, 0.4), estimate=True),
    camera=CameraSetup("world", (900.0, 910.0), (640.0, 500.0), estimate=True),
    targets={
        f"m{k}": PointSetup((0.1 * (k % 2), 0.08 * (k // 2), 0.1)) for k in range(4)
    },
)
"""A camera that stands still looks at a board of four marks."""


SIZES = [(QuantityError("position", "m", size, size),) for size in (2e-3, 1e-4)]
LADDER = ModelSelection(
    "geometric",
    "near",
    {},
    (
        Candidate("joint offset", (), None, 7, SIZES[0], 20.0, 2.0, True),
        Candidate("geometric", (), None, 34, SIZES[1], 1.0, 0.1, True),
        Candidate("+ compliance", (), None, reason="no masses"),
    ),
)


def arm(name: str, *joints: str) -> Chain:
    """Three joints; names of the robot and of the joints as they stand in XML."""
    first, second, third = joints
    text = urdf_of(
        joint(first, "base a", "0 0 0.4", limits="-2.5 2.5"),
        joint(second, "a b", "0.1 0.3 0", "0 1 0", limits="-2 2"),
        joint(third, "b c", "0.5 0 0.05;0.5 0.1 0", kind="prismatic", limits="0 0.4"),
        name=name,
    )
    return chain_of(text)


def full_report(result: CalibrationResult) -> str:
    """The report with all details."""
    return format_report(result, details=True)


def solve(
    names: tuple[str, ...] = ("arm", "j1", "j2", "j3"),
    model: str = "pose",
    setup: Setup | None = None,
    count: int = 30,
    **options: Any,
) -> CalibrationResult:
    """A calibration of an arm."""
    problem, _ = simulated(model, setup, count, 1.0, 1, robot=arm(*names), noise=None)
    return calib_pin.calibrate(problem.chains, problem.data, setup, **options)


# --- of every kind -----------------------------------------------------------------


def drawn(robot: Any, model: Any, setup: Setup, count: int) -> Observations:
    return simulated(model, setup, count, 1.0, 3, robot=robot, noise=None)[0].data


def several_blocks(make: Callable[..., Any]) -> CalibrationResult:
    """Two stations, two tools and a held-out third station."""
    chain = calib_pin.load_chain("space6")
    setup = Setup(
        parameters=OFFSETS,
        stations={
            "day1": FrameSetup((2.0, 1.0, 0.3), (0.1, 0.2, 1.2)),
            "day2": FrameSetup((-1.0, 0.5, 0.1), (0.0, -0.1, 0.4)),
        },
        tools={"ball": ToolSetup((0.0, 0.1, 0.05))},
    )
    keys = [
        BlockKey("position", "", "day1", "probe"),
        BlockKey("pose", "", "day2", "ball"),
        BlockKey("position", "", "day2", "probe"),
    ]
    rows = drawn(chain, keys, setup, 120)
    first, second, third = rows.blocks
    later = replace(third.rows(slice(20, None)), station="day3")
    data = Observations((first, second, third.rows(slice(20))))
    return calib_pin.calibrate(chain, data, setup, validation=later)


def two_hands(make: Callable[..., Any]) -> CalibrationResult:
    chain = calib_pin.load_chain("example:talos_reduced", tip="arm_left_7_link")
    names = ("arm_left_7_link", "arm_right_7_link")
    chains, setup = Chains(chain.robot, names=names), Setup(parameters=OFFSETS)
    rows = drawn(chains, [BlockKey("pose", name) for name in names], setup, 80)
    return calib_pin.calibrate(chains, rows, setup)


@cache
def lost_motion(make: Callable[..., Any]) -> CalibrationResult:
    """Sides that no file states, and a warm robot."""
    chain = calib_pin.load_chain("space6")
    setup = Setup(
        parameters=("placement", "hysteresis"), tool_frame=FrameSetup((0.1, 0.05, 0.1))
    )
    rows = drawn(chain, "position", setup, 40).only
    warmth = np.random.default_rng(4).uniform(20.0, 30.0, len(rows))
    held = replace(rows.conditions, source="order", temperature=warmth)
    rows = replace(rows, conditions=held)
    return calib_pin.calibrate(chain, rows, setup, holdout=0.25)


def corrections(make: Callable[..., Any]) -> CalibrationResult:
    setup = Setup(
        parameters=("placement", "transmission", "compliance"),
        payloads={"p": Payload(6.0, (0.0, 0.0, 0.1))},
    )
    return make("pose", setup, 60, robot="pa10", noise=None, holdout=0.25)


def distances(make: Callable[..., Any]) -> CalibrationResult:
    places = {"a": (1.4, 0.9, 0.2), "b": (1.4, -0.9, 0.2), "c": (-1.0, 0.2, 1.4)}
    setup = Setup(
        parameters=OFFSETS,
        tool_frame=FrameSetup((0.02, 0.03, 0.1)),
        anchors={
            name: AnchorSetup(xyz, estimate_bias=True) for name, xyz in places.items()
        },
        distances=(DistanceSetup(("a", "b"), 1.8001, 1e-4),),
    )
    return make("point-distance", setup, 120, noise=None, holdout=0.25)


def learned(make: Callable[..., Any]) -> CalibrationResult:
    chain = calib_pin.load_chain("space6")
    rows = drawn(chain, "pose", Setup(), 60).only
    values = rows.values.copy()
    values[:, :3] += 2e-3 * np.sin(3.0 * rows.q[:, 1:4])
    setup = Setup(parameters=OFFSETS, learned="gaussian-process")
    return calib_pin.calibrate(chain, replace(rows, values=values), setup)


def search(make: Callable[..., Any]) -> CalibrationResult:
    """A selected model, and one that a search has found."""
    setup = Setup(parameters=OFFSETS, solver=SolverSetup(name="hybrid"))
    return replace(make("position", setup, 40), model_selection=LADDER)


def camera(make: Callable[..., Any]) -> CalibrationResult:
    return make("camera", SEEN, 60, noise=None, holdout=0.25)


KINDS: dict[str, Callable[[Callable[..., Any]], CalibrationResult]] = {
    "blocks": several_blocks,
    "hands": two_hands,
    "lost motion": lost_motion,
    "corrections": corrections,
    "distances": distances,
    "camera": camera,
    "learned": learned,
    "search": search,
}
"""Calibrations of every kind, each made by the fixture `calibrated_robot`."""


# --- changed -----------------------------------------------------------------------


def changed(result: CalibrationResult, **changes: Any) -> CalibrationResult:
    """A result with other values, each in the group that holds it."""
    inner = {key: changes[key] for key in changes if not hasattr(result, key)}
    accuracy = {key: inner[key] for key in inner if hasattr(result.accuracy, key)}
    if accuracy:
        changes["accuracies"] = {"": replace(result.accuracy, **accuracy)}
    for name in ("statistics", "solver", "validation", "identifiability"):
        part = changes.get(name, getattr(result, name))
        own = {key: inner[key] for key in inner if hasattr(part, key)}
        changes[name] = replace(part, **own)
    return replace(result, **{k: v for k, v in changes.items() if k not in inner})


def with_rows(result: CalibrationResult, index: Any) -> CalibrationResult:
    """A result with some of its rows, or with more, fitted and held out."""
    fitted, names = result.fitted, ("before", "after", "sigma", "points", "leverage")
    parts = {name: getattr(fitted, name)[index] for name in names}
    taken = replace(fitted, rows=fitted.rows.rows(index), **parts)
    return changed(result, fitted=taken, held_out=taken, outliers=())


def with_errors(result: CalibrationResult, **errors: Any) -> CalibrationResult:
    """A result with other errors of its fitted rows; a number stands for all."""
    shape = result.fitted.after.shape
    arrays = {k: np.broadcast_to(v, shape).copy() for k, v in errors.items()}
    return replace(result, fitted=replace(result.fitted, **arrays), held_out=None)


def in_pixels(result: CalibrationResult) -> CalibrationResult:
    """A result whose errors have no direction in space."""
    pixels = Quantity("pixel", "px", slice(0, 2), 0.5)
    fitted = replace(result.fitted, quantities=(pixels,))
    return replace(result, fitted=fitted, held_out=fitted)


def with_stations(result: CalibrationResult, count: int) -> CalibrationResult:
    """A result whose fitted measurements come from stations in turn, some from each."""
    (block,) = result.fitted.rows.blocks
    shares = np.array_split(np.arange(len(block)), count)
    parts = [
        replace(block.rows(own), station=f"day{k}") for k, own in enumerate(shares)
    ]
    rows = Observations(tuple(parts))
    fitted = replace(result.fitted, rows=rows)
    return replace(result, fitted=fitted, held_out=None)


def without(result: CalibrationResult) -> CalibrationResult:
    """A result of which only the rows are left."""
    return changed(
        result,
        tip=None,
        verdict="untrusted",
        parameters=(),
        groups=(),
        covariance=np.zeros((0, 0)),
        sigma0=np.nan,
        noise=(),
        held_out=None,
        validation=Validation("none", 0),
        singular_values=(),
        structural_values=(),
        gap=np.inf,
        history=(),
        model_selection=None,
    )
