"""Robots in and out: load a URDF, write it back with corrected joint origins."""

from __future__ import annotations

import importlib.metadata
import os
import re
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import pinocchio as pin

from calib_pin.errors import InputError, OptionError, OutputError, RobotError, nearest
from calib_pin.io.files import read_bytes, write_atomically
from calib_pin.io.urdf_bytes import (
    Document,
    Element,
    edit_origins,
    parse_document,
    read_origin,
)
from calib_pin.kinematics.chain import Chain, Robot

__all__ = [
    "bundled_robots",
    "corrected_urdf",
    "edit_origins",
    "is_source",
    "load_chain",
    "load_robot",
    "locate_robot",
    "parse_robot",
    "robot_file",
    "write_corrected_urdf",
]

_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
_WITH_AXIS = ("revolute", "continuous", "prismatic", "planar")
_EXAMPLE = "example:"


def bundled_robots() -> dict[str, Path]:
    """The robots that come with calib-pin.

    Returns:
        Path of each robot's URDF by name, sorted.

    Example:
        >>> all(path.is_file() for path in bundled_robots().values())
        True
    """
    package = Path(__file__).parents[1]
    folder = package / "robots"
    if not folder.is_dir():  # A source checkout keeps them beside the package.
        folder = package.parent / "robots"
    return {path.parent.name: path for path in sorted(folder.glob("*/robot.urdf"))}


def robot_file(robot: str, name: str) -> Path:
    """A file that comes with a bundled robot.

    Args:
        robot: Name of the robot.
        name: Name of the file, such as `setup.yaml`.

    Raises:
        RobotError: If there is no such robot or file.

    Example:
        >>> robot_file("space7", "setup.yaml").name
        'setup.yaml'
    """
    robots = bundled_robots()
    if robot not in robots:
        raise RobotError(
            f"there is no bundled robot '{robot}'{nearest(robot, robots)}",
            allowed=", ".join(robots),
        )
    folder = robots[robot].parent
    files = sorted(file.name for file in folder.iterdir())
    if name not in files:
        raise RobotError(
            f"'{robot}' has no file '{name}'{nearest(name, files)}",
            allowed=", ".join(files),
        )
    return folder / name


def load_chain(
    name_or_path: str | Path, *, base: str | None = None, tip: str | None = None
) -> Chain:
    """Load a robot and take the chain between two of its links.

    Args:
        name_or_path: As for `load_robot`.
        base: Link the chain starts at; default the root.
        tip: Link the chain ends at; default the only leaf.

    Raises:
        RobotError: If the robot or a link cannot be used.

    Example:
        >>> load_chain("example:ur10_robot", tip="wrist_3_link").joints[0]
        'shoulder_pan_joint'
    """
    return Chain(load_robot(name_or_path), base, tip)


def load_robot(name_or_path: str | Path) -> Robot:
    """Load a robot.

    Args:
        name_or_path: Path of a URDF, else the name of a bundled robot, else
            `example:` and the file name of a robot of example-robot-data.

    Returns:
        The robot, checked.

    Raises:
        RobotError: If there is no such robot, or its URDF cannot be used.

    Example:
        >>> load_robot("example:panda").root
        'panda_link0'
    """
    name = str(name_or_path)
    path = locate_robot(name)
    try:
        source = read_bytes(path)
    except InputError as error:
        reason, bundled = error.reason, bundled_robots()
        if reason == "no such file":
            reason += nearest(name, bundled)
        names = f" ({', '.join(bundled)})" if bundled else ""
        allowed = f"a URDF file, a bundled robot{names}, or {_EXAMPLE}NAME"
        raise RobotError(reason, file=name or ".", allowed=allowed) from error
    return parse_robot(source, name)


def parse_robot(source: bytes, file: str) -> Robot:
    """Check a URDF and build the robot.

    Args:
        source: The bytes of the URDF.
        file: Where they come from, for messages.

    Returns:
        The robot.

    Raises:
        RobotError: If the URDF cannot be used.

    Example:
        >>> parse_robot(b'<robot name="r"><link name="a"/></robot>', "r.urdf").leaves
        ('a',)
    """
    document = parse_document(source, file)
    root = document.root
    if root.tag != "robot":
        raise document.error(
            root, f"the outermost element is <{root.tag}>", allowed="<robot>"
        )
    name = _attribute(document, root, "name", "the robot")
    links = _named(document, "link")
    joints = _named(document, "joint")
    if not links:
        raise document.error(root, "the robot has no links")
    for joint in joints.values():
        _check_joint(document, joint, links)
    parents = _parents(document, joints)
    root_link = _root(document, links, joints, parents)
    inner = {_end(joint, "parent") for joint in joints.values()}
    fixed = {
        child: joint
        for child, joint in parents.items()
        if joints[joint].attributes["type"] == "fixed"
    }
    return Robot(
        name=name,
        file=file,
        source=source,
        model=_build_model(document, links, joints),
        root=root_link,
        links=tuple(links),
        leaves=tuple(link for link in links if link not in inner),
        fixed_parents=fixed,
        refused=_refused(joints),
    )


def write_corrected_urdf(
    path: str | Path,
    robot: Robot,
    corrections: Mapping[str, pin.SE3],
    check: Callable[[Robot], None] | None,
    force: bool = False,
) -> None:
    """Write a robot's URDF with corrected joint origins.

    Args:
        path: The new file; never the robot's own.
        robot: As for `corrected_urdf`.
        corrections: As for `corrected_urdf`.
        check: As for `corrected_urdf`.
        force: Replace an existing file.

    Raises:
        OptionError: If the file exists and `force` is false, or is the robot's own.
        OutputError: If it cannot be written or does not read back.
        RobotError: If the robot has no joint of such a name.

    Example:
        >>> robot = load_robot("example:panda")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     new = Path(folder, "panda.urdf")
        ...     write_corrected_urdf(new, robot, {}, check=None)
        ...     new.read_bytes() == robot.source
        True
    """
    corrected = corrected_urdf(path, robot, corrections, check)
    write_atomically(Path(path), corrected, force=force)


def corrected_urdf(
    path: str | Path,
    robot: Robot,
    corrections: Mapping[str, pin.SE3],
    check: Callable[[Robot], None] | None,
) -> bytes:
    """A robot's URDF with corrected joint origins.

    Args:
        path: The file it is for; never the robot's own.
        robot: The robot.
        corrections: Correction of each joint by name, multiplied from the right.
        check: Called with the robot as it reads back; raises `OutputError` if the
            robot is not as it should be.

    Raises:
        OptionError: If the file is the robot's own.
        OutputError: If it does not read back.
        RobotError: If the robot has no joint of such a name.
    """
    if is_source(Path(path), robot):
        raise OptionError(
            "is the robot's own URDF, which is never changed",
            file=path,
            allowed="another file",
        )
    corrected = edit_origins(robot.source, corrections, robot.file)
    try:
        reread = parse_robot(corrected, str(path))
    except RobotError as error:
        raise OutputError(f"the corrected URDF does not read back: {error}") from error
    if check is not None:
        check(reread)
    return corrected


def locate_robot(name: str) -> Path:
    """Path of the URDF that a user's word stands for, whether or not it is there.

    Args:
        name: As for `load_robot`.

    Raises:
        RobotError: If example-robot-data has no such robot.

    Example:
        >>> locate_robot("pa10").name, locate_robot("my/arm.urdf").name
        ('robot.urdf', 'arm.urdf')
    """
    path = Path(name)
    bundled = bundled_robots()
    if name in bundled and not path.is_file():
        return bundled[name]
    if name.startswith(_EXAMPLE) and not path.is_file():
        return _example(name)
    return path


def _example(name: str) -> Path:
    """Path of a robot of example-robot-data, by the end of its path."""
    data = "cmeel.prefix/share/example-robot-data"
    files: Sequence[Path] = ()
    try:
        distribution = importlib.metadata.distribution("example-robot-data")
        files = sorted(Path(str(distribution.locate_file(data))).rglob("*.urdf"))
    except importlib.metadata.PackageNotFoundError:
        pass
    if not files:
        raise RobotError(
            "example robots need a package: pip install 'example-robot-data>=4.4'",
            file=name,
        )
    stem = name.removeprefix(_EXAMPLE).removesuffix(".urdf")
    wanted = Path(stem).parts
    matches = [
        path for path in files if path.with_suffix("").parts[-len(wanted) :] == wanted
    ]
    if len(matches) == 1:
        return matches[0]
    if matches:
        ends = [path.with_suffix("").parts[-3:] for path in matches]
        raise RobotError(
            f"{len(matches)} example robots have this name",
            file=name,
            allowed=", ".join(_EXAMPLE + "/".join(end) for end in ends),
        )
    stems = sorted({path.stem for path in files})
    longer = [_EXAMPLE + other for other in stems if stem and stem in other]
    hint = "" if longer else nearest(stem, stems)
    reason = f"example-robot-data has no robot '{stem}'{hint}"
    raise RobotError(reason, file=name, allowed=", ".join(longer) or None)


def is_source(path: Path, robot: Robot) -> bool:
    """Whether a file is the one that a robot was read from."""
    try:
        return path.samefile(locate_robot(robot.file))
    except (OSError, ValueError, RobotError):
        return False  # One of them does not exist.


def _attribute(document: Document, element: Element, key: str, owner: str) -> str:
    value = element.attributes.get(key, "")
    if not value:
        raise document.error(element, f"{owner} has no {key}")
    return value


def _named(document: Document, tag: str) -> dict[str, Element]:
    """All links or all joints by name, in the order of the file."""
    result: dict[str, Element] = {}
    for element in document.root.children:
        if element.tag != tag:
            continue
        name = _attribute(document, element, "name", f"a {tag}")
        if name in result:
            reason = f"{tag} '{name}' is here for the second time"
            line = result[name].line
            raise document.error(element, f"{reason}, the first is in line {line}")
        result[name] = element
    return result


def _end(joint: Element, role: str) -> str:
    """Name of a joint's parent or child link."""
    element = joint.child(role)
    return "" if element is None else element.attributes.get("link", "")


def _check_joint(
    document: Document, joint: Element, links: Mapping[str, Element]
) -> None:
    name = joint.attributes["name"]
    owner = f"joint '{name}'"
    kind = _attribute(document, joint, "type", owner)
    if kind not in _TYPES:
        reason = f"{owner} has the unknown type '{kind}'{nearest(kind, _TYPES)}"
        raise document.error(joint, reason, allowed=", ".join(_TYPES))
    if name == "universe" and kind != "fixed":
        reason = "a joint cannot be called 'universe', Pinocchio's name for the world"
        raise document.error(joint, reason)
    for role in ("parent", "child"):
        link = _end(joint, role)
        if not link:
            raise document.error(joint, f"{owner} names no {role} link")
        if link not in links:
            reason = f"the {role} link '{link}' of {owner} does not exist"
            raise document.error(joint, reason + nearest(link, links))
    read_origin(document, joint)
    axis = joint.child("axis")
    if axis is not None and kind in _WITH_AXIS:
        _attribute(document, axis, "xyz", f"the <axis> of {owner}")
        if not document.numbers(owner, axis, "xyz", 3).any():
            raise document.error(axis, f"the axis of {owner} is zero")
    limit = joint.child("limit")
    for key in ("lower", "upper", "effort", "velocity"):
        if limit is not None and key in limit.attributes:
            document.numbers(owner, limit, key, 1)


def _parents(document: Document, joints: Mapping[str, Element]) -> dict[str, str]:
    """The joint that carries each link but the root."""
    result: dict[str, str] = {}
    for name, joint in joints.items():
        child = _end(joint, "child")
        if child in result:
            reason = f"link '{child}' is the child of two joints"
            raise document.error(joint, f"{reason}, '{result[child]}' and '{name}'")
        result[child] = name
    return result


def _root(
    document: Document,
    links: Mapping[str, Element],
    joints: Mapping[str, Element],
    parents: Mapping[str, str],
) -> str:
    """Name of the root link, after a check that the links form one tree."""
    grounded: set[str] = set()
    for link in links:
        branch = [link]
        while branch[-1] in parents and branch[-1] not in grounded:
            branch.append(_end(joints[parents[branch[-1]]], "parent"))
            if branch[-1] in branch[:-1]:
                loop = " > ".join(reversed(branch[branch.index(branch[-1]) :]))
                reason = f"the links {loop} form a loop, and a URDF is a tree"
                raise document.error(joints[parents[branch[-1]]], reason)
        grounded.update(branch)
    roots = [link for link in links if link not in parents]
    if len(roots) > 1:
        names = ", ".join(f"'{link}'" for link in roots)
        reason = f"the links {names} all have no parent joint, and a URDF has one root"
        raise document.error(links[roots[1]], reason)
    return roots[0]


def _refused(joints: Mapping[str, Element]) -> dict[str, str]:
    """Reasons, for the sentence "joint x is ..., which a chain cannot contain"."""
    result = {}
    for name, joint in joints.items():
        if joint.child("mimic") is not None:
            result[name] = "a mimic joint"
        elif joint.attributes["type"] in ("floating", "planar"):
            result[name] = f"a {joint.attributes['type']} joint"
    return result


def _build_model(
    document: Document, links: Mapping[str, Element], joints: Mapping[str, Element]
) -> pin.Model:
    # The declaration may name the encoding of the file, and this is UTF-8 by now.
    text = re.sub(r"\A<\?xml.*?\?>", "", document.data.decode(), flags=re.DOTALL)
    try:
        with captured_stderr() as printed:
            model = pin.buildModelFromXML(text)
    except Exception as failure:  # Whatever C++ throws.
        errors = re.search(r"Error:\s+(.*?)\s+at line", printed[0], re.DOTALL)
        reason = f"Pinocchio cannot read it: {errors[1] if errors else failure}"
        named = re.findall(r"[Jj]oint \[(.+?)\]", printed[0])
        culprit = next((joints[name] for name in named if name in joints), None)
        raise document.error(culprit or document.root, reason) from failure
    for name, link in links.items():
        if not model.existFrame(name, pin.FrameType.BODY):
            raise document.error(link, f"Pinocchio does not take over link '{name}'")
    for name, joint in joints.items():
        fixed = joint.attributes["type"] == "fixed"
        if not fixed and not model.existJointName(name):
            raise document.error(joint, f"Pinocchio does not take over joint '{name}'")
    return model


@contextmanager
def captured_stderr() -> Iterator[list[str]]:
    """Collect what C++ prints to file descriptor 2, past `sys.stderr`."""
    printed: list[str] = []
    if sys.stderr is not None:
        sys.stderr.flush()
    try:
        saved = os.dup(2)
    except OSError:  # It is closed, so nothing is printed.
        yield [""]
        return
    with tempfile.TemporaryFile() as file:
        os.dup2(file.fileno(), 2)
        try:
            yield printed
        finally:
            os.dup2(saved, 2)
            os.close(saved)
            file.seek(0)
            printed.append(file.read().decode(errors="replace"))
