"""calibration.json: what comes back is the robot that was calibrated, or an error."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from calib_pin.calibration import calibrate
from calib_pin.errors import InputError, OptionError, OutputError, RobotError
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.io import results
from calib_pin.io.json_text import encode
from calib_pin.io.measurement_errors import encode_errors
from calib_pin.io.results import (
    calibration_document,
    read_calibration,
    read_result,
    read_written,
    write_urdf,
)
from calib_pin.io.setup import read_setup
from calib_pin.io.urdf import load_robot
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.observations import BlockKey, Observations
from calib_pin.setup import ChainSetup
from calib_pin.simulation import draw_errors, simulate
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.result import CalibrationResult, Provenance
from tests.shared import joint, refused, urdf_of

ARM = urdf_of(
    joint("j.1", "base a", "0 0 0.4", limits="-2.5 2.5"),
    joint("j.2", "a b", "0.1 0 0;0.1 0 0", "0 1 0", limits="-2 2"),
    joint("plane", "b c", "0.5 0 0.05", "0 1 0", limits="-2.5 2.5"),
    joint("tool", "c d", "0.4 0 0;0.3 0.2 0", "0 0 -1", "prismatic", "0 0.4"),
    joint("flange", "d tool", "0.1 0.02 0.05;0 1.4 0", kind="fixed"),
    name="arm",
)

LIMB = (("0 0 1", "torso", "_0"), ("0 1 0", "_0", "_1"), ("1 0 0", "_1", "_hand"))
"""Three joints and a hand on the torso; the hand is the last joint's own link."""

PAIR = urdf_of(
    joint("waist", "base torso", "0 0 0.8", "0 0.6 0.8", limits="-1 1"),
    *(
        joint(
            f"{side}.{k}",
            f"{side * (k > 0)}{parent} {side}{child}",
            f"{0.1 + 0.3 * k} {0.02 if k else y} 0.1;0.1 0 {0.2 * k}",
            axis,
            limits="-1.5 1.5",
        )
        for side, y in (("left", 0.3), ("right", -0.3))
        for k, (axis, parent, child) in enumerate(LIMB)
    ),
    name="pair",
)

PROVENANCE = Provenance(("calib-pin",), "2026-01-01", 0.5, numpy="2")
TOLD = """
position, joint-offset: {measured: {position: []}, parameters: [joint-offset]}
pose, dh backwards:
  {measured: {pose: []}, base: tool, tip: a, parameters: [dh], frames: {base: &known
    {xyz: [0.1, 0.2, 0.3], rpy: [0.4, 0.5, 0.6], estimate: false}}}
pose, everything:
  measured: {pose: []}
  fixed: ["*.placement.rz", base.frame.z]
  bounds: {j.1.placement.x: 0.01, "j.2.*": [-0.1, 0.2]}
  prior: {"*.placement.*": 0.01}
  noise: {position: 1.0e-3, orientation: 1.0e-5}
  joints: {J1: {joint: j.1, sign: -1, gear: 2.0, offset: 0.1, coupled: {J2: 0.5}}}
pose, joint corrections:
  measured: {pose: []}
  parameters: [compliance, transmission, placement]
  gravity: [1.5, -0.5, -9.6]
  payloads: {gripper: {mass: 4.0, com: [0.1, -0.05, 0.2]}}
  gear_ratios: {"j.*": 80.0, plane: -31.5}
position, corrections alone:
  {measured: {position: []}, parameters: [compliance], frames: {tool: {xyz: [0.1, 0,
    0.2]}}, payloads: {p: {mass: 6.0, com: [0.0, 0.0, 0.0]}}}
sphere-contact:
  measured: {sphere-contact: []}
  parameters: [joint-offset]
  frames: {tool: &tip {xyz: [0.0, 0.02, 0.1], estimate: false}}
  spheres: {s.1: {xyz: [0.6, 0.1, 0.4], radius: 0.05},
    s.2: {xyz: [0.5, 0.3, 0.3], radius: 0.04, estimate_radius: true}}
relative-distance:
  {measured: {relative-distance: [ball@1, "2"]}, parameters: [joint-offset],
   targets: {ball: &ball {xyz: [0.05, 0.0, 0.1]}}}
points and planes of four models:
  measured: {position: ["", a.b], fixed-point: [ball@front/0, ball@top],
    plane-distance: [my.wall], plane-contact: [ball@shelf, ball@floor]}
  parameters: [joint-offset]
  frames: {base: *known}
  targets: {ball: *ball, a.b: {xyz: [0.0, 0.1, 0.1]}, unseen: {xyz: [0.0, 0.0, 1.0]}}
  sockets: {front/0: {xyz: [0.6, 0.1, 0.3]}, front/1: {xyz: [0.6, -0.2, 0.35]},
    top: {xyz: [0.5, 0.0, 0.6], estimate: false}}
  planes: {my.wall: {normal: [1.0, 0.2, 0.3], offset: -1.8},
    shelf: {normal: [0.1, 0.2, 1.0], offset: -0.7},
    floor: {normal: [0.0, 0.0, 2.0], offset: -0.8, estimate: false}}
two stations and two tools:
  measured: {position/left/day1/probe: [], position/left/day2/probe: [],
    pose/left/day2/ball: []}
  stations: &stations {day1: &away {xyz: [2.0, 1.0, 0.3], rpy: [0.1, 0.2, 1.2]},
    day2: {xyz: [-1.0, 0.5, 0.1], rpy: [0.0, -0.1, 0.4]}}
  tools: {probe: &probe {xyz: [0.05, 0.02, 0.1]},
    ball: {xyz: [0.0, 0.1, 0.2], rpy: [0.4, 0.5, 0.6], "on": probe}}
anchors of two stations:
  measured: {pose/left/day1: [], point-distance/left/day1: [], pose/left/day2: [],
    point-distance/left/day2: []}
  stations: *stations
  anchors: {a: {xyz: [1.5, 0.4, 0.9], bias: 0.02, estimate_bias: true},
    day1/b: {xyz: [-0.6, 1.1, 1.0], bias: -0.1, estimate: false}}
  frames: {tool: *tip}
cameras of two stations:
  measured: {camera/left/here: [], camera/left/there: [], pose/left/here: []}
  stations: {here: {xyz: [0.0, 0.0, 4.0], rpy: [3.141592653589793, 0.0, 0.0]},
    there: {xyz: [0.1, 0.3, 4.5], rpy: [3.041592653589793, 0.05, 0.3]}}
  targets: {m0: {xyz: [0.0, 0.0, 0.0]}, m1: {xyz: [0.1, 0.0, 0.0]},
    m2: {xyz: [0.0, 0.1, 0.0]}, m3: {xyz: [0.1, 0.1, 0.03]}}
  camera: {mount: world, focal: [800.0, 810.0], center: [640.0, 480.0],
    distortion: [0.01, 0.0, 0.0, 0.0, 0.0], size: [1280.0, 960.0], estimate: true}
  frames: {tool: {xyz: [0.0, 0.0, 0.1]}}
two hands that touch:
  measured: {pose/left: [], pose/right_hand: [], position/touch: []}
  frames: {base: *away}
  tools: {ball: *probe, right_hand: {xyz: [0.0, 0.05, 0.1]}}
"""
"""By case the blocks "model/chain/station/tool" with some targets, and a setup file."""

CASES = {
    name: (
        {BlockKey(*key.split("/")): of for key, of in case.pop("measured").items()},
        read_setup(case),
    )
    for name, case in yaml.safe_load(TOLD).items()
}
SIMPLE, POINTS = "position, joint-offset", "points and planes of four models"
STATIONS, MANY = "two stations and two tools", "anchors of two stations"
SEEN = "cameras of two stations"
ENDS = {
    "left": ChainSetup(tip="left_hand"),
    "touch": ChainSetup(base="left_hand", tip="right_hand"),
}


def chains_of(case: str) -> Chains:
    measured, setup = CASES[case]
    names = tuple(key.chain for key in measured)
    if names[0] == "":
        return Chains.of(Chain(load_robot("arm.urdf"), setup.base, setup.tip))
    return Chains(load_robot("pair.urdf"), tip="left_hand", setups=ENDS, names=names)


@cache
def solved(case: str) -> tuple[CalibrationResult, Observations]:
    """The calibration of a case, and measurements that were not fitted."""
    chains, (measured, setup) = chains_of(case), CASES[case]
    problem = nominal_problem(chains, measured, setup)
    rng = np.random.default_rng(4)
    theta = np.where(problem.parameters.free, draw_errors(problem.parameters, rng), 0)
    count = len(problem.data.keys)
    data, new = (
        simulate(problem, theta, rng, count=k, noise=1e-4)
        for k in (20 + 15 * count, 6 * count)
    )
    return calibrate(chains, data, setup, validate=False), new


def written(result: CalibrationResult) -> Path:
    """The result in a folder, as `calibrate` writes it."""
    Path("out").mkdir(exist_ok=True)
    Path("out/measurements.csv").write_bytes(encode_errors(result, ""))
    file = Path("out/calibration.json")
    file.write_bytes(encode(calibration_document(result, PROVENANCE)))
    return file


@cache
def encoded(case: str) -> bytes:
    return encode(calibration_document(solved(case)[0], PROVENANCE))


def document_of(case: str) -> dict[str, Any]:
    return json.loads(encoded(case))


def stored(document: Any) -> Path:
    Path("calibration.json").write_text(json.dumps(document))
    return Path("calibration.json")


@pytest.fixture(autouse=True)
def robots(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("arm.urdf").write_text(ARM)
    Path("pair.urdf").write_text(PAIR)


@pytest.fixture
def simple() -> tuple[CalibrationResult, Path]:
    result, _ = solved(SIMPLE)
    return result, written(result)


# --- what comes back ---------------------------------------------------------------


def predicted(model: CalibratedModel, rows: Observations) -> Any:
    """Tool poses, values and errors."""
    problem, theta = model.problem(rows), model.theta
    T = [b.term.poses(theta, b.data) for b in problem.blocks]
    values = [problem.predict(theta, block).reshape(-1) for block in rows.blocks]
    return np.concatenate(T), np.concatenate(values), problem.errors(theta)


def assert_predicts_the_same(
    found: CalibratedModel, model: CalibratedModel, rows: Observations
) -> None:
    size = max(float(np.abs(block.values).max(initial=1)) for block in rows.blocks)
    for there, here in zip(predicted(found, rows), predicted(model, rows), strict=True):
        # Frames are written as angles, and poses come back to some eps.
        np.testing.assert_allclose(there, here, rtol=0.0, atol=1e-12 * size)


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, Any]]:
    """The path of everything in a document, and what stands there."""
    yield path, value
    items: Any = value.items() if isinstance(value, dict) else ()
    for key, item in enumerate(value) if isinstance(value, list) else items:
        yield from places(item, (*path, key))


@pytest.mark.parametrize("case", CASES)
def test_all_comes_back(case: str) -> None:
    result, rows = solved(case)
    model = result.model
    # Something must have been estimated, and met, or the test would show nothing.
    assert np.abs(model.theta).max() > 1e-5
    errors = predicted(model, rows)[2] / model.problem(rows).sigma
    assert np.sqrt(np.mean(errors**2)) < 3.0

    file = written(result)
    found = read_calibration(file)

    assert found.setup == model.setup
    assert found.chains.names == model.chains.names
    assert found.given.parameters == model.given.parameters
    for there, here in zip(found.terms.values(), model.terms.values(), strict=True):
        assert there.frames == here.frames
        np.testing.assert_array_equal(there.index, here.index)
    assert_predicts_the_same(found, model, rows)
    assert encode(calibration_document(read_result(file))) == file.read_bytes()
    # The corrected robot is read back, and compared with the calibrated one.
    geometry = result.geometry
    assert (geometry is model) == model.geometric == (result.urdf is None)
    if geometry is None:
        assert case == "position, corrections alone" and result.urdf.reason
    else:
        write_urdf(geometry, "corrected.urdf")
        corrected = load_robot("corrected.urdf")
        assert corrected.source != model.chains.robot.source


# --- how it is written -------------------------------------------------------------

LAYOUT: list[tuple[str, tuple[Any, ...], Any]] = [
    (POINTS, ("reference", "planes", "my.wall"), "normal offset estimate"),
    (POINTS, ("sockets", "top", "xyz"), [0.5, 0.0, 0.6]),
    (POINTS, ("sockets", "top", "estimate"), False),
    ("sphere-contact", ("spheres", "s.2", "estimate_radius"), True),
    (MANY, ("anchors",), "day1/a day1/day1/b day2/a day2/day1/b"),
    (SEEN, ("cameras",), "here/camera there/camera"),
    # A tool on another one has no frame of its own.
    (STATIONS, ("frames",), "day1.station probe.tool day2.station"),
    ("two hands that touch", ("measurements", "model"), "pose+position"),
    ("two hands that touch", ("measurements", "blocks", 2, "chain"), "touch"),
    ("two hands that touch", ("robot", "chains", "touch", "base"), "left_hand"),
]
"""Parts of documents, and their values or the keys that they have."""


def test_the_layout_of_documents() -> None:
    for case, path, expected in LAYOUT:
        found = document_of(case)
        for step in path:
            found = found[step]
        if isinstance(found, dict):
            found, expected = set(found), set(expected.split())
        assert found == expected, (case, path)
    document = document_of(POINTS)
    found, begin = (d["targets"]["ball"] for d in (document, document["reference"]))
    moved = {p["name"]: p["value"] for p in document["parameters"]}
    x = begin["xyz"][0] + moved["ball.target.x"]
    assert found["xyz"][0] == pytest.approx(x)


@dataclass(frozen=True, repr=False)
class Extended(CalibrationResult):
    """With one more field."""

    lengths: tuple[float, ...] = ()


def test_a_field_is_written_and_read_where_it_is_declared(monkeypatch):
    result, _ = solved(SIMPLE)
    monkeypatch.setattr("calib_pin.io.results.CalibrationResult", Extended)
    own = {part.name: getattr(result, part.name) for part in fields(result)}
    file = written(Extended(**own, lengths=(1.0, np.inf)))
    assert json.loads(file.read_text())["lengths"] == [1.0, "Infinity"]
    found = read_result(file)
    assert isinstance(found, Extended) and found.lengths == (1.0, np.inf)


# --- older, newer and untrusted files ----------------------------------------------


def test_other_documents_than_ours() -> None:
    """Unknown keys are passed over, of another version none is read."""
    result, rows = solved(SIMPLE)
    document = document_of(SIMPLE) | {"later": {"unknown": 1}}
    document["parameters"][0]["note"] = "unknown"
    assert_predicts_the_same(read_calibration(stored(document)), result.model, rows)
    for other in (1, document["version"] + 1):
        for read in (read_calibration, read_result):
            with pytest.raises(InputError, match=r"update .*calibrate again") as caught:
                read(stored(document | {"version": other}))
            assert "\n" not in str(caught.value)


# --- where the robot is ------------------------------------------------------------


def test_the_robot_is_found(simple, tmp_path, monkeypatch):
    """From the working folder, from that of the file, and beside the file."""
    result, file = simple
    file.rename("calibration.json")  # Beside the URDF, as its path says.
    monkeypatch.chdir(tmp_path / "out")
    assert read_calibration("../calibration.json").chains.robot.name == "arm"
    Path("../calibration.json").rename("calibration.json")
    Path("../arm.urdf").rename("arm.urdf")
    for name in ("calibration.json", "../out/calibration.json"):
        np.testing.assert_array_equal(read_calibration(name).theta, result.model.theta)
    monkeypatch.chdir(tmp_path)
    assert read_calibration(file).chains.robot.name == "arm"


def test_a_robot_that_is_another_one_is_refused(simple):
    (result, file), given, beside = simple, Path("arm.urdf"), Path("out/arm.urdf")
    # Both have the same name, as the commands write them.
    write_urdf(result.model, beside)
    assert read_calibration(file).chains.robot.file == "arm.urdf"
    given.unlink()
    with refused(InputError, file=str(file)):
        read_calibration(file)
    # With the original back at its side, a wrong one at the stated place is passed.
    beside.write_text(ARM)
    given.write_text(ARM.replace("0.4", "0.41"))
    assert read_calibration(file).chains.robot.file == "out/arm.urdf"
    beside.unlink()
    for kind in (InputError, RobotError):
        with refused(kind, file=str(file)):
            read_calibration(file)
        given.unlink(missing_ok=True)


def test_what_is_written_is_the_robot(simple, monkeypatch) -> None:
    """Never over the own file, and read again before it is written."""
    model, source = simple[0].model, Path("arm.urdf").read_bytes()
    with refused(OptionError, file="arm.urdf"):
        write_urdf(model, "arm.urdf", force=True)
    for wrong in (source, b"<robot/>"):
        monkeypatch.setattr(results, "edit_origins", lambda *_, wrong=wrong: wrong)
        with pytest.raises(OutputError):
            write_urdf(model, "corrected.urdf")
    assert Path("arm.urdf").read_bytes() == source
    assert not Path("corrected.urdf").exists()


# --- damage ------------------------------------------------------------------------

POSITION, SAMPLES = ("errors", "position"), ("predicted", "", "tip", "samples")
DAMAGE: list[tuple[str, tuple[Any, ...], Any]] = [
    *(("", (key,), ...) for key in ("errors", "statistics", "verdict")),
    ("", ("errors",), [1]),
    ("", (*POSITION, "unit"), "furlong"),
    ("", (*POSITION, "training", "after", "rms"), ...),
    ("", ("identifiability", "coupled", 0, "value"), [[[]]]),
    ("", (*SAMPLES, "points", 0, 0), 10**400),
    ("", (*SAMPLES, "position", 0), ...),
    ("", ("measurements", "training"), ...),
    ("", ("verdict", "status"), "fine"),
    ("", ("provenance",), 7),
    ("", ("files",), {"../a": ""}),
    (POINTS, ("sockets", "top"), ...),
    ("sphere-contact", ("spheres", "s.1", "radius"), ...),
    (MANY, ("reference", "anchors", "day1/a", "xyz"), [0.0]),
    (SEEN, ("cameras", "here/camera", "mount"), ...),
    (SEEN, ("frames", "here.station", "xyz"), [0.0]),
    (POINTS, ("measurements", "blocks", 0, "targets", 1), ...),
    (MANY, ("frames", "day2.station"), ...),
    (MANY, ("measurements", "blocks", 3), ...),
    (MANY, ("measurements", "blocks", 3, "station"), "day1"),
    (MANY, ("measurements", "blocks", 3, "chain"), "right"),
    (MANY, ("robot", "chains"), ...),
    (MANY, ("robot", "chains", "left", "tip"), 7),
]


def edit(document: Any, path: Sequence[Any], to: Any) -> None:
    """Replace a part of a document, or take it out with `...`."""
    for step in path[:-1]:
        document = document[step]
    if to is ...:
        del document[path[-1]]
    else:
        document[path[-1]] = to


@pytest.fixture(scope="module")
def checked(calibrated_robot: Callable[..., Any]) -> CalibrationResult:
    """With all that a validation leads to."""
    found: CalibrationResult = calibrated_robot("pose", count=40)
    return found


def test_a_checked_result_comes_back(checked: CalibrationResult) -> None:
    found, document = read_written(written(checked))
    assert found.robot_errors == checked.robot_errors != ()
    assert (found.validation.method, len(found.fitted)) == ("5-fold", 40)
    assert found.provenance.created == PROVENANCE.created
    assert json.loads(encode(calibration_document(found))) == document
    # What is not known, and what a compensation takes from it.
    position, orientation = document["errors"].values()
    position["validation"]["after"]["max"] = orientation["validation"]["after"] = None
    position["validation"]["before"] = document["predicted"][""]["tip"] = None
    orientation["unit"] = "px"
    found = read_result(stored(document))
    assert found.accuracy.tip is found.errors[0].validation_before is None


def test_damaged_parts_are_refused(checked: CalibrationResult) -> None:
    whole = encode(calibration_document(checked, PROVENANCE))
    for case, path, to in DAMAGE:
        edit(document := document_of(case) if case else json.loads(whole), path, to)
        with refused(InputError, file="calibration.json"):
            read_result(stored(document))


def test_files_that_are_no_calibration(simple: tuple[CalibrationResult, Path]) -> None:
    file = simple[1]
    good = file.read_bytes().rstrip()
    head = b'{"format": "calib-pin/calibration"'
    contents = [b"", b"\xff\xfe", b"[]", b"null", b"[" * 100_000, head + b"}"]
    contents += [b'{"version": ' + b"1" * 5000 + b"}"]
    contents += [head + b', "version": %b}' % v for v in (b"true", b"0", b"2", b"9")]
    contents += [good[: int(part * len(good))] for part in (0.1, 0.5, 0.9, 0.999)]
    for content in contents:
        file.write_bytes(content)
        with refused(InputError, file=str(file)):
            read_calibration(file)
    file.write_bytes(b"\xef\xbb\xbf" + good)  # A byte order mark is no damage.
    read_calibration(file)


DAMAGED = ("sphere-contact", SEEN, "position, corrections alone", MANY)
JUNK = (..., None, True, -1, 7.5, 10**400, float("nan"), "x", "", [], {}, [[0]])
UNUSED = ("covariance", "predicted", "identifiability", "statistics", "urdf")

ANY = {"derandomize": True, "suppress_health_check": [*HealthCheck]}


@settings(max_examples=16, **ANY)
@given(data=st.data())
def test_no_damage_passes_unnoticed_or_crashes(data: st.DataObject) -> None:
    """Any entry is replaced: an error in one line, or the robot is as it was."""
    case = data.draw(st.sampled_from(DAMAGED))
    (result, rows), document = solved(case), document_of(case)
    used = [path for path, _ in places(document) if path and path[0] not in UNUSED]
    path, junk = data.draw(st.sampled_from(used)), data.draw(st.sampled_from(JUNK))
    edit(document, path, junk)
    try:
        found = read_calibration(stored(document))
    except InputError as error:
        assert error.file == "calibration.json"
        assert len(str(error)) < 400 and "\n" not in str(error)
        return
    # What was accepted predicts finite numbers (a point may be behind the camera now),
    # and others only where a number stands in the place of a number.
    there, here = (predicted(model, rows)[2] for model in (found, result.model))
    assert "camera" in case or np.isfinite(there).all(), (path, junk)
    if not np.allclose(there, here):
        assert isinstance(junk, int | float), (path, junk)
