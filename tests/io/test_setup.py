"""Setup files: what they may say, and one line about the first thing wrong."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path

import pytest

from calib_pin.errors import InputError
from calib_pin.io.setup import read_setup, setup_document, setup_of
from calib_pin.io.yaml_tree import read_tree
from calib_pin.measurement_models import MEASUREMENT_MODELS
from calib_pin.setup import (
    AnchorSetup,
    Ball,
    BoardSetup,
    CameraSetup,
    ChainSetup,
    Cone,
    DistanceSetup,
    FrameSetup,
    JointMap,
    Obstacle,
    Payload,
    PlaneSetup,
    PointSetup,
    RangerSetup,
    Region,
    ReportSetup,
    Setup,
    SolverSetup,
    SphereSetup,
    ToolSetup,
)


@pytest.fixture
def write(tmp_path):
    def write(text: str | bytes) -> Path:
        file = tmp_path / "setup.yaml"
        data = text.encode() if isinstance(text, str) else text
        file.write_bytes(data)
        return file

    return write


@pytest.fixture
def bad(write, refused):
    """A file that cannot be used: `bad(text, line=3, reason="...")`, see `refused`."""

    def bad(text: str | bytes, **fields) -> None:
        file = write(text)
        with refused(InputError, file=str(file), **fields):
            read_setup(file)

    return bad


FULL = """\
# every key there is
base: base_link
tip: "tool0"
chains:
  left: {tip: left_hand}
  touch: {base: left_hand, tip: right_finger}
model: position+fixed-point
parameters: [placement, joint-offset]
frames:
  base: {estimate: true}
  tool: {xyz: [0, 0, 0.1], rpy: [0, -1.5, 1e-5], estimate: false}
stations:
  day1: {xyz: [1, 0, 0], rpy: [0, 0, 3], estimate: true}
  day2: {}
tools:
  probe: {xyz: [0, 0, 0.1], estimate: true}
  stylus: {on: probe, xyz: [0, 0, 0.05], rpy: [0, 1.5, 0], estimate: false}
  cap: {on: stylus}
planes:
  wall: {normal: [0, 1, 4.6], offset: -0.69, estimate: false}
  floor:
    normal:
      - 0
      - 0
      - 1
    offset: 0
targets:
  ball: {xyz: [0.01, 0.02, 0.1], estimate: true}
  tip: {}
sockets:
  front/0: {xyz: [0.6, 0, 0.3], estimate: false}
  front/1: {xyz: [0.65, 0, 0.3]}
spheres:
  gauge: {xyz: [0.6, 0.2, 0.3], radius: 0.0254, estimate: false,
    estimate_radius: false}
  knob: {radius: 0.01}
anchors:
  wire: {xyz: [1, 0, 2], bias: -0.01, estimate: false, estimate_bias: true}
  spring: {}
camera:
  mount: hand
  focal: [1200, 1210.5]
  center: [639.5, "479.5"]
  distortion: [-0.1, 1e-2, 0, 1e-4, 0.3]
  size: [1280, 960]
  estimate: true
distances:
  - {between: [front/0, front/1], value: 0.05, sigma: 1.0e-5}
  - between: [ball, "12"]
    value: 0.2
joints:
  J3: {joint: joint_3, sign: -1, gear: 0.01, offset: 1.57, coupled: {J2: 1.0}}
  4: {joint: joint_4}
gravity: [0, -6.9, 6.9]
payloads: {p1: {mass: 20, com: [0, 0, 0.15]}}
gear_ratios: {"joint_*": 160, rail: -1.2e3}
fixed: ["*.placement.z", base.frame.x]
bounds: {"*.placement.x": 0.01, "*.dh.*": [-0.1, 0.2]}
prior: {"*.placement.*": 0.002}
noise: {position: 1e-4, orientation: .5e-3, distance: "2.0e-4",
  contact: 1e-5, pixel: 0.3}
loss: gnc
solver: {name: hybrid, strategy: best/1, population_size: 60, mutation: "0.7",
  recombination: 1, maxiter: 5e2, target: 1e-3, tol: 0, atol: 1e-9, init: random}
obstacles:
  - {box: [1, 1, 0.02], xyz: [0, 0, -0.02]}
  - {sphere: 0.2, xyz: [1, 0, 0.5]}
  - {cylinder: [0.1, 1.0], rpy: [0, 1.57, 0]}
  - {mesh: /fixtures/table.stl, scale: 0.001}
  - {mesh: /fixtures/wall.dae, scale: [1, 2, 1]}
  - {mesh: /fixtures/door.obj}
region:
  box: [[0.2, -0.5, 0.1], [1.0, 0.5, 1.2]]
  sphere: {center: [0.5, 0, 0.5], radius: 0.8}
  cone: {apex: [2, 0, 1], axis: [-1, 0, 0], angle: 0.5, range: 3}
limits: {"joint_*": [-2, 2], rail: [0.1, 1.5]}
ranger: {range: [0.05, 2], incidence: 1.2}
report: {serial_number: KR 7, temperature: "20.5", date: 2026-11-23}
"""


def test_every_key(write):
    assert read_setup(write(FULL)) == Setup(
        base="base_link",
        tip="tool0",
        chains={
            "left": ChainSetup("left_hand"),
            "touch": ChainSetup("right_finger", "left_hand"),
        },
        model="position+fixed-point",
        parameters=("placement", "joint-offset"),
        base_frame=FrameSetup(estimate=True),
        tool_frame=FrameSetup((0.0, 0.0, 0.1), (0.0, -1.5, 1e-5), False),
        stations={
            "day1": FrameSetup((1.0, 0.0, 0.0), (0.0, 0.0, 3.0), True),
            "day2": FrameSetup(),
        },
        tools={
            "probe": ToolSetup((0.0, 0.0, 0.1), estimate=True),
            "stylus": ToolSetup((0.0, 0.0, 0.05), (0.0, 1.5, 0.0), False, "probe"),
            "cap": ToolSetup(on="stylus"),
        },
        planes={
            "wall": PlaneSetup((0.0, 1.0, 4.6), -0.69, False),
            "floor": PlaneSetup((0.0, 0.0, 1.0), 0.0, True),
        },
        targets={"ball": PointSetup((0.01, 0.02, 0.1), True), "tip": PointSetup()},
        sockets={
            "front/0": PointSetup((0.6, 0.0, 0.3), False),
            "front/1": PointSetup((0.65, 0.0, 0.3)),
        },
        spheres={
            "gauge": SphereSetup((0.6, 0.2, 0.3), 0.0254, False, False),
            "knob": SphereSetup(radius=0.01),
        },
        anchors={
            "wire": AnchorSetup((1.0, 0.0, 2.0), -0.01, False, True),
            "spring": AnchorSetup(),
        },
        camera=CameraSetup(
            mount="hand",
            focal=(1200.0, 1210.5),
            center=(639.5, 479.5),
            distortion=(-0.1, 0.01, 0.0, 1e-4, 0.3),
            size=(1280.0, 960.0),
            estimate=True,
        ),
        distances=(
            DistanceSetup(("front/0", "front/1"), 0.05, 1e-5),
            DistanceSetup(("ball", "12"), 0.2),
        ),
        joints={
            "J3": JointMap("joint_3", -1, 0.01, 1.57, {"J2": 1.0}),
            "4": JointMap("joint_4"),
        },
        gravity=(0.0, -6.9, 6.9),
        payloads={"p1": Payload(20.0, (0.0, 0.0, 0.15))},
        gear_ratios={"joint_*": 160.0, "rail": -1200.0},
        fixed=("*.placement.z", "base.frame.x"),
        bounds={"*.placement.x": 0.01, "*.dh.*": (-0.1, 0.2)},
        prior={"*.placement.*": 0.002},
        noise={
            "position": 1e-4,
            "orientation": 5e-4,
            "distance": 2e-4,
            "contact": 1e-5,
            "pixel": 0.3,
        },
        loss="gnc",
        solver=SolverSetup(
            "hybrid",
            {
                "strategy": "best/1",
                "population_size": 60,
                "mutation": 0.7,
                "recombination": 1,
                "maxiter": 500,
                "target": 1e-3,
                "tol": 0,
                "atol": 1e-9,
                "init": "random",
            },
        ),
        obstacles=(
            Obstacle(box=(1.0, 1.0, 0.02), xyz=(0.0, 0.0, -0.02)),
            Obstacle(sphere=0.2, xyz=(1.0, 0.0, 0.5)),
            Obstacle(cylinder=(0.1, 1.0), rpy=(0.0, 1.57, 0.0)),
            Obstacle(mesh="/fixtures/table.stl", scale=(0.001,) * 3),
            Obstacle(mesh="/fixtures/wall.dae", scale=(1.0, 2.0, 1.0)),
            Obstacle(mesh="/fixtures/door.obj", scale=(1.0, 1.0, 1.0)),
        ),
        region=Region(
            box=((0.2, -0.5, 0.1), (1.0, 0.5, 1.2)),
            sphere=Ball((0.5, 0.0, 0.5), 0.8),
            cone=Cone((2.0, 0.0, 1.0), (-1.0, 0.0, 0.0), 0.5, (0.0, 3.0)),
        ),
        limits={"joint_*": (-2.0, 2.0), "rail": (0.1, 1.5)},
        ranger=RangerSetup((0.05, 2.0), 1.2),
        report=ReportSetup("KR 7", temperature=20.5, date="2026-11-23"),
    )


def test_the_document_of_a_setup_reads_back(write):
    setup = read_setup(write(FULL))
    assert setup_of(json.loads(json.dumps(setup_document(setup)))) == setup


@pytest.mark.parametrize(
    "setup",
    [
        Setup(obstacles=(Obstacle(sphere=0.1, xyz=(1.0, 2.0, 3.0)),)),
        Setup(region=Region(sphere=Ball((0.0, 0.0, 1.0), 2.0))),
        Setup(region=Region(cone=Cone((0, 0, 0), (1, 0, 0), math.pi, (1.0, 2.0)))),
        Setup(ranger=RangerSetup((0.1, 3.0))),
        Setup(limits={"a[1]": (-1.0, 0.0)}),
        Setup(gravity=(0.0, 0.0, 0.0)),
        Setup(
            payloads={
                "a": Payload(0.1, (0.0, 0.0, 0.0)),
                "b": Payload(3.0, (0.0, 1.0, 0.0)),
            }
        ),
        Setup(gear_ratios={"a[1]": 80.5}),
        Setup(model="pose+plane-contact+camera"),
        Setup(targets={"a": PointSetup(), "b": PointSetup((1.0, 2.0, 3.0), False)}),
        Setup(sockets={"a/0": PointSetup(estimate=True)}),
        Setup(spheres={"a": SphereSetup(), "b": SphereSetup(None, 0.1, True, False)}),
        Setup(anchors={"a": AnchorSetup(), "b": AnchorSetup((1.0, 0.0, 0.0), -0.1)}),
        Setup(camera=CameraSetup("world", (900.0, 900.0), (320.0, -5.5))),
        Setup(board=BoardSetup("charuco", 7, 5, 0.03)),
        Setup(distances=(DistanceSetup(("a", "b"), 0.1),)),
        Setup(noise={"contact": 1e-3, "pixel": 2.0}),
    ],
)
def test_parts_of_a_setup_read_back(setup):
    assert setup_of(json.loads(json.dumps(setup_document(setup)))) == setup


def test_keys_of_a_later_version_are_passed_over():
    setup = Setup(tip="a", planes={"p": PlaneSetup((0.0, 0.0, 1.0), 0.0)})
    document = setup_document(setup)
    document["later"] = 1
    document["planes"]["p"]["later"] = {"any": "thing"}
    assert setup_of(document) == setup


@pytest.mark.parametrize("name", ["network", "gaussian-process"])
def test_a_residual_model_reads_back(name, write):
    setup = read_setup(write(f"learned: {name}"))
    assert setup == Setup(learned=name)
    assert setup_of(json.loads(json.dumps(setup_document(setup)))) == setup


def test_what_nobody_stated_is_not_stored():
    keys = setup_document(Setup()).keys()
    assert keys == {"parameters"}
    spring = Setup(anchors={"a": AnchorSetup()}, targets={"b": PointSetup()})
    assert setup_document(spring)["targets"] == {"b": {}}
    assert "xyz" not in setup_document(spring)["anchors"]["a"]
    assert setup_document(Setup(gravity=(0, 0, 9.81)))["gravity"] == [0, 0, 9.81]


def test_meshes_are_found_beside_the_setup_file(write, monkeypatch):
    file = write("obstacles: [{mesh: fixtures/a.stl}, {sphere: 1}, {mesh: /b.stl}]")
    expected = [str(file.parent / "fixtures" / "a.stl"), None, "/b.stl"]
    assert [obstacle.mesh for obstacle in read_setup(file).obstacles] == expected
    monkeypatch.chdir(file.parent)
    assert [o.mesh for o in read_setup(file.name).obstacles] == expected


@pytest.mark.parametrize("text", ["", "# nothing\n", "---\n", "\n\n", "~\n", "{}"])
def test_empty_file_is_the_default(write, text):
    assert read_setup(write(text)) == Setup()


def test_keys_without_a_value_count_as_not_written(write):
    text = "base:\nframes:\n  tool:\nplanes:\nnoise: {position: }\nparameters:\n"
    assert read_setup(write(text)) == Setup()


def test_byte_order_mark_and_windows_line_ends(write):
    text = b"\xef\xbb\xbfbase: a\r\ntip: b\r\n"
    assert read_setup(write(text)) == Setup(base="a", tip="b")


def test_names_that_yaml_would_take_for_something_else(write):
    setup = read_setup(
        write(
            "tip: 2020-01-01\nplanes: {on: {normal: [0, 0, 1]"
            ", offset: 1}}\njoints: {010: {joint: 'no'}}"
        )
    )
    assert setup.tip == "2020-01-01"
    assert list(setup.planes) == ["on"]
    assert setup.joints == {"010": JointMap("no")}


@pytest.mark.parametrize(
    ("written", "value"),
    [
        ("1e-5", 1e-5),
        ("1E5", 1e5),
        ("+.5", 0.5),
        ("3", 3.0),
        ("010", 10.0),
        ("5.", 5.0),
        ("'1e-3'", 1e-3),
    ],
)
def test_numbers(write, written, value):
    file = write(f"prior: {{a: {written}}}")
    assert read_setup(file).prior == {"a": value}


@pytest.mark.parametrize("written", ["1:30", "0x10", "1_000", "one", "true", "[1]"])
def test_what_is_not_a_number(bad, written):
    bad(
        f"prior:\n  'a.*': {written}\n",
        line=2,
        value=written,
        reason="'prior.a.*'",
        allowed="a number",
    )


KEYS = (
    "base, tip, chains, model, parameters, learned, frames, stations, tools, planes, "
    "targets, sockets, spheres, anchors"
)


def test_halves_of_characters(tmp_path, refused):
    """An escape can write what no encoding can."""
    for text in ('"\\uDCFF": 1', 'fixed: ["\\uD800"]'):
        file = tmp_path / "setup.yaml"
        file.write_text(f"tip: tool\n{text}\n")
        with refused(InputError, file=str(file), line=2, reason="half of a character"):
            read_setup(file)


@pytest.mark.parametrize(
    ("text", "fields"),
    [
        # Unknown keys, with the nearest known one.
        (
            "base: a\nframe: {}\n",
            dict(
                line=2,
                reason=("'frame'", "did you mean 'frames'"),
                allowed=KEYS,
            ),
        ),
        (
            "frames:\n  tol: {}\n",
            dict(line=2, reason=("'frames.tol'", "mean 'tool'"), allowed="base, tool"),
        ),
        (
            "frames:\n  tool:\n    xzy: [0, 0, 0]\n",
            dict(
                line=3,
                reason=("'frames.tool.xzy'", "mean 'xyz'"),
                allowed="xyz, rpy, estimate",
            ),
        ),
        (
            "noise:\n  positon: 1\n",
            dict(line=2, reason=("noise.positon", "mean 'position'")),
        ),
        (
            "planes:\n  w:\n    normal: [0, 0, 1]\n    offest: 1\n    offset: 1\n",
            dict(line=4, reason=("planes.w.offest", "mean 'offset'")),
        ),
        (
            "joints:\n  a:\n    joint: b\n    signs: 1\n",
            dict(line=4, reason="mean 'sign'"),
        ),
        ("<<: {base: a}", dict(line=1, reason="unknown key '<<'")),
        # Missing keys.
        (
            "planes:\n  w: {normal: [0, 0, 1]}",
            dict(line=2, reason="'planes.w.offset' is missing"),
        ),
        (
            "joints:\n  J1: {sign: 1}",
            dict(line=2, reason="'joints.J1.joint' is missing"),
        ),
        (
            "joints:\n  J1: {joint: }",
            dict(line=2, reason="'joints.J1.joint' is missing"),
        ),
        (
            "payloads:\n  p: {com: [0, 0, 1]}",
            dict(line=2, reason="'payloads.p.mass' is missing"),
        ),
        # Wrong types.
        ("base: 12\n", dict(line=1, value="12", reason="'base'", allowed="text")),
        ("tip: no\n", dict(line=1, value="no", reason="'tip'", allowed="in quotes")),
        ("tip: ''\n", dict(line=1, value="", reason="'tip'", allowed="text")),
        ("tip: [a]\n", dict(line=1, value="[a]", reason="'tip'", allowed="text")),
        (
            "model: cam\n",
            dict(line=1, value="cam", allowed="position, pose, plane-distance"),
        ),
        (
            "model: pose+cam\n",
            dict(line=1, value="pose+cam", allowed="several of them with a + between"),
        ),
        ("model: pose+\n", dict(line=1, value="pose+", allowed="several of them")),
        (
            "model: ''\n",
            dict(line=1, value="", reason="'model'", allowed="several of them"),
        ),
        (
            "model: pose+camera+pose\n",
            dict(line=1, value="pose+camera+pose", allowed="at most once"),
        ),
        (
            "model: [pose]\n",
            dict(line=1, value="[pose]", allowed="position, pose, plane-distance"),
        ),
        (
            "frames: base\n",
            dict(line=1, value="base", reason="'frames'", allowed="mapping"),
        ),
        (
            "frames: [base]\n",
            dict(line=1, value="[base]", reason="'frames'", allowed="mapping"),
        ),
        (
            "planes:\n  wall:\n  floor: 1\n",
            dict(line=2, value="", reason="'planes.wall'", allowed="mapping"),
        ),
        (
            "joints: [1]\n",
            dict(line=1, value="[1]", reason="'joints'", allowed="mapping"),
        ),
        ("fixed: '*'\n", dict(line=1, value="*", reason="'fixed'", allowed="list")),
        (
            "fixed:\n  - a\n  - 2\n",
            dict(line=3, value="2", reason="'fixed[1]'", allowed="text"),
        ),
        (
            "parameters: dh\n",
            dict(line=1, value="dh", reason="'parameters'", allowed="list"),
        ),
        (
            "frames: {base: {estimate: 1}}",
            dict(line=1, value="1", reason="base.estimate", allowed="true, false"),
        ),
        # Wrong values.
        (
            "parameters:\n  - placement\n  - placment\n",
            dict(
                line=3,
                value="placment",
                reason="'parameters[1]'",
                allowed="placement, link-transform, dh, dh-full",
            ),
        ),
        (
            "parameters: []\n",
            dict(line=1, value="[]", reason="'parameters'", allowed="at least one"),
        ),
        (
            "parameters: [dh, dh]\n",
            dict(
                line=1, value="[dh, dh]", reason="'parameters'", allowed="at most once"
            ),
        ),
        (
            "parameters: [{a: b}]\n",
            dict(line=1, value="{a: b}", reason="'parameters[0]'"),
        ),
        (
            "frames:\n  tool:\n    xyz: [1, 2]\n",
            dict(line=3, value="[1, 2]", reason=("'frames.tool.xyz'", "m")),
        ),
        (
            "frames: {tool: {xyz: [1, 2, a]}}",
            dict(line=1, value="[1, 2, a]", allowed="three finite numbers"),
        ),
        (
            "frames: {tool: {xyz: [1, 2, .inf]}}",
            dict(line=1, value="[1, 2, .inf]", allowed="three finite numbers"),
        ),
        (
            "frames: {tool: {xyz: [0, 0, 150]}}",
            dict(line=1, value="[0, 0, 150]", allowed="numbers in m"),
        ),
        (
            "frames: {tool: {rpy: [0, 0, 90]}}",
            dict(line=1, value="[0, 0, 90]", allowed="numbers in rad"),
        ),
        (
            "planes:\n  w:\n    offset: 0\n    normal: [0, 0.0, 0]\n",
            dict(
                line=4,
                value="[0, 0.0, 0]",
                reason="'planes.w.normal'",
                allowed="not all 0",
            ),
        ),
        (
            "planes: {w: {normal: [0, 0, 1], offset: .nan}}",
            dict(line=1, value=".nan", reason="w.offset", allowed="finite"),
        ),
        (
            "joints: {a: {joint: b, sign: 2}}",
            dict(line=1, value="2", reason="joints.a.sign", allowed="1, -1"),
        ),
        (
            "joints: {a: {joint: b, gear: 0}}",
            dict(line=1, value="0", reason="joints.a.gear", allowed="1e-6 to 1e6"),
        ),
        (
            "joints: {a: {joint: b, offset: x}}",
            dict(line=1, value="x", reason="joints.a.offset", allowed="a number"),
        ),
        (
            "joints: {a: {joint: b, coupled: {c: x}}}",
            dict(line=1, value="x", reason="coupled.c", allowed="a number"),
        ),
        (
            "joints:\n  a:\n    joint: j\n  b:\n    joint: j\n",
            dict(
                line=5,
                value="j",
                reason=("'joints.b.joint'", "'joints.a.joint'", "same joint"),
            ),
        ),
        (
            "bounds: {a: 0}",
            dict(
                line=1,
                value="0",
                reason="'bounds.a'",
                allowed=("positive", "lower < upper"),
            ),
        ),
        ("bounds: {a: [1, 1]}", dict(line=1, value="[1, 1]", allowed="lower < upper")),
        (
            "bounds: {a: [1, 2, 3]}",
            dict(line=1, value="[1, 2, 3]", allowed="lower < upper"),
        ),
        (
            "bounds: {a: [-.inf, 2]}",
            dict(line=1, value="[-.inf, 2]", allowed="lower < upper"),
        ),
        (
            "bounds:\n  a:\n    - 2 # m\n    - 1\n",
            dict(line=2, value="- 2", reason="'bounds.a'", allowed="lower < upper"),
        ),
        (
            "prior: {a: -1}",
            dict(line=1, value="-1", reason="'prior.a'", allowed="a positive number"),
        ),
        (
            "noise: {distance: 0}",
            dict(
                line=1,
                value="0",
                reason="'noise.distance'",
                allowed="a positive number",
            ),
        ),
        (
            "noise: {distance: .nan}",
            dict(line=1, value=".nan", allowed="a finite number"),
        ),
        (
            "noise: {distance: '1e999'}",
            dict(line=1, value="1e999", allowed="a finite number"),
        ),
        (
            "noise: {contact: 0}",
            dict(
                line=1, value="0", reason="'noise.contact'", allowed="a positive number"
            ),
        ),
        (
            "noise: {pixel: -1}",
            dict(
                line=1, value="-1", reason="'noise.pixel'", allowed="a positive number"
            ),
        ),
        (
            "noise: {pixel: 2e3}",
            dict(line=1, value="2e3", allowed="a standard deviation in px, at most"),
        ),
        # What is measured against.
        (
            "targets: [a]",
            dict(
                line=1,
                value="[a]",
                reason="'targets'",
                allowed="mapping of names to values",
            ),
        ),
        (
            "targets:\n  a: [0, 0, 1]\n",
            dict(line=2, value="[0, 0, 1]", reason="'targets.a'", allowed="mapping"),
        ),
        (
            "targets:\n  a:\n    xzy: 1\n",
            dict(line=3, reason=("'targets.a.xzy'", "mean 'xyz'")),
        ),
        (
            "targets: {a: {xyz: [0, 1]}}",
            dict(
                line=1,
                value="[0, 1]",
                reason="'targets.a.xyz'",
                allowed="three finite numbers",
            ),
        ),
        (
            "targets: {a: {xyz: [0, 0, 101]}}",
            dict(
                line=1,
                value="[0, 0, 101]",
                reason="'targets.a.xyz'",
                allowed="numbers in m",
            ),
        ),
        (
            "targets: {a: {}}\nboard:\n  type: circles\n  columns: 3\n  rows: 3\n"
            "  square: 0.03\n",
            dict(line=2, reason=("'board'", "'targets'"), allowed="one of them"),
        ),
        (
            "board: {type: aruco, columns: 3, rows: 3, square: 0.03}",
            dict(
                line=1,
                value="aruco",
                allowed="charuco, chessboard, circles, apriltag, marker",
            ),
        ),
        (
            "board: {type: circles, columns: 2.5, rows: 3, square: 0.03}",
            dict(line=1, value="2.5", reason="board.columns", allowed="from 1 to 100"),
        ),
        (
            "board: {type: charuco, columns: 3, rows: 0, square: 0.03}",
            dict(line=1, value="0", reason="board.rows", allowed="from 1 to 100"),
        ),
        (
            "board: {type: charuco, columns: 3, rows: 3, square: 0}",
            dict(line=1, value="0", reason="board.square", allowed="a positive number"),
        ),
        (
            "board: {type: charuco, columns: 3, rows: 3}",
            dict(line=1, reason="'board.square' is missing"),
        ),
        (
            "sockets: {a: {estimate: 1}}",
            dict(line=1, value="1", reason="sockets.a.estimate", allowed="true, false"),
        ),
        *(
            (
                f"tip: a\n{key}:\n  b: {{}}\n  c: {{estimate: false}}\n",
                dict(
                    line=4,
                    value="{estimate: false}",
                    reason=f"'{key}.c'",
                    allowed="only together with xyz",
                ),
            )
            for key in ("targets", "sockets", "spheres", "anchors")
        ),
        *(
            (
                f"{key}:\n  b: {{{rest}}}\n  {name}: {{{rest}}}\n",
                dict(
                    line=3,
                    reason="cannot have this name",
                    allowed="a name without @, which in the target",
                ),
            )
            for key, rest in (
                ("targets", ""),
                ("sockets", ""),
                ("spheres", ""),
                ("anchors", ""),
                ("planes", "normal: [0, 0, 1], offset: 1"),
            )
            for name in ("a@b", "'@'", "''", "' '")
        ),
        (
            "payloads:\n  p: {mass: 1, com: [0, 0, 0]}\n"
            "  none: {mass: 1, com: [0, 0, 0]}\n",
            dict(
                line=3,
                reason="'payloads.none' cannot have this name",
                allowed="any name but none, which measurements",
            ),
        ),
        (
            "payloads: {'': {mass: 1, com: [0, 0, 0]}}",
            dict(line=1, reason="cannot have this name"),
        ),
        # Chains, stations and tools.
        (
            "chains:\n  world: {tip: a}\n",
            dict(line=2, reason="'chains.world'", allowed="any name but world, which"),
        ),
        *(
            (f"{key}: {{' ': {{{rest}}}}}", dict(line=1, reason=f"'{key}. ' cannot"))
            for key, rest in (("chains", "tip: a"), ("stations", ""), ("tools", ""))
        ),
        (
            "chains:\n  left: {base: a}\n",
            dict(line=2, reason="'chains.left.tip' is missing"),
        ),
        (
            "chains:\n  left: {base: a, tip: a}\n",
            dict(line=2, reason="'chains.left'", allowed="two different links"),
        ),
        (
            "chains: {left: {tip: a, bas: b}}",
            dict(line=1, reason="did you mean 'base'", allowed="tip, base"),
        ),
        (
            "stations: {day1: {on: probe}}",
            dict(line=1, reason="'stations.day1.on'", allowed="xyz, rpy, estimate"),
        ),
        (
            "tools:\n  probe: {}\n  tip:\n    on: prob\n",
            dict(
                line=4,
                value="prob",
                reason=("'tools.tip.on' is no other tool", "did you mean 'probe'"),
                allowed="probe",
            ),
        ),
        (
            "tools: {a: {on: a}}",
            dict(line=1, value="a", reason="'tools.a.on'", allowed=None),
        ),
        (
            "tools:\n  d: {on: a}\n  a: {on: b}\n  b: {on: c}\n  c: {on: a}\n",
            dict(line=3, value="b", reason="'tools.a' carries itself"),
        ),
        (
            "tools:\n  a: {}\n  b: {on: a, estimate: true}\n",
            dict(line=3, reason="'tools.b'", allowed="estimate: true only without on"),
        ),
        (
            "spheres: {a: {radius: 0}}",
            dict(
                line=1,
                value="0",
                reason="spheres.a.radius",
                allowed="a positive number",
            ),
        ),
        (
            "spheres: {a: {radius: -1}}",
            dict(
                line=1,
                value="-1",
                reason="spheres.a.radius",
                allowed="a positive number",
            ),
        ),
        (
            "spheres: {a: {radius: 25.4e3}}",
            dict(line=1, value="25.4e3", allowed="a length in m, at most"),
        ),
        (
            "spheres: {a: {raduis: 1}}",
            dict(line=1, reason=("spheres.a.raduis", "mean 'radius'")),
        ),
        (
            "spheres: {a: {estimate_radius: false}}",
            dict(
                line=1,
                value="{estimate_radius: false}",
                reason="'spheres.a'",
                allowed="estimate_radius: false only together with radius",
            ),
        ),
        (
            "anchors: {a: {bias: x}}",
            dict(line=1, value="x", reason="anchors.a.bias", allowed="a number"),
        ),
        (
            "anchors: {a: {bias: -200}}",
            dict(
                line=1,
                value="-200",
                reason="anchors.a.bias",
                allowed="at most 100 either",
            ),
        ),
        (
            "anchors: {a: {estimat_bias: true}}",
            dict(line=1, reason="mean 'estimate_bias'", allowed="xyz, bias"),
        ),
        (
            "camera: world",
            dict(line=1, value="world", reason="'camera'", allowed="mapping"),
        ),
        ("tip: a\ncamera: {}", dict(line=2, reason="'camera.mount' is missing")),
        (
            "camera:\n  mount: hand\n  center: [1, 2]\n",
            dict(line=1, reason="'camera.focal' is missing"),
        ),
        (
            "camera: {mount: hand, focal: [1, 1]}",
            dict(line=1, reason="'camera.center' is missing"),
        ),
        *(
            (
                "camera:\n"
                + "".join(
                    f"  {key}: {value}\n"
                    for key, value in {
                        "mount": "hand",
                        "focal": "[900, 900]",
                        "center": "[320, 240]",
                        **dict([wrong.split(": ", 1)]),
                    }.items()
                ),
                dict(reason=f"'camera.{wrong.split(':')[0]}'") | fields,
            )
            for wrong, fields in (
                ("mount: table", dict(line=2, value="table", allowed="hand, world")),
                ("mount: [hand]", dict(line=2, value="[hand]", allowed="hand, world")),
                (
                    "focal: 900",
                    dict(
                        line=3,
                        value="900",
                        allowed="[f_x, f_y], in px, 1 to 100000",
                    ),
                ),
                (
                    "focal: [900, 0]",
                    dict(line=3, value="[900, 0]", allowed="1 to 100000"),
                ),
                (
                    "focal: [900, -1]",
                    dict(line=3, value="[900, -1]", allowed="1 to 100000"),
                ),
                (
                    "focal: [900, 1e6]",
                    dict(line=3, value="[900, 1e6]", allowed="1 to 100000"),
                ),
                (
                    "focal: [900, .nan]",
                    dict(line=3, value="[900, .nan]", allowed="1 to 100000"),
                ),
                (
                    "center: [1, 2, 3]",
                    dict(line=4, value="[1, 2, 3]", allowed="[c_x, c_y] in px"),
                ),
                (
                    "center: [1, -1e6]",
                    dict(line=4, value="[1, -1e6]", allowed="[c_x, c_y] in px"),
                ),
                (
                    "size: [640, 0]",
                    dict(line=5, value="[640, 0]", allowed="[width, height]"),
                ),
                (
                    "distortion: 0.1",
                    dict(line=5, value="0.1", allowed="the first two or four of them"),
                ),
                (
                    "distortion: [1, 2, 3]",
                    dict(line=5, value="[1, 2, 3]", allowed="two or four of them"),
                ),
                (
                    "distortion: [1, 1e9]",
                    dict(line=5, value="[1, 1e9]", allowed="two or four of them"),
                ),
                (
                    "distortion: [1, x]",
                    dict(line=5, value="[1, x]", allowed="two or four of them"),
                ),
                (
                    "estimate: yes please",
                    dict(line=5, value="yes please", allowed="true, false"),
                ),
                (
                    "fokal: 1",
                    dict(
                        line=5,
                        reason=("unknown key", "mean 'focal'"),
                        allowed="mount, focal",
                    ),
                ),
            )
        ),
        (
            "distances: {a: 1}",
            dict(line=1, value="{a: 1}", reason="'distances'", allowed="a list"),
        ),
        (
            "distances:\n  - 0.05\n",
            dict(line=2, value="0.05", reason="'distances[0]'", allowed="mapping"),
        ),
        (
            "distances: [{value: 1}]",
            dict(line=1, reason="'distances[0].between' is missing"),
        ),
        (
            "distances: [{between: [a, b]}]",
            dict(line=1, reason="'distances[0].value' is missing"),
        ),
        *(
            (
                f"distances:\n  - between: {between}\n    value: 1\n",
                dict(
                    line=2,
                    value=between,
                    reason="'distances[0].between'",
                    allowed=("two different names, such as", "in quotes"),
                ),
            )
            for between in ("a", "[a]", "[a, a]", "[a, b, c]", "[1, 2]", "[a, '']")
        ),
        (
            "distances:\n  - between: [a, b]\n    value: -0.05\n",
            dict(
                line=3,
                value="-0.05",
                reason="'distances[0].value'",
                allowed="a positive number",
            ),
        ),
        (
            "distances: [{between: [a, b], value: 500}]",
            dict(line=1, value="500", allowed="a length in m"),
        ),
        (
            "distances: [{between: [a, b], value: 1, sigma: 0}]",
            dict(
                line=1,
                value="0",
                reason="'distances[0].sigma'",
                allowed="a positive number",
            ),
        ),
        (
            "distances: [{between: [a, b], value: 1, sgma: 1}]",
            dict(
                line=1,
                reason=("'distances[0].sgma'", "mean 'sigma'"),
                allowed="between, value, sigma",
            ),
        ),
        (
            "distances:\n  - {between: [a, b], value: 1}\n"
            "  - {between: [a, c], value: 1}\n  - {between: [b, a], value: 1}\n",
            dict(
                line=4,
                value=["b", "a"],
                reason=("'distances[2]'", "'distances[0]'", "the same points"),
            ),
        ),
        # Gravity, loads and gears.
        (
            "gravity: 9.81",
            dict(
                line=1,
                value="9.81",
                reason="'gravity'",
                allowed="three finite numbers in m/s^2",
            ),
        ),
        (
            "gravity: [0, -9.81]",
            dict(
                line=1, value="[0, -9.81]", reason="'gravity'", allowed="[0, 0, -9.81]"
            ),
        ),
        (
            "gravity: [0, 0, .nan]",
            dict(
                line=1,
                value="[0, 0, .nan]",
                reason="'gravity'",
                allowed="three finite numbers",
            ),
        ),
        (
            "gravity:\n  - 0\n  - 0\n  - -9810\n",
            dict(
                line=1, value="- 0 - 0 - -9810", reason="'gravity'", allowed="in m/s^2"
            ),
        ),
        (
            "payloads: [20]",
            dict(line=1, value="[20]", reason="'payloads'", allowed="mapping"),
        ),
        (
            "payloads: {p: 20}",
            dict(line=1, value="20", reason="'payloads.p'", allowed="mapping"),
        ),
        (
            "payloads:\n  p:\n    mass: 1\n    com: [0, 0, 0]\n    cm: [0, 0, 0]\n",
            dict(line=5, reason=("'payloads.p.cm'", "mean 'com'"), allowed="mass, com"),
        ),
        (
            "payloads: {p: {mass: 1}}",
            dict(line=1, reason="'payloads.p.com' is missing"),
        ),
        (
            "payloads: {p: {mass: 0}}",
            dict(line=1, value="0", reason="payloads.p.mass", allowed="more than 0"),
        ),
        (
            "payloads: {p: {mass: -2}}",
            dict(line=1, value="-2", reason="payloads.p.mass", allowed="in kg"),
        ),
        (
            "payloads: {p: {mass: 2 kg}}",
            dict(line=1, value="2 kg", reason="payloads.p.mass", allowed="in kg"),
        ),
        (
            "payloads: {p: {mass: 2.0e5}}",
            dict(line=1, value="2.0e5", allowed="at most 100000"),
        ),
        (
            "payloads: {p: {mass: 1, com: [0, 1]}}",
            dict(line=1, value="[0, 1]", reason="p.com", allowed="in m"),
        ),
        (
            "payloads: {p: {mass: 1, com: [0, 0, 150]}}",
            dict(line=1, value="[0, 0, 150]", reason="p.com", allowed="numbers in m"),
        ),
        (
            "gear_ratios: 160",
            dict(line=1, value="160", reason="'gear_ratios'", allowed="mapping"),
        ),
        (
            "gear_ratios:\n  a: 1\n  b: 0\n",
            dict(line=3, value="0", reason="gear_ratios.b", allowed="1e-6 to 1e6"),
        ),
        (
            "gear_ratios: {a: .inf}",
            dict(line=1, value=".inf", reason="'gear_ratios.a'", allowed="finite"),
        ),
        (
            "learned: netwrok",
            dict(
                line=1,
                value="netwrok",
                reason="'learned'",
                allowed="network, gaussian-process",
            ),
        ),
        ("learned: [network]", dict(line=1, value="[network]", reason="'learned'")),
        (
            "loss: hubert",
            dict(
                line=1,
                value="hubert",
                reason="'loss'",
                allowed="auto, squared, huber, gnc",
            ),
        ),
        # The solver.
        *(
            (
                f"solver: {{{key}: {value}}}",
                dict(line=1, value=value, reason=f"solver.{key}") | allowed,
            )
            for key, value, allowed in (
                ("population_size", "3", dict(allowed="a whole number, 4 to 100000")),
                ("population_size", "1000000000000", dict(allowed="4 to 100000")),
                ("recombination", "1.2", dict(allowed="0 to 1")),
                ("mutation", "0", dict(allowed="more than 0, up to 2")),
                ("target", ".inf", dict(allowed="a finite number")),
                ("maxiter", "2.5", dict(allowed="a whole number")),
                ("tol", "tight", dict(allowed="0 or more")),
                ("name", "simplex", dict(allowed="gauss-newton, two-step, de, hybrid")),
                ("strategy", "rand/2", dict(allowed="rand/1, best/1, rand-to-best/1")),
                ("popsize", "15", dict(value=None, allowed="population_size")),
            )
        ),
        # Where the robot may measure.
        (
            "obstacles: {sphere: 1}\n",
            dict(line=1, value="{sphere: 1}", reason="'obstacles'", allowed="a list"),
        ),
        (
            "obstacles:\n  - 3\n",
            dict(line=2, value="3", reason="'obstacles[0]'", allowed="mapping"),
        ),
        (
            "obstacles:\n  - {sphere: 1}\n  - {xyz: [0, 0, 0]}\n",
            dict(
                line=3,
                value="{xyz: [0, 0, 0]}",
                reason="'obstacles[1]'",
                allowed="exactly one of box, sphere, cylinder, mesh",
            ),
        ),
        (
            "obstacles: [{box: [1, 1, 1], sphere: 1}]\n",
            dict(
                line=1,
                value="{box: [1, 1, 1], sphere: 1}",
                allowed="exactly one of box",
            ),
        ),
        (
            "obstacles: [{sphere: 1, scale: 2}]\n",
            dict(
                line=1,
                value="{sphere: 1, scale: 2}",
                allowed="scale only together with",
            ),
        ),
        (
            "obstacles:\n  - sphere: 1\n    xzy: [0, 0, 0]\n",
            dict(
                line=3,
                reason=("'obstacles[0].xzy'", "mean 'xyz'"),
                allowed="box, sphere, cylinder, mesh, scale",
            ),
        ),
        (
            "obstacles: [{box: [1, 1]}]",
            dict(
                line=1,
                value="[1, 1]",
                reason="'obstacles[0].box'",
                allowed="three positive",
            ),
        ),
        (
            "obstacles: [{box: [1, 1, -1]}]",
            dict(line=1, value="[1, 1, -1]", allowed="three positive"),
        ),
        (
            "obstacles: [{box: [1, 1, 900]}]",
            dict(line=1, value="[1, 1, 900]", allowed="in m"),
        ),
        (
            "obstacles: [{sphere: 0}]",
            dict(
                line=1,
                value="0",
                reason="'obstacles[0].sphere'",
                allowed="positive number",
            ),
        ),
        (
            "obstacles: [{sphere: 500}]",
            dict(line=1, value="500", allowed="a length in m, at most 100"),
        ),
        (
            "obstacles: [{cylinder: 1}]",
            dict(line=1, value="1", allowed=("[radius, length]", "in m")),
        ),
        (
            "obstacles: [{cylinder: [1, 0]}]",
            dict(line=1, value="[1, 0]", allowed="[radius, length]"),
        ),
        (
            "obstacles: [{mesh: 3}]",
            dict(line=1, value="3", reason="'obstacles[0].mesh'", allowed="text"),
        ),
        (
            "obstacles: [{mesh: a, scale: 0}]",
            dict(line=1, value="0", reason="[0].scale'", allowed="0.001 for a mesh"),
        ),
        (
            "obstacles: [{mesh: a, scale: [1, 1]}]",
            dict(line=1, value="[1, 1]", allowed="three of them"),
        ),
        (
            "obstacles: [{sphere: 1, xyz: [0, 0]}]",
            dict(line=1, value="[0, 0]", reason="[0].xyz'", allowed="three finite"),
        ),
        (
            "obstacles: [{sphere: 1, rpy: [0, 0, 90]}]",
            dict(line=1, value="[0, 0, 90]", reason="[0].rpy'", allowed="in rad"),
        ),
        ("region: 3\n", dict(line=1, value="3", reason="'region'", allowed="mapping")),
        (
            "region: {}\n",
            dict(
                line=1,
                value="{}",
                reason="'region'",
                allowed="at least one of box, sphere, cone",
            ),
        ),
        (
            "region:\n  bx: 1\n",
            dict(
                line=2,
                reason=("'region.bx'", "mean 'box'"),
                allowed="box, sphere, cone",
            ),
        ),
        (
            "region: {box: [[0, 0, 0]]}",
            dict(
                line=1,
                value="[[0, 0, 0]]",
                reason="'region.box'",
                allowed="[lower, upper]",
            ),
        ),
        (
            "region: {box: [[0, 0, 0], [1, 1]]}",
            dict(
                line=1,
                value="[[0, 0, 0], [1, 1]]",
                reason="region.box",
                allowed="three numbers",
            ),
        ),
        (
            "region: {box: [[0, 0, 0], 1]}",
            dict(
                line=1,
                value="[[0, 0, 0], 1]",
                reason="region.box",
                allowed="[lower, upper]",
            ),
        ),
        (
            "region: {box: [[0, 0, 2], [1, 1, 1]]}",
            dict(
                line=1,
                value="[[0, 0, 2], [1, 1, 1]]",
                reason="region.box",
                allowed="[lower, upper]",
            ),
        ),
        (
            "region: {sphere: 1}",
            dict(line=1, value="1", reason="'region.sphere'", allowed="mapping"),
        ),
        (
            "region: {sphere: {radius: 1}}",
            dict(line=1, reason="'region.sphere.center' is missing"),
        ),
        (
            "region:\n  sphere:\n    raduis: 1\n    radius: 1\n    center: [0, 0, 0]\n",
            dict(
                line=3,
                reason=("'region.sphere.raduis'", "mean 'radius'"),
                allowed="center, radius",
            ),
        ),
        (
            "region: {sphere: {center: [0, 0, 0], radius: -1}}",
            dict(
                line=1,
                value="-1",
                reason="'region.sphere.radius'",
                allowed="a positive number",
            ),
        ),
        *(
            (
                f"region:\n  cone:\n    {wrong}\n    apex: [0, 0, 0]\n"
                + "".join(
                    f"    {key}: {value}\n"
                    for key, value in (
                        ("axis", "[0, 0, 1]"),
                        ("angle", "0.5"),
                        ("range", "2"),
                    )
                    if not wrong.startswith(key)
                ),
                dict(line=3) | fields,
            )
            for wrong, fields in (
                (
                    "axis: [0, 0, 0]",
                    dict(reason="'region.cone.axis'", allowed="not all 0"),
                ),
                (
                    "angle: 30",
                    dict(reason="'region.cone.angle'", value="30", allowed="in rad"),
                ),
                (
                    "angle: 0",
                    dict(reason="'region.cone.angle'", value="0", allowed="above 0"),
                ),
                (
                    "range: 0",
                    dict(
                        reason="'region.cone.range'",
                        allowed="the farthest distance in m",
                    ),
                ),
                ("range: [2, 1]", dict(value="[2, 1]", allowed="[nearest, farthest]")),
                (
                    "range: [-1, 1]",
                    dict(value="[-1, 1]", allowed="[nearest, farthest]"),
                ),
            )
        ),
        (
            "region: {cone: {apex: [0, 0, 0]}}",
            dict(line=1, reason="'region.cone.axis' is missing"),
        ),
        *(
            (f"report: {{{entry}}}", dict(line=1, reason=f"'report.{key}'", **fields))
            for entry, key, fields in (
                (
                    'serial_number: "7\\x1b[2J"',
                    "serial_number",
                    dict(allowed="at most 80 printable letters"),
                ),
                (
                    f"serial_number: {'7a' * 100}",
                    "serial_number",
                    dict(allowed="at most 80 printable letters"),
                ),
                ("serial_number: 17", "serial_number", dict(allowed="in quotes")),
                ("temperature: 293.15", "temperature", dict(allowed="from -100 to")),
                ("date: 2026-02-30", "date", dict(allowed="such as 2026-11-23")),
                ("date: 23.11.2026", "date", dict(allowed="such as 2026-11-23")),
            )
        ),
        (
            "limits: [1, 2]",
            dict(line=1, value="[1, 2]", reason="'limits'", allowed="mapping"),
        ),
        (
            "limits: {j: 1}",
            dict(line=1, value="1", reason="'limits.j'", allowed="[lower, upper]"),
        ),
        ("limits: {j: [1, 1]}", dict(line=1, value="[1, 1]", allowed="lower < upper")),
        (
            "limits:\n  a: [0, 1]\n  j: [-90, 90]",
            dict(
                line=3, value="[-90, 90]", reason="'limits.j'", allowed="at most 12.57"
            ),
        ),
        ("ranger: {rang: 1}", dict(line=1, reason=("'ranger.rang'", "mean 'range'"))),
        (
            "ranger: {range: 500}",
            dict(line=1, value="500", reason="'ranger.range'", allowed="in m"),
        ),
        (
            "ranger: {range: [1, 2, 3]}",
            dict(line=1, value="[1, 2, 3]", allowed="[nearest, farthest]"),
        ),
        (
            "ranger: {incidence: 70}",
            dict(line=1, value="70", allowed="in rad, above 0 and below 1.57"),
        ),
        # What is YAML, but not for us.
        (
            "base: a\ntip: b\nbase: c\n",
            dict(line=3, reason="the key 'base' occurs twice"),
        ),
        (
            "frames:\n  base: {}\n  base: {}\n",
            dict(line=3, reason="the key 'base' occurs twice"),
        ),
        ("base: &x a\ntip: b\n", dict(line=1, reason="anchor, '&x', is not allowed")),
        ("base: &x a\ntip: *x\n", dict(line=1, reason="anchor, '&x', is not allowed")),
        (
            "base: a\ntip: *x\n",
            dict(line=2, reason=("alias, '*x'", "a glob needs quotes")),
        ),
        ("base: a\ntip: !!str b\n", dict(line=2, reason=("tag", "is not allowed"))),
        (
            "prior: !!python/object:os.system {}\n",
            dict(line=1, reason=("tag", "is not allowed")),
        ),
        ("[a, b]: c\n", dict(line=1, reason="a key must be a name")),
        ("- a\n", dict(line=1, reason="must be a mapping")),
        ("placement\n", dict(line=1, reason="must be a mapping")),
        # What is not YAML.
        ("base: a\ntip: [b\n", dict(line=3, reason="not valid YAML")),
        ("base: a\n\ttip: b\n", dict(line=2, reason="not valid YAML")),
        ("base: a: b\n", dict(line=1, reason="not valid YAML")),
        (
            "base: a\n---\nbase: b\n",
            dict(line=2, reason=("not valid YAML", "single document")),
        ),
        (
            "fixed: [*.x]\n",
            dict(line=1, reason='a glob needs quotes, as in "*.placement.z"'),
        ),
        ("prior:\n  *.x: 1\n", dict(line=2, reason="a glob needs quotes")),
        (b"base: a\ntip: \xff\n", dict(line=2, reason="not UTF-8")),
        (b"base: a\x00\n", dict(reason="not a text file")),
        (
            "base: " + "[" * 3000,
            dict(line=1, reason="so deep a nesting is not allowed"),
        ),
    ],
)
def test_errors(bad, text, fields):
    bad(text, **{"line": None, **fields})


@pytest.mark.parametrize(
    ("written", "value"),
    [
        ("[0.1, 0.2]", (0.1, 0.2, 0.0, 0.0, 0.0)),
        ("[0.1, 0.2, 3, -4]", (0.1, 0.2, 3.0, -4.0, 0.0)),
        ("[0, 0, 0, 0, -0.5]", (0.0, 0.0, 0.0, 0.0, -0.5)),
    ],
)
def test_distortions(write, written, value):
    camera = f"mount: world, focal: [9, 9], center: [0, 0], distortion: {written}"
    assert read_setup(write(f"camera: {{{camera}}}")).camera.distortion == value


@pytest.mark.parametrize("name", MEASUREMENT_MODELS)
def test_models(write, name):
    assert read_setup(write(f"model: {name}")).model == name
    other = "pose" if name != "pose" else "position"
    assert read_setup(write(f"model: {other}+{name}")).model == f"{other}+{name}"


def test_the_first_problem_of_several_is_reported(bad):
    text = "noise: {position: 0}\nprior: {a: 0}\nbounds: {b: 0}\nbase: 1\nfoo: 1\n"
    bad(text, line=1, reason="'noise.position'")


def test_long_values_are_shortened(write):
    with pytest.raises(InputError) as caught:
        read_setup(write("tip:\n" + "  - a very long item in a list\n" * 20))
    assert len(caught.value.value) < 80
    assert "..." in caught.value.value


def test_missing_file(tmp_path, refused):
    with refused(InputError, file=str(tmp_path / "none.yaml"), reason="no such file"):
        read_setup(tmp_path / "none.yaml")


def test_the_path_is_named_as_given(tmp_path, monkeypatch, refused):
    (tmp_path / "s.yaml").write_text("tip: 1")
    monkeypatch.chdir(tmp_path)
    with refused(InputError, file="s.yaml", line=1):
        read_setup("s.yaml")


def test_lines_of_a_tree(write):
    tree = read_tree(write("a:\n  - 1\n  - b: 2\n    c: 3\nd: x\n"))
    assert tree.data == {"a": [1.0, {"b": 2.0, "c": 3.0}], "d": "x"}
    assert tree.line(("a", 0)) == 2
    assert tree.line(("a", 1, "c")) == 4
    assert tree.line(("d", "not", "there")) == 5
    assert tree.written(("d",)) == "x"


def test_importing_does_not_load_yaml_or_pydantic():
    code = (
        "import sys, calib_pin.io.setup; "
        "sys.exit(not {'yaml', 'pydantic', 'scipy'}.isdisjoint(sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
