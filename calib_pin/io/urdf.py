"""Robots by name or file: a URDF, what becomes one, and the bundled ones."""

from __future__ import annotations

import importlib.metadata
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache
from pathlib import Path

from calib_pin.errors import (
    CalibPinError,
    InputError,
    OptionError,
    RobotError,
    nearest,
    require_known,
)
from calib_pin.io.children import converted
from calib_pin.io.files import TEXT, read_bytes, same_file
from calib_pin.io.packages import package_folders
from calib_pin.io.straightening import straightened
from calib_pin.io.urdf_tree import parse_document, parse_robot
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.robot import Robot
from calib_pin.setup import ChainSetup, Setup

_GAP = re.compile(r"\s+(?=[^\W\d]\w*:=)")
"""The blanks before an argument of a xacro file, as ROS writes them."""
_EXAMPLE = "example:"
_DESCRIPTION = "robot_description"
"""Stands for the file of a robot that is given as text, as ROS calls it."""
_MUJOCO = (".xml", ".mjcf")


def bundled_robots() -> dict[str, Path]:
    """The robots that come with calib-pin.

    Returns:
        Path of each robot's URDF by name, sorted.

    Examples:
        >>> all(path.is_file() for path in bundled_robots().values())
        True
    """
    package = Path(__file__).parents[1]
    folder = package / "robots"
    if not folder.is_dir():  # A source checkout keeps them beside the package.
        folder = package.parent / "robots"
    return {path.parent.name: path for path in sorted(folder.glob("*/robot.urdf"))}


def known_robots() -> dict[str, Path]:
    """The bundled robots, and those of example-robot-data, by the names of both.

    Examples:
        >>> "pa10" in known_robots()
        True
    """
    robots, files = bundled_robots(), list[Path]()
    data = "cmeel.prefix/share/example-robot-data"
    with suppress(importlib.metadata.PackageNotFoundError):
        package = importlib.metadata.distribution("example-robot-data")
        files = _urdfs(Path(str(package.locate_file(data))))
    stems = Counter(path.stem for path in files)
    for path in files:
        # Of several robots of one name a longer one tells which.
        parts = path.with_suffix("").parts[-3 if stems[path.stem] > 1 else -1 :]
        robots[_EXAMPLE + "/".join(parts)] = path
    return robots


@cache
def _urdfs(folder: Path) -> list[Path]:
    """The URDF files of an installed package, sorted; each mesh of a robot asks."""
    return sorted(folder.rglob("*.urdf"))


def robot_file(robot: str, name: str) -> Path:
    """A file that comes with a bundled robot.

    Args:
        robot: Name of the robot.
        name: Name of the file, such as `setup.yaml`.

    Raises:
        OptionError: If there is no such robot or file.

    Examples:
        >>> robot_file("space7", "setup.yaml").name
        'setup.yaml'
    """
    robots = bundled_robots()
    require_known("bundled robot", robot, robots)
    folder = robots[robot].parent
    require_known(f"file of '{robot}'", name, sorted(p.name for p in folder.iterdir()))
    return folder / name


def load_chain(
    name_or_path: str | Path, *, base: str | None = None, tip: str | None = None
) -> Chain:
    """Load a robot and take the chain between two of its links.

    Args:
        name_or_path: Path of a URDF, a xacro file with its arguments or one of MuJoCo,
            the name of a bundled robot, or `example:` and that of one of
            example-robot-data; or the text of a URDF, as a node of ROS has it.
        base: Link the chain starts at; default the root.
        tip: Link the chain ends at; default the only leaf.

    Raises:
        RobotError: If the robot or a link cannot be used.

    Examples:
        >>> load_chain("example:ur10_robot", tip="wrist_3_link").joints[0]
        'shoulder_pan_joint'
    """
    return load_chains(name_or_path, base=base, tip=tip)[""]


def load_chains(
    name_or_path: str | Path,
    *,
    base: str | None = None,
    tip: str | None = None,
    stated: Mapping[str, ChainSetup] | None = None,
    names: Sequence[str] = ("",),
    package_dirs: Sequence[str | Path] = (),
) -> Chains:
    """Load a robot and take several chains of its tree.

    Their names are those in the column `chain` of measurements.

    Args:
        name_or_path: As for `load_robot`.
        base: Link at which chains start that do not state another; default the root.
        tip: Link at which the default chain ends; default the only leaf.
        stated: Base and tip of chains by name, as in a setup.
        names: Names of the chains, see `Chains`.
        package_dirs: As for `load_robot`.

    Raises:
        RobotError: If the robot, a chain or a link cannot be used.

    Examples:
        >>> hands = ("arm_left_7_link", "arm_right_7_link")
        >>> chains = load_chains("example:talos_reduced", names=hands)
        >>> len(chains.joints), len(chains["arm_left_7_link"].joints)
        (16, 9)
    """
    robot = load_robot(name_or_path, package_dirs)
    return Chains(robot, base, tip, stated or {}, names)


def load_robot(
    name_or_path: str | Path, package_dirs: Sequence[str | Path] = ()
) -> Robot:
    """Load a robot.

    Args:
        name_or_path: Path of a URDF, a xacro file or one of MuJoCo, else the name of a
            bundled robot, else `example:` and the file name of a robot of
            example-robot-data. Behind the path of a xacro file may stand its arguments,
            `arm.xacro size:=10`. Or the text of a URDF.
        package_dirs: Folders of the packages that a xacro file names; then come those
            of ROS and the folders above the file.

    Returns:
        The robot, checked, and straightened where it needs that, see
        `io.straightening`; then its `remarks` say so.

    Raises:
        OptionError: If the extra for xacro is missing, or another file has arguments.
        RobotError: If there is no such robot, or its URDF cannot be used.

    Examples:
        >>> load_robot("example:panda").root
        'panda_link0'
    """
    name = str(name_or_path)
    if name.lstrip().startswith("<"):
        return straightened(parse_robot(name.strip().encode(), _DESCRIPTION))
    path, (file, arguments) = locate_robot(name), split_arguments(name)
    if arguments and not is_xacro(path):
        reason = f"{next(iter(arguments))}:= is an argument for a xacro file"
        raise OptionError(reason, file=file, allowed="a file that ends in .xacro")
    try:
        urdf = source = read_bytes(path, TEXT)
    except InputError as error:
        raise _unread(name, error.reason) from error
    remark, other = "", path.suffix.lower() in _MUJOCO
    if is_xacro(path):
        folders = list(map(str, package_folders(path.absolute(), package_dirs)))
        urdf, _ = converted("xacro", path, arguments=arguments, folders=folders)
    elif other and parse_document(source, name).root.tag == "mujoco":
        urdf, remark = converted("MJCF", path)
    try:
        robot = parse_robot(urdf, name)
    except RobotError as error:
        if urdf is source:
            raise
        raise error.within(name) from error  # Its lines are in no file.
    return straightened(replace(robot, remarks=(remark,) if remark else ()))


def split_arguments(robot: str) -> tuple[str, dict[str, str]]:
    """The file in a user's word for a robot, and its arguments.

    Args:
        robot: The word.

    Examples:
        >>> split_arguments("my arm.urdf.xacro size:=10 name:=my arm")
        ('my arm.urdf.xacro', {'size': '10', 'name': 'my arm'})
    """
    file, *words = _GAP.split(robot)
    parts = (word.partition(":=") for word in words)
    return file, {name: value for name, _, value in parts}


def is_xacro(path: Path) -> bool:
    """Whether a file is to be expanded, by its name."""
    return path.suffix.lower() == ".xacro"


def locate_robot(name: str) -> Path:
    """Path of the URDF that a user's word stands for, whether or not it is there.

    Args:
        name: As for `load_robot`.

    Examples:
        >>> locate_robot("pa10").name, locate_robot("my/arm.urdf").name
        ('robot.urdf', 'arm.urdf')
    """
    name, _ = split_arguments(name)
    path, known = Path(name), bundled_robots()
    if not (name in known or name.startswith(_EXAMPLE)) or path.is_file():
        return path
    return known_robots().get(name.removesuffix(".urdf"), path)


def _unread(name: str, reason: str) -> RobotError:
    """The error of a user's word for which no file can be read, with what there is."""
    known, bundled = known_robots(), ", ".join(bundled_robots())
    if name.startswith(_EXAMPLE) and not any(_EXAMPLE in key for key in known):
        reason = "example robots need a package: pip install 'example-robot-data>=4.4'"
    elif reason == "no such file":
        reason += nearest(name, known)
    allowed = f"a URDF or xacro file, a bundled robot ({bundled}), or {_EXAMPLE}NAME"
    return RobotError(reason, file=name or ".", allowed=allowed)


def is_source(path: Path, robot: Robot) -> bool:
    """Whether a file is the one that a robot was read from."""
    return same_file(path, locate_robot(robot.file))


def other_robots(chains: Chains, setup: Setup) -> Iterator[Chains]:
    """Robots known by name that may have been measured: of chains with the same joints.

    Args:
        chains: The chains that were taken to be measured.
        setup: The setup.
    """
    ends = (setup.base, setup.tip)
    joints = [f'"{joint}"'.encode() for joint in chains.joints]
    # Of robots with the same geometry the plainest name counts.
    for name, path in sorted(known_robots().items(), key=lambda known: len(known[0])):
        with suppress(CalibPinError):
            source = read_bytes(path)
            if source != chains.robot.source and all(j in source for j in joints):
                robot = load_robot(name)
                base, tip = (k if k in robot.links else None for k in ends)
                other = Chains(robot, base, tip, setup.chains, chains.names)
                if {*other.joints} == {*chains.joints}:
                    yield other
