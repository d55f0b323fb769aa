"""Collisions along a chain, against Pinocchio on a model of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.io.collision import load_collisions
from calib_pin.io.urdf import load_chain, locate_robot
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.collision import Collisions
from calib_pin.setup import Obstacle
from tests.shared import chain_of, joint, urdf_of

CHAINS = {
    # The base is not the root.
    "panda": ("example:panda", "panda_link1", "panda_link8"),
    "space7": ("space7", None, None),
}
OBSTACLES = (
    Obstacle(box=(0.5, 0.4, 0.3), xyz=(0.6, 0.2, 0.1), rpy=(0.3, 0.2, 0.1)),
    Obstacle(sphere=0.2, xyz=(0.1, -0.6, 0.6)),
    Obstacle(cylinder=(0.1, 1.0), xyz=(-0.5, 0.3, 0.4), rpy=(0.0, 0.4, 0.0)),
)
# A square without thickness, on which Qhull crashes.
SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3\nf 1 3 4\n"

BALL = """<collision>
  <origin xyz="0.5 0 0"/><geometry><sphere radius="0.1"/></geometry>
</collision>"""


def touching(collisions: Collisions, q: np.ndarray) -> list[tuple[str, str]]:
    """Names of the pairs that are closer than their clearance."""
    (found,) = collisions.contacts(q[None])
    return list(dict.fromkeys(collisions.pairs[k] for k in np.flatnonzero(found)))


@dataclass(frozen=True)
class Reference:
    """All solids of a robot with obstacles, straight from Pinocchio.

    Attributes:
        chain: Some of its joints; the others stand still.
        model: Robot from its file.
        geometry: Its solids, and those of the obstacles on the base of the chain.
        names: Link of each solid, or the name of the obstacle.
    """

    chain: Chain
    model: pin.Model
    geometry: pin.GeometryModel
    names: tuple[str, ...]

    @staticmethod
    def of(chain: Chain, obstacles: Sequence[Obstacle] = OBSTACLES) -> Reference:
        urdf = locate_robot(chain.robot.file).resolve()
        model = pin.buildModelFromUrdf(str(urdf))
        folders = [str(folder) for folder in urdf.parents]
        geometry = pin.buildGeomFromUrdf(
            model, str(urdf), pin.COLLISION, package_dirs=folders
        )
        links = [model.frames[s.parentFrame].name for s in geometry.geometryObjects]
        base = model.frames[model.getFrameId(chain.base, pin.FrameType.BODY)]
        kinds = {
            "box": pin.coal.Box,
            "sphere": pin.coal.Sphere,
            "cylinder": pin.coal.Cylinder,
        }
        for k, obstacle in enumerate(obstacles, 1):
            size = np.atleast_1d(getattr(obstacle, obstacle.kind)).tolist()
            turn = pin.rpy.rpyToMatrix(*map(float, obstacle.rpy))
            pose = base.placement * pin.SE3(turn, np.array(obstacle.xyz))
            solid = pin.GeometryObject(
                *(f"{k}", base.parentJoint, pose, kinds[obstacle.kind](*size))
            )
            geometry.addGeometryObject(solid)
            links.append(f"obstacle {k} ({obstacle.kind})")
        geometry.addAllCollisionPairs()
        return Reference(chain, model, geometry, tuple(links))

    def full(self, q: np.ndarray) -> np.ndarray:
        """All positions of the model, of which the chain moves some."""
        result = pin.neutral(self.model)
        for name, angle in zip(self.chain.joints, q, strict=True):
            joint = self.model.joints[self.model.getJointId(name)]
            turned = (np.cos(angle), np.sin(angle)) if joint.nq == 2 else angle
            result[joint.idx_q : joint.idx_q + joint.nq] = turned
        return result

    def touching(self, q: np.ndarray) -> set[frozenset[str]]:
        """Names of all solids that touch."""
        data, results = self.model.createData(), self.geometry.createData()
        pin.computeCollisions(
            self.model, data, self.geometry, results, self.full(q), False
        )
        return {
            frozenset((self.names[pair.first], self.names[pair.second]))
            for pair, result in zip(
                self.geometry.collisionPairs, results.collisionResults, strict=True
            )
            if result.isCollision()
        }

    def tip(self, q: np.ndarray) -> pin.SE3:
        """Pose of the tip in the base link."""
        data = self.model.createData()
        pin.framesForwardKinematics(self.model, data, self.full(q))
        base, tip = (
            data.oMf[self.model.getFrameId(link, pin.FrameType.BODY)]
            for link in (self.chain.base, self.chain.tip)
        )
        return base.actInv(tip)


@pytest.fixture(scope="module", params=CHAINS)
def chain(request: pytest.FixtureRequest) -> Chain:
    robot, base, tip = CHAINS[request.param]
    return load_chain(robot, base=base, tip=tip)


@pytest.fixture(scope="module")
def collisions(chain: Chain) -> Collisions:
    result = load_collisions(chain, OBSTACLES, clearance=0.0)
    assert result is not None
    return result


@pytest.fixture
def arm() -> Chain:
    return chain_of(urdf_of(joint("turn", "base arm", kind="continuous", inside=BALL)))


def test_as_pinocchio_finds_them(chain: Chain, collisions: Collisions) -> None:
    reference, chosen = Reference.of(chain), set(map(frozenset, collisions.pairs))
    q = chain.random_configurations(20, np.random.default_rng(7))
    met = [reference.touching(row) for row in q]
    expected = [pairs & chosen for pairs in met]
    found = [set(map(frozenset, touching(collisions, row))) for row in q]
    assert found == expected
    # Hulls do not change the answer.
    free = collisions.free(q)
    assert free.tolist() == [not pairs for pairs in expected]
    assert free.any()
    assert not free.all()
    assert collisions.free(q[:0]).shape == (0,)
    # Of all that ever touch, what is left out always does: it is built that way.
    for pair in set.union(*met) - chosen:
        assert np.mean([pair in pairs for pairs in met]) > 0.9


def test_clearance(arm: Chain) -> None:
    ball = Obstacle(sphere=0.1, xyz=(0.705, 0.0, 0.0))
    for clearance, free in ((0.0, True), (0.002, True), (0.01, False), (0.2, False)):
        collisions = load_collisions(arm, [ball], clearance=clearance)
        assert collisions is not None
        assert collisions.pairs == (("arm", "obstacle 1 (sphere)"),)
        assert collisions.free(np.zeros((1, 1))).tolist() == [free]


def test_continuous_joints(arm: Chain) -> None:
    # The middle of the arm's ball runs on a circle of 0.5 m, and so does the obstacle.
    ball = Obstacle(sphere=0.1, xyz=(0.0, 0.5, 0.0))
    collisions = load_collisions(arm, [ball], clearance=0.0)
    assert collisions is not None
    turn = 2.0 * np.arcsin(0.1 / 0.5)
    q = np.pi / 2 + np.array([0.0, turn - 0.01, turn + 0.01, -turn + 0.01, 3.0])
    for turns in (-4.0, 0.0, 2.0):
        free = collisions.free((q + np.pi * turns)[:, None])
        assert free.tolist() == [False, False, True, False, True]


def test_obstacles_stand_on_the_base_link_of_the_chain(arm: Chain) -> None:
    backwards = Chain(arm.robot, "arm", "base")
    on_arm = Obstacle(box=(0.2, 0.2, 0.2), xyz=(0.5, 0.0, 0.0))
    # It moves with the arm's ball, around which it is.
    collisions = load_collisions(backwards, [on_arm])
    assert collisions is not None
    assert collisions.pairs == ()
    q = np.linspace(-3.0, 3.0, 5)[:, None]
    assert collisions.free(q).all()
    assert collisions.contacts(q).shape == (5, 0)
    assert touching(collisions, q[0]) == []


def test_a_clearance_of_each_pair(chain: Chain, collisions: Collisions) -> None:
    q = chain.random_configurations(60, np.random.default_rng(3))
    every = range(len(collisions.pairs))
    distances = np.where(np.arange(len(every)) % 2, 0.1, 0.0)
    mixed = collisions.only(every, distances)
    near, bare = (
        collisions.only(every, np.full(len(every), d)).contacts(q) for d in (0.1, 0.0)
    )
    assert (near != bare).any()
    found = mixed.contacts(q)
    np.testing.assert_array_equal(found, np.where(distances > 0.0, near, bare))
    # The hulls know them too, and so does a part of the pairs.
    np.testing.assert_array_equal(mixed.free(q), ~found.any(axis=1))
    kept = [7, 0, 4]
    some = mixed.only(kept)
    assert some.clearances.tolist() == distances[kept].tolist()
    np.testing.assert_array_equal(some.contacts(q), found[:, kept])
    np.testing.assert_array_equal(some.free(q), ~found[:, kept].any(axis=1))


def test_a_larger_clearance_switches_nothing_off() -> None:
    chain = load_chain("space7")
    bare, wide = (
        load_collisions(chain, OBSTACLES, clearance=distance) for distance in (0.0, 0.2)
    )
    assert bare is not None
    assert wide is not None
    assert sorted(wide.pairs) == sorted(bare.pairs)
    q = chain.random_configurations(100, np.random.default_rng(4))
    contacts, free = bare.contacts(q), wide.free(q)
    assert contacts.any(axis=1).sum() > 8
    assert not contacts[free].any()
    np.testing.assert_array_equal(free, ~wide.contacts(q).any(axis=1))
    # What is far by design keeps all of it, and so do the obstacles.
    assert set(wide.clearances) == {0.0, 0.2}
    for pair, distance in zip(wide.pairs, wide.clearances, strict=True):
        assert distance == 0.2 or "obstacle" not in pair[1]


def test_flat_obstacles(tmp_path: Path) -> None:
    """A mesh without thickness, the same tilted, and a box of nearly none."""
    file = tmp_path / "square.obj"
    file.write_text(SQUARE)
    mesh = Obstacle(mesh=str(file), scale=(1.0, 1.0, 1.0), xyz=(-0.2, -0.5, 0.4))
    tilted = replace(mesh, rpy=(0.3, 0.2, 0.1))
    plate = Obstacle(box=(1.0, 1.0, 1e-6), xyz=(0.3, 0.0, 0.4))
    chain = load_chain("space7")
    q = chain.random_configurations(80, np.random.default_rng(1))
    for flat in (mesh, tilted, plate):
        collisions = load_collisions(chain, [flat])
        assert collisions is not None
        contacts = collisions.contacts(q)
        ours = [k for k, pair in enumerate(collisions.pairs) if "obstacle" in pair[1]]
        assert 8 < contacts[:, ours].any(axis=1).sum() < 72
        np.testing.assert_array_equal(collisions.free(q), ~contacts.any(axis=1))
