"""Searches for plans, as fixtures."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.kinematics.collision import Collisions
from calib_pin.planning.workspace import Workspace
from calib_pin.setup import Setup


@pytest.fixture(scope="session")
def workspace_of() -> Callable[..., Workspace]:
    """Workspace of a robot: `workspace_of("space6", "position", limits={...})`."""

    def make(
        robot: Any,
        model: str = "position",
        collisions: Collisions | None = None,
        distance: float = 0.0,
        **settings: Any,
    ) -> Workspace:
        chain = calib_pin.load_chain(robot) if isinstance(robot, str) else robot
        problem = nominal_problem(chain, model, Setup(**settings))
        return Workspace.create(problem, collisions, distance)

    return make


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)
