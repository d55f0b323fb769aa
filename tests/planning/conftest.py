"""Searches for plans, as fixtures."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import calib_pin
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.io.urdf import parse_robot
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.collision import Collisions
from calib_pin.planning.workspace import Workspace
from calib_pin.setup import ChainSetup, Setup
from tests.shared import joint, urdf_of


@pytest.fixture(scope="session")
def workspace_of() -> Callable[..., Workspace]:
    """Workspace of a robot: `workspace_of("space6", "position", limits={...})`."""

    def make(
        robot: Any,
        model: str = "position",
        collisions: Collisions | None = None,
        **settings: Any,
    ) -> Workspace:
        chain = calib_pin.load_chain(robot) if isinstance(robot, str) else robot
        problem = nominal_problem(chain, model, Setup(**settings))
        return Workspace.create(problem, collisions)

    return make


@pytest.fixture(scope="session")
def tree() -> Chains:
    """Two arms on a torso; the left one ends in a finger that follows its wrist."""
    turn = pin.rpy.rpyToMatrix(0.3, -0.2, 0.4)
    joints = [joint("torso", "base torso_link")]
    for side, y in (("left", 0.2), ("right", -0.2)):
        parent = "torso_link"
        for k, axis in enumerate(((0, 1, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1))):
            xyz = (0.3, 0.02, 0.05) if k else (0.0, y, 0.4)
            child, at = f"{side}_link_{k}", pin.SE3(turn, np.array(xyz))
            joints.append(joint(f"{side}_{k}", f"{parent} {child}", at, axis))
            parent = child
    at, wrist = pin.SE3(turn, np.array((0.1, 0.02, 0.0))), "left_link_3"
    follows = '<mimic joint="left_3" multiplier="0.5" offset="0.1"/>'
    finger = joint("left_finger", f"{wrist} finger", at, "0 1 0", more=follows)
    robot = parse_robot(urdf_of(*joints, finger).encode(), "tree.urdf")
    stated = {"left": ChainSetup(tip="finger"), "right": ChainSetup(tip="right_link_3")}
    return Chains(robot, setups=stated, names=("left", "right"))


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)
