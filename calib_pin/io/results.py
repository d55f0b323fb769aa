"""`calibration.json`, section 8 of the contract: a result as a document, and back.

The document holds the fields of `CalibrationResult` as they are declared there, and
beside them those of `Document`: the robot, the frames and reference objects of its
model, and the files. Whoever adds a field to the result has it written and read back.

It is the document of a folder, of which one run wrote all, and which can be moved. It
has the id of the run and a manifest, the SHA-256 of every file that was written with
it. A URDF is known by its hash, so that it stays as it is. The page says when it was
made: it is known by the id, and has no hash, so that the same run leaves the same
manifest at any time.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError, RobotError
from calib_pin.estimation.evidence import TRUSTED, VERDICTS, FoundCurve
from calib_pin.io.calibrated_model import (
    LearnedRecord,
    ModelRecord,
    Places,
    learned_model,
    learned_record,
    model_of,
    model_record,
    places_of,
)
from calib_pin.io.files import inside, read_bytes, settled, sha256
from calib_pin.io.json_text import Json, decoded, encode, merged, plain, reading, typed
from calib_pin.io.measurement_errors import (
    MEASUREMENTS,
    SETS,
    decode_errors,
    unknown_errors,
)
from calib_pin.io.setup import setup_of
from calib_pin.io.straightening import straight_source
from calib_pin.io.urdf import is_xacro, locate_robot
from calib_pin.io.urdf_tree import parse_robot
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.robot import Robot
from calib_pin.kinematics.spatial import Floats
from calib_pin.planning.suggestions import Suggestion
from calib_pin.units import DISPLAY
from calib_pin.validation.assessment import chi2_interval
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.result import (
    CalibrationResult,
    NamedArray,
    Provenance,
)

FORMAT, VERSION = "calib-pin/calibration", 2

JSON = 1 << 28
"""Bytes of the largest document: its objects take many times as much memory."""

DOCUMENT = "calibration.json"
REPORT = "report.html"
NOMINAL = "nominal.urdf"
"""Names in a folder: the result, the page, and the robot as it was."""

MADE = ("command", "created")
"""Keys of the provenance that are new for every run; all others are versions."""

PICTURES = (".png", ".pdf", ".svg")
"""Endings of files from which no program takes a number: these may be edited."""


@dataclass(frozen=True)
class Source:
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


@dataclass(frozen=True)
class Ends:
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
        rotations: By set, rotations from the measurement frame of each block to the
            base link, shape (B, 3, 3).
        suggestions: Suggested measurements.
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
    reference: Places
    rotations: Mapping[str, Floats] = field(metadata={"key": "rotations_to_base"})
    residual_model: LearnedRecord | None
    urdf_model: ModelRecord | None
    suggestions: tuple[Suggestion, ...] = field(
        metadata={"key": "identifiability.remedies"}
    )
    chi2_interval: tuple[float, ...] = field(
        metadata={"key": "statistics.chi2_interval"}
    )
    setup_file: Source | None

    def __post_init__(self) -> None:
        """Refuse a manifest of files that are not those of a folder."""
        if not all(map(inside, self.manifest)):
            raise ValueError("'files' are not those of a folder")


def calibration_document(
    result: CalibrationResult,
    provenance: Provenance | None = None,
    suggestions: Sequence[Suggestion] = (),
) -> Json:
    """A result as the JSON document of version 2.

    Errors of single measurements stand beside it, see `io.measurement_errors`.

    Args:
        result: The result.
        provenance: How it came about; default what the result says.
        suggestions: Suggested measurements.

    Raises:
        InputError: If a measurement file cannot be read again for its hash.
    """
    model, dof = result.model, result.statistics.dof
    alone = None if result.urdf is None else result.urdf.model
    made, chains = provenance or result.provenance, result.model.chains
    chain, setup = model.moving.error.chain, model.setup.file
    files = map(Source, result.files, made.hashes)
    names = () if chains.names == ("",) else chains.names
    parts = zip(SETS, (result.fitted, result.held_out), strict=True)
    record = Document(
        robot=RobotRecord(
            chains.robot.name,
            Source(chains.robot.file, sha256(chains.robot.source)),
            Ends(chain.base, chain.tip),
            chains.joints,
            {n: Ends(chains[n].base, chains[n].tip) for n in names},
        ),
        files=tuple(files if made.hashes else map(Source.of, result.files)),
        training=len(result.fitted),
        validation=result.validation.count,
        model=model_record(model),
        reference=places_of(result.reference),
        rotations={name: part.to_base for name, part in parts if part is not None},
        residual_model=learned_record(model),
        urdf_model=None if alone is None else model_record(alone),
        suggestions=tuple(suggestions),
        chi2_interval=chi2_interval(dof) if dof > 0 else (),
        setup_file=Source.of(setup) if setup else None,
    )
    expected = dict(result.accuracies)
    for name, accuracy in expected.items():
        if (tip := accuracy.tip) is not None:
            # The curve is found when somebody asks.
            tip = replace(tip, by_count=FoundCurve(*tip.by_count.curve))
            expected[name] = replace(accuracy, tip=tip)
    own = plain(replace(result, provenance=made, accuracies=expected))
    for errors in own["errors"].values():
        errors["validation"]["method"] = result.validation.method
    document = merged(plain(record), own)
    first = ("format", "version", "verdict", "findings", "robot")
    return {key: document[key] for key in first} | document


def provenance(command: tuple[str, ...] = (), seconds: float = math.nan) -> Provenance:
    """How a result comes about that is written now, by these versions.

    Args:
        command: The command line; none for a program of its own.
        seconds: Time the solver took; NaN where nobody looked.
    """
    names = {"calib_pin": "calib-pin", "pinocchio": "pin", "numpy": "numpy"}
    return Provenance(
        command=command,
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        seconds=seconds,
        versions={name: version(package) for name, package in names.items()},
    )


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


@serial_blas
def read_written(path: str | Path) -> tuple[CalibrationResult, Json]:
    """A result, and the document that it was read from.

    Args:
        path: The folder of the result, or its `calibration.json`.

    Raises:
        InputError, OutputError, RobotError: As `read_result`.
    """
    file = document_file(path)
    with settled(file.parent):
        document, record, model = _read_model(file)
        with reading(file):
            return _result(document, record, model, file), document


@serial_blas
def read_calibration(
    path: str | Path, *, notice: Callable[[str], None] | None = None
) -> CalibratedModel:
    """The calibrated robot of a `calibration.json`.

    The robot is looked for where the file says, from the working folder and from that
    of the file, and beside the file itself, where `calibrate` keeps a copy. It must be
    the one that was calibrated.

    Args:
        path: The file.
        notice: Called with one sentence if the calibration must not be trusted.

    Raises:
        InputError: If the file is not such a document or of another version, the
            robot has changed, or the files beside it are of another run.
        OutputError: If what a killed run decided on cannot be put in place.
        RobotError: If the robot cannot be found.
    """
    path = Path(path)
    with settled(path.parent):
        document, _, model = _read_model(path)
    verdict = document["verdict"]
    if notice is not None and verdict["status"] not in TRUSTED:
        notice(f"{path} must not be trusted: {verdict['reason']}")
    return model


def read_suggestions(document: Json) -> tuple[Suggestion, ...]:
    """The suggested measurements in a document that was read."""
    return typed(tuple[Suggestion, ...], document["identifiability"]["remedies"])


def used_files(path: str | Path, files: Sequence[Path]) -> list[Path]:
    """Those of some files whose content a calibration has used, to fit or to check.

    Args:
        path: A `calibration.json`, which can be read.
        files: Measurement files; what is no file, such as a pipe, is left alone.
    """
    known = {source.sha256 for source in read_record(path).files} - {""}
    return [file for file in files if Source.of(str(file)).sha256 in known]


def _read_model(path: Path) -> tuple[Json, Document, CalibratedModel]:
    """A `calibration.json`, and the calibrated robot that it tells of.

    Raises:
        InputError, RobotError: As `read_calibration`.
    """
    document = read_document(path)
    with reading(path):
        record, verdict = typed(Document, document), document["verdict"]
        if verdict["status"] not in VERDICTS or not isinstance(verdict["reason"], str):
            raise ValueError(f"{verdict['status']!r} is no verdict")
    robot = find_robot(record.robot.source, path)
    with reading(path):
        model = model_of(record.model, _chains(record, robot))
        model = learned_model(model, record.residual_model)
    require_one_run(record, robot.source, path)
    return document, record, model


def _chains(record: Document, robot: Robot) -> Chains:
    """The chains that were measured."""
    about, setup = record.robot, setup_of(record.model.setup)
    ends = about.chains or {"": about.ends}
    built = {name: Chain(robot, e.base, e.tip) for name, e in ends.items()}
    default = built.get("", setup)
    stated = default.base, default.tip, setup.chains
    chains = Chains(robot, *stated, tuple(built), built)
    if chains.joints != about.joints:
        raise ValueError("the joints are not those from base to tip")
    return chains


def _result(
    document: Json, record: Document, model: CalibratedModel, file: Path
) -> CalibrationResult:
    fitted, held_out = unknown_errors(model, record.training), None
    if (measured := file.parent / MEASUREMENTS).is_file():
        data = read_bytes(measured)
        fitted, held_out = decode_errors(data, model, record.rotations)
    names, about = model.given.names, document["provenance"]
    result = typed(
        CalibrationResult,
        document,
        model=model,
        reference=model_of(record.model, model.chains, record.reference),
        covariance=NamedArray.of(document["covariance"], names, names),
        fitted=fitted,
        held_out=held_out,
        files=tuple(source.file for source in record.files),
        provenance=typed(
            Provenance,
            document,
            versions={n: text for n, text in about.items() if n not in MADE},
            file=str(file),
            hashes=tuple(source.sha256 for source in record.files),
        ),
    )
    if (urdf := result.urdf) and (alone := record.urdf_model):
        urdf = replace(urdf, model=model_of(alone, model.chains))
    for error in (*result.errors, *(urdf.errors if urdf else ())):
        if error.unit not in DISPLAY:
            raise ValueError(f"'{error.unit}' is no unit of '{error.name}'")
    return replace(result, urdf=urdf)


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
    taken = f"{name}.urdf".casefold() == NOMINAL
    return f"{name}-corrected.urdf" if taken else f"{name}.urdf"


def run_id(document: Json) -> str:
    """Id of the run that led to a document; the same input and seed lead to the same.

    Args:
        document: The `calibration.json`, without an id.
    """
    made = {key: None for key in MADE}
    unlike = {"solver": {"seconds": None}, "provenance": made}
    return sha256(encode(merged(document, unlike)))[:16]


def read_document(path: str | Path) -> Json:
    """The content of a `calibration.json`.

    Raises:
        InputError: If the file is not such a document, or of another version.
    """
    data = read_bytes(path, JSON)
    return decoded(data, "calibration", FORMAT, path, version=VERSION)


def read_record(path: str | Path) -> Document:
    """The robot and the files of a `calibration.json`.

    Raises:
        InputError: If the file is not such a document, or of another version.
    """
    document = read_document(path)
    with reading(path):
        return typed(Document, document)


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
            raise InputError(
                f"not the file that '{path.name}' beside it was written with, but of "
                "another run or edited; keep the files of one run together, or remove "
                "this one",
                file=file,
            )


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
    copy = path.parent / NOMINAL
    try:
        given = locate_robot(source.file)
    except RobotError:  # The package it came from is not installed here.
        given = copy
    places = [given, path.parent / given, path.parent / given.name, copy]
    # A xacro file was expanded, and what came of it is in the copy.
    expanded = is_xacro(given)
    found = [place for place in places[3 * expanded :] if place.is_file()]
    for place in found:
        data = read_bytes(place)
        if sha256(data) != source.sha256 and place != copy:
            data = straight_source(data)
        if sha256(data) == source.sha256:
            there = given != copy and ((expanded and given.is_file()) or place == given)
            return parse_robot(data, source.file if there else str(place))
    if not found:
        reason = f"the robot '{source.file}' that was calibrated is neither there nor"
        raise RobotError(f"{reason} beside the calibration", file=path)
    raise InputError(
        f"'{found[0]}' is not the robot that was calibrated: its content differs; keep "
        "the files of one run together",
        file=path,
    )


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
            names = read_record(path).manifest
    except InputError:
        return []
    return [path.parent / name for name in names if (path.parent / name).is_file()]
