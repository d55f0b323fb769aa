"""The bundled robots against their tables, with kinematics written out here."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml
from numpy.typing import NDArray

from calib_pin.calibration import calibrate
from calib_pin.io.measurements import read_measurements
from calib_pin.io.setup import read_setup
from calib_pin.io.urdf import bundled_robots, load_robot
from calib_pin.kinematics.chain import Chain
from calib_pin.parameterizations import parameterization

Floats = NDArray[np.float64]
ROBOTS = Path(__file__).parents[1] / "robots"
NAMES = ("heavy6", "pa10", "space6", "space7")
H = np.pi / 2.0

# Rows theta, d, a, alpha of A_i = Rz(theta) Tz(d) Tx(a) Rx(alpha).
STANDARD = {
    "space6": [
        (0.0, 0.80, 0.10, -H),
        (0.0, 0.0, 0.85, 0.0),
        (0.0, 0.15, 0.05, H),
        (0.0, 0.75, 0.0, -H),
        (0.0, 0.0, 0.0, H),
        (0.0, 0.20, 0.0, 0.0),
    ],
    "heavy6": [
        (0.0, 0.675, 0.35, -H),
        (0.0, 0.0, 1.15, 0.0),
        (0.0, 0.0, -0.04, H),
        (0.0, 1.2, 0.0, -H),
        (0.0, 0.0, 0.0, H),
        (0.0, 0.215, 0.0, 0.0),
    ],
    "pa10": [
        (0.0, 0.317, 0.0, -H),
        (0.0, 0.0, 0.0, H),
        (0.0, 0.450, 0.0, -H),
        (0.0, 0.0, 0.0, H),
        (0.0, 0.480, 0.0, -H),
        (0.0, 0.0, 0.0, H),
        (0.0, 0.070, 0.0, 0.0),
    ],
}

# Rows alpha, a, d, theta of Rx(alpha) Tx(a) Rz(theta) Tz(d); the last is the tool.
MODIFIED = [
    (0.0, 0.0, 0.20, 0.0),
    (H, 0.0, 0.13, 0.0),
    (-H, 0.0, 0.90, -H),
    (-H, 0.76, 0.10, H),
    (H, 0.76, 0.90, H),
    (H, 0.0, 0.13, 0.0),
    (-H, 0.0, 0.20, 0.0),
    (0.0, 0.0, 0.20, 0.0),
]

# Published errors of space7: m_x m_y m_z in mm, delta_x delta_y delta_z in degrees.
PRESET = {
    "joint_1": (10.2, -5.8, 3.2, 0.158, -0.114, 0.014),
    "joint_2": (-9.8, 12.5, 4.8, -0.015, 0.206, -0.086),
    "joint_3": (6.2, -8.4, 10.7, -0.120, -0.053, 0.132),
    "joint_4": (6.5, 9.4, -8.9, 0.217, -0.072, 0.096),
    "joint_5": (-8.7, 5.5, -10.4, 0.174, 0.118, -0.042),
    "joint_6": (5.9, -8.6, 6.6, 0.065, -0.201, 0.005),
    "joint_7": (-8.1, -5.2, -7.4, -0.143, 0.081, 0.052),
    "tool_joint": (10.1, 4.9, 5.2, 0.105, -0.049, -0.172),
}


def about_z(angle: float, shift: float) -> Floats:
    """Rz(angle) Tz(shift)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, shift], [0, 0, 0, 1]])


def about_x(angle: float, shift: float) -> Floats:
    """Rx(angle) Tx(shift)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1, 0, 0, shift], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1]])


def frames_of(name: str, q: Sequence[float]) -> list[Floats]:
    """The base and every frame of the table up to the tool, in the base."""
    frames = [np.eye(4)]
    if name == "space7":
        for (alpha, a, d, theta), turn in zip(MODIFIED, [*q, 0.0], strict=True):
            frames.append(frames[-1] @ about_x(alpha, a) @ about_z(theta + turn, d))
    else:
        for (theta, d, a, alpha), turn in zip(STANDARD[name], q, strict=True):
            frames.append(frames[-1] @ about_z(theta + turn, d) @ about_x(alpha, a))
    return frames


def chain_of(name: str) -> Chain:
    return Chain(load_robot(name))


@pytest.mark.parametrize("name", NAMES)
def test_names(name: str) -> None:
    assert bundled_robots()[name].samefile(ROBOTS / name / "robot.urdf")
    chain = chain_of(name)
    count = len(chain.joints)
    links = ("base_link", *(f"link_{i}" for i in range(1, count + 1)), "tool")
    assert chain.robot.model.name == name
    assert chain.joints == tuple(f"joint_{i}" for i in range(1, count + 1))
    assert set(chain.robot.links) == set(links)
    ends = chain.base, chain.tip, chain.tip_joint
    assert ends == ("base_link", "tool", "tool_joint")
    # Every link can be seen.
    root = ElementTree.parse(ROBOTS / name / "robot.urdf").getroot()
    for link in root.findall("link"):
        tags = {shape.tag for shape in link.findall("visual/geometry/*")}
        assert tags == {"cylinder"}, link.get("name")


@pytest.mark.parametrize("name", NAMES)
def test_pinocchio_agrees_with_the_table(name: str) -> None:
    model = pin.buildModelFromUrdf(str(ROBOTS / name / "robot.urdf"))
    data, tool = model.createData(), model.getFrameId("tool")
    for q in np.random.default_rng(20221).uniform(-3.0, 3.0, (10, model.nq)):
        pin.framesForwardKinematics(model, data, q)
        frames = frames_of(name, q)
        assert np.abs(data.oMf[tool].homogeneous - frames[-1]).max() < 1e-12
        for i in range(1, model.njoints):
            # The axis of joint i is z of frame i - 1 (standard) or i (modified DH).
            line = frames[i if name == "space7" else i - 1]
            found = data.oMi[i].homogeneous
            assert np.abs(found[:3, 2:] - line[:3, 2:]).max() < 1e-12


@pytest.mark.parametrize(
    ("name", "bent", "masses", "distances"),
    [
        # Stretched out horizontally: of the centers of mass from the shoulder.
        ("pa10", 1, [6, 5, 4, 3, 2, 1], [0.1125, 0.3375, 0.57, 0.81, 0.9475, 0.9825]),
        # Upper arm along x, forearm straight on: from the axis of joint 2.
        ("heavy6", 2, [180, 200, 70, 40, 15], [0.55, 1.33, 1.95, 2.38, 2.53]),
    ],
)
def test_gravity_torque(name, bent, masses, distances):
    model = chain_of(name).robot.model
    q = np.zeros(model.nq)
    q[bent] = H
    torque = pin.computeGeneralizedGravity(model, model.createData(), q)
    moment = 9.81 * np.dot(masses, distances)
    assert torque[1] == pytest.approx(-moment, rel=1e-9)
    # The first axis stands upright, the last one carries nothing aside.
    np.testing.assert_allclose(torque[[0, -1]], 0.0, atol=1e-12 * moment)


def test_heavy6_measurements_calibrate() -> None:
    """144 rows without load and with the payload."""
    chain, folder = chain_of("heavy6"), ROBOTS / "heavy6"
    rows = read_measurements(folder / "measurements.csv", chain)
    assert len(rows) == 144 and rows.configurations == 24
    assert set(rows.payload) == {"none", "heavy"}
    found = calibrate(chain, rows, read_setup(folder / "setup.yaml"), validate=False)
    assert found.verdict == "good"
    assert found.identifiability.rank == found.identifiability.structural_rank == 38
    assert 0.9 < found.statistics.sigma0 < 1.1


def test_space7_errors_are_the_published_ones() -> None:
    found: dict[str, Any] = yaml.safe_load(
        (ROBOTS / "space7" / "errors.yaml").read_text()
    )
    screws = parameterization("link-transform").screws(chain_of("space7"))
    assert list(found) == [screw.parameter.name for screw in screws]
    for joint, values in PRESET.items():
        expected = [v * 1e-3 for v in values[:3]] + list(np.radians(values[3:]))
        components = ("mx", "my", "mz", "dx", "dy", "dz")
        written = [found[f"{joint}.link-transform.{c}"] for c in components]
        np.testing.assert_allclose(written, expected, rtol=1e-12)
