"""The block that is meant, and how exactly its frame and point are known."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest

from calib_pin.calibration import calibrate
from calib_pin.control.calibrated import block_of, ends_known, kinematics
from calib_pin.control.compensation import compensate
from calib_pin.errors import InputError, OptionError
from calib_pin.kinematics.chain import Chain
from calib_pin.observations import BlockKey
from calib_pin.setup import FrameSetup, Payload, PlaneSetup, Setup
from calib_pin.validation.calibrated_model import CalibratedModel
from tests.shared import refused, simulated

FRAMES = Setup(
    base_frame=FrameSetup((0.3, -0.2, 0.5), (0.1, -0.05, 0.4)),
    tool_frame=FrameSetup((0.1, 0.05, 0.2)),
)
GIVEN = Setup(
    base_frame=replace(FRAMES.base_frame, estimate=False),
    tool_frame=replace(FRAMES.tool_frame, estimate=False),
)
SEEDS = range(3)

LEFT = [BlockKey("position", "left", day, "probe") for day in ("day 1", "day 2")]
RIGHT = [BlockKey("position", "right", "day 2", tool) for tool in ("probe", "ball")]
POST = BlockKey("position", "world", "day 1")


@pytest.mark.parametrize(
    ("named", "found"),
    [
        (("left",), LEFT[0]),
        (("left", "day 2"), LEFT[1]),
        (("right", None, "ball"), RIGHT[1]),
        # Several chains; none of this name; not measured at this station.
        ((), "--chain"),
        (("rihgt",), "'rihgt'"),
        (("right", "day 1"), "'day 1'"),
        (("right", None, "bal"), "'bal'"),
        (("world",), "'world'"),
    ],
)
def test_names_say_which_block_is_meant(named, found):
    terms = dict.fromkeys([POST, *LEFT, *RIGHT])
    model = SimpleNamespace(terms=terms, measured_chains=("left", "right"))
    if isinstance(found, BlockKey):
        assert block_of(model, *named) == found
    else:
        with pytest.raises(OptionError, match=found):
            block_of(model, *named)


def only(result):
    (key,) = result.model.terms
    return key


@pytest.mark.parametrize(
    ("frame", "point"), [("base", "tool"), ("base", "tip"), ("measuring", "tip")]
)
def test_deviations_are_those_of_the_true_robot(calibrated_robot, frame, point):
    """The mean square of what several robots are off is what is told of them."""
    squares = np.zeros((2, len(SEEDS)))
    for seed in SEEDS:
        job = "pose", FRAMES, 40, 1.0, seed
        problem, theta = simulated(*job, noise=3e-5)
        result = calibrated_robot(*job, noise=3e-5, validate=False)
        said = ends_known(result, only(result), frame, point)
        (told,) = re.findall(r"\+- ([0-9.]+) mm", said)
        true = CalibratedModel.create(problem, theta).of()
        q = true.chain.random_configurations(50, np.random.default_rng(1))
        ways = (
            kinematics(m, frame=frame, point=point) for m in (true, result.model.of())
        )
        first, second = (way(q)[0][:, :3, 3] for way in ways)
        off = 1e3 * np.linalg.norm(first - second, axis=1)
        squares[:, seed] = np.mean(off**2), float(told) ** 2
    # Six directions or so of each robot: a factor of three has a chance of one in 100.
    ratio = np.sqrt(np.divide(*squares.mean(axis=1)))
    assert 1.0 / 3.0 < ratio < 3.0


def test_nothing_is_said_where_nothing_matters(calibrated_robot):
    result = calibrated_robot("pose", FRAMES, 40, 1.0, 0, noise=3e-5, validate=False)
    assert ends_known(result, only(result)) == ""
    result = calibrated_robot("pose", GIVEN, 40, 1.0, 0, noise=3e-5, validate=False)
    for frame, point in product(("base", "measuring"), ("tool", "tip")):
        assert ends_known(result, only(result), frame, point) == ""


def test_what_is_unknown_is_refused(scara, calibrated_robot):
    """Base and tool along parallel axes: their sum is known, and the robot."""
    result = calibrated_robot("pose", FRAMES, 40, 1.0, 1, robot=scara, noise=5e-5)
    for frame, point, whose in (
        ("base", "tool", "z of the tool"),
        ("measuring", "tip", "z of the base"),
    ):
        with refused(OptionError, reason=(whose, "fixed: [tool.frame.z]")):
            ends_known(result, only(result), frame, point)
    assert ends_known(result, only(result)) == ""
    assert " mm and " in ends_known(result, only(result), "base", "tip")


def test_a_point_that_the_measurements_do_not_show(scara, calibrated_robot):
    """Points tell nothing of the turn about them of a link that slides."""
    job = "position", GIVEN, 40, 1.0, 0
    slide = Chain(scara.robot, "l0", "l3")
    result = calibrated_robot(*job, robot=slide, noise=3e-5, validate=False)
    said = ends_known(result, only(result), "base", "tip")
    assert "do not show" in said and " mm and " in said
    assert ends_known(result, only(result), "base", "tool") == ""


def test_estimated_planes_leave_open_where_the_robot_stands(calibrated_robot):
    """They move with the errors of the first joint, and targets with them."""
    plane, known = PlaneSetup((0.0, 0.0, 1.0), 0.5), FrameSetup((0.0, 0.0, 0.1))
    planes = {"floor": plane, "wall": PlaneSetup((-1.0, 0.1, 0.0), 1.6)}
    planes["side"] = PlaneSetup((0.0, -1.0, 0.1), 1.5)
    setup = Setup(planes=planes, tool_frame=known)
    result = calibrated_robot("plane-distance", setup, 80, noise=3e-5)
    assert result.verdict == "good"
    said = ends_known(result, only(result))
    (told,) = re.findall(r"\+- ([0-9.]+) mm", said)
    assert "do not show" in said
    assert float(told) > 5e3 * result.accuracy.workspace.calibrated.position


def test_of_several_payloads_the_one_that_is_named_counts():
    """Nothing is guessed, and what is named is asked for nowhere else."""
    loads = {"light": Payload(1.0, (0, 0, 0.1)), "heavy": Payload(9.0, (0, 0, 0.1))}
    setup = replace(FRAMES, parameters=("joint-offset", "compliance"), payloads=loads)
    problem, theta = simulated("pose", setup, 40, 1.0, noise=3e-5)
    chain, rows = problem.chains[""], problem.data
    result = calibrate(chain, rows, problem.setup, validate=False)
    true, model = CalibratedModel.create(problem, theta).of(), result.model.of()
    q = chain.random_configurations(20, np.random.default_rng(1))
    with refused(InputError, reason="several payloads"):
        result.predict(q)
    with refused(OptionError, reason="haevy", allowed="light, heavy, none"):
        model.carrying("haevy")
    assert "mm" in ends_known(result, only(result), "base", "tool")
    for name in ("light", "heavy", "none"):
        T = true.carrying(name).poses(q)
        found = compensate(model.carrying(name), T, q).q
        reached = true.carrying(name).poses(found)
        predicted = result.predict(q, payload=name).poses
        np.testing.assert_allclose(reached[:, :3, 3], T[:, :3, 3], atol=2e-4)
        np.testing.assert_allclose(predicted[:, :3, 3], T[:, :3, 3], atol=2e-4)
