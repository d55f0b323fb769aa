"""No plan breaks a limit, a collision pair or the region.

Checked by code that shares nothing with ours: Pinocchio's own geometry of the URDF,
limits from the XML, regions by hand.
"""

from __future__ import annotations

from dataclasses import dataclass
from fnmatch import fnmatchcase
from itertools import pairwise
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

import calib_pin
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.collision import Collisions
from calib_pin.kinematics.spatial import Floats
from calib_pin.setup import FrameSetup, Obstacle, Region, Setup
from tests.kinematics.test_collision import Reference
from tests.planning.test_plan import Calls

TOOL = (0.03, 0.05, 0.08)


@dataclass(frozen=True)
class Cell:
    """A robot in its surroundings.

    Attributes:
        chain: The robot.
        obstacles: What stands around it.
        region: Corners of the box in which the tool must be.
        limits: Narrower limits, by names or globs.
    """

    chain: Chain
    obstacles: tuple[Obstacle, ...]
    region: tuple[Any, Any]
    limits: dict[str, tuple[float, float]]

    def collisions(self) -> Collisions:
        found = calib_pin.load_collisions(self.chain, self.obstacles, clearance=0.0)
        assert found is not None
        return found

    def touching(self, q: Floats) -> list[bool]:
        """Whether solids touch that do not always do, by the design of the robot."""
        reference = Reference.of(self.chain, self.obstacles)
        some = self.chain.random_configurations(60, np.random.default_rng(4))
        met = [reference.touching(row) for row in some]
        always = {
            pair
            for pair in set.union(*met)
            if np.mean([pair in pairs for pairs in met]) > 0.9
        }
        return [bool(reference.touching(row) - always) for row in q]

    def check(self, q: Floats) -> None:
        """Fail where a configuration is not allowed."""
        assert not any(self.touching(q))
        reference = Reference.of(self.chain)
        points = np.array([reference.tip(row).act(np.array(TOOL)) for row in q])
        lower, upper = np.array(self.region)
        assert (lower <= points).all() and (points <= upper).all()
        root = ElementTree.fromstring(self.chain.robot.source)
        for name, column in zip(self.chain.joints, q.T, strict=True):
            limit = root.find(f"joint[@name='{name}']/limit")
            assert limit is not None
            ends = [(float(limit.attrib["lower"]), float(limit.attrib["upper"]))]
            ends += [self.limits[key] for key in self.limits if fnmatchcase(name, key)]
            for low, high in ends:
                assert low <= column.min() and column.max() <= high, name


CELLS = {
    "panda": Cell(
        calib_pin.load_chain("example:panda", tip="panda_hand_tcp"),
        (Obstacle(box=(2.0, 2.0, 0.1), xyz=(0.0, 0.0, -0.1)),),
        ((0.1, -0.6, 0.1), (0.9, 0.6, 1.0)),
        {"panda_joint1": (-1.5, 1.0)},
    ),
    "space7": Cell(
        calib_pin.load_chain("space7"),
        (
            Obstacle(sphere=0.6, xyz=(1.2, 0.3, 1.0)),
            Obstacle(box=(0.4, 4.0, 0.4), xyz=(-1.0, 0.0, 0.8), rpy=(0.2, 0.1, 0.5)),
        ),
        ((-3.0, -3.0, 0.2), (3.0, 3.0, 4.0)),
        {"joint_*": (-2.5, 2.5)},
    ),
}


def planned(cell: Cell, method: str, most: int) -> Any:
    setup = Setup(
        tool_frame=FrameSetup(TOOL), region=Region(box=cell.region), limits=cell.limits
    )
    return calib_pin.plan(
        cell.chain,
        "position",
        12,
        setup,
        method=method,
        collisions=cell.collisions(),
        candidates=50,
        progress=Calls(most + 2),
    )


@pytest.mark.parametrize("name", CELLS)
def test_plans_keep_all_rules(name: str) -> None:
    cell, collisions = CELLS[name], CELLS[name].collisions()
    # The rules are strict: of random configurations they refuse just those that we do.
    q = cell.chain.random_configurations(60, np.random.default_rng(4))
    theirs = [not touches for touches in cell.touching(q)]
    assert collisions.free(q).tolist() == theirs
    assert 0.02 < np.mean(theirs) < 0.99
    plan = planned(cell, "greedy", 10**6)
    assert plan.q.shape == (12, len(cell.chain.joints))
    cell.check(plan.q)
    # Moves that collide are counted; steps of another size may pass a narrow place.
    steps = np.linspace(0.0, 1.0, 60)[1:-1, None]
    hits = [not collisions.free(a + steps * (b - a)).all() for a, b in pairwise(plan.q)]
    assert abs(len(plan.blocked) - sum(hits)) <= 1


@pytest.mark.parametrize(
    ("method", "most", "name"),
    [
        pytest.param("gradient", 40, "panda", marks=pytest.mark.slow),
        ("pso", 15, "space7"),
        pytest.param("gradient", 40, "space7", marks=pytest.mark.slow),
        pytest.param("pso", 15, "panda", marks=pytest.mark.slow),
    ],
)
def test_descents_and_swarms_keep_all_rules(name: str, method: str, most: int) -> None:
    """They move configurations where no candidate has been."""
    CELLS[name].check(planned(CELLS[name], method, most).q)
