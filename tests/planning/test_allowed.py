"""No plan breaks a limit, a collision pair or the region.

Checked by code that shares nothing with ours: Pinocchio's own geometry model of the
URDF with the pairs of its SRDF, limits from the XML, regions by hand.
"""

from __future__ import annotations

import importlib.metadata
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest

import calib_pin
from calib_pin.kinematics.spatial import Floats
from calib_pin.setup import FrameSetup, Obstacle, Region, Setup

DATA = Path(
    str(
        importlib.metadata.distribution("example-robot-data").locate_file(
            "cmeel.prefix/share/example-robot-data/robots"
        )
    )
)
TOOL = (0.03, 0.05, 0.08)


@dataclass(frozen=True)
class Cell:
    """A robot in its surroundings.

    Attributes:
        name: Robot as users name it.
        urdf: Its file.
        base: First link.
        tip: Last link.
        srdf: File of pairs that may touch; empty for those that we find ourselves.
        obstacles: What stands around it.
        region: Corners of the box in which the tool must be.
        limits: Narrower limits.
        distance: Least distance.
    """

    name: str
    urdf: Path
    base: str
    tip: str
    srdf: Path | None = None
    obstacles: tuple[Obstacle, ...] = ()
    region: tuple[Any, Any] = ((-5.0, -5.0, -5.0), (5.0, 5.0, 5.0))
    limits: dict[str, tuple[float, float]] = field(default_factory=dict)
    distance: float = 0.0


CELLS = {
    "panda": Cell(
        "example:panda",
        DATA / "panda_description/urdf/panda.urdf",
        "panda_link0",
        "panda_hand_tcp",
        DATA / "panda_description/srdf/panda.srdf",
        (Obstacle(box=(2.0, 2.0, 0.1), xyz=(0.0, 0.0, -0.1)),),
        ((0.1, -0.6, 0.1), (0.9, 0.6, 1.0)),
        {"panda_joint1": (-1.5, 1.0)},
    ),
    "space7": Cell(
        "space7",
        Path(str(calib_pin.robot_file("space7", "robot.urdf"))),
        "base_link",
        "tool",
        None,
        (
            Obstacle(sphere=0.6, xyz=(1.2, 0.3, 1.0)),
            Obstacle(box=(0.4, 4.0, 0.4), xyz=(-1.0, 0.0, 0.8), rpy=(0.2, 0.1, 0.5)),
        ),
        ((-3.0, -3.0, 0.2), (3.0, 3.0, 4.0)),
        {"joint_*": (-2.5, 2.5)},
        0.4,
    ),
}


class Referee:
    """The rules of a cell from its files, by Pinocchio alone."""

    def __init__(self, cell: Cell, left_out: set[frozenset[str]]) -> None:
        self.cell = cell
        packages = [str(DATA), str(DATA.parent), str(DATA.parent.parent)]
        self.model = pin.buildModelFromUrdf(str(cell.urdf))
        self.geometry = pin.buildGeomFromUrdf(
            self.model, str(cell.urdf), pin.COLLISION, package_dirs=packages
        )
        links = self.geometry.ngeoms
        base = self.model.getFrameId(cell.base, pin.FrameType.BODY)
        frame = self.model.frames[base]
        for k, obstacle in enumerate(cell.obstacles):
            shapes = {
                "box": pin.coal.Box,
                "sphere": pin.coal.Sphere,
                "cylinder": pin.coal.Cylinder,
            }
            size = np.atleast_1d(getattr(obstacle, obstacle.kind)).tolist()
            placement = pin.SE3(
                pin.rpy.rpyToMatrix(*map(float, obstacle.rpy)), np.array(obstacle.xyz)
            )
            self.geometry.addGeometryObject(
                pin.GeometryObject(
                    f"thing {k}",
                    frame.parentJoint,
                    frame.placement * placement,
                    shapes[obstacle.kind](*size),
                )
            )
        self.geometry.addAllCollisionPairs()
        if cell.srdf is not None:
            pin.removeCollisionPairs(self.model, self.geometry, str(cell.srdf), False)
        root = ElementTree.parse(cell.urdf).getroot()
        joined = {
            frozenset((j.find("parent").get("link"), j.find("child").get("link")))
            for j in root.iterfind("joint")
        }
        owner = [
            self.model.frames[solid.parentFrame].name if k < links else f"thing {k}"
            for k, solid in enumerate(self.geometry.geometryObjects)
        ]
        moved = {self.model.getJointId(name) for name in self._joints(root)}
        # Numbers, as pairs are references into a list that changes.
        pairs = [(pair.first, pair.second) for pair in self.geometry.collisionPairs]
        for first, second in pairs:
            link_pair = frozenset((owner[first], owner[second]))
            ends = [
                set(self.model.supports[self.geometry.geometryObjects[k].parentJoint])
                for k in (first, second)
            ]
            fixed = not (ends[0] ^ ends[1]) & moved
            excused = cell.srdf is None and (
                link_pair in joined or link_pair in left_out
            )
            if fixed or excused:
                self.geometry.removeCollisionPair(pin.CollisionPair(first, second))
        self.data = self.model.createData()
        self.results = pin.GeometryData(self.geometry)
        self.limits = {}
        for joint in root.iterfind("joint"):
            limit = joint.find("limit")
            if limit is not None and limit.get("lower") is not None:
                bounds = float(limit.get("lower")), float(limit.get("upper", "0"))
                self.limits[joint.get("name")] = bounds

    def _joints(self, root: ElementTree.Element) -> list[str]:
        """Moving joints from base to tip."""
        above = {j.find("child").get("link"): j for j in root.iterfind("joint")}
        link, names = self.cell.tip, []
        while link != self.cell.base:
            joint = above[link]
            if joint.get("type") in ("revolute", "prismatic", "continuous"):
                names.append(joint.get("name", ""))
            link = joint.find("parent").get("link")
        return names[::-1]

    def full(self, joints: tuple[str, ...], values: Floats) -> Floats:
        """All positions of the model, of which a chain moves some."""
        result = pin.neutral(self.model)
        for name, value in zip(joints, values, strict=True):
            joint = self.model.getJointId(name)
            index, many = self.model.idx_qs[joint], self.model.nqs[joint]
            turn = [np.cos(value), np.sin(value)]
            result[index : index + many] = turn if many == 2 else value
        return result

    def check(self, joints: tuple[str, ...], q: Floats) -> None:
        """Fail where a configuration is not allowed."""
        lower, upper = np.array(self.cell.region)
        base = self.model.getFrameId(self.cell.base, pin.FrameType.BODY)
        tip = self.model.getFrameId(self.cell.tip, pin.FrameType.BODY)
        for values in q:
            full = self.full(joints, values)
            for name, value in zip(joints, values, strict=True):
                low, high = self.limits.get(name, (-np.pi, np.pi))
                assert low <= value <= high, name
            assert not self.touching(full)
            pin.framesForwardKinematics(self.model, self.data, full)
            T = self.data.oMf[base].inverse() * self.data.oMf[tip]
            point = T.act(np.array(TOOL))
            assert (lower <= point).all() and (point <= upper).all()
        for pattern, (low, high) in self.cell.limits.items():
            stem = pattern.rstrip("*")
            columns = [
                k
                for k, name in enumerate(joints)
                if name == pattern or (pattern.endswith("*") and name.startswith(stem))
            ]
            assert columns
            assert (q[:, columns] >= low).all() and (q[:, columns] <= high).all()
        between = np.abs(q[:, None] - q[None]).max(axis=2)
        np.fill_diagonal(between, np.inf)
        assert between.min() >= self.cell.distance

    def touching(self, full: Floats) -> bool:
        return bool(
            pin.computeCollisions(
                self.model, self.data, self.geometry, self.results, full, True
            )
        )


@pytest.fixture(scope="module", params=CELLS)
def cell(request: pytest.FixtureRequest) -> tuple[Cell, Any, Any, Referee]:
    """A cell with its chain, its collisions and the referee."""
    of = CELLS[request.param]
    chain = calib_pin.load_chain(of.name, base=of.base, tip=of.tip)
    notices: list[str] = []
    collisions = calib_pin.load_collisions(
        chain, of.obstacles, srdf=of.srdf, clearance=0.0, notice=notices.append
    )
    left_out = {
        frozenset(pair.split(" and "))
        for line in notices
        for pair in line.partition("(")[2].rstrip(")").split("; ")
        if " and " in pair
    }
    return of, chain, collisions, Referee(of, left_out)


def planned(cell: tuple[Cell, Any, Any, Referee], method: str, most: int) -> Any:
    of, chain, collisions, _ = cell
    setup = Setup(
        tool_frame=FrameSetup(TOOL), region=Region(box=of.region), limits=of.limits
    )
    calls = iter(range(10**9))
    return calib_pin.plan(
        chain,
        "position",
        12,
        setup,
        method=method,
        collisions=collisions,
        candidates=50,
        distance=of.distance,
        progress=lambda *_: next(calls) > most,
    )


def test_plans_keep_all_rules(cell: tuple[Cell, Any, Any, Referee]) -> None:
    _, chain, collisions, referee = cell
    # The referee is strict: of random configurations it refuses just those that we do.
    q = chain.random_configurations(60, np.random.default_rng(4))
    theirs = [not referee.touching(referee.full(chain.joints, row)) for row in q]
    assert collisions.free(q).tolist() == theirs
    assert 0.02 < np.mean(theirs) < 0.99
    plan = planned(cell, "greedy", 10**6)
    assert plan.q.shape == (12, len(chain.joints))
    referee.check(chain.joints, plan.q)
    # Moves that collide are counted; steps of another size may pass a narrow place.
    steps = np.linspace(0.0, 1.0, 60)[1:-1, None]
    hits = [not collisions.free(a + steps * (b - a)).all() for a, b in pairwise(plan.q)]
    assert abs(len(plan.blocked) - sum(hits)) <= 1


@pytest.mark.parametrize(("method", "most"), [("gradient", 40), ("pso", 15)])
def test_descents_and_swarms_keep_all_rules(
    method: str, most: int, cell: tuple[Cell, Any, Any, Referee]
) -> None:
    """They move configurations where no candidate has been."""
    _, chain, _, referee = cell
    referee.check(chain.joints, planned(cell, method, most).q)
