"""Collision geometry: the solids of a URDF, an SRDF, and obstacles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.errors import InputError, RobotError
from calib_pin.io.files import TEXT, read_bytes
from calib_pin.io.meshes import MeshReader
from calib_pin.io.urdf_bytes import parse_document
from calib_pin.io.urdf_tree import captured_stderr
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.collision import Collisions
from calib_pin.kinematics.robot import Robot
from calib_pin.kinematics.shapes import Surface
from calib_pin.setup import Obstacle

CLEARANCE = 0.01
"""Distance kept where the user asks for none: robots and fixtures are never quite
where their models are [m]."""

SAMPLES = 200
"""Random configurations that show which pairs touch, and how often."""

BY_DESIGN = 0.95
"""Share of the configurations from which on two links touch, or are close, because they
are built so."""


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
    tell = notice or (lambda line: None)
    chains = Chains.of(chain)
    robot = chains.robot
    apart = _adjacent(robot.model) if srdf is None else _disabled(srdf, robot)
    with MeshReader(robot.file, package_dirs) as meshes:
        geometry = _solids(robot, meshes)
        links = geometry.ngeoms
        for k, obstacle in enumerate(obstacles if links else (), 1):
            solid = _obstacle(chains, obstacle, k, file, meshes)
            geometry.addGeometryObject(solid)
    if links == 0:
        nor = ", and neither are collisions with the obstacles" if obstacles else ""
        tell("the robot has no collision geometry: self-collision is not checked" + nor)
        return None
    solids = [
        (solid.parentJoint, robot.model.frames[solid.parentFrame].name)
        for solid in geometry.geometryObjects
    ]
    for first, second in combinations(range(geometry.ngeoms), 2):
        (joint, link), (other_joint, other) = solids[first], solids[second]
        # Two solids that a joint moves, and of the robot only those that may not touch.
        if joint != other_joint and (
            second >= links or frozenset((link, other)) not in apart
        ):
            geometry.addCollisionPair(pin.CollisionPair(first, second))
    collisions = Collisions(chains, geometry, clearance)
    if not collisions.pairs:
        still = "no two solids that may not touch move against each other"
        tell(f"{still}, so no collision is checked")
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
    close = _by_design(collisions.pairs, contacts, chains.robot)
    places = [k for k, pair in enumerate(collisions.pairs) if pair in close]
    # What touches by design does so without any clearance, however large it is.
    bare = collisions.only(places, np.zeros(len(clearances)))
    touches = bare.contacts(q)
    touching = _by_design(bare.pairs, touches, chains.robot)
    left_out = touching if guess else []
    near = [pair for pair in close if pair not in touching]
    touch = "touch at nearly every configuration are not checked against each other"
    keep = "are always closer than the clearance are only kept from touching"
    for found, words in ((left_out, touch), (near, keep)):
        if found:
            tell(f"links that {words}: {_listed(found)}")
    for place, touched in zip(places, touches.T, strict=True):
        if collisions.pairs[place] in near:
            clearances[place], contacts[:, place] = 0.0, touched
    order = np.argsort(-contacts.mean(axis=0), kind="stable")
    kept = (k for k in order if collisions.pairs[k] not in left_out)
    return collisions.only(kept, clearances)


def _listed(pairs: Sequence[tuple[str, str]]) -> str:
    named = "; ".join(f"{first} and {second}" for first, second in pairs[:3])
    count = "1 pair" if len(pairs) == 1 else f"{len(pairs)} pairs"
    return f"{count} ({named}{'; ...' if len(pairs) > 3 else ''})"


def _solids(robot: Robot, meshes: MeshReader) -> pin.GeometryModel:
    """The collision geometry of a URDF, without pairs."""
    surfaces: dict[str, pin.coal.CollisionGeometry] = {}
    try:
        root = ElementTree.fromstring(parse_document(robot.source).plain)
        # Pinocchio would read meshes in this process: it gets spheres in their place.
        for link in root.iterfind("link"):
            owner = link.get("name", "")
            for k, solid in enumerate(link.iterfind("collision")):
                shape = solid.find("geometry/*")
                if shape is not None and shape.tag == "mesh":
                    surfaces[f"{owner}_{k}"] = _mesh(robot, owner, shape, meshes)
                    shape.tag, shape.attrib = "sphere", {"radius": "1"}
        text = ElementTree.tostring(root, encoding="unicode")
        with captured_stderr():
            model = pin.buildGeomFromUrdfString(robot.model, text, pin.COLLISION)
    except RobotError:
        raise
    except Exception as failure:  # Whatever C++ throws, and what is no XML.
        reason = f"its collision geometry cannot be read: {failure}"
        raise _link_error(robot, "", reason) from None
    for solid in model.geometryObjects:
        solid.geometry = surfaces.get(solid.name, solid.geometry)
    return model


def _mesh(
    robot: Robot, link: str, mesh: ElementTree.Element, meshes: MeshReader
) -> pin.coal.CollisionGeometry:
    """The solid of a `<mesh>`."""
    written = mesh.get("filename", "")
    scale = [float(factor) for factor in mesh.get("scale", "1 1 1").split()]
    try:
        return _solid(meshes.read(written, scale))
    except InputError as error:
        reason = f"the collision mesh '{written}' {error.reason}"
        hint = error.allowed or "another mesh"
        raise _link_error(robot, link, reason, hint) from None


def _solid(surface: Surface) -> pin.coal.CollisionGeometry:
    """A surface that may collide."""
    solid = pin.coal.BVHModelOBBRSS()
    solid.beginModel(len(surface.triangles), len(surface.vertices))
    solid.addVertices(surface.vertices)
    solid.addTriangles(surface.triangles)
    solid.endModel()
    return solid


def _link_error(
    robot: Robot, link: str, reason: str, hint: str = "another mesh"
) -> RobotError:
    """An error about a link, in one line with what helps."""
    document = parse_document(robot.source, robot.file)
    links = {e.attributes.get("name"): e for e in document.root.all("link")}
    element = links.get(link, document.root)
    owner = f"link '{link}'" if link else "the robot"
    allowed = f"{hint}, or no check of collisions (plan --ignore-collisions)"
    return document.error(element, f"{owner}: {reason}", allowed=allowed)


def _obstacle(
    chains: Chains, obstacle: Obstacle, number: int, file: str, meshes: MeshReader
) -> pin.GeometryObject:
    """An obstacle as a solid of the base link."""
    if obstacle.box is not None:
        shape = pin.coal.Box(*obstacle.box)
    elif obstacle.sphere is not None:
        shape = pin.coal.Sphere(obstacle.sphere)
    elif obstacle.cylinder is not None:
        shape = pin.coal.Cylinder(*obstacle.cylinder)
    else:
        assert obstacle.mesh is not None
        path, scale = Path(obstacle.mesh).absolute(), obstacle.scale or (1.0, 1.0, 1.0)
        try:
            shape = _solid(meshes.read(path, scale))
        except InputError as error:
            reason = f"the mesh '{obstacle.mesh}' of obstacle {number} {error.reason}"
            raise InputError(reason, file=file or None) from None
    model = chains.robot.model
    base = model.getFrameId(chains.base, pin.FrameType.BODY)
    frame = model.frames[base]
    place = pin.SE3(pin.rpy.rpyToMatrix(*obstacle.rpy), np.array(obstacle.xyz))
    name = f"obstacle {number} ({obstacle.kind})"
    return pin.GeometryObject(
        name, frame.parentJoint, base, frame.placement * place, shape
    )


def _adjacent(model: pin.Model) -> set[frozenset[str]]:
    """Links joined by one moving joint."""
    joined: set[frozenset[str]] = set()
    for frame in model.frames:
        joint = model.frames[frame.parentFrame]
        if frame.type == pin.FrameType.BODY and joint.type == pin.FrameType.JOINT:
            joined.add(frozenset((model.frames[joint.parentFrame].name, frame.name)))
    return joined


def _disabled(srdf: str | Path, robot: Robot) -> set[frozenset[str]]:
    """Links that an SRDF allows to touch."""
    try:
        root = ElementTree.fromstring(read_bytes(srdf, TEXT))
    except ElementTree.ParseError as error:
        reason = f"not an SRDF: {error.msg.split(':')[0]}"
        raise InputError(reason, file=srdf, line=error.position[0]) from None
    if root.tag != "robot" or root.find("link") is not None:
        found = "a URDF" if root.tag == "robot" else f"<{root.tag}>"
        raise InputError(f"not an SRDF but {found}", file=srdf)
    if (name := root.get("name", "")) != robot.name:
        reason = "the SRDF is of another robot"
        raise InputError(reason, file=srdf, value=name, allowed=robot.name)

    def named(tag: str) -> set[frozenset[str]]:
        return {
            frozenset((element.get("link1", ""), element.get("link2", "")))
            for element in root.iterfind(tag)
        }

    # MoveIt 2 can also disable all pairs of a link, and enable some of them again.
    disabled = {
        element.get("link", "")
        for element in root.iterfind("disable_default_collisions")
    }
    pairs = {frozenset((link, other)) for link in disabled for other in robot.links}
    return named("disable_collisions") | pairs - named("enable_collisions")


def _by_design(
    pairs: Sequence[tuple[str, str]], contacts: NDArray[np.bool_], robot: Robot
) -> list[tuple[str, str]]:
    """Links that are in contact at nearly every configuration."""
    together: dict[tuple[str, str], list[int]] = {}
    for k, pair in enumerate(pairs):
        if set(pair) <= set(robot.links):  # Not an obstacle.
            together.setdefault(pair, []).append(k)
    return [
        pair
        for pair, places in together.items()
        if contacts[:, places].any(axis=1).mean() >= BY_DESIGN
    ]
