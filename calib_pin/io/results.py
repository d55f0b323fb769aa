"""`calibration.json`, section 8 of the contract: a result as a document, and back.

The document holds the fields of `CalibrationResult` as they are declared there, and
beside them those of `Document`: the robot, the frames and reference objects of its
model, and the files. Whoever adds a field to the result has it written and read back.

Frames and reference objects are written as a setup file states them, where the fit has
them; where it began, they are written once more: the values of their parameters are the
way between both. A learned correction is plain numbers, nothing to execute. It means
nothing for another robot, and nobody can see from its numbers that one of them has been
changed: it is taken only as it was written, by its checksum.

It is the document of a folder, of which one run wrote all, and which can be moved. It
has the id of the run and a manifest, the SHA-256 of every file that was written with
it. A URDF is known by its hash, so that it stays as it is. The page says when it was
made: it is known by the id, and has no hash, so that the same run leaves the same
manifest at any time.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

import calib_pin.io.measurement_errors as measurement_errors
from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError, OptionError, OutputError, RobotError
from calib_pin.estimation.evidence import TRUSTED
from calib_pin.estimation.formulation import make_terms
from calib_pin.estimation.statistics.distributions import chi2_interval
from calib_pin.estimation.terms import Terms
from calib_pin.io.files import listed, read_bytes, settled, sha256, write_atomically
from calib_pin.io.json_text import Json, decoded, encode, merged, plain, reading, typed
from calib_pin.io.setup import setup_document, setup_of
from calib_pin.io.straightening import straightened
from calib_pin.io.urdf import is_source, is_xacro, locate_robot
from calib_pin.io.urdf_tree import edit_origins, parse_robot
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.robot import Robot
from calib_pin.measurement_models import measurement_model
from calib_pin.observations import BlockKey
from calib_pin.parameterizations import frame_pose
from calib_pin.residual_models import LearnedCorrection, restore
from calib_pin.residual_models.documents import Array
from calib_pin.setup import FrameSetup
from calib_pin.validation.calibrated_model import CalibratedChain, CalibratedModel
from calib_pin.validation.result import (
    CalibrationResult,
    MeasurementErrors,
    NamedArray,
    Provenance,
    UrdfResult,
)

FORMAT, VERSION = "calib-pin/calibration", 2

JSON = 1 << 28
"""Bytes of the largest document: its objects take many times as much memory."""

DOCUMENT = "calibration.json"
REPORT = "report.html"
NOMINAL = "nominal.urdf"
"""Names in a folder: the result, the page, and the robot as it was."""

TOGETHER = "keep the files of one run together"

PICTURES = (".png", ".pdf", ".svg")
"""Endings of files from which no program takes a number: these may be edited."""

SECTIONS = ("targets", "planes", "sockets", "spheres", "anchors", "cameras")
"""Keys of reference objects: sections of a setup, which knows a single camera."""

LARGEST = 1e12
"""Largest value, position or offset [m, rad, px]; a fit that is lost ends far off."""

AGREEMENT = 1e-9
"""Largest difference of forward kinematics between model and written URDF [m, rad]."""


@dataclass(frozen=True)
class Block:
    """A block of measurements, and the targets that they are of."""

    key: BlockKey = field(metadata={"key": ""})
    targets: tuple[str, ...]


class Value(NamedTuple):
    """The value of a parameter."""

    name: str
    value: float


@dataclass(frozen=True)
class ModelRecord:
    """A calibrated robot, but for its chains and what was learned.

    Attributes:
        places: Frames, and reference objects by the `SECTIONS` of a setup, by name.
    """

    model: str = field(metadata={"key": "measurements.model"})
    blocks: tuple[Block, ...] = field(metadata={"key": "measurements.blocks"})
    parameters: tuple[Value, ...]
    places: Mapping[str, Any] = field(metadata={"key": ""})
    setup: Mapping[str, Any]


@dataclass(frozen=True)
class LearnedRecord:
    """A learned correction: its name, its numbers, and the SHA-256 of these.

    Attributes:
        shift: Of all parameters, in their order, shape (P,).
        model: Document of the `ResidualModel`.
    """

    name: str
    sha256: str
    shift: tuple[float, ...]
    model: Mapping[str, Any]


class Source(NamedTuple):
    """A file and the SHA-256 of its content, empty for what has none, as a pipe."""

    file: str
    sha256: str

    @staticmethod
    def of(file: str) -> Source:
        """A file as it is now.

        Raises:
            InputError: If it cannot be read.
        """
        # A pipe cannot be read twice.
        known = Path(file).is_file()
        return Source(file, sha256(read_bytes(file)) if known else "")


class Ends(NamedTuple):
    """The links at both ends of a chain."""

    base: str
    tip: str


@dataclass(frozen=True)
class RobotRecord:
    """The robot that was calibrated, and its chains; the first that moves at the top.

    Attributes:
        joints: Of all chains.
        chains: By name; none where the only one has no name.
    """

    name: str
    source: Source = field(metadata={"key": ""})
    ends: Ends = field(metadata={"key": ""})
    joints: tuple[str, ...]
    chains: Mapping[str, Ends] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Document:
    """The parts of `calibration.json` that are not the result's own.

    Attributes:
        run: Id of the run that wrote the folder; empty for what stands in none.
        manifest: SHA-256 of the files that were written with it, by name; None for
            those that are known by the id.
        reference: Where the fit began, from which its parameters deviate.
    """

    format: str = FORMAT
    version: int = VERSION
    run: str = ""
    manifest: Mapping[str, str | None] = field(
        default_factory=dict, metadata={"key": "files"}
    )
    robot: RobotRecord
    files: tuple[Source, ...] = field(metadata={"key": "measurements.files"})
    training: int = field(metadata={"key": "measurements.training"})
    validation: int = field(metadata={"key": "measurements.validation"})
    model: ModelRecord = field(metadata={"key": ""})
    reference: Mapping[str, Any]
    residual_model: LearnedRecord | None
    urdf_model: ModelRecord | None
    chi2_interval: tuple[float, ...] = field(
        metadata={"key": "statistics.chi2_interval"}
    )
    setup_file: Source | None


def calibration_document(
    result: CalibrationResult, provenance: Provenance | None = None
) -> Json:
    """A result as the JSON document of version 2.

    Errors of single measurements stand beside it, see `io.measurement_errors`.

    Args:
        result: The result.
        provenance: How it came about; default what the result says.

    Raises:
        InputError: If a measurement file cannot be read again for its hash.
    """
    model, made = result.model, provenance or result.provenance
    urdf = None if result.urdf is None else result.urdf.model
    dof = result.statistics.dof
    chains, setup = model.chains, model.setup.file
    ends = {name: Ends(chains[name].base, chains[name].tip) for name in chains.names}
    chain = model.of_chain().error.chain
    files = map(Source, result.files, made.hashes)
    record = Document(
        robot=RobotRecord(
            chains.robot.name,
            Source(chains.robot.file, sha256(chains.robot.source)),
            Ends(chain.base, chain.tip),
            chains.joints,
            {} if chains.names == ("",) else ends,
        ),
        files=tuple(files if made.hashes else map(Source.of, result.files)),
        training=len(result.fitted),
        validation=result.validation.count,
        model=model_record(model),
        reference=places_of(result.reference),
        residual_model=learned_record(model),
        urdf_model=None if urdf is None else model_record(urdf),
        chi2_interval=chi2_interval(dof) if dof > 0 else (),
        setup_file=Source.of(setup) if setup else None,
    )
    fields = plain(replace(result, provenance=made))
    for errors in fields["errors"].values():
        errors["validation"]["method"] = result.validation.method
    document = merged(plain(record), fields)
    first = ("format", "version", "verdict", "findings", "robot")
    return {key: document[key] for key in first} | document


def document_file(path: str | Path) -> Path:
    """The `calibration.json` of a folder, or the file itself."""
    path = Path(path)
    return path / DOCUMENT if path.is_dir() else path


def read_result(path: str | Path) -> CalibrationResult:
    """Read the whole result of a calibration.

    If `measurements.csv` is missing, the errors of the measurements are unknown (NaN).

    Args:
        path: The folder of the result, or its `calibration.json`.

    Raises:
        InputError: If the file is not such a document or is of another version, the
            robot has changed, or the files beside it belong to another run.
        OutputError: If what a killed run decided on cannot be put in place.
        RobotError: If the robot cannot be found.

    Examples:
        >>> import calib_pin
        >>> calib_pin.read_result("/no/such/folder/calibration.json")
        Traceback (most recent call last):
        calib_pin.errors.InputError: /no/such/folder/calibration.json: no such file
    """
    return read_written(path)[0]


def read_calibration(path: str | Path) -> CalibratedModel:
    """The calibrated robot of a `calibration.json`.

    The robot is looked for where the file says, from the working folder and from that
    of the file, and beside the file itself, where `calibrate` keeps a copy. It must be
    the one that was calibrated.

    Args:
        path: The file, or its folder.

    Raises:
        InputError, OutputError, RobotError: As `read_result`.
    """
    return read_written(path, measured=False)[0].model


def doubt_of(result: CalibrationResult | None, path: str | Path | None) -> str:
    """Why a calibration must not be trusted, in a sentence; empty where it may be."""
    if result is None or result.verdict in TRUSTED:
        return ""
    return f"{path} must not be trusted: {result.reason}"


@serial_blas
def read_written(
    path: str | Path, *, measured: bool = True
) -> tuple[CalibrationResult, Json]:
    """A result, and the document that it was read from.

    Args:
        path: The folder of the result, or its `calibration.json`.
        measured: Whether the errors of single measurements are read.

    Raises:
        InputError, OutputError, RobotError: As `read_result`.
    """
    file = document_file(path)
    with settled(file.parent):
        document, record = read_document(file)
        robot = find_robot(record.robot.source, file)
        require_one_run(record, robot.source, file)
        with reading(file):
            model = model_of(record.model, chains := _chains(record, robot))
            model = learned_model(model, record.residual_model)
            fitted = MeasurementErrors.unknown(model, record.training)
            held_out, errors = None, file.parent / measurement_errors.MEASUREMENTS
            if measured and errors.is_file():
                data = read_bytes(errors)
                fitted, held_out = measurement_errors.decode_errors(data, model)
            urdf, alone, names = document["urdf"], record.urdf_model, model.given.names
            geometry = alone and model_of(alone, chains)
            hashes = tuple(source.sha256 for source in record.files)
            result = typed(
                CalibrationResult,
                document,
                model=model,
                reference=model_of(record.model, chains, record.reference),
                covariance=NamedArray.of(document["covariance"], names, names),
                fitted=fitted,
                held_out=held_out,
                files=tuple(source.file for source in record.files),
                urdf=None if urdf is None else typed(UrdfResult, urdf, model=geometry),
                provenance=typed(Provenance, document, file=str(file), hashes=hashes),
            )
            return result, document


def _chains(record: Document, robot: Robot) -> Chains:
    """The chains that were measured."""
    robot_record, setup = record.robot, setup_of(record.model.setup)
    ends = robot_record.chains or {"": robot_record.ends}
    built = {name: Chain(robot, e.base, e.tip) for name, e in ends.items()}
    default = built.get("", setup)
    return Chains(robot, default.base, default.tip, setup.chains, tuple(built), built)


def read_document(path: str | Path) -> tuple[Json, Document]:
    """A `calibration.json`, and its robot and files as they are declared.

    Raises:
        InputError: If the file is not such a document, or of another version.
    """
    data, folder = read_bytes(path, JSON), Path(path).parent
    document = decoded(data, "calibration", FORMAT, path, version=VERSION)
    with reading(path):
        record = typed(Document, document)
        if not all(listed(folder / name, folder) for name in record.manifest):
            raise ValueError("'files' are not those of a folder")
    return document, record


def used_files(path: str | Path, files: Sequence[Path]) -> list[Path]:
    """Those of some files whose content a calibration has used, to fit or to check.

    Args:
        path: A `calibration.json`, which can be read.
        files: Measurement files; what is no file, such as a pipe, is left alone.
    """
    known = {source.sha256 for source in read_document(path)[1].files} - {""}
    return [file for file in files if Source.of(str(file)).sha256 in known]


# --- the robot ---------------------------------------------------------------------


def model_name(system: Terms) -> str:
    """Names of the measurement models, joined by plus signs."""
    return "+".join(dict.fromkeys(key.model for key in system.terms))


def model_record(model: CalibratedModel) -> ModelRecord:
    """A calibrated robot as plain data."""
    blocks = (Block(k, tuple(p.measurement.targets)) for k, p in model.terms.items())
    values = map(Value, model.given.names, model.theta.tolist())
    about = places_of(model), setup_document(model.setup)
    return ModelRecord(model_name(model), tuple(blocks), tuple(values), *about)


def places_of(model: CalibratedModel) -> Json:
    """Where the frames of all stations and tools are, each once, and all references."""
    sections: dict[str, Json] = {key: {} for key in SECTIONS}
    for (section, name), reference in model.references.items():
        entries = sections[section if section in SECTIONS else "cameras"]
        entries[name] = reference.stated()
    frames = {name.removesuffix(".frame"): at for name, at in model.frames().items()}
    return {"frames": frames, **sections}


def model_of(
    record: ModelRecord, chains: Chains, reference: Mapping[str, Any] | None = None
) -> CalibratedModel:
    """The calibrated robot of plain data.

    Args:
        record: What `model_record` made.
        chains: The nominal chains.
        reference: Where the fit began, for the nominal robot there.

    Raises:
        CalibPinError, KeyError, TypeError, ValueError, AttributeError: If a part is
            missing or is not what it should be, see `json_text.reading`.
    """
    setup, places = setup_of(record.setup), reference or record.places
    frames = {n: typed(FrameSetup, at) for n, at in places["frames"].items()}
    placed = {n if "." in n else f"{n}.frame": at for n, at in frames.items()}
    # A model that looks at nothing with a name has no targets.
    blocks = {block.key: list(block.targets) or [""] for block in record.blocks}
    terms, given = make_terms(chains, blocks, setup)
    values = dict(record.parameters)
    theta = np.array([*values.values()])
    if tuple(values) != given.names or not np.all(np.abs(theta) < LARGEST):
        raise ValueError("the parameters are not those of this chain, in their order")
    theta = theta if reference is None else np.zeros(len(given))
    for key, term in terms.items():
        objects: dict[str, Json] = {}
        for item in term.measurement.references:
            section, name = term.frames.place(item)
            place = places[section if section in SECTIONS else "cameras"][name]
            objects.setdefault(section, {})[item.name] = place
        data = {**record.setup, "camera": None, **objects, **objects.get("camera", {})}
        measurement = measurement_model(key.model, setup_of(data), blocks[key])
        names = term.frames.station, term.frames.tool
        ends = [frames[name.removesuffix(".frame")] for name in names]
        base, tool = map(frame_pose, ends)
        far = max(np.abs(pose.homogeneous).max() for pose in (base, tool))
        known = all(None not in (frame.xyz, frame.rpy) for frame in ends)
        known &= all(item.located for item in measurement.references)
        if not (known and far < LARGEST):
            raise ValueError("a place is not known")
        # An error of the tip is carried by the tool: a URDF has no place for it.
        error = term.error.with_frames(base, pin.SE3.Identity())
        tip = CalibratedChain(error, theta[term.of_error], setup).tool
        error = error.with_frames(base, tip.actInv(tool) * term.frames.offset)
        terms[key] = replace(term, measurement=measurement, error=error)
    model = CalibratedModel(chains, terms, given, theta, setup)
    # Frames and reference objects hold their own values.
    theta = np.where(model.referred, 0.0, theta)
    return replace(model, theta=theta, placed=placed)


def learned_record(model: CalibratedModel) -> LearnedRecord | None:
    """The learned correction of a robot; None where nothing was learned."""
    learned, shift = None, np.zeros(len(model.given))
    for term in model.terms.values():
        if isinstance(correction := term.error.learned, LearnedCorrection):
            learned, shift[term.of_error] = correction, correction.shift
    if learned is None:
        return None
    content = tuple(shift.tolist()), learned.model.document()
    return LearnedRecord(learned.model.name, sha256(encode({"": content})), *content)


def learned_model(
    model: CalibratedModel, record: LearnedRecord | None
) -> CalibratedModel:
    """A robot with what it has learned.

    Raises:
        ValueError: If that is not as it was written, or does not belong to the robot.
    """
    if (record is None) != (model.setup.learned is None):
        raise ValueError("'residual_model' and 'setup.learned' need each other")
    if record is None:
        return model
    if sha256(encode({"": (record.shift, record.model)})) != record.sha256:
        raise ValueError("'residual_model' is not the one that was learned")
    shift = np.array(record.shift)
    Array("P").require("shift", shift, {"P": len(model.given)})
    learned = restore(record.model, len(model.of_chain().error.chain.joints))
    return model.learning(LearnedCorrection(learned, shift))


def write_urdf(
    model: CalibratedModel | None, path: str | Path, *, force: bool = False
) -> None:
    """Write the corrected URDF of a calibrated robot.

    Args:
        model: The calibrated robot, `CalibrationResult.geometry`: its `model` is the
            fit, whatever the verdict on it.
        path: The new file.
        force: Replace an existing file; the robot's own file is never replaced.

    Raises:
        OptionError: If there is none, as the verdict is not `good`; if the file exists
            or is the robot's own, or the model has corrections that a URDF cannot hold.
        OutputError: If it cannot be written or does not agree with the model.
    """
    if model is None:
        reason = "there is no corrected geometry; see 'verdict' and 'reason'"
        raise OptionError(reason, file=path)
    write_atomically(Path(path), encode_urdf(model, path), force=force)


def encode_urdf(model: CalibratedModel, path: str | Path) -> bytes:
    """The corrected URDF of a calibrated robot.

    Only the joint origins that change are edited. The result is read again and its
    forward kinematics compared with the model.

    Args:
        model: The calibrated robot, `CalibrationResult.geometry`.
        path: The file it is for, never the robot's own.

    Raises:
        OptionError: If the file is the robot's own, or the model has corrections that
            a URDF cannot hold.
        OutputError: If it does not read back, or agree with the model.
    """
    if not model.geometric:
        reason = "a URDF cannot hold corrections of joints; write the geometry alone"
        raise OptionError(reason, file=path, allowed="CalibrationResult.geometry")
    chains, nominal = model.chains, model.chains.robot
    if is_source(Path(path), nominal):
        reason = "is the robot's own URDF, which is never changed"
        raise OptionError(reason, file=path, allowed="another file")
    data = edit_origins(nominal.source, model.urdf_corrections(), nominal.file)
    try:
        robot = parse_robot(data, str(path))
    except RobotError as error:
        raise OutputError(f"the corrected URDF does not read back: {error}") from error
    q = chains.random_configurations(20, np.random.default_rng(0))
    for name in model.measured_chains:
        positions, chain = q[:, chains.columns(name)], chains[name]
        fitted, corrected = model.of(name), Chain(robot, chain.base, chain.tip)
        written = fitted.error.base.homogeneous @ corrected.poses(positions)
        expected = fitted.poses(positions) @ fitted.tool.inverse().homogeneous
        difference = float(np.abs(written - expected).max())
        if not difference < AGREEMENT:
            reason = f"the written robot differs from the model by {difference:.2g}"
            raise OutputError(f"{path}: {reason}")
    return data


# --- the folder -------------------------------------------------------------------


def urdf_name(robot: str) -> str:
    """Name of the corrected URDF of a robot.

    Examples:
        >>> urdf_name("ur 10"), urdf_name("Nominal"), urdf_name("../arm")
        ('ur_10.urdf', 'Nominal-corrected.urdf', '_arm.urdf')
    """
    # The name comes from the file: it must not lead out of the folder.
    name = re.sub(r"[^\w.-]", "_", robot).lstrip(".") or "robot"
    # Some file systems do not tell capitals apart.
    clash = f"{name}.urdf".casefold() == NOMINAL
    return f"{name}-corrected.urdf" if clash else f"{name}.urdf"


def require_one_run(record: Document, robot: bytes, path: Path) -> None:
    """Refuse a calibration among files that were not written with it.

    Those that are not there are not missed here; pictures may be edited.

    Args:
        record: The calibration.
        robot: The robot that was calibrated, which may stand in the place of the
            corrected one.
        path: The `calibration.json`.

    Raises:
        InputError: If one of them is of another run, or was edited.
    """
    for name, content in record.manifest.items():
        file = path.parent / name
        if file.suffix in PICTURES or not file.is_file():
            continue
        data = read_bytes(file)
        known = sha256(data) == content or data == robot
        if not (record.run.encode() in data if content is None else known):
            reason = f"was edited, or is of another run than '{path.name}'; {TOGETHER}"
            raise InputError(reason, file=file)


def find_robot(source: Source, path: Path) -> Robot:
    """The robot that was calibrated, recognized by its content.

    Where it was calibrated comes before the copy: meshes are beside the former.

    Args:
        source: Its file as it was given.
        path: The `calibration.json`.

    Raises:
        InputError: If there is only another one.
        RobotError: If there is none.
    """
    given, copy = locate_robot(source.file), path.parent / NOMINAL
    # A xacro file was expanded, and what came of it is in the copy.
    expanded, beside = is_xacro(given), [path.parent / given, path.parent / given.name]
    places = [copy] if expanded else [given, *beside, copy]
    files = [place for place in places if place.is_file()]
    for place in files:
        data = read_bytes(place)
        if sha256(data) != source.sha256:
            with suppress(RobotError):
                data = straightened(parse_robot(data, "")).source
        if sha256(data) == source.sha256:
            original = place == given or (expanded and given.is_file())
            return parse_robot(data, source.file if original else str(place))
    if not files:
        reason = f"the robot '{source.file}' that was calibrated is neither there nor"
        raise RobotError(f"{reason} beside the calibration", file=path)
    reason = f"'{files[0]}' is not the robot that was calibrated"
    raise InputError(f"{reason}; {TOGETHER}", file=path)


def written_before(path: Path) -> list[Path]:
    """Files that were written with a calibration and are still there.

    They are those of its manifest; of anything else, nothing is known.

    Args:
        path: The `calibration.json`, if there is one.

    Raises:
        OutputError: If what a killed run decided on cannot be put in place.
    """
    try:
        with settled(path.parent):
            names = read_document(path)[1].manifest
    except InputError:
        return []
    return [path.parent / name for name in names if (path.parent / name).is_file()]
