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
from calib_pin.io.packages import locate_mesh
from calib_pin.io.urdf import locate_robot
from calib_pin.io.urdf_bytes import parse_document
from calib_pin.io.urdf_tree import captured_stderr
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
    with MeshReader() as meshes:
        geometry = _solids(robot, package_dirs, meshes)
        links = geometry.ngeoms
        for k, obstacle in enumerate(obstacles if links else (), 1):
            shape = _shape(obstacle, k, file, meshes)
            geometry.addGeometryObject(_obstacle(chains, obstacle, k, shape))
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
        tell(
            "no two solids that may not touch move against each other, so "
            "no collision is checked"
        )
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
    if left_out:
        tell(
            "links that touch at nearly every configuration are not checked against "
            f"each other: {_listed(left_out)}"
        )
    near = [pair for pair in close if pair not in touching]
    if near:
        tell(
            "links that are always closer than the clearance are only kept from "
            f"touching: {_listed(near)}"
        )
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


def _solids(
    robot: Robot, package_dirs: Sequence[str | Path], meshes: MeshReader
) -> pin.GeometryModel:
    """The collision geometry of a URDF, without pairs."""
    urdf = locate_robot(robot.file).resolve()
    try:
        root = ElementTree.fromstring(parse_document(robot.source).plain)
    except ElementTree.ParseError as error:
        # Pinocchio is more lenient.
        reason = f"its collision geometry cannot be read: {error}"
        raise _link_error(robot, "", reason, "well-formed XML") from None
    # Pinocchio would read meshes in this process, so it gets spheres in their place.
    surfaces: dict[str, pin.coal.CollisionGeometry] = {}
    for link in root.iterfind("link"):
        owner = link.get("name", "")
        for k, solid in enumerate(link.iterfind("collision")):
            shape = solid.find("geometry/*")
            if shape is not None and shape.tag == "mesh":
                try:
                    surfaces[f"{owner}_{k}"] = _mesh(shape, urdf, package_dirs, meshes)
                except InputError as error:
                    hint = error.allowed or "another mesh"
                    raise _link_error(robot, owner, error.reason, hint) from None
                shape.tag, shape.attrib = "sphere", {"radius": "1"}
    text = ElementTree.tostring(root, encoding="unicode")
    try:
        with captured_stderr():
            model = pin.buildGeomFromUrdfString(robot.model, text, pin.COLLISION)
    except Exception as failure:  # Whatever C++ throws.
        reason = f"its collision geometry cannot be read: {failure}"
        raise _link_error(robot, "", reason) from None
    for solid in model.geometryObjects:
        solid.geometry = surfaces.get(solid.name, solid.geometry)
    return model


def _mesh(
    mesh: ElementTree.Element,
    urdf: Path,
    package_dirs: Sequence[str | Path],
    meshes: MeshReader,
) -> pin.coal.CollisionGeometry:
    """The surface of a `<mesh>`.

    Raises:
        InputError: If it is missing or cannot be used.
    """
    written = mesh.get("filename", "")
    path = locate_mesh(written, urdf, package_dirs)
    if path is None:
        hint = "--package-dir DIR, the folder of its package"
        if "package://" not in written:
            hint = "a path from the folder of the URDF"
        reason = f"the collision mesh '{written}' does not exist"
        raise InputError(reason, allowed=hint)
    scale = [float(factor) for factor in mesh.get("scale", "1 1 1").split()]
    return _surface(meshes, path, scale, f"the collision mesh '{written}'")


def _surface(
    meshes: MeshReader, path: Path, scale: Sequence[float], name: str
) -> pin.coal.CollisionGeometry:
    """The solid of a mesh file with a name for messages.

    Raises:
        InputError: If it cannot be used.
    """
    try:
        vertices, triangles = meshes.read(path, scale)
    except InputError as error:
        raise InputError(f"{name} {error.reason}") from None
    solid = pin.coal.BVHModelOBBRSS()
    solid.beginModel(len(triangles), len(vertices))
    solid.addVertices(vertices)
    solid.addTriangles(triangles)
    solid.endModel()
    return solid


def _link_error(
    robot: Robot, link: str, reason: str, hint: str = "another mesh"
) -> RobotError:
    """An error about a link, in one line with what helps."""
    document = parse_document(robot.source, robot.file)
    element = next(
        (
            element
            for element in document.root.children
            if element.tag == "link" and element.attributes.get("name") == link
        ),
        document.root,
    )
    owner = f"link '{link}'" if link else "the robot"
    allowed = f"{hint}, or no check of collisions (plan --ignore-collisions)"
    return document.error(element, f"{owner}: {reason}", allowed=allowed)


def _obstacle(
    chains: Chains,
    obstacle: Obstacle,
    number: int,
    shape: pin.coal.CollisionGeometry,
) -> pin.GeometryObject:
    """An obstacle as a solid of the base link."""
    model = chains.robot.model
    base = model.getFrameId(chains.base, pin.FrameType.BODY)
    frame = model.frames[base]
    placement = pin.SE3(pin.rpy.rpyToMatrix(*obstacle.rpy), np.array(obstacle.xyz))
    return pin.GeometryObject(
        f"obstacle {number} ({obstacle.kind})",
        frame.parentJoint,
        base,
        frame.placement * placement,
        shape,
    )


def _shape(
    obstacle: Obstacle, number: int, file: str, meshes: MeshReader
) -> pin.coal.CollisionGeometry:
    if obstacle.box is not None:
        return pin.coal.Box(*obstacle.box)
    if obstacle.sphere is not None:
        return pin.coal.Sphere(obstacle.sphere)
    if obstacle.cylinder is not None:
        return pin.coal.Cylinder(*obstacle.cylinder)
    assert obstacle.mesh is not None
    mesh = f"the mesh '{obstacle.mesh}' of obstacle {number}"
    if not Path(obstacle.mesh).is_file():
        raise InputError(f"{mesh} does not exist", file=file or None)
    try:
        scale = obstacle.scale or (1.0, 1.0, 1.0)
        return _surface(meshes, Path(obstacle.mesh), scale, mesh)
    except InputError as error:
        raise error.within(file) from None


def _adjacent(model: pin.Model) -> set[frozenset[str]]:
    """Links joined by one moving joint."""
    joined = (
        (model.frames[frame.parentFrame], frame)
        for frame in model.frames
        if frame.type == pin.FrameType.BODY
    )
    return {
        frozenset((str(model.frames[joint.parentFrame].name), str(child.name)))
        for joint, child in joined
        if joint.type == pin.FrameType.JOINT
    }


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
    if root.get("name") != robot.name:
        raise InputError(
            "the SRDF is of another robot",
            file=srdf,
            value=root.get("name", ""),
            allowed=robot.name,
        )

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
