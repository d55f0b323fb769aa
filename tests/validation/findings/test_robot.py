"""Another robot, another link or a wrong frame explains what no joint does."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.io.urdf import other_robots
from calib_pin.kinematics.chains import Chains
from calib_pin.observations import Observations
from calib_pin.setup import CameraSetup, FrameSetup, PointSetup, Setup
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.explanations import explain, finding
from calib_pin.validation.findings.readings import robots

TOOL = FrameSetup((0.05, 0.08, 0.12), (0.2, -0.3, 0.1))
UR5, UR10 = "example:ur5_robot", "example:ur10_robot"


def told(chains, rows, setup=None, known=tuple):
    case = Case.of_robot(Chains.of(chains), rows, setup or Setup(), known)
    assert case.doubtful
    found = explain(case, (robots,))
    return [] if found is None else list(finding(case, found))


@pytest.fixture(scope="module")
def file(tmp_path_factory, ur10):
    path = tmp_path_factory.mktemp("robot") / "rows.csv"
    calib_pin.write_measurements(path, ur10(count=50))
    return path


def read(file):
    return lambda chains: calib_pin.read_measurements(file, chains)


def test_wrong_robot(file) -> None:
    chains = calib_pin.load_chains(UR5, base="base_link", tip="tool0")
    setup, rows = Setup(base="base_link", tip="tool0"), read(file)(chains)
    (found,) = told(chains, rows, setup, partial(other_robots, chains, setup))
    assert (found.code, found.severity, found.setup) == ("robot", "error", {})
    assert UR10 in found.message and UR10 in found.remedy and UR5 in found.remedy
    assert told(chains, rows, setup) == []


@pytest.mark.parametrize(
    ("code", "ends"),
    [
        ("tip-link", {"base": "base_link", "tip": "wrist_2_link"}),
        ("base-link", {"base": "shoulder_link", "tip": "tool0"}),
    ],
)
def test_wrong_link_of_which_the_file_has_the_joints(file, code, ends) -> None:
    chains = calib_pin.load_chains(UR10, **ends)
    (found,) = told(chains, read(file)(chains))
    assert found.code == code
    lines = {"tip-link": {"tip": "wrist_3_link"}, "base-link": {"base": "base_link"}}
    assert found.setup == lines[code]


def test_tip_behind_the_measured_link() -> None:
    """The joints of the measured link are among those that were read."""
    chain = calib_pin.load_chain(UR10, base="base_link", tip="tool0")
    short = calib_pin.load_chain(UR10, base="base_link", tip="wrist_1_link")
    rng = np.random.default_rng(0)
    q = chain.random_configurations(50, rng)
    problem = nominal_problem(short, "position", Setup(tool_frame=TOOL))
    theta = calib_pin.draw_errors(problem.parameters, rng)
    rows = calib_pin.simulate(problem, theta, rng, q=q[:, :4], noise=1e-4).only
    rows = calib_pin.Measurements(
        model="position", joints=chain.joints, q=q, values=rows.values
    )
    (found,) = told(chain, Observations.of(rows))
    assert found.setup == {"tip": "wrist_1_link"}


KNOWN = {
    "base_frame": FrameSetup((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), estimate=False),
    "tool_frame": replace(TOOL, estimate=False),
}
NEAR = FrameSetup((0.08, 0.08, 0.12), TOOL.rpy, estimate=False)


@pytest.mark.parametrize(
    ("code", "frame", "known"),
    [
        ("tool-frame", NEAR, {"parameters": ("joint-offset",)}),
        ("base-frame", NEAR, {"parameters": ("joint-offset",)}),
        ("base-frame", FrameSetup(rpy=(0.0, 0.0, np.pi)), KNOWN),
        ("base-frame", FrameSetup(rpy=(np.pi, 0.0, 0.0)), KNOWN),
        ("base-frame", FrameSetup((0.3, 0.0, 0.0)), KNOWN),
        ("tool-frame", FrameSetup((0.05, 0.08, 0.27), TOOL.rpy), KNOWN),
    ],
)
def test_a_frame_that_is_stated_wrongly(code, frame, known, ur10) -> None:
    """Half a turn, too, where nothing is fitted from what was stated."""
    chain = calib_pin.load_chain(UR10, base="base_link", tip="tool0")
    end = code.removesuffix("-frame")
    wrong = {f"{end}_frame": replace(frame, estimate=False)}
    (found,) = told(chain, ur10(count=50), Setup(**{**known, **wrong}))
    assert found.code == code
    assert found.setup == {"frames": {end: {"estimate": True}}}


@pytest.mark.parametrize(
    ("mount", "said", "away"), [("world", "hand", 4.0), ("hand", "world", 1.8)]
)
def test_a_camera_that_is_somewhere_else(mount, said, away) -> None:
    """What stands still is said to move with the tool, or the other way round."""
    chain = calib_pin.load_chain(UR10, base="base_link", tip="tool0")
    board = {
        name: PointSetup((0.1 + 0.05 * (k % 2), 0.05 * (k // 2), 0.15))
        for k, name in enumerate("abcd")
    }
    camera = CameraSetup(mount, (900.0, 910.0), (4500.0, 4500.0))
    setup = Setup(camera=camera, targets=board)
    far = FrameSetup((0.1, -0.2, away))
    problem = nominal_problem(chain, "camera", replace(setup, base_frame=far))
    rng = np.random.default_rng(0)
    theta = calib_pin.draw_errors(problem.parameters, rng)
    q = chain.random_configurations(2000, rng)
    if mount == "hand":
        # The board is below, in front of the lens.
        T = chain.poses(q)
        q = q[(T[:, 2, 2] < -0.9) & (T[:, 2, 3] > -0.5)]
    q = np.repeat(q[:30], 4, axis=0)
    names = tuple("abcd" * (len(q) // 4))
    rows = calib_pin.simulate(problem, theta, rng, q=q, target=names, noise=0.2)
    wrong = replace(setup, camera=replace(camera, mount=said))
    case = Case.of_none(Chains.of(chain), rows, wrong)
    found = explain(case, (robots,))
    assert found is not None
    (one,) = finding(case, found)
    assert (one.code, one.setup) == ("camera-mount", {"camera": {"mount": mount}})
