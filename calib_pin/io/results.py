"""`calibration.json`, section 8 of the contract: a result as a document, and back.

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
from dataclasses import fields
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from reprlib import repr
from typing import get_type_hints

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError, RobotError
from calib_pin.estimation.evidence import (
    TRUSTED,
    VERDICTS,
    ExpectedAccuracy,
    FoundCurve,
    PoseErrors,
    TipAccuracy,
)
from calib_pin.estimation.learning import with_learned
from calib_pin.io.calibrated_model import (
    CAMERAS,
    count_without_instruments,
    model_document,
    model_of,
    read_residual_model,
)
from calib_pin.io.files import inside, read_bytes, settled, sha256
from calib_pin.io.json_text import (
    Json,
    decoded,
    encode,
    format_keys,
    plain,
    reading,
    typed,
)
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
from calib_pin.planning.suggestions import Suggestion
from calib_pin.units import DISPLAY
from calib_pin.validation.accuracy import QuantityErrors
from calib_pin.validation.assessment import chi2_interval
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.measurement_errors import MeasurementErrors
from calib_pin.validation.result import (
    Breakdown,
    CalibrationResult,
    Identification,
    NamedArray,
    Provenance,
    ToolAccuracy,
    UrdfResult,
)

FORMAT = "calib-pin/calibration"

BREAKDOWN = tuple(f.name for f in fields(Breakdown) if f.name != "accuracies")
"""Parts of a result that tell of its stations, tools, chains and blocks."""

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

STATED = (
    *("findings", "parameters", "identifiability", "validation"),
    *("statistics", "solver", "distances", *BREAKDOWN),
)
"""Parts of a result that are written as they are declared, under their own names."""

SAMPLES = ("configurations", "points", "position", "orientation")
"""Keys of the predicted uncertainty of the tool point, arrays over the workspace."""

CURVE = ("measurements", "position")
"""Keys of that uncertainty by the number of measurements."""

STAGES = ("before", "after")
"""Keys of errors: of the nominal robot, registered, and of the calibrated one."""


def calibration_document(
    result: CalibrationResult,
    provenance: Provenance | None = None,
    residual_model: Mapping[str, str] | None = None,
    suggestions: Sequence[Suggestion] = (),
) -> Json:
    """A result as the JSON document of version 1.

    Errors of single measurements stand beside it, see `io.measurement_errors`.

    Args:
        result: The result.
        provenance: How it came about; default what the result says.
        residual_model: Where what was learned is written, see `io.calibrated_model`.
        suggestions: Suggested measurements.

    Raises:
        InputError: If a measurement file cannot be read again for its hash.
    """
    model, dof = result.model, result.statistics.dof
    made = provenance or result.provenance
    hashes = made.hashes or tuple(map(_sha256_of, result.files))
    setup, method = model.setup.file, result.validation.method
    covariance, urdf = result.covariance, result.urdf
    begun, described = result.recalibration, model_document(model, result.reference)
    _mark_unknown(described, result)
    return {
        **format_keys(FORMAT),
        "verdict": {"status": result.verdict, "reason": result.reason},
        "findings": plain(result.findings),
        "robot": _robot(model),
        "measurements": {
            "files": [
                {"file": file, "sha256": content}
                for file, content in zip(result.files, hashes, strict=True)
            ],
            **described.pop("measurements"),
            "training": len(result.fitted),
            "validation": result.validation.count,
            "placed_by_validation": list(result.validation.located),
        },
        **_rotations(result),
        **described,
        **identification_parts(result, suggestions),
        "errors": _errors(result.errors, method),
        "validation": plain(result.validation),
        **_predictions(result),
        **{key: plain(getattr(result, key)) for key in BREAKDOWN},
        "statistics": {
            **plain(result.statistics),
            "chi2_interval": list(chi2_interval(dof)) if dof > 0 else [],
        },
        "covariance": plain(covariance) if np.isfinite(covariance).all() else None,
        "solver": {**plain(result.solver), "seconds": made.seconds},
        "distances": plain(result.distances),
        "residual_model": plain(residual_model),
        "rejected_residual_model": result.rejected,
        "model_ladder": plain(result.model_selection),
        **({} if begun is None else {"recalibration": plain(begun)}),
        "urdf": urdf and _urdf(urdf, method),
        "setup_file": {"file": setup, "sha256": _sha256_of(setup)} if setup else None,
        "provenance": {
            **made.versions,
            "command": list(made.command),
            "created": made.created,
        },
    }


def _mark_unknown(described: Json, result: CalibrationResult) -> None:
    """Say in the entries of frames and instruments which values are left open."""
    for suffix, frames in ((".station", result.stations), (".tool", result.tools)):
        for frame in frames:
            for name in (frame.name, frame.name + suffix):
                if frame.unknown and name in described["frames"]:
                    described["frames"][name]["unknown"] = list(frame.unknown)
    for owner, kind, component in (name.rsplit(".", 2) for name in result.unknown):
        if kind not in ("frame", "station", "tool"):
            key = f"{kind}s" if f"{kind}s" in described else CAMERAS
            entry = described.get(key, described)[owner]
            entry.setdefault("unknown", []).append(component)


def identification_parts(
    found: Identification, suggestions: Sequence[Suggestion] = ()
) -> Json:
    """The parts `parameters` and `identifiability` of section 8 of the contract.

    Args:
        found: The identifiability of a robot.
        suggestions: Suggested measurements.
    """
    return {
        "parameters": plain(found.parameters),
        "identifiability": {
            **plain(found.identifiability),
            "coupled": plain(found.groups),
            "robot_errors": plain(found.robot_errors),
            "remedies": plain(suggestions),
        },
    }


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
        document, model = _read_model(file)
        with reading(file):
            result = _result(document, model, file)
            read_suggestions(document)
    return result, document


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
        document, model = _read_model(path)
    verdict = document["verdict"]
    if notice is not None and verdict["status"] not in TRUSTED:
        notice(f"{path} must not be trusted: {verdict['reason']}")
    return model


def read_suggestions(document: Json) -> tuple[Suggestion, ...]:
    """The suggested measurements in a document."""
    stated = document["identifiability"]["remedies"]
    return typed(tuple[Suggestion, ...], stated)


def used_files(path: str | Path, files: Sequence[Path]) -> list[Path]:
    """Those of some files whose content a calibration has used, to fit or to check.

    Args:
        path: A `calibration.json`, which can be read.
        files: Measurement files; what is no file, such as a pipe, is left alone.
    """
    document = read_document(path)
    with reading(path):
        stated = document["measurements"]["files"]
        known = {typed(str, entry["sha256"]) for entry in stated}
    return [file for file in files if _sha256_of(str(file)) in known - {""}]


def _sha256_of(file: str) -> str:
    """Hexadecimal SHA-256 of a file; empty for what is none, such as a pipe."""
    # A pipe cannot be read twice.
    return sha256(read_bytes(file)) if Path(file).is_file() else ""


# --- the robot ---------------------------------------------------------------------


def _read_model(path: Path) -> tuple[Json, CalibratedModel]:
    """A `calibration.json` and the calibrated robot that it tells of.

    Raises:
        InputError, RobotError: As `read_calibration`.
    """
    document = read_document(path)
    with reading(path):
        verdict, stated = document["verdict"], document["robot"]
        if verdict["status"] not in VERDICTS:
            raise ValueError(f"'{verdict['status']}' is no verdict")
        texts = verdict["reason"], stated["file"], stated["sha256"]
        _, name, content = typed(tuple[str, str, str], texts)
    robot = find_robot(name, content, path)
    with reading(path):
        model = model_of(document, _chains(document, robot))
        learned = document["residual_model"]
        if (learned is None) != (model.setup.learned is None):
            raise ValueError("'residual_model' and 'setup.learned' need each other")
        if learned is not None:
            # Its name alone: a calibration does not reach into other folders.
            file = path.with_name(Path(learned["file"]).name)
            content = typed(str, learned["sha256"])
    require_one_run(document, robot.source, path)
    if learned is None:
        return document, model
    data = read_bytes(file)
    if sha256(data) != content:
        reason = "not the file that this calibration was written with"
        raise InputError(reason, file=file)
    return document, with_learned(model, read_residual_model(data, model, file))


def _robot(model: CalibratedModel) -> Json:
    """The robot with the ends of its chains, where they have names."""
    chains, chain = model.chains, model.moving.error.chain
    about: Json = {
        "name": chains.robot.name,
        "file": chains.robot.file,
        "sha256": sha256(chains.robot.source),
        "base": chain.base,
        "tip": chain.tip,
        "joints": list(chains.joints),
    }
    if chains.names != ("",):
        ends = {name: chains[name] for name in chains.names}
        about["chains"] = {k: {"base": e.base, "tip": e.tip} for k, e in ends.items()}
    return about


def _chains(document: Json, robot: Robot) -> Chains:
    """The chains that were measured."""
    about, setup = document["robot"], setup_of(document["setup"])
    built = {
        name: Chain(robot, typed(str, end["base"]), typed(str, end["tip"]))
        for name, end in about.get("chains", {"": about}).items()
    }
    default = built.get("", setup)
    stated = default.base, default.tip, setup.chains
    chains = Chains(robot, *stated, tuple(built), built)
    if list(chains.joints) != about["joints"]:
        raise ValueError("the joints are not those from base to tip")
    return chains


# --- the result --------------------------------------------------------------------


def _result(document: Json, model: CalibratedModel, file: Path) -> CalibrationResult:
    verdict, about = document["verdict"], document["measurements"]
    kinds = get_type_hints(CalibrationResult)
    parts = {key: document[key] for key in STATED} | {
        "recalibration": document.get("recalibration"),
        "model_selection": document["model_ladder"],
        "groups": document["identifiability"]["coupled"],
        "robot_errors": document["identifiability"]["robot_errors"],
    }
    known = {key: typed(kinds[key], part) for key, part in parts.items()}
    names = [parameter.name for parameter in known["parameters"]]
    covariance = document["covariance"] or np.full((len(names), len(names)), np.nan)
    fitted, held_out = _measured(document, model, file.parent)
    made, urdf = document["provenance"], document["urdf"]
    return CalibrationResult(
        **known,
        model=model,
        reference=model_of(document, model.chains, reference=True),
        verdict=verdict["status"],
        reason=verdict["reason"],
        errors=_read_errors(document["errors"]),
        accuracies=_accuracies(document, model),
        covariance=NamedArray.of(covariance, names, names),
        fitted=fitted,
        held_out=held_out,
        files=tuple(typed(str, entry["file"]) for entry in about["files"]),
        urdf=urdf and _urdf_result(urdf, model.chains),
        rejected=typed(str, document["rejected_residual_model"]),
        provenance=Provenance(
            command=typed(tuple[str, ...], made["command"]),
            created=typed(str, made["created"]),
            seconds=typed(float, document["solver"]["seconds"]),
            versions={k: v for k, v in made.items() if k not in MADE},
            file=str(file),
            hashes=tuple(typed(str, entry["sha256"]) for entry in about["files"]),
        ),
    )


def _errors(errors: Sequence[QuantityErrors], method: str) -> Json:
    return {
        e.name: {
            "unit": e.unit,
            "training": {"before": plain(e.before), "after": plain(e.after)},
            "validation": {
                "method": method,
                "before": plain(e.validation_before),
                "after": plain(e.validation_after),
            },
        }
        for e in errors
    }


def _read_errors(document: Json) -> tuple[QuantityErrors, ...]:
    found = []
    for name, entry in document.items():
        if entry["unit"] not in DISPLAY:
            raise ValueError(f"{repr(entry['unit'])} is no unit of '{name}'")
        unseen = {f"validation_{k}": entry["validation"][k] for k in STAGES}
        stated = {"name": name, "unit": entry["unit"], **entry["training"], **unseen}
        found.append(typed(QuantityErrors, stated))
    return tuple(found)


def _predictions(result: CalibrationResult) -> Json:
    """The expected errors of the tools: of the first chain, and of the others."""
    _, *others = result.accuracies or [""]
    found = {name: _predicted(result.accuracies[name]) for name in others}
    return {
        "predicted": _predicted(result.accuracy),
        **({"predicted_by_chain": found} if found else {}),
    }


def _predicted(accuracy: ToolAccuracy) -> Json | None:
    """Errors of the tool to expect: what noise leaves by the fit, and all of them."""
    stages = {"measured": accuracy.measured, "workspace": accuracy.workspace}
    known = {name: plain(found) for name, found in stages.items() if found}
    if accuracy.tip is None:
        return {"position": None, "orientation": None, **known} if known else None
    tip = accuracy.tip
    samples = tip.q, tip.points, tip.position, tip.orientation
    return {
        **plain(PoseErrors(*tip.rms)),
        "robot": plain(PoseErrors(*tip.of_robot)),
        **known,
        "samples": plain(dict(zip(SAMPLES, samples, strict=True))),
        "by_count": plain(dict(zip(CURVE, tip.by_count.curve, strict=True))),
    }


def _accuracies(document: Json, model: CalibratedModel) -> dict[str, ToolAccuracy]:
    """The expected errors of the tool by the name of the chain."""
    first = {model.moving.key.chain: document["predicted"]}
    entries = first | document.get("predicted_by_chain", {})
    return {name: _accuracy(entry or {}) for name, entry in entries.items()}


def _accuracy(entry: Json) -> ToolAccuracy:
    tip = None
    if "samples" in entry:
        samples = (np.array(entry["samples"][key], float) for key in SAMPLES)
        q, points, position, orientation = samples
        if not len(q) == len(points) == len(position) == len(orientation):
            raise ValueError("the lists of 'samples' are not of one length")
        counts, errors = (np.array(entry["by_count"][key], float) for key in CURVE)
        alone, curve = typed(PoseErrors, entry["robot"]), FoundCurve((counts, errors))
        tip = TipAccuracy(q, points, position, orientation, alone, curve)
    stages = (entry.get(key) for key in ("measured", "workspace"))
    return ToolAccuracy(tip, *(s and typed(ExpectedAccuracy, s) for s in stages))


def _rotations(result: CalibrationResult) -> Json:
    """Rotations from the measurement frame to the base link.

    It is that of the first block; where others differ, those of all stand beside it.
    """
    sets = zip(SETS, (result.fitted, result.held_out), strict=True)
    found = {name: part.to_base for name, part in sets if part is not None}
    first = result.fitted.to_base[0]
    every = np.concatenate([*found.values()])
    alike = np.array_equal(every, np.broadcast_to(first, every.shape), equal_nan=True)
    return {
        "rotation_to_base": first.tolist(),
        **({} if alike else {"rotations_to_base": plain(found)}),
    }


def _measured(
    document: Json, model: CalibratedModel, folder: Path
) -> tuple[MeasurementErrors, MeasurementErrors | None]:
    """The errors of the fitted and of the validation measurements."""
    count = typed(int, document["measurements"]["training"])
    try:
        data = read_bytes(folder / MEASUREMENTS)
    except InputError:
        return unknown_errors(model, count), None
    rotations = dict.fromkeys(SETS, document["rotation_to_base"])
    rotations |= document.get("rotations_to_base", {})
    to_base = {name: np.array(stated, float) for name, stated in rotations.items()}
    return decode_errors(data, model, to_base)


def _urdf(urdf: UrdfResult, method: str) -> Json:
    described = None
    if urdf.model is not None:
        model, count = urdf.model, count_without_instruments(urdf.model)
        values = zip(model.given.names[:count], model.theta.tolist(), strict=False)
        parameters = [{"name": name, "value": value} for name, value in values]
        described = {**model_document(model, model), "parameters": parameters}
    return {
        "reason": urdf.reason,
        "errors": _errors(urdf.errors, method),
        "model": described,
    }


def _urdf_result(entry: Json, chains: Chains) -> UrdfResult:
    return UrdfResult(
        model=entry["model"] and model_of(entry["model"], chains),
        errors=_read_errors(entry["errors"]),
        reason=typed(str, entry["reason"]),
    )


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


def run_id(document: Json, learned: bytes | None) -> str:
    """Id of the run that led to a document; the same input and seed lead to the same.

    Args:
        document: The `calibration.json`, without an id.
        learned: Its residual model, without an id.
    """
    solver, about = document["solver"], document["provenance"]
    content = {
        **document,
        "residual_model": None,
        "solver": {k: v for k, v in solver.items() if k != "seconds"},
        "provenance": {k: v for k, v in about.items() if k not in MADE},
    }
    return sha256(encode(content) + (learned or b""))[:16]


def read_document(path: str | Path) -> Json:
    """The content of a `calibration.json`.

    Raises:
        InputError: If the file is not such a document, or of another version.
    """
    document = decoded(read_bytes(path, JSON), "calibration", FORMAT, path)
    # Version 0.1 of the program wrote none of these.
    if not document.keys() >= set(BREAKDOWN):
        reason = "of an older version of calib-pin, or edited: calibrate again"
        raise InputError(f"{reason} from the measurements", file=path)
    return document


def members(document: Json) -> dict[str, str | None]:
    """SHA-256 of the files that were written with a calibration, by name.

    None for those that are known by the id of the run.

    Raises:
        ValueError: If these are no such names.
    """
    stated = document.get("files", {})
    if not isinstance(stated, Mapping) or not all(
        isinstance(name, str) and inside(name) for name in stated
    ):
        raise ValueError("'files' are not those of a folder")
    return dict(stated)


def require_one_run(document: Json, robot: bytes, path: Path) -> None:
    """Refuse a calibration among files that were not written with it.

    Those that are not there are not missed here; pictures may be edited.

    Args:
        document: The calibration.
        robot: The robot that was calibrated, which may stand in the place of the
            corrected one.
        path: The `calibration.json`.

    Raises:
        InputError: If one of them is of another run, or was edited.
    """
    run = str(document.get("run", "")).encode()
    with reading(path):
        listed = members(document)
    for name, content in listed.items():
        file = path.parent / name
        if file.suffix in PICTURES or not file.is_file():
            continue
        data = read_bytes(file)
        known = sha256(data) == content or data == robot
        if not (run in data if content is None else known):
            raise InputError(
                f"not the file that '{path.name}' beside it was written with, but of "
                "another run or edited; keep the files of one run together, or remove "
                "this one",
                file=file,
            )


def find_robot(name: str, content: str, path: Path) -> Robot:
    """The robot that was calibrated, recognized by its content.

    Where it was calibrated comes before the copy: meshes are beside the former.

    Args:
        name: Its file as it was given.
        content: Its SHA-256.
        path: The `calibration.json`.

    Raises:
        InputError: If there is only another one.
        RobotError: If there is none.
    """
    copy, other = path.parent / NOMINAL, None
    try:
        given = locate_robot(name)
    except RobotError:  # The package it came from is not installed here.
        given = copy
    places = [given, path.parent / given, path.parent / given.name, copy]
    # A xacro file was expanded, and what came of it is in the copy.
    for place in places[3:] if is_xacro(given) else places:
        if not place.is_file():
            continue
        data = read_bytes(place)
        if sha256(data) != content and place != copy:
            data = straight_source(data)
        if sha256(data) == content:
            kept = given if is_xacro(given) and given.is_file() else place
            there = kept == given and given != copy
            return parse_robot(data, name if there else str(place))
        other = other or place
    if other is None:
        reason = f"the robot '{name}' that was calibrated is neither there nor beside"
        raise RobotError(f"{reason} the calibration", file=path)
    raise InputError(
        f"'{other}' is not the robot that was calibrated: its content differs; keep "
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
            names = members(read_document(path))
    except (InputError, ValueError):
        return []
    return [path.parent / name for name in names if (path.parent / name).is_file()]
