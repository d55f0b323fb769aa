"""Collision geometry: the solids of a URDF, an SRDF, and obstacles."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from calib_pin.errors import InputError, enumerated
from calib_pin.io.files import TEXT, read_bytes
from calib_pin.io.robot_shapes import read_mesh, shape_of
from calib_pin.io.urdf_tree import Document, link_of, parse_document, placed
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.collision import Collisions
from calib_pin.kinematics.robot import Robot
from calib_pin.setup import Obstacle

CLEARANCE = 0.01
"""Distance kept where the user asks for none: robots and fixtures are never quite
where their models are [m]."""

SAMPLES = 200
"""Random configurations that show which pairs touch, and how often."""

BY_DESIGN = 0.95
"""Share of the configurations from which on two links touch, or are close, because they
are built so."""


TOUCH = "touch at nearly every configuration are not checked against each other"
NEAR = "are always closer than the clearance are only kept from touching"
"""Ends of sentences about links that are built so."""


def load_collisions(
    chain: Chain | Chains,
    obstacles: Sequence[Obstacle] = (),
    *,
    srdf: str | Path | None = None,
    package_dirs: Sequence[str | Path] = (),
    clearance: float = CLEARANCE,
    notice: Callable[[str], None] | None = None,
    file: str = "",
) -> Collisions | None:
    """Collisions of a chain's robot with itself and with obstacles.

    Without an SRDF, links joined by one joint are not checked against each other, nor
    those that touch at nearly every configuration. With one, only the pairs that it
    disables are left out. Links that are closer than the clearance at nearly every
    configuration are only kept from touching; obstacles always keep it.

    Args:
        chain: The chain whose joints move, or several.
        obstacles: Obstacles around the robot, placed in the base link of the chains.
        srdf: File that says which links need no check.
        package_dirs: Folders that hold the packages of `package://` meshes; then come
            those of ROS and the folders above the URDF.
        clearance: Distance that is kept [m].
        notice: Called with one line for each check that is left out or weakened.
        file: File that states the obstacles, for messages.

    Returns:
        The collisions, or None if the URDF describes no solids.

    Raises:
        RobotError: If a mesh of the URDF is missing or cannot be read.
        InputError: If the SRDF, or the mesh of an obstacle, cannot be used.

    Examples:
        >>> from calib_pin.io.urdf import load_chain
        >>> table = Obstacle(box=(1.0, 1.0, 0.02), xyz=(0.0, 0.0, -0.02))
        >>> collisions = load_collisions(load_chain("space7"), [table])
        >>> ("link_7", "obstacle 1 (box)") in collisions.pairs
        True
    """
    tell, chains = notice or (lambda line: None), Chains.of(chain)
    robot, model, geometry = chains.robot, chains.robot.model, pin.GeometryModel()
    document = parse_document(robot.source, robot.file)
    apart = _adjacent(document) if srdf is None else _disabled(srdf, robot)
    robot_solids = [*_of_links(document, robot, package_dirs)]
    if not robot_solids:
        tell("the robot has no collision geometry: no collisions are checked")
        return None
    solids = [*robot_solids, *_of_obstacles(chains, obstacles, file)]
    for number, name, place, solid in solids:
        frame = model.frames[number]
        arguments = name, frame.parentJoint, number, frame.placement * place, solid
        geometry.addGeometryObject(pin.GeometryObject(*arguments))
    links = [model.frames[number].name for number, *_ in solids]
    for i, j in combinations(range(len(solids)), 2):
        # Obstacles, and of the robot only links that may not touch.
        if j >= len(robot_solids) or frozenset((links[i], links[j])) not in apart:
            geometry.addCollisionPair(pin.CollisionPair(i, j))
    collisions = Collisions(chains, geometry, clearance)
    if not collisions.pairs:
        tell("no two solids that may not touch move against each other")
    return _as_built(chains, collisions, srdf is None, tell)


def _as_built(
    chains: Chains, collisions: Collisions, guess: bool, tell: Callable[[str], None]
) -> Collisions:
    """The collisions without clearances that a robot's links never have.

    Args:
        chains: The chains of the robot.
        collisions: All pairs that may not touch.
        guess: Whether links that touch at nearly every configuration are left out.
        tell: Called with one line for each change.
    """
    # The same pairs come out at every run, whatever the seed of the plan.
    q = chains.random_configurations(SAMPLES, np.random.default_rng(0))
    contacts, clearances = collisions.contacts(q), collisions.clearances.copy()
    places: dict[tuple[str, str], list[int]] = {}
    for k, pair in enumerate(collisions.pairs):
        if set(pair) <= set(chains.robot.links):  # Not an obstacle.
            places.setdefault(pair, []).append(k)

    def often() -> list[tuple[str, str]]:
        touching = {pair: contacts[:, k].any(axis=1) for pair, k in places.items()}
        return [pair for pair, touch in touching.items() if touch.mean() >= BY_DESIGN]

    # What touches by design does so without any clearance, however large it is.
    close = often()
    of_close = [k for pair in close for k in places[pair]]
    bare = collisions.only(of_close, np.zeros(len(clearances)))
    contacts[:, of_close] = bare.contacts(q)
    touching = often()
    left_out = touching if guess else []
    near = [pair for pair in close if pair not in touching]
    clearances[[k for pair in near for k in places[pair]]] = 0.0
    for pairs, words in ((left_out, TOUCH), (near, NEAR)):
        if pairs:
            named = (" and ".join(pair) for pair in pairs)
            tell(f"links that {words}: {enumerated(named)}")
    order = np.argsort(-contacts.mean(axis=0), kind="stable")
    indices = (k for k in order if collisions.pairs[k] not in left_out)
    return collisions.only(indices, clearances)


_Solid = tuple[int, str, pin.SE3, pin.coal.CollisionGeometry]
"""Number of a link's frame, name, and place of a solid in the link."""


def _solid(kind: str, values: Iterable[Any]) -> pin.coal.CollisionGeometry:
    """A solid of some kind of shape, from its numbers or its surface."""
    if kind != "mesh":
        return getattr(pin.coal, kind.capitalize())(*values)
    (surface,), solid = values, pin.coal.BVHModelOBBRSS()
    solid.beginModel(len(surface.triangles), len(surface.vertices))
    solid.addVertices(surface.vertices)
    solid.addTriangles(surface.triangles)
    solid.endModel()
    return solid


def _of_links(
    document: Document, robot: Robot, package_dirs: Sequence[str | Path]
) -> Iterator[_Solid]:
    """The collision geometry of a URDF."""
    links, frames = document.named("link"), enumerate(robot.model.frames)
    for number, frame in (f for f in frames if f[1].type == pin.FrameType.BODY):
        for k, element in enumerate(links[frame.name].findall("collision")):
            if shape := shape_of(document, element, robot, package_dirs):
                name, place = f"{frame.name}_{k}", document.origin(element)
                yield number, name, place, _solid(*shape)


def _of_obstacles(
    chains: Chains, obstacles: Sequence[Obstacle], file: str
) -> Iterator[_Solid]:
    """Solids that stand still in the base link."""
    base = chains.robot.model.getFrameId(chains.base, pin.FrameType.BODY)
    for k, obstacle in enumerate(obstacles, 1):
        numbers = getattr(obstacle, obstacle.kind)
        if obstacle.mesh is not None:
            path, scale = Path(obstacle.mesh).absolute(), obstacle.scale or (1, 1, 1)
            try:
                numbers = [read_mesh(path, chains.robot, scale=scale)]
            except InputError as error:
                reason = f"the mesh '{path}' of obstacle {k} {error.reason}"
                raise InputError(reason, file=file or None) from None
        place = placed([*obstacle.xyz, *obstacle.rpy])
        name, solid = f"obstacle {k} ({obstacle.kind})", np.atleast_1d(numbers)
        yield base, name, place, _solid(obstacle.kind, solid)


def _adjacent(document: Document) -> set[frozenset[str]]:
    """Links joined by one moving joint."""
    joints = (j for j in document.root.findall("joint") if j.get("type") != "fixed")
    return {frozenset((link_of(j, "parent"), link_of(j, "child"))) for j in joints}


def _disabled(srdf: str | Path, robot: Robot) -> set[frozenset[str]]:
    """Links that an SRDF allows to touch."""
    root = parse_document(read_bytes(srdf, TEXT), str(srdf)).root
    if root.tag != "robot" or root.findall("link"):
        raise InputError("is no SRDF", file=srdf, allowed="a <robot> without links")
    if (name := root.get("name", "")) != robot.name:
        reason = "the SRDF is of another robot"
        raise InputError(reason, file=srdf, value=name, allowed=robot.name)

    def pairs(tag: str) -> set[frozenset[str]]:
        elements = root.findall(tag)
        return {frozenset((e.get("link1", ""), e.get("link2", ""))) for e in elements}

    # MoveIt 2 can also disable all pairs of a link, and enable some of them again.
    alone = (e.get("link", "") for e in root.findall("disable_default_collisions"))
    default = {frozenset((link, other)) for link in alone for other in robot.links}
    return pairs("disable_collisions") | default - pairs("enable_collisions")
