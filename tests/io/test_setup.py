"""Setup files: what they may say, and one line about the first thing wrong."""

from __future__ import annotations

import json
import math
import re
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
    CameraSetup,
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
    Setup,
    SolverSetup,
    SphereSetup,
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
def message(write):
    """The one line about a file that cannot be used, without the folder."""

    def message(text: str | bytes) -> str:
        file = write(text)
        with pytest.raises(InputError) as caught:
            read_setup(file)
        result = str(caught.value)
        assert result.startswith(f"{file}:")
        assert "\n" not in result
        return result.replace(str(file), "setup.yaml")

    return message


FULL = """\
# every key there is
base: base_link
tip: "tool0"
model: position+fixed-point
parameters: [placement, joint-offset]
frames:
  base: {estimate: true}
  tool: {xyz: [0, 0, 0.1], rpy: [0, -1.5, 1e-5], estimate: false}
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
"""


def test_every_key(write):
    assert read_setup(write(FULL)) == Setup(
        base="base_link",
        tip="tool0",
        model="position+fixed-point",
        parameters=("placement", "joint-offset"),
        base_frame=FrameSetup(estimate=True),
        tool_frame=FrameSetup((0.0, 0.0, 0.1), (0.0, -1.5, 1e-5), False),
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
            Obstacle("box", (1.0, 1.0, 0.02), xyz=(0.0, 0.0, -0.02)),
            Obstacle("sphere", (0.2,), xyz=(1.0, 0.0, 0.5)),
            Obstacle("cylinder", (0.1, 1.0), rpy=(0.0, 1.57, 0.0)),
            Obstacle("mesh", (0.001,) * 3, "/fixtures/table.stl"),
            Obstacle("mesh", (1.0, 2.0, 1.0), "/fixtures/wall.dae"),
            Obstacle("mesh", (1.0, 1.0, 1.0), "/fixtures/door.obj"),
        ),
        region=Region(
            box=((0.2, -0.5, 0.1), (1.0, 0.5, 1.2)),
            sphere=((0.5, 0.0, 0.5), 0.8),
            cone=Cone((2.0, 0.0, 1.0), (-1.0, 0.0, 0.0), 0.5, (0.0, 3.0)),
        ),
        limits={"joint_*": (-2.0, 2.0), "rail": (0.1, 1.5)},
        ranger=RangerSetup((0.05, 2.0), 1.2),
    )


def test_the_document_of_a_setup_reads_back(write):
    setup = read_setup(write(FULL))
    assert setup_of(json.loads(json.dumps(setup_document(setup)))) == setup


@pytest.mark.parametrize(
    "setup",
    [
        Setup(obstacles=(Obstacle("sphere", (0.1,), "", (1.0, 2.0, 3.0)),)),
        Setup(region=Region(sphere=((0.0, 0.0, 1.0), 2.0))),
        Setup(region=Region(cone=Cone((0, 0, 0), (1, 0, 0), math.pi, (1.0, 2.0)))),
        Setup(ranger=RangerSetup((0.1, 3.0))),
        Setup(limits={"a[1]": (-1.0, 0.0)}),
        Setup(gravity=(0.0, 0.0, 0.0)),
        Setup(payloads={"a": Payload(0.1), "b": Payload(3.0, (0.0, 1.0, 0.0))}),
        Setup(gear_ratios={"a[1]": 80.5}),
        Setup(model="pose+plane-contact+camera"),
        Setup(targets={"a": PointSetup(), "b": PointSetup((1.0, 2.0, 3.0), False)}),
        Setup(sockets={"a/0": PointSetup(estimate=True)}),
        Setup(spheres={"a": SphereSetup(), "b": SphereSetup(None, 0.1, True, False)}),
        Setup(anchors={"a": AnchorSetup(), "b": AnchorSetup((1.0, 0.0, 0.0), -0.1)}),
        Setup(camera=CameraSetup("world", (900.0, 900.0), (320.0, -5.5))),
        Setup(distances=(DistanceSetup(("a", "b"), 0.1),)),
        Setup(noise={"contact": 1e-3, "pixel": 2.0}),
    ],
)
def test_parts_of_a_setup_read_back(setup):
    assert setup_of(json.loads(json.dumps(setup_document(setup)))) == setup


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
    expected = [str(file.parent / "fixtures" / "a.stl"), "", "/b.stl"]
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
def test_what_is_not_a_number(message, written):
    text = message(f"prior:\n  'a.*': {written}\n")
    assert text == (
        f"setup.yaml:2: 'prior.a.*' cannot have this value (value '{written}'); "
        "allowed: a number"
    )


KEYS = (
    "base, tip, model, parameters, learned, frames, planes, targets, sockets, spheres, "
    "anchors, camera, distances, joints, gravity, payloads, gear_ratios, fixed, "
    "bounds, prior"
)


@pytest.mark.parametrize(
    ("text", "line", "parts"),
    [
        # Unknown keys, with the nearest known one.
        ("base: a\nframe: {}\n", 2, ["'frame'", "did you mean 'frames'", KEYS]),
        ("frames:\n  tol: {}\n", 2, ["'frames.tol'", "mean 'tool'", "base, tool"]),
        (
            "frames:\n  tool:\n    xzy: [0, 0, 0]\n",
            3,
            ["'frames.tool.xzy'", "mean 'xyz'", "xyz, rpy, estimate"],
        ),
        ("noise:\n  positon: 1\n", 2, ["noise.positon", "mean 'position'"]),
        (
            "planes:\n  w:\n    normal: [0, 0, 1]\n    offest: 1\n    offset: 1\n",
            4,
            ["planes.w.offest", "mean 'offset'"],
        ),
        ("joints:\n  a:\n    joint: b\n    signs: 1\n", 4, ["mean 'sign'"]),
        ("<<: {base: a}", 1, ["unknown key '<<'"]),
        # Missing keys.
        ("planes:\n  w: {normal: [0, 0, 1]}", 2, ["'planes.w.offset' is missing"]),
        ("joints:\n  J1: {sign: 1}", 2, ["'joints.J1.joint' is missing"]),
        ("joints:\n  J1: {joint: }", 2, ["'joints.J1.joint' is missing"]),
        ("payloads:\n  p: {com: [0, 0, 1]}", 2, ["'payloads.p.mass' is missing"]),
        # Wrong types.
        ("base: 12\n", 1, ["'base'", "'12'", "text"]),
        ("tip: no\n", 1, ["'tip'", "'no'", "in quotes"]),
        ("tip: ''\n", 1, ["'tip'", "text"]),
        ("tip: [a]\n", 1, ["'tip'", "'[a]'", "text"]),
        ("model: cam\n", 1, ["'cam'", "position, pose, plane-distance"]),
        ("model: pose+cam\n", 1, ["'pose+cam'", "several of them with a + between"]),
        ("model: pose+\n", 1, ["'pose+'", "several of them"]),
        ("model: ''\n", 1, ["'model'", "several of them"]),
        ("model: pose+camera+pose\n", 1, ["'pose+camera+pose'", "at most once"]),
        ("model: [pose]\n", 1, ["'[pose]'", "position, pose, plane-distance"]),
        ("frames: base\n", 1, ["'frames'", "'base'", "mapping"]),
        ("frames: [base]\n", 1, ["'frames'", "'[base]'", "mapping"]),
        ("planes:\n  wall:\n  floor: 1\n", 2, ["'planes.wall'", "mapping"]),
        ("joints: [1]\n", 1, ["'joints'", "'[1]'", "mapping"]),
        ("fixed: '*'\n", 1, ["'fixed'", "'*'", "list"]),
        ("fixed:\n  - a\n  - 2\n", 3, ["'fixed[1]'", "'2'", "text"]),
        ("parameters: dh\n", 1, ["'parameters'", "'dh'", "list"]),
        ("frames: {base: {estimate: 1}}", 1, ["base.estimate", "'1'", "true, false"]),
        # Wrong values.
        (
            "parameters:\n  - placement\n  - placment\n",
            3,
            ["'parameters[1]'", "'placment'", "placement, link-transform, dh, dh-full"],
        ),
        ("parameters: []\n", 1, ["'parameters'", "'[]'", "at least one"]),
        ("parameters: [dh, dh]\n", 1, ["'parameters'", "[dh, dh]", "at most once"]),
        ("parameters: [{a: b}]\n", 1, ["'parameters[0]'", "{a: b}"]),
        (
            "frames:\n  tool:\n    xyz: [1, 2]\n",
            3,
            ["'frames.tool.xyz'", "[1, 2]", "m"],
        ),
        ("frames: {tool: {xyz: [1, 2, a]}}", 1, ["[1, 2, a]", "three finite numbers"]),
        ("frames: {tool: {xyz: [1, 2, .inf]}}", 1, [".inf", "three finite numbers"]),
        ("frames: {tool: {xyz: [0, 0, 150]}}", 1, ["[0, 0, 150]", "numbers in m"]),
        ("frames: {tool: {rpy: [0, 0, 90]}}", 1, ["[0, 0, 90]", "numbers in rad"]),
        (
            "planes:\n  w:\n    offset: 0\n    normal: [0, 0.0, 0]\n",
            4,
            ["'planes.w.normal'", "[0, 0.0, 0]", "not all 0"],
        ),
        ("planes: {w: {normal: [0, 0, 1], offset: .nan}}", 1, ["w.offset", "finite"]),
        ("joints: {a: {joint: b, sign: 2}}", 1, ["joints.a.sign", "'2'", "1, -1"]),
        ("joints: {a: {joint: b, gear: 0}}", 1, ["joints.a.gear", "other than 0"]),
        ("joints: {a: {joint: b, offset: x}}", 1, ["joints.a.offset", "a number"]),
        ("joints: {a: {joint: b, coupled: {c: x}}}", 1, ["coupled.c", "a number"]),
        (
            "joints:\n  a:\n    joint: j\n  b:\n    joint: j\n",
            5,
            ["'joints.b.joint'", "'joints.a.joint'", "'j'", "same joint"],
        ),
        ("bounds: {a: 0}", 1, ["'bounds.a'", "'0'", "positive", "lower < upper"]),
        ("bounds: {a: [1, 1]}", 1, ["[1, 1]", "lower < upper"]),
        ("bounds: {a: [1, 2, 3]}", 1, ["[1, 2, 3]", "lower < upper"]),
        ("bounds: {a: [-.inf, 2]}", 1, ["lower < upper"]),
        ("bounds:\n  a:\n    - 2 # m\n    - 1\n", 2, ["'bounds.a'", "lower < upper"]),
        ("prior: {a: -1}", 1, ["'prior.a'", "'-1'", "a positive number"]),
        ("noise: {distance: 0}", 1, ["'noise.distance'", "'0'", "a positive number"]),
        ("noise: {distance: .nan}", 1, ["'.nan'", "a finite number"]),
        ("noise: {distance: '1e999'}", 1, ["'1e999'", "a finite number"]),
        ("noise: {contact: 0}", 1, ["'noise.contact'", "'0'", "a positive number"]),
        ("noise: {pixel: -1}", 1, ["'noise.pixel'", "'-1'", "a positive number"]),
        ("noise: {pixel: 2e3}", 1, ["'2e3'", "a standard deviation in px, at most"]),
        # What is measured against.
        ("targets: [a]", 1, ["'targets'", "'[a]'", "mapping of names to values"]),
        ("targets:\n  a: [0, 0, 1]\n", 2, ["'targets.a'", "mapping"]),
        ("targets:\n  a:\n    xzy: 1\n", 3, ["'targets.a.xzy'", "mean 'xyz'"]),
        ("targets: {a: {xyz: [0, 1]}}", 1, ["'targets.a.xyz'", "three finite numbers"]),
        ("targets: {a: {xyz: [0, 0, 101]}}", 1, ["'targets.a.xyz'", "numbers in m"]),
        ("sockets: {a: {estimate: 1}}", 1, ["sockets.a.estimate", "true, false"]),
        *(
            (
                f"tip: a\n{key}:\n  b: {{}}\n  c: {{estimate: false}}\n",
                4,
                [f"'{key}.c'", "{estimate: false}", "only together with xyz"],
            )
            for key in ("targets", "sockets", "spheres", "anchors")
        ),
        *(
            (
                f"{key}:\n  b: {{{rest}}}\n  {name}: {{{rest}}}\n",
                3,
                ["cannot have this name", "a name without @, which in the target"],
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
            3,
            ["'payloads.none' cannot have this name", "any name but none, which rows"],
        ),
        ("payloads: {'': {mass: 1, com: [0, 0, 0]}}", 1, ["cannot have this name"]),
        ("spheres: {a: {radius: 0}}", 1, ["spheres.a.radius", "a positive number"]),
        ("spheres: {a: {radius: -1}}", 1, ["spheres.a.radius", "a positive number"]),
        ("spheres: {a: {radius: 25.4e3}}", 1, ["'25.4e3'", "a length in m, at most"]),
        ("spheres: {a: {raduis: 1}}", 1, ["spheres.a.raduis", "mean 'radius'"]),
        (
            "spheres: {a: {estimate_radius: false}}",
            1,
            ["'spheres.a'", "estimate_radius: false only together with radius"],
        ),
        ("anchors: {a: {bias: x}}", 1, ["anchors.a.bias", "'x'", "a number"]),
        ("anchors: {a: {bias: -200}}", 1, ["anchors.a.bias", "at most 100 either"]),
        (
            "anchors: {a: {estimat_bias: true}}",
            1,
            ["mean 'estimate_bias'", "xyz, bias"],
        ),
        ("camera: world", 1, ["'camera'", "'world'", "mapping"]),
        ("tip: a\ncamera: {}", 2, ["'camera.mount' is missing"]),
        (
            "camera:\n  mount: hand\n  center: [1, 2]\n",
            1,
            ["'camera.focal' is missing"],
        ),
        ("camera: {mount: hand, focal: [1, 1]}", 1, ["'camera.center' is missing"]),
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
                line,
                [f"'camera.{wrong.split(':')[0]}'", *parts],
            )
            for wrong, line, parts in (
                ("mount: table", 2, ["'table'", "hand, world"]),
                ("mount: [hand]", 2, ["'[hand]'", "hand, world"]),
                ("focal: 900", 3, ["'900'", "[f_x, f_y], both positive and in px"]),
                ("focal: [900, 0]", 3, ["'[900, 0]'", "both positive"]),
                ("focal: [900, -1]", 3, ["'[900, -1]'", "both positive"]),
                ("focal: [900, 1e6]", 3, ["'[900, 1e6]'", "both positive"]),
                ("focal: [900, .nan]", 3, ["'[900, .nan]'", "both positive"]),
                ("center: [1, 2, 3]", 4, ["'[1, 2, 3]'", "[c_x, c_y] in px"]),
                ("center: [1, -1e6]", 4, ["'[1, -1e6]'", "[c_x, c_y] in px"]),
                ("size: [640, 0]", 5, ["'[640, 0]'", "[width, height]"]),
                ("distortion: 0.1", 5, ["'0.1'", "the first two or four of them"]),
                ("distortion: [1, 2, 3]", 5, ["'[1, 2, 3]'", "two or four of them"]),
                ("distortion: [1, 1e9]", 5, ["'[1, 1e9]'", "two or four of them"]),
                ("distortion: [1, x]", 5, ["'[1, x]'", "two or four of them"]),
                ("estimate: yes please", 5, ["'yes please'", "true, false"]),
                ("fokal: 1", 5, ["unknown key", "mean 'focal'", "mount, focal"]),
            )
        ),
        ("distances: {a: 1}", 1, ["'distances'", "a list"]),
        ("distances:\n  - 0.05\n", 2, ["'distances[0]'", "'0.05'", "mapping"]),
        ("distances: [{value: 1}]", 1, ["'distances[0].between' is missing"]),
        ("distances: [{between: [a, b]}]", 1, ["'distances[0].value' is missing"]),
        *(
            (
                f"distances:\n  - between: {between}\n    value: 1\n",
                2,
                [between, "two different names, such as", "in quotes"],
            )
            for between in ("a", "[a]", "[a, a]", "[a, b, c]", "[1, 2]", "[a, '']")
        ),
        (
            "distances:\n  - between: [a, b]\n    value: -0.05\n",
            3,
            ["'distances[0].value'", "'-0.05'", "a positive number"],
        ),
        ("distances: [{between: [a, b], value: 500}]", 1, ["'500'", "a length in m"]),
        (
            "distances: [{between: [a, b], value: 1, sigma: 0}]",
            1,
            ["'distances[0].sigma'", "'0'", "a positive number"],
        ),
        (
            "distances: [{between: [a, b], value: 1, sgma: 1}]",
            1,
            ["'distances[0].sgma'", "mean 'sigma'", "between, value, sigma"],
        ),
        (
            "distances:\n  - {between: [a, b], value: 1}\n"
            "  - {between: [a, c], value: 1}\n  - {between: [b, a], value: 1}\n",
            4,
            ["'distances[2]'", "'distances[0]'", "the same points", "['b', 'a']"],
        ),
        # Gravity, loads and gears.
        ("gravity: 9.81", 1, ["'gravity'", "'9.81'", "three finite numbers in m/s^2"]),
        ("gravity: [0, -9.81]", 1, ["'gravity'", "[0, -9.81]", "[0, 0, -9.81]"]),
        ("gravity: [0, 0, .nan]", 1, ["'gravity'", ".nan", "three finite numbers"]),
        ("gravity:\n  - 0\n  - 0\n  - -9810\n", 1, ["'gravity'", "in m/s^2"]),
        ("payloads: [20]", 1, ["'payloads'", "'[20]'", "mapping"]),
        ("payloads: {p: 20}", 1, ["'payloads.p'", "'20'", "mapping"]),
        (
            "payloads:\n  p:\n    mass: 1\n    com: [0, 0, 0]\n    cm: [0, 0, 0]\n",
            5,
            ["'payloads.p.cm'", "mean 'com'", "mass, com"],
        ),
        ("payloads: {p: {mass: 1}}", 1, ["'payloads.p.com' is missing"]),
        ("payloads: {p: {mass: 0}}", 1, ["payloads.p.mass", "'0'", "more than 0"]),
        ("payloads: {p: {mass: -2}}", 1, ["payloads.p.mass", "'-2'", "in kg"]),
        ("payloads: {p: {mass: 2 kg}}", 1, ["payloads.p.mass", "'2 kg'", "in kg"]),
        ("payloads: {p: {mass: 2.0e5}}", 1, ["'2.0e5'", "at most 100000"]),
        ("payloads: {p: {mass: 1, com: [0, 1]}}", 1, ["p.com", "[0, 1]", "in m"]),
        ("payloads: {p: {mass: 1, com: [0, 0, 150]}}", 1, ["p.com", "numbers in m"]),
        ("gear_ratios: 160", 1, ["'gear_ratios'", "'160'", "mapping"]),
        ("gear_ratios:\n  a: 1\n  b: 0\n", 3, ["gear_ratios.b", "other than 0"]),
        ("gear_ratios: {a: .inf}", 1, ["'gear_ratios.a'", "'.inf'", "finite"]),
        (
            "learned: netwrok",
            1,
            ["'learned'", "'netwrok'", "network, gaussian-process"],
        ),
        ("learned: [network]", 1, ["'learned'", "'[network]'"]),
        # Where the robot may measure.
        ("obstacles: {sphere: 1}\n", 1, ["'obstacles'", "a list"]),
        ("obstacles:\n  - 3\n", 2, ["'obstacles[0]'", "'3'", "mapping"]),
        (
            "obstacles:\n  - {sphere: 1}\n  - {xyz: [0, 0, 0]}\n",
            3,
            ["'obstacles[1]'", "exactly one of box, sphere, cylinder, mesh"],
        ),
        ("obstacles: [{box: [1, 1, 1], sphere: 1}]\n", 1, ["exactly one of box"]),
        ("obstacles: [{sphere: 1, scale: 2}]\n", 1, ["scale only together with"]),
        (
            "obstacles:\n  - sphere: 1\n    xzy: [0, 0, 0]\n",
            3,
            ["'obstacles[0].xzy'", "mean 'xyz'", "box, sphere, cylinder, mesh, scale"],
        ),
        ("obstacles: [{box: [1, 1]}]", 1, ["'obstacles[0].box'", "three positive"]),
        ("obstacles: [{box: [1, 1, -1]}]", 1, ["'[1, 1, -1]'", "three positive"]),
        ("obstacles: [{box: [1, 1, 900]}]", 1, ["'[1, 1, 900]'", "in m"]),
        ("obstacles: [{sphere: 0}]", 1, ["'obstacles[0].sphere'", "positive number"]),
        ("obstacles: [{sphere: 500}]", 1, ["'500'", "a length in m, at most 100"]),
        ("obstacles: [{cylinder: 1}]", 1, ["[radius, length]", "in m"]),
        ("obstacles: [{cylinder: [1, 0]}]", 1, ["'[1, 0]'", "[radius, length]"]),
        ("obstacles: [{mesh: 3}]", 1, ["'obstacles[0].mesh'", "'3'", "text"]),
        ("obstacles: [{mesh: a, scale: 0}]", 1, ["[0].scale'", "0.001 for a mesh"]),
        ("obstacles: [{mesh: a, scale: [1, 1]}]", 1, ["'[1, 1]'", "three of them"]),
        ("obstacles: [{sphere: 1, xyz: [0, 0]}]", 1, ["[0].xyz'", "three finite"]),
        ("obstacles: [{sphere: 1, rpy: [0, 0, 90]}]", 1, ["[0].rpy'", "in rad"]),
        ("region: 3\n", 1, ["'region'", "'3'", "mapping"]),
        ("region: {}\n", 1, ["'region'", "at least one of box, sphere, cone"]),
        ("region:\n  bx: 1\n", 2, ["'region.bx'", "mean 'box'", "box, sphere, cone"]),
        ("region: {box: [[0, 0, 0]]}", 1, ["'region.box'", "[lower, upper]"]),
        ("region: {box: [[0, 0, 0], [1, 1]]}", 1, ["region.box", "three numbers"]),
        ("region: {box: [[0, 0, 0], 1]}", 1, ["region.box", "[lower, upper]"]),
        ("region: {box: [[0, 0, 2], [1, 1, 1]]}", 1, ["region.box", "[lower, upper]"]),
        ("region: {sphere: 1}", 1, ["'region.sphere'", "mapping"]),
        ("region: {sphere: {radius: 1}}", 1, ["'region.sphere.center' is missing"]),
        (
            "region:\n  sphere:\n    raduis: 1\n    radius: 1\n    center: [0, 0, 0]\n",
            3,
            ["'region.sphere.raduis'", "mean 'radius'", "center, radius"],
        ),
        (
            "region: {sphere: {center: [0, 0, 0], radius: -1}}",
            1,
            ["'region.sphere.radius'", "'-1'", "a positive number"],
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
                3,
                parts,
            )
            for wrong, parts in (
                ("axis: [0, 0, 0]", ["'region.cone.axis'", "not all 0"]),
                ("angle: 30", ["'region.cone.angle'", "'30'", "in rad"]),
                ("angle: 0", ["'region.cone.angle'", "'0'", "above 0"]),
                ("range: 0", ["'region.cone.range'", "the farthest distance in m"]),
                ("range: [2, 1]", ["'[2, 1]'", "[nearest, farthest]"]),
                ("range: [-1, 1]", ["'[-1, 1]'", "[nearest, farthest]"]),
            )
        ),
        ("region: {cone: {apex: [0, 0, 0]}}", 1, ["'region.cone.axis' is missing"]),
        ("limits: [1, 2]", 1, ["'limits'", "'[1, 2]'", "mapping"]),
        ("limits: {j: 1}", 1, ["'limits.j'", "'1'", "[lower, upper]"]),
        ("limits: {j: [1, 1]}", 1, ["'[1, 1]'", "lower < upper"]),
        ("limits:\n  a: [0, 1]\n  j: [-90, 90]", 3, ["'limits.j'", "at most 12.57"]),
        ("ranger: {rang: 1}", 1, ["'ranger.rang'", "mean 'range'"]),
        ("ranger: {range: 500}", 1, ["'ranger.range'", "'500'", "in m"]),
        ("ranger: {range: [1, 2, 3]}", 1, ["'[1, 2, 3]'", "[nearest, farthest]"]),
        ("ranger: {incidence: 70}", 1, ["'70'", "in rad, above 0 and below 1.57"]),
        # What is YAML, but not for us.
        ("base: a\ntip: b\nbase: c\n", 3, ["the key 'base' occurs twice"]),
        ("frames:\n  base: {}\n  base: {}\n", 3, ["the key 'base' occurs twice"]),
        ("base: &x a\ntip: b\n", 1, ["anchor, '&x', is not allowed"]),
        ("base: &x a\ntip: *x\n", 1, ["anchor, '&x', is not allowed"]),
        ("base: a\ntip: *x\n", 2, ["alias, '*x'", "a glob needs quotes"]),
        ("base: a\ntip: !!str b\n", 2, ["tag", "is not allowed"]),
        ("prior: !!python/object:os.system {}\n", 1, ["tag", "is not allowed"]),
        ("[a, b]: c\n", 1, ["a key must be a name"]),
        ("- a\n", 1, ["must be a mapping"]),
        ("placement\n", 1, ["must be a mapping"]),
        # What is not YAML.
        ("base: a\ntip: [b\n", 3, ["not valid YAML"]),
        ("base: a\n\ttip: b\n", 2, ["not valid YAML"]),
        ("base: a: b\n", 1, ["not valid YAML"]),
        ("base: a\n---\nbase: b\n", 2, ["not valid YAML", "single document"]),
        ("fixed: [*.x]\n", 1, ['a glob needs quotes, as in "*.placement.z"']),
        ("prior:\n  *.x: 1\n", 2, ["a glob needs quotes"]),
        (b"base: a\ntip: \xff\n", 2, ["not UTF-8"]),
        (b"base: a\x00\n", None, ["not a text file"]),
        ("base: " + "[" * 3000, 1, ["so deep a nesting is not allowed"]),
    ],
)
def test_errors(message, text, line, parts):
    result = message(text)
    place = "setup.yaml:" if line is None else f"setup.yaml:{line}:"
    assert result.startswith(f"{place} ")
    for part in parts:
        assert part in result


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


def test_the_first_problem_of_several_is_reported(message):
    text = "noise: {position: 0}\nprior: {a: 0}\nbounds: {b: 0}\nbase: 1\nfoo: 1\n"
    assert message(text).startswith("setup.yaml:1: 'noise.position'")


def test_long_values_are_shortened(message):
    result = message("tip:\n" + "  - a very long item in a list\n" * 20)
    assert len(result) < 200
    assert "..." in result


def test_missing_file(tmp_path):
    with pytest.raises(InputError, match=re.escape("none.yaml: no such file")):
        read_setup(tmp_path / "none.yaml")


def test_the_path_is_named_as_given(tmp_path, monkeypatch):
    (tmp_path / "s.yaml").write_text("tip: 1")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=r"^s\.yaml:1: "):
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
