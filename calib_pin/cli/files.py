"""The files that commands read, and those they must not write."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from itertools import compress, product
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import calib_pin.errors as errors
from calib_pin.cli.options import OfCalibration, OfRobot, same
from calib_pin.cli.printing import Bar, notice, stage
from calib_pin.errors import InputError, OptionError, RobotError, enumerated
from calib_pin.io.files import same_file
from calib_pin.io.measured_columns import asked_models
from calib_pin.io.measurements import read_measurements
from calib_pin.io.urdf import load_chains, locate_robot
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.joint_space import FREE_TRAVEL
from calib_pin.measurement_models import MEASUREMENT_MODELS
from calib_pin.observations import BlockKey, Observations
from calib_pin.parameterizations import required_keys
from calib_pin.setup import WORLD, Setup
from calib_pin.setup.arguments import keys_of

if TYPE_CHECKING:
    from calib_pin.validation.result import CalibrationResult

exists = os.path.exists  # False also where that cannot be determined.

FLAGS = ("base", "tip", "model", "parameters", "solver", "loss", "learned")
"""Settings that flags may state in place of a setup file."""

MANY_TURNS = 60.0
"""Range from which the limits of a joint look like degrees, ten turns [rad]."""


def open_setup(file: Path | None) -> Setup:
    """A setup file; where none is given, what holds without one.

    Raises:
        InputError: If the file cannot be used.
    """
    if file is None:
        return Setup()
    from calib_pin.io.setup import read_setup  # With all that may be stated.

    return read_setup(file)


def setup_for(asked: OfRobot) -> Setup:
    """The setup file of a command with its options on top.

    Raises:
        InputError: If the file cannot be used.
        OptionError: If an option cannot.
    """
    setup = open_setup(asked.setup)
    given = {k: v for k, v in vars(asked).items() if k in FLAGS and v is not None}
    asked_models(given.get("model"))
    if "parameters" in given:
        given["parameters"] = tuple(map(str.strip, given["parameters"].split(",")))
    if "solver" in given:
        given["solver"] = replace(setup.solver, name=given["solver"])
    return replace(setup, **given)


def block_keys(setup: Setup, *chains: str) -> tuple[BlockKey, ...]:
    """The blocks that can be measured: models, chains, stations and tools of a setup.

    Args:
        setup: The setup.
        chains: Names of the chains; default all of the setup.

    Raises:
        OptionError: If neither the setup nor a flag names a measurement model.
    """
    if setup.model is None:
        reason = "without measurements, --model must name the measurement model"
        raise OptionError(reason, allowed=", ".join(MEASUREMENT_MODELS))
    parts = (chains or setup.chains, setup.stations, setup.tools)
    places = (tuple(names) or ("",) for names in parts)
    keys = product(asked_models(setup.model), *places)
    return tuple(BlockKey(*key) for key in keys)


def open_chains(
    asked: OfRobot, setup: Setup, measured: Sequence[BlockKey] | str | None = None
) -> Chains:
    """The chains of a robot by the setup.

    Args:
        asked: The robot and its packages.
        setup: The setup.
        measured: What is measured, or the name of the only chain; default what the
            measurements will name.

    Raises:
        OptionError: If a folder of packages is not there.
        RobotError: If the robot, a link or a chain cannot be used.
    """
    robot, package_dirs = asked.robot, asked.package_dir or []
    require_folders(package_dirs)
    if robot.endswith(".json"):
        reason = "is a calibration, which evaluate and compensate take, and no robot"
        allowed = "a URDF file, such as the corrected one"
        raise RobotError(reason, file=robot, allowed=allowed)
    # A tip that is stated has to be there, whatever else is measured.
    names = [] if setup.tip is None else [""]
    if measured is not None:
        names = [measured] if isinstance(measured, str) else [k.chain for k in measured]
    ends: Any = {"base": setup.base, "tip": setup.tip, "stated": setup.chains}
    chains = load_chains(robot, **ends, names=names, package_dirs=package_dirs)
    for remark in chains.robot.remarks:
        notice(f"{robot}: {remark}")
    return chains


def tell_limits(chains: Chains) -> None:
    """Remark on joints whose range is only assumed, or many turns."""
    far = (chains.upper - chains.lower > MANY_TURNS) & chains.revolute
    if far.any():
        joints = enumerated(compress(chains.joints, far))
        remark = f"limits of {joints} are many turns; a URDF has rad, no degrees"
        notice(f"{chains.robot.file}: {remark}")
    if chains.unlimited:
        joints = enumerated(chains.unlimited)
        remark = f"limits of {joints} missing, inverted or endless; assumed is a turn"
        notice(f"{chains.robot.file}: {remark}, or {FREE_TRAVEL:g} m either way")


class Subject(NamedTuple):
    """A robot, or a calibration of it, with the setup to read measurements by.

    Attributes:
        calibration: The calibration; None for a robot.
        chains: The chains of the calibration, or of the robot.
        setup: The setup.
        file: The file of the calibration; None for a robot.
        doubt: Why the calibration must not be trusted; empty where it may be.
    """

    calibration: CalibrationResult | None
    chains: Chains
    setup: Setup
    file: Path | None = None
    doubt: str = ""


def open_subject(asked: OfCalibration, *also: str) -> Subject:
    """The robot or calibration that a command is for.

    A calibration is without the errors of its own measurements, of which there may be
    many. Beside it the setup file may state the further keys `also`.

    Raises:
        InputError: If one of the files cannot be used.
        OptionError: If something is stated that a calibration has of its own.
    """
    from calib_pin.io.results import DOCUMENT, doubt_of, model_name, read_written

    setup, chain = setup_for(asked), getattr(asked, "chain", None)
    file = Path(asked.robot, DOCUMENT)
    if not exists(file):
        if not asked.robot.endswith(".json"):
            return Subject(None, open_chains(asked, setup, chain), setup)
        file = Path(asked.robot)
    calibration, _ = read_written(file, measured=False)
    model = calibration.model
    first, models = model.of().chain, model_name(model)
    known = replace(model.setup, base=first.base, tip=first.tip, model=models)
    require_joints_only(setup, *also, known=known)
    if chain is not None:
        errors.require_known("chain", chain, model.measured_chains)
    # Of poses, positions alone may be measured now.
    read = f"{models}+position" if models == "pose" else models
    plain = vars(type(setup)())
    given = {key: getattr(setup, key) for key in ("columns", "joints", *also)}
    changes = {key: value for key, value in given.items() if value != plain[key]}
    used = replace(model.setup, model=read, reading=setup.reading, **changes)
    doubt = doubt_of(calibration, file)
    return Subject(calibration, model.chains, used, file, doubt)


def require_joints_only(setup: Setup, *also: str, known: Setup | None = None) -> None:
    """Refuse what a setup states otherwise than the calibration, which has its own.

    Args:
        setup: The setup.
        also: Further keys that it may state.
        known: The setup of the calibration; None to refuse what it says as well.

    Raises:
        OptionError: If it does.
    """
    keys, other = sorted(("columns", "joints", "reading", *also)), dict[str, None]()
    for name, key in keys_of(Setup).items():
        expected = key.default, getattr(known, name, key.default)
        if name not in keys and getattr(setup, name) not in expected:
            other[str(key.path[0])] = None
    if other:
        reason = f"a calibration has its own {enumerated(other)}"
        raise OptionError(reason, file=setup.file or None, allowed=", ".join(keys))


PLANNED = (
    *("model", "parameters", "fixed", "base_frame", "tool_frame", "stations", "tools"),
    *("targets", "planes", "sockets", "spheres", "anchors", "camera"),
    *("distances", "payloads", "gravity"),
)
"""Statements that a plan takes from an older calibration where there is no other."""


def open_older(
    path: Path | None, setup: Setup, *, used: Sequence[Path] = (), planned: bool = False
) -> tuple[CalibrationResult | None, Setup]:
    """An older calibration, and a setup with what it leaves open as that has it.

    Args:
        path: Its folder or its `calibration.json`; None for none.
        setup: The options of a command, on top of its setup file; without one the
            parameters and the ends of the chain are taken.
        used: Measurements that it must not have used.
        planned: Whether the instrument and the frames that it has found are taken.

    Raises:
        InputError: If it cannot be read, or has used one of the measurements: they
            would count twice.
    """
    if path is None:
        return None, setup
    from calib_pin.io.results import document_file, read_result, used_files
    from calib_pin.planning.suggestions import calibrated_setup

    older = read_result(path)
    for file in used_files(document_file(path), used):
        reason = "the older calibration has used these measurements, which would count "
        reason += "twice"
        raise InputError(reason, file=file, value=str(path))
    model, before = older.model, dict[str, Any]()
    if not setup.file:
        before["parameters"] = model.setup.parameters
        if model.chains.names == ("",):
            chain = model.of_chain().error.chain
            before |= {"base": chain.base, "tip": chain.tip}
    if planned:
        known = vars(calibrated_setup(model))
        models = dict.fromkeys(k.model for k in model.terms if k.chain != WORLD)
        before |= {n: known[n] for n in PLANNED} | {"model": "+".join(models)}
    given, empty = vars(setup), vars(type(setup)())
    changes = {n: value for n, value in before.items() if given[n] == empty[n]}
    return older, replace(setup, **changes)


def open_rows(
    asked: OfRobot,
    files: Sequence[Path],
    chains: Chains,
    setup: Setup,
    *,
    sockets: Iterable[str] = (),
    quiet: bool = False,
    bar: Bar | None = None,
) -> tuple[Chains, Observations]:
    """Measurement files and the chains that they name.

    A remark tells of columns that mean nothing. Where a chain is asked for, only its
    measurements count.

    Args:
        asked: The options of a command.
        files: The files.
        chains: The chains of the robot.
        setup: The setup to read by.
        sockets: Sockets whose places are known beside those of the setup.
        quiet: Whether there are no remarks.
        bar: Told the progress.

    Raises:
        InputError: If a file cannot be used.
    """
    require_distinct(files)
    chain = getattr(asked, "chain", None)
    known = (name for name, s in setup.sockets.items() if s.estimate is False)
    quiet = quiet or getattr(asked, "quiet", False)
    given = same(setup, read_measurements) | {"sockets": [*sockets, *known]}
    given |= {"station_per_file": getattr(asked, "station_per_file", False)}
    given |= {"notice": None if quiet else notice, "progress": stage(bar, "read")}
    with errors.in_file(setup.file):
        rows = read_measurements(files, chains, unnamed=chain, **given)
    names = tuple(key.chain for key in rows.keys)
    if chain is not None:
        errors.require_known("measured chain", chain, names)
        rows = Observations(tuple(b for b in rows.blocks if b.chain == chain))
    return chains.named(names), rows


def open_tested(
    asked: OfCalibration, files: Sequence[Path], subject: Subject, bar: Bar | None
) -> tuple[Chains, Observations]:
    """Measurements of a robot or a calibration, see `open_rows`.

    A remark tells which payload of a calibration those carry that name none.
    """
    setup, known = subject.setup, list[str]()
    if subject.calibration is not None:
        known = [r.name for r in subject.calibration.model.references.values()]
    opened = partial(open_rows, asked, files, subject.chains, setup)
    chains, rows = opened(sockets=known, bar=bar)
    unnamed = any("" in block.payload.distinct for block in rows.blocks)
    loaded = "payloads" in required_keys(setup.parameters) and len(setup.payloads) == 1
    if subject.calibration and unnamed and loaded:
        carried = f"'{setup.heaviest}'; a column 'payload' says another one, or 'none'"
        notice(f"measurements without a payload carry {carried}")
    return chains, rows


def beside(file: Path, robot: str) -> str:
    """A robot that a file names: from its folder, or a bundled one.

    A xacro file has its arguments behind it.
    """
    local = exists(file.parent / robot.split(" ")[0])
    return str(file.parent / robot) if local else robot


def require_folders(folders: Sequence[Path]) -> None:
    """Refuse folders that are not there.

    Raises:
        OptionError: If one is missing, or is a file.
    """
    for folder in folders:
        if not folder.is_dir():
            reason = "is a file, not a folder" if exists(folder) else "no such folder"
            raise OptionError(reason, file=folder)


def require_distinct(files: Sequence[Path]) -> None:
    """Refuse measurements that would count twice.

    Raises:
        OptionError: If a file is given twice.
    """
    for position, file in enumerate(files):
        if any(same_file(file, other) for other in files[:position]):
            raise OptionError("this file is given twice", file=file)


def check_outputs(
    outputs: Iterable[Path | None],
    inputs: Iterable[str | Path | None],
    force: bool,
) -> None:
    """Complain about files that must not be written, before the work is done.

    Raises:
        OptionError: If an output exists without `force`, is a folder or an input, is
            given twice, would be the folder of another, or can have no place.
    """
    read = [locate_robot(str(file)) for file in inputs if file is not None]
    written = [path for path in outputs if path is not None]
    for k, path in enumerate(written):
        whole, others = path.absolute(), [other.absolute() for other in written]
        place = next(filter(exists, path.parents))
        require_folders([place])
        if not (exists(path) or os.access(place, os.W_OK)):
            reason = "is a folder in which nothing can be written"
            raise OptionError(reason, file=place)
        faults = {
            "is an input of this run, and inputs are never changed": any(
                same_file(path, file) for file in read
            ),
            "two outputs would go to this file": whole in others[:k],
            "is an output of this run, and cannot be a folder for others": any(
                whole in other.parents for other in others
            ),
            "is a folder, not a file": path.is_dir(),
            "exists already; --force replaces it": exists(path) and not force,
        }
        if wrong := [reason for reason, applies in faults.items() if applies]:
            raise OptionError(wrong[0], file=path)
