"""Setup files: every key of the schema, what it means, and one line about a mistake."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import calib_pin.setup as of
from calib_pin.cli.options import meanings
from calib_pin.errors import CalibPinError, InputError
from calib_pin.io import setup as setup_files
from calib_pin.io.json_text import encode
from calib_pin.io.setup import read_setup, setup_document, setup_of, yaml_text
from calib_pin.measurement_models import MEASUREMENT_MODELS, Quantity
from calib_pin.parameterizations import PARAMETERIZATIONS
from calib_pin.setup import LOSSES, SOLVERS, JointMap, PopulationPrior, Setup
from calib_pin.setup.population import JointType, ParameterPrior, RobotType
from calib_pin.solvers import DifferentialEvolution
from documentation.setup_reference import json_schema
from tests.shared import refused


@pytest.fixture
def write(write):
    return partial(write, name="setup.yaml")


@pytest.fixture
def bad(write):
    """A file that cannot be used: `bad(text, line=3, value="x")`, see `refused`."""

    def bad(text: str | bytes, words="", **fields) -> None:
        file = write(text)
        with refused(InputError, words, file=str(file), **fields):
            read_setup(file)

    return bad


# --- keys and their values ---------------------------------------------------------

KEYS = list(json_schema()["properties"])

TEXT = "text (in quotes if it looks like something else)"
WRONG = [
    # A file, its key, what is allowed there, and what is not.
    (
        *("gauge: %s", "gauge", "a positive number [m], at most 0.1"),
        "one|true|[1]|.nan|-.inf|1:30|0x10|1_000|''|0|-1|100.1|{a: b}",
    ),
    *(
        (f"{key}: {{{name}: %s}}", f"{key}.{name}", f"a positive number {most}", value)
        for key in ("noise", "limit")
        for name, most, value in (
            ("position", "[m], at most 0.02", "0.05|0.5"),
            ("distance", "[m], at most 0.02", "0.03"),
            ("orientation", "[rad], at most 0.05", "0.1"),
        )
    ),
    ("limit: {repeatability: %s}", "limit.repeatability", None, "0.05|1"),
    ("noise: {contact: %s}", "noise.contact", None, "0.03"),
    (
        *("distances: [{between: [a, b], value: 1, sigma: %s}]", "distances[0].sigma"),
        *("a positive number [m], at most 0.02", "0.05"),
    ),
    ("payloads: {a: {mass: 1, com: %s}}", "payloads.a.com", None, "[0, 0, 80]"),
    (
        *(
            "reading: {shift: %s}",
            "reading.shift",
            "a whole number, at least -1e6, at most 1e6",
        ),
        "one|true|2.5|.nan|1000001|[1]",
    ),
    (
        *("drift: {shift: %s}", "drift.shift"),
        *("a finite number [m], at least 0, at most 0.02", "-1e-9|'1 mm'|0.05"),
    ),
    (
        *("limits: {j: %s}", "limits.j"),
        "2 finite numbers [rad, m], at least -12.5664, at most 12.5664",
        "1|[1]|[1, 2, 3]|[1, a]|[-13, 1]|{a: b}|'12'",
    ),
    (
        *("drift: {spans: {a: %s}}", "drift.spans.a"),
        "2 finite numbers [s], each larger than the one before",
        "[2, 1]|[1, 1]",
    ),
    ("tip: %s", "tip", TEXT, "12|no|[a]|{a: b}|' '"),
    ("reading: {inverted: %s}", "reading.inverted", "true, false", "1|one|'true'|[]"),
    ("fixed: %s", "fixed", "a list in square brackets", "{a: b}"),
    ("fixed: [a, %s]", "fixed[1]", TEXT, "12|[a]|''"),
    ("loss: %s", "loss", ", ".join(LOSSES), "one|''"),
    ("loss: %s", "loss", TEXT, "1"),
    (
        *("model: %s", "model"),
        f"{', '.join(MEASUREMENT_MODELS)}, or several of them with a + between, "
        "each at most once",
        "one|pose+pose",
    ),
    ("camera: {mount: %s}", "camera.mount", "hand, world", "one|1|[hand]"),
    ("joints: {a: {joint: b, sign: %s}}", "joints.a.sign", "1, -1", "0|2|-3"),
    (
        *("region: {box: %s}", "region.box"),
        "2 values",
        "[[0, 0, 0]]|1",
    ),
    ("planes: %s", "planes", "a mapping of names to values", "12|[a]|true|one"),
    ("planes: {a: %s}", "planes.a", "a mapping of keys to values", "12|[a]|true"),
    ("frames: %s", "frames", "a mapping of names to values", "12|[a]|true"),
    ("report: {load: %s}", "report.load", None, f"{81 * 'a'}|1"),
    ("reading: {axes: %s}", "reading.axes", None, "[x, y]|[x, y, y]|x"),
    ("reading: {without: %s}", "reading.without", None, "[a]|0|1.5|[true]|a:b"),
    ("reading: {exchanged: %s}", "reading.exchanged", None, "[1, 2]|[[1]]|1"),
    ("solver: {mutation: %s}", "solver.mutation", None, "0|one|true|[1]|.inf"),
]


@pytest.mark.parametrize(("text", "key", "allowed", "values"), WRONG)
def test_values_that_a_key_refuses(bad, text, key, allowed, values):
    """By line, key, value, and what is allowed."""
    about = {} if allowed is None else {"allowed": allowed}
    for value in values.split("|"):
        bad(f"# \nbase: a\n{text % value}\n", f"'{key}'", line=3, **about)


def test_limits_themselves_are_allowed(write):
    text = "gauge: 0.1\nreading: {shift: -1e6}\ndrift: {shift: 0}\nlimits: {j: [1, 1]}"
    text += "\nnoise: {position: 0.02, pixel: 1000}\nlimit: {orientation: 0.05}"
    assert read_setup(write(text)).limits == {"j": (1.0, 1.0)}


UNKNOWN = [
    # A file, its unknown key, and some that are known instead.
    ("modle: pose", "modle", "model"),
    ("frames: {bas: {}}", "frames.bas", "base, tool"),
    ("stations: {a: {xzy: 1}}", "stations.a.xzy", "xyz, rpy, estimate"),
    ("distances: [{betwen: [a, b]}]", "distances[0].betwen", "between, value, sigma"),
    ("solver: {mutatoin: 1}", "solver.mutatoin", "name, strategy"),
    ("noise: {positoin: 1}", "noise.positoin", "position, orientation"),
    ("file: a", "file", "base, tip"),
    ("base_frame: {}", "base_frame", "frames"),
]


@pytest.mark.parametrize(("text", "key", "allowed"), UNKNOWN)
def test_unknown_keys_are_told_their_neighbors(bad, text, key, allowed):
    bad(f"tip: a\n{text}", f"unknown key '{key}'", line=2, allowed=allowed)


def test_missing_keys(bad):
    for text in ("{offset: 1}", "{offset: 1, normal: }"):
        bad(f"tip: a\nplanes:\n  wall: {text}", "'planes.wall.normal'", line=3)


FULL = """\
base: base_link
tip: "tool0"
chains: {left: {tip: left_hand}, touch: {base: left_hand, tip: right_finger}}
model: position+fixed-point
frames:
  base: {estimate: true}
  tool: {xyz: [0, 0, 0.1], rpy: [0, -1.5, 1e-5], estimate: false}
tools: {probe: {estimate: true}, stylus: {on: probe}, cap: {on: stylus}}
planes:
  floor:
    normal:
      - 0
      - 0
      - 1
    offset: -0.69
spheres: {knob: {radius: 0.01}}
anchors: {spring: {}}
distances:
  - {between: [front/0, front/1], value: 0.05, sigma: 1.0e-5}
  - between: [ball, "12"]
    value: 0.2
joints:
  J3: {joint: joint_3, sign: -1, gear: 0.01, offset: 1.57, coupled: {J2: 1.0}}
  4: {joint: joint_4}
payloads: {p1: {mass: 20, com: [0, 0, 0.15]}}
gear_ratios: {"joint_*": 160, rail: -1.2e3}
fixed: ["*.placement.z", base.frame.x]
bounds: {"*.placement.x": 0.01, "*.dh.*": [-0.1, 0.2]}
noise: {position: 1e-4, orientation: .5e-3, distance: "2.0e-4"}
solver: {name: hybrid, population_size: 60, mutation: "0.7", maxiter: 5e2, atol: 1e-9}
obstacles:
  - {sphere: 0.2, xyz: [1, 0, 0.5]}
  - {mesh: /fixtures/table.stl, scale: 0.001}
  - {mesh: /fixtures/wall.dae, scale: [1, 2, 1]}
  - {mesh: /fixtures/door.obj}
region: {box: [[0.2, -0.5, 0.1], [1, 0.5, 1.2]], sphere: {center: [0, 0, 1], radius: 2}}
limits: {"joint_*": [-2, 2], rail: [0.1, 1.5]}
ranger: {range: 3, incidence: 1.2}
report: {serial_number: KR 7, temperature: "20.5", date: 2026-11-23}
parameters: [dh, thermal]
learned: network
stations: {day1: {xyz: [1, 2, 3], estimate: false}}
sockets: {front/0: {}, front/1: {xyz: [1, 2, 3]}}
board: {type: charuco, columns: 7, rows: 5, square: 0.03, marker: 0.02}
columns: {x: "X [mm]"}
encoder_steps: {J*: 4096}
reading: {without: [12, "a.csv:3"], exchanged: [[1, 2]], axes: [-y, x, z], drift: [0.1]}
gravity: [0, 0, 9.81]
prior: {"*.placement.*": 0.002}
loss: gnc
limit: {position: 5e-4}
thermal: {reference: 20, switched_on: [0]}
drift: {spans: {base: [0, 60]}, shift: 0}
gauge: 0.01
monte_carlo: {robot: pa10, configurations: [9, 12], errors: {"*": 1e-3}}
camera: {mount: world, focal: [9, 9], center: [0, 0], distortion: [0.1, 0.2, 3, -4]}
"""


def test_what_keys_mean(write):
    """Where a file says it otherwise than the setup, in other types, or by defaults."""
    setup = read_setup(write(FULL))
    found = json.loads(json.dumps(setup_document(setup)))
    assert found.keys() == set(KEYS) - {"targets"}
    assert (
        setup_of(found)
        == setup
        == read_setup(found)
        == read_setup(write(yaml_text(found)))
    )
    assert setup.reading.without == ("12", "a.csv:3")
    assert setup.reading.drift == (0.1, 0.0, 0.0)
    assert setup.base_frame == of.FrameSetup(estimate=True)
    assert setup.tool_frame == of.FrameSetup((0.0, 0.0, 0.1), (0.0, -1.5, 1e-5), False)
    assert setup.tools["cap"] == of.ToolSetup(on="stylus")
    assert setup.planes == {"floor": of.PlaneSetup((0.0, 0.0, 1.0), -0.69, True)}
    assert setup.spheres == {"knob": of.SphereSetup(None, 0.01, True, None)}
    assert setup.anchors == {"spring": of.AnchorSetup(None, 0.0, True, False)}
    assert setup.distances == (
        of.DistanceSetup(("front/0", "front/1"), 0.05, 1e-5),
        of.DistanceSetup(("ball", "12"), 0.2, 1e-4),
    )
    assert setup.joints == {
        "J3": JointMap("joint_3", -1, 0.01, 1.57, {"J2": 1.0}),
        "4": JointMap("joint_4"),
    }
    assert setup.bounds == {"*.placement.x": 0.01, "*.dh.*": (-0.1, 0.2)}
    assert setup.noise == {"position": 1e-4, "orientation": 5e-4, "distance": 2e-4}
    options = {"population_size": 60, "mutation": 0.7, "maxiter": 500, "atol": 1e-9}
    assert setup.solver == of.SolverSetup("hybrid", options)
    assert isinstance(setup.solver.evolution["maxiter"], int)
    scales = [obstacle.scale for obstacle in setup.obstacles]
    assert scales == [None, (0.001,) * 3, (1.0, 2.0, 1.0), None]
    assert setup.camera.distortion == (0.1, 0.2, 3.0, -4.0, 0.0)
    assert setup.ranger == of.RangerSetup((0.0, 3.0), 1.2)
    assert setup.report == of.ReportSetup("KR 7", temperature=20.5, date="2026-11-23")


# --- the documents that are made from the schema ---------------------------------


def test_the_names_that_there_are_stand_in_the_schema(bad) -> None:
    keys, solver = json_schema()["properties"], json_schema()["$defs"]["SolverSetup"]
    assert keys["model"]["anyOf"][0]["enum"] == list(MEASUREMENT_MODELS)
    assert keys["parameters"]["items"]["enum"] == list(PARAMETERIZATIONS)
    assert solver["properties"]["name"]["enum"] == list(SOLVERS)
    options = [option.name for option in fields(DifferentialEvolution)]
    assert list(solver["properties"]) == ["name", *options]
    bad("solver: {mutatoin: 1}", "'mutation'", allowed=", ".join(["name", *options]))


def test_the_noise_of_a_quantity_of_another_package(monkeypatch, bad) -> None:
    angle = SimpleNamespace(quantities=[Quantity("angle", "rad", slice(0, 2), 1e-5)])
    models = {**MEASUREMENT_MODELS, "theodolite": SimpleNamespace(declaration=angle)}
    monkeypatch.setattr(setup_files, "MEASUREMENT_MODELS", models)
    assert read_setup({"noise": {"angle": 1e-5}}).noise == {"angle": 1e-5}
    bad("noise: {x: 1}", "'noise.x'", line=1, allowed="pixel, angle")


def test_every_key_has_a_meaning() -> None:
    def described(part: Any, path: str) -> None:
        for key, value in part.get("properties", {}).items():
            if not path.endswith(".noise"):  # Its keys are the quantities.
                assert value.get("description"), f"{path}.{key}"
            described(value, f"{path}.{key}")
        for key in ("items", "additionalProperties"):
            if isinstance(part.get(key), dict):
                described(part[key], f"{path}.{key}")

    described(json_schema(), "")
    for name, part in json_schema()["$defs"].items():
        described(part, name)


def test_the_keys_of_a_setup_and_of_its_file() -> None:
    ours = {field.name for field in fields(Setup)} - {"file"}
    assert ours ^ set(KEYS) == {"base_frame", "tool_frame", "frames"}
    assert set(meanings(Setup)) == ours | {"file"}


# --- what is written reads back ----------------------------------------------------


@settings(max_examples=40, derandomize=True, suppress_health_check=list(HealthCheck))
@given(
    places=st.lists(st.integers(0, len(FULL.encode())), min_size=1, max_size=3),
    damage=st.lists(st.integers(0, 255), max_size=3).map(bytes),
    width=st.integers(0, 3),
)
def test_damage_ends_in_a_line_or_in_a_setup(tmp_path, places, damage, width):
    data = FULL.encode()
    for at in places:
        data = data[:at] + damage + data[at + width :]
    (tmp_path / "setup.yaml").write_bytes(data)
    try:
        read_setup(tmp_path / "setup.yaml")
    except CalibPinError as error:
        assert "\n" not in str(error)
        assert error.file == str(tmp_path / "setup.yaml")


def test_what_nobody_stated_is_not_stored():
    assert setup_document(Setup()).keys() == {"parameters"}
    spring = Setup(anchors={"a": of.AnchorSetup()}, targets={"b": of.PointSetup()})
    assert setup_document(spring)["targets"] == {"b": {}}
    assert "xyz" not in setup_document(spring)["anchors"]["a"]


def test_keys_of_a_later_version_are_passed_over():
    setup = Setup(tip="a", planes={"p": of.PlaneSetup((0.0, 0.0, 1.0), 0.0)})
    document = setup_document(setup)
    document["later"] = 1
    document["planes"]["p"]["later"] = {"any": "thing"}
    assert setup_of(document) == setup


# --- what a file may look like -----------------------------------------------------


def test_meshes_are_found_beside_the_setup_file(write, monkeypatch):
    file = write("obstacles: [{mesh: fixtures/a.stl}, {sphere: 1}, {mesh: /b.stl}]")
    expected = [str(file.parent / "fixtures" / "a.stl"), None, "/b.stl"]
    assert [obstacle.mesh for obstacle in read_setup(file).obstacles] == expected
    monkeypatch.chdir(file.parent)
    assert [o.mesh for o in read_setup(file.name).obstacles] == expected


@pytest.mark.parametrize(
    "text",
    [
        *("", "# nothing\n", "---\n", "\n\n", "~\n", "{}"),
        "base:\nframes:\n  tool:\nplanes:\nnoise: {position: }\nparameters:\n",
    ],
)
def test_what_states_nothing_is_the_default(write, text):
    assert replace(read_setup(write(text)), file=Setup().file) == Setup()


def test_byte_order_mark_and_windows_line_ends(write):
    setup = read_setup(write(b"\xef\xbb\xbfbase: a\r\ntip: b\r\n"))
    assert (setup.base, setup.tip) == ("a", "b")


def test_names_that_yaml_would_take_for_something_else(write):
    text = "tip: 2020-01-01\nplanes: {on: {normal: [0, 0, 1], offset: 1}}\n"
    setup = read_setup(write(text + "joints: {010: {joint: 'no'}}"))
    assert setup.tip == "2020-01-01"
    assert list(setup.planes) == ["on"]
    assert setup.joints == {"010": JointMap("no")}


@pytest.mark.parametrize("written", ["1e-5", "1E5", "+.5", "3", "010", "5.", "'1e-3'"])
def test_numbers(write, written):
    value = float(written.strip("'"))
    assert read_setup(write(f"prior: {{a: {written}}}")).prior == {"a": value}


# --- what contradicts itself or is no such YAML ------------------------------------

NAMED = ("planes", "targets", "sockets", "spheres", "anchors")
BARE = {key: "{}" for key in (*NAMED, "stations", "tools")} | {
    "planes": "{normal: [0, 0, 1], offset: 1}",
    "payloads": "{mass: 1, com: [0, 0, 0]}",
    "chains": "{tip: a}",
}
APART = "distances:\n  - {between: [a, b], value: 1}\n"
CIRCLES = "board: {type: circles, columns: 3, rows: 3, square: 0.03}\n"

# A file, the line of the error, and the key or name that it is about.
MISTAKES: list[Any] = [
    # Names that cannot be.
    *(
        (f"{key}:\n  b: {BARE[key]}\n  {name}: {BARE[key]}\n", 3, f"'{key}.")
        for key in NAMED
        for name in ("a@b", "''")
    ),
    *((f"{key}: {{' ': {BARE[key]}}}\n", 1, f"'{key}. '") for key in BARE),
    ("payloads:\n  none: {mass: 1, com: [0, 0, 0]}\n", 2, "'payloads.none'"),
    ("chains:\n  world: {tip: a}\n", 2, "'chains.world'"),
    # Known names, each at most once.
    ("model: pose+\n", 1, "'model'"),
    ("parameters: [dh, dh]\n", 1, "'parameters[1]'"),
    ("parameters: []\n", 1, "'parameters'"),
    ("parameters:\n  - placement\n  - placment\n", 3, "'parameters[1]'"),
    # Keys that need or exclude each other.
    *(
        (f"tip: a\n{key}:\n  b: {{}}\n  c: {{estimate: false}}\n", 4, f"'{key}.c'")
        for key in NAMED[1:]
    ),
    ("spheres: {a: {estimate_radius: false}}", 1, "'spheres.a'"),
    ("tools:\n  a: {}\n  b: {on: a, estimate: true}\n", 3, "'tools.b'"),
    ("chains:\n  left: {base: a, tip: a}\n", 2, "'chains.left'"),
    (f"targets: {{a: {{}}}}\n{CIRCLES}", 2, "'targets'"),
    (CIRCLES.replace("}", ", gap: 0.01}"), 1, "'board'"),
    (CIRCLES.replace("rows: 3", "rows: 1"), 1, "'board'"),
    ("obstacles:\n  - {sphere: 1}\n  - {xyz: [0, 0, 0]}\n", 3, "'obstacles[1]'"),
    ("obstacles: [{sphere: 1, scale: 2}]\n", 1, "'obstacles[0]'"),
    ("region: {}\n", 1, "'region'"),
    # References that lead nowhere, or to themselves.
    ("tools:\n  probe: {}\n  tip:\n    on: prob\n", 4, "'probe'"),
    ("tools:\n  d: {on: a}\n  a: {on: b}\n  b: {on: a}\n", 2, "'tools.d.on'"),
    ("joints:\n  a:\n    joint: j\n  b:\n    joint: j\n", 5, "'joints.a.joint'"),
    (f"{APART}  - {{between: [b, a], value: 1}}\n", 3, "distances[0]"),
    # Numbers together, or where the schema says less.
    ("planes:\n  w:\n    offset: 0\n    normal: [0, 0, 0]\n", 4, "normal'"),
    ("bounds: {a: [1, 1]}", 1, "'bounds.a'"),
    ("bounds:\n  a:\n    - 2 # m\n    - 1\n", 2, "'bounds.a'"),
    ("limits:\n  a: [0, 1]\n  j: [-90, 90]", 3, "'limits.j'"),
    ("joints: {a: {joint: b, gear: 0}}", 1, "'joints.a.gear'"),
    ("distances:\n  - between: [a, a]\n    value: 1\n", 2, "[0].between"),
    ("region: {box: [[0, 0, 0], [1, 1, 0]]}", 1, "'region.box'"),
    ("ranger: {range: [2, 1]}", 1, "'ranger.range'"),
    ("solver: {population_size: 3}", 1, "'solver.population_size'"),
    ('report: {customer: "7\\x1b[2J"}', 1, "'report.customer'"),
    ("report: {date: 2026-02-30}", 1, "'report.date'"),
    # Of several mistakes the first.
    ("noise: {position: 0}\nprior: {a: 0}\nbase: 1\nfoo: 1\n", 1, "noise.position"),
    # YAML, but not for us.
    ("base: a\ntip: b\nbase: c\n", 3, "'base'"),
    ("frames:\n  base: {}\n  base: {}\n", 3, "'base'"),
    ("<<: {base: a}", 1, "'<<'"),
    ("base: &x a\ntip: *x\n", 1, "(&x)"),
    ("base: a\ntip: *x\n", 2, '"*.placement.z"'),
    ("base: a\ntip: !!str b\n", 2),
    ("[a, b]: c\n", 1),
    ("- a\n", 1),
    ('tip: tool\n"\\uDCFF": 1\n', 2),
    ("base: " + "[" * 3000, None),
    # No YAML.
    ("base: a\ntip: [b\n", 3),
    ("base: a\n\ttip: b\n", 2),
    ("base: a\n---\nbase: b\n", 2),
    ("fixed: [*.x]\n", 1, '"*.placement.z"'),
    (b"base: a\ntip: \xff\n", 2),
    (b"base: a\x00\n", None),
]


@pytest.mark.parametrize("case", MISTAKES)
def test_mistakes(bad, case):
    text, line, *words = case
    bad(text, words, line=line)


def test_the_path_is_named_as_given(tmp_path, monkeypatch):
    with refused(InputError, file=str(tmp_path / "s.yaml"), line=None):
        read_setup(tmp_path / "s.yaml")  # It is not there.
    (tmp_path / "s.yaml").write_text("tip: 1")
    monkeypatch.chdir(tmp_path)
    with refused(InputError, file="s.yaml", line=1):
        read_setup("s.yaml")
    (tmp_path / "s.yaml").write_text("tip:\n" + "  - a very long item in a list\n" * 20)
    with pytest.raises(InputError) as caught:
        read_setup("s.yaml")
    assert len(caught.value.value) < 80 and "..." in caught.value.value


# --- priors of fleets, files of their own ------------------------------------------

PRIOR = PopulationPrior(
    RobotType("arm", (JointType("a", (0.0, 0.0, 1.0), ()),)),
    (
        ParameterPrior("a.placement.x", "m", 1e-3, 1e-4, 3e-4, 11.5),
        ParameterPrior("a.placement.rz", "rad", -1 / 3e3, 1e-4, 1e-4, 0.1),
    ),
    ((1e-7, 2e-8), (2e-8, 4e-8)),
    {"position": 1.1e-4},
    robots=12,
)


def test_a_prior_comes_back(tmp_path, monkeypatch) -> None:
    """Its path counts from the setup file; a setup in a result needs no other file."""
    file = tmp_path / "fleet.json"
    file.write_bytes(encode(setup_files.prior_document(PRIOR)))
    document = json.loads(file.read_text())
    assert document["format"] == "calib-pin/fleet-prior" and document["version"] == 1
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "setup.yaml").write_text("prior: ../fleet.json\n")
    monkeypatch.chdir(tmp_path / "sub")
    found = read_setup("setup.yaml").prior
    assert isinstance(found, PopulationPrior) and replace(found, file="") == PRIOR
    stored = json.loads(json.dumps(setup_document(Setup(prior=PRIOR, tip="x"))))
    assert setup_of(stored) == Setup(prior=PRIOR, tip="x")


DAMAGED: list[dict[str, Any]] = [
    {"version": 2},
    {"covariance": [[1.0]]},
    {"covariance": [[1e-7, 2e-8], [3e-8, 4e-8]]},
    {"covariance": [[1e-7, 1e-7], [1e-7, 4e-8]]},
    {"covariance": [[1e-7, None], [None, 1.0]]},
    {"covariance": ["a", "b"]},
    {"robots": "many"},
    {"parameters": [setup_files.prior_document(PRIOR)["parameters"][0]] * 2},
    {"noise": {"position": -1.0}},
    {"robot": []},
]


def test_files_that_are_no_priors(tmp_path, bad) -> None:
    file, whole = tmp_path / "fleet.json", setup_files.prior_document(PRIOR)
    lacking = {k: v for k, v in whole.items() if k != "covariance"}
    wrong = [{"format": "calib-pin/plan"}, lacking, *(whole | one for one in DAMAGED)]
    for text in ("{", *map(json.dumps, wrong)):
        file.write_text(text)
        with refused(InputError, file=str(file)):
            read_setup({"prior": str(file)})
    for text, line in (("base: b\nprior: 3", 2), ("prior: ''", 1), ("prior: [a]", 1)):
        bad(text, line=line)
    with refused(InputError):
        read_setup({"prior": "none.json"})
