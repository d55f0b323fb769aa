"""Collisions of a robot with itself and with obstacles.

Most configurations touch nothing, and most that do touch at one of a few pairs. So a
configuration first goes through convex hulls, which are quick and hold the meshes
within them; only if two hulls meet do the meshes decide, in the order of the pairs,
until two of them touch. Bounding boxes keep the hulls from being looked at in vain.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.kinematics.threads import PerThread
from calib_pin.kinematics.tree import Configurations

ROUNDING = 1e-5
"""Distance kept beyond the clearance [m]: at the very edge of a collision, where a
descent may end, rounding would decide."""

SLACK = 1e-3
"""Distance within which hulls count as meeting [m]: the meshes decide, but whether
hulls just touch comes out differently now and then."""

LEAST = 0.01
"""Least motion of points between two places of a move that are checked [m]."""

FLAT = 1e-6
"""Thickness by length up to which a mesh counts as flat."""

THICKNESS = 1e-6
"""Thickness that the bounding box of a flat solid adds to the solid [m]."""


class Collisions:
    """Self-collision of a robot and its collisions with obstacles.

    Joints outside the chains stand at zero. Meshes are surfaces: a solid wholly within
    one does not touch it.

    Args:
        chain: The chain whose joints move, or several.
        geometry: The solids on `chain.robot.model`, and the pairs of them that may
            not touch; those that it does not move against each other are left
            out. The pairs that touch most often come first for speed.
        clearance: Distance that is kept [m]: one of all pairs, or one of each.

    Attributes:
        pairs: Names of the two solids of each pair that is checked: the link of a
            solid that the URDF describes, else the solid's own name. A link of
            several solids stands in several pairs.
        clearances: Distance that each of them keeps, shape (number of pairs,) [m].

    Examples:
        >>> from calib_pin.io.collision import load_collisions
        >>> from calib_pin.io.urdf import load_chain
        >>> collisions = load_collisions(load_chain("space7"))
        >>> collisions.free(np.zeros((1, 7))).tolist()
        [True]
    """

    def __init__(
        self,
        chain: Chain | Chains,
        geometry: pin.GeometryModel,
        clearance: float | Sequence[float] | Floats = 0.0,
    ) -> None:
        """Choose the pairs and build the hulls."""
        model = chain.robot.model
        ids = [model.getJointId(name) for name in chain.joints]
        self._chain = chain
        self._model = model
        self._configurations = Configurations(model, ids)
        solids = geometry.geometryObjects
        all_pairs = [(pair.first, pair.second) for pair in geometry.collisionPairs]
        moving = [_moves(model, solids[a], solids[b], ids) for a, b in all_pairs]
        pairs = [pair for pair, moves in zip(all_pairs, moving, strict=True) if moves]
        clearances = np.broadcast_to(np.asarray(clearance, float), len(all_pairs))
        self.clearances: Floats = clearances[np.array(moving, bool)]
        self._meshes = _with_pairs(geometry.copy(), pairs)
        hulls = _with_pairs(_hulls(geometry), pairs)
        self._checks = PerThread(_checks, model, self._meshes, hulls, self.clearances)
        self.pairs: tuple[tuple[str, str], ...] = tuple(
            (_name(model, solids[a]), _name(model, solids[b])) for a, b in pairs
        )

    def free(self, q: Floats) -> NDArray[np.bool_]:
        """Configurations where no pair is closer than its clearance.

        Args:
            q: Positions of the joints of all chains, shape (N, n) [rad, m].

        Returns:
            True for configurations without a collision, shape (N,).
        """
        return np.array([self._is_free(full) for full in self._configurations(q)], bool)

    def contacts(self, q: Floats) -> NDArray[np.bool_]:
        """Pairs that are closer than their clearance.

        Args:
            q: Joint positions, shape (N, n) [rad, m].

        Returns:
            True for pairs in collision, shape (N, number of pairs).
        """
        touching = np.zeros((len(q), len(self.pairs)), bool)
        for row, full in zip(touching, self._configurations(q), strict=True):
            geometry = self._place(full)
            pin.computeCollisions(self._meshes, geometry, False)
            row[:] = [result.isCollision() for result in geometry.collisionResults]
        return touching

    def only(self, kept: Iterable[int], clearances: Floats | None = None) -> Collisions:
        """The same for some of the pairs.

        Args:
            kept: Their indices in `pairs`, in the order of the checks.
            clearances: Distance that each of `pairs` is to keep instead, shape (number
                of pairs,) [m].
        """
        places = [int(k) for k in kept]
        pairs = self._meshes.collisionPairs
        chosen = [(pairs[k].first, pairs[k].second) for k in places]
        geometry = _with_pairs(self._meshes.copy(), chosen)
        distances = self.clearances if clearances is None else clearances
        return Collisions(self._chain, geometry, distances[places])

    def move_is_free(self, a: Floats, b: Floats) -> bool:
        """Whether nothing touches on a straight move, its ends of shape (n,) included.

        Two places of it are checked if points of the robot move by more than twice the
        clearance between them, so that what keeps off at both touches nothing between.
        """
        clearance = float(self.clearances.max(initial=0.0))
        length = float(np.abs(b - a) @ self.reach)
        count = 1 + max(1, int(np.ceil(length / max(2.0 * clearance, LEAST))))
        places = np.linspace(a, b, count)
        # A few places far apart first: most moves that are blocked are so for long.
        return all(self.free(places[k::7]).all() for k in range(7))

    @cached_property
    def reach(self) -> Floats:
        """How far points of the robot move at most by each joint, shape (n,).

        A bound by the lengths of all links beyond [m/rad, 1 for prismatic joints].
        """
        chain = self._chain
        ways = np.maximum(np.abs(chain.lower), np.abs(chain.upper))
        travel = np.where(chain.revolute, 0.0, ways)
        slides = dict(zip(chain.joints, travel.tolist(), strict=True))
        longest = np.array([self._longest(name, slides) for name in chain.joints])
        return np.where(chain.revolute, longest, 1.0)

    def _longest(self, name: str, slides: Mapping[str, float]) -> float:
        """Longest way from a joint to a point that it moves, by lengths of links."""
        model, longest = self._model, 0.0
        joint = model.getJointId(name)
        for solid in self._meshes.geometryObjects:
            above = [*model.supports[solid.parentJoint]]
            if joint not in above:
                continue
            shape = solid.geometry
            shape.computeLocalAABB()
            center = solid.placement.act(np.array(shape.aabb_center))
            length = float(np.linalg.norm(center)) + float(shape.aabb_radius)
            for beyond in above[above.index(joint) + 1 :]:
                offset = model.jointPlacements[beyond].translation
                length += float(np.linalg.norm(offset))
                length += slides.get(model.names[beyond], 0.0)
            longest = max(longest, length)
        return longest

    def _is_free(self, full: Floats) -> bool:
        data, boxes, _ = self._checks.value
        if not pin.computeCollisions(self._model, data, boxes, full, True):
            return True
        return not pin.computeCollisions(self._meshes, self._place(full), True)

    def _place(self, full: Floats) -> pin.GeometryData:
        data, _, geometry = self._checks.value
        pin.updateGeometryPlacements(self._model, data, self._meshes, geometry, full)
        return geometry


def _checks(
    model: pin.Model,
    meshes: pin.GeometryModel,
    hulls: pin.GeometryModel,
    clearances: Floats,
) -> tuple[pin.Data, Any, pin.GeometryData]:
    """Data of the model, a manager of the hulls, and storage for what meshes meet."""
    # The simplest of Pinocchio's managers, which tries every pair of bounding boxes,
    # is also the fastest for the few dozen solids of a robot.
    boxes = pin.BroadPhaseManager_NaiveCollisionManager(
        model, hulls, _results(hulls, clearances + SLACK)
    )
    return model.createData(), boxes, _results(meshes, clearances)


def _moves(
    model: pin.Model,
    first: pin.GeometryObject,
    second: pin.GeometryObject,
    joints: Collection[int],
) -> bool:
    """Whether a joint of the chain stands between two solids."""
    above = [set(model.supports[solid.parentJoint]) for solid in (first, second)]
    return not (above[0] ^ above[1]).isdisjoint(joints)


def _name(model: pin.Model, solid: pin.GeometryObject) -> str:
    """The users' name of a solid; Pinocchio counts those of a link: `<link>_<k>`."""
    link = str(model.frames[solid.parentFrame].name)
    name = str(solid.name)
    return link if name.startswith(f"{link}_") else name


def _with_pairs(
    geometry: pin.GeometryModel, pairs: Sequence[tuple[int, int]]
) -> pin.GeometryModel:
    geometry.removeAllCollisionPairs()
    for first, second in pairs:
        geometry.addCollisionPair(pin.CollisionPair(first, second))
    return geometry


def _results(geometry: pin.GeometryModel, clearances: Floats) -> pin.GeometryData:
    """Storage for the results of the pairs, with the request for each of them."""
    results = geometry.createData()
    for request, clearance in zip(results.collisionRequests, clearances, strict=True):
        request.enable_contact = False
        request.security_margin = float(clearance) + ROUNDING
    return results


def _hulls(geometry: pin.GeometryModel) -> pin.GeometryModel:
    """The geometry with convex solids around its meshes.

    That is their convex hull. A flat solid gets its bounding box instead, a little
    thicker: Qhull crashes on flat meshes, and Pinocchio's managers pass over solids
    without a volume.
    """
    hulls = geometry.clone()
    for solid in hulls.geometryObjects:
        shape = solid.geometry
        is_mesh = isinstance(shape, pin.coal.BVHModelBase)
        if is_mesh and _is_thick(np.array(shape.vertices())):
            shape.buildConvexHull(False, "Qt")
            solid.geometry = shape.convex
            continue
        shape.computeLocalAABB()
        extents = shape.aabb_local.max_ - shape.aabb_local.min_
        if is_mesh or extents.min() == 0.0:
            center = pin.SE3(np.eye(3), np.array(shape.aabb_center))
            solid.placement = solid.placement * center
            solid.geometry = pin.coal.Box(*(extents + THICKNESS))
    return hulls


def _is_thick(points: Floats) -> bool:
    """Whether points, shape (N, 3), are far from lying in one plane."""
    extents = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return len(points) >= 4 and bool(extents[-1] > FLAT * extents[0])
