"""What would tell more of a robot: counts by the structure, and what they promise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import calib_pin
from calib_pin.planning.suggestions import calibrated_setup, suggestions
from calib_pin.setup import FrameSetup, PlaneSetup, PointSetup, Setup

CHAIN = calib_pin.load_chain("space6")
BASE = FrameSetup((0, 0, 0), (0, 0, 0), estimate=False)
TOOL = FrameSetup((0.1, 0.05, 0.2), (0.1, 0.2, 0.3), estimate=False)


BESIDE = Setup(tool_frame=replace(TOOL, estimate=True))
"""A tool that is estimated, and known to sit beside the last axis."""


def found(model: str, setup: Setup) -> dict[str, int]:
    known = calib_pin.identify(CHAIN, model, setup)
    return {r.change: r.count for r in suggestions(CHAIN, model, setup, known)}


def test_counts_by_the_structure() -> None:
    """A target on the last axis hides two errors, full poses show two as well."""
    known = calib_pin.identify(CHAIN, "position")
    assert known.identifiability.robot_rank == 16
    gains = found("position", Setup())
    assert [*gains.values()] == [18, 18, 22, 17, 26]
    _, _, base, tool, last = gains
    assert "frames.base" in base and "frames.tool" in tool and "full poses" in last
    # Where a target sits beside the axis already, poses alone show no more.
    assert [*found("position", BESIDE).values()] == [24, 20, 26]
    # Of joint offsets the last is seen by full poses with a known tool alone.
    gains = [*found("position", Setup(parameters=("joint-offset",))).values()]
    assert gains[-1] == 6 > max(gains[:-1])


@pytest.mark.parametrize("model", ["position", "relative-distance", "plane-distance"])
def test_all_that_can_be_told_is_last(model: str) -> None:
    """However it is measured now: that is the robot's, not the instrument's."""
    planes = {"wall": PlaneSetup((0.1, 0.2, 1.0), -3.0)}
    setup = replace(BESIDE, planes=planes if model == "plane-distance" else {})
    known = calib_pin.identify(CHAIN, model, setup)
    *others, last = suggestions(CHAIN, model, setup, known)
    assert last.count == 26 and last.complete
    assert all(known.identifiability.robot_rank < other.count for other in others)
    assert not any(remedy.complete for remedy in others)


def test_points_on_the_tool_take_the_place_of_its_frame() -> None:
    """They stay what is measured where something else is known."""
    places = ((0.1, 0.0, 0.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.1))
    points = {f"p{k}": PointSetup(xyz, True) for k, xyz in enumerate(places)}
    gains = found("position", Setup(targets=points))
    known = calib_pin.identify(
        CHAIN, "position", Setup(targets=points, base_frame=BASE)
    )
    base = next(count for change, count in gains.items() if "frames.base" in change)
    assert base == known.identifiability.robot_rank
    assert any("(targets)" in change for change in gains)
    assert not any("frames.tool" in c or "beside" in c for c in gains)


def test_a_fit_is_taken_as_it_found_things() -> None:
    chain = calib_pin.load_chain("heavy6")
    setup = calib_pin.read_setup(calib_pin.robot_file("heavy6", "setup.yaml"))
    file = calib_pin.robot_file("heavy6", "measurements.csv")
    rows = calib_pin.read_measurements(file, chain)
    result = calib_pin.calibrate(chain, rows, setup, validate=False)
    stood = calibrated_setup(result.model)
    term = result.model.only
    references = {f.name: f for f in term.measurement.references}
    assert stood.targets.keys() == references.keys()
    for name, point in stood.targets.items():
        assert point.xyz == pytest.approx(references[name].stated().xyz)
    base = stood.base_frame
    assert base.estimate and base.xyz == pytest.approx(term.error.base.translation)
    changes = [r.change for r in suggestions(chain, rows.keys, stood, result)]
    assert any("(targets)" in change for change in changes)

    # Of images that were read wrong a fit may end thousands of kilometers away.
    far = term.error.with_frames(pin.SE3(np.eye(3), np.full(3, 4e6)), term.error.tool)
    lost = {key: replace(term, error=far) for key in result.model.terms}
    assert calibrated_setup(replace(result.model, terms=lost)) == result.model.setup


def test_what_becomes_identifiable() -> None:
    """The names are those of an analysis in which the frame is known."""
    setup = Setup()
    now = calib_pin.identify(CHAIN, "pose", setup)
    base = next(
        r for r in suggestions(CHAIN, "pose", setup, now) if "frames.base" in r.change
    )
    then = calib_pin.identify(CHAIN, "pose", Setup(base_frame=BASE))
    known = {p.name for p in now.parameters if p.status == "identifiable"}
    gained = {p.name for p in then.parameters if p.status == "identifiable"} - known
    assert set(base.parameters) == gained
    assert any(name.startswith("joint_1.placement") for name in gained)


def test_nothing_is_left_to_gain_where_all_is_known() -> None:
    assert found("pose", Setup(base_frame=BASE, tool_frame=TOOL)) == {}


def test_what_is_held_stays_held() -> None:
    """Globs of the setup hold here too, those of the instrument name nothing."""
    setup = Setup(
        planes={"wall": PlaneSetup((0.1, 0.2, 1.0), -3.0)},
        tool_frame=TOOL,
        fixed=("wall.plane.*", "joint_[1-5].placement.*"),
    )
    gains = found("plane-distance", setup)
    assert all(count <= 6 for count in gains.values())
