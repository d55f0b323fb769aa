"""Setup files: every key of the schema, what it means, and one line about a mistake."""

from __future__ import annotations

import json
import math
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from calib_pin.cli.options import meanings
from calib_pin.errors import CalibPinError, InputError
from calib_pin.estimation.solve import SOLVERS
from calib_pin.io import setup as setup_files
from calib_pin.io.setup import read_setup, setup_document, setup_of, yaml_text
from calib_pin.measurement_models import MEASUREMENT_MODELS, Quantity
from calib_pin.parameterizations import PARAMETERIZATIONS
from calib_pin.setup import (
    AnchorSetup,
    DistanceSetup,
    FrameSetup,
    JointMap,
    PlaneSetup,
    PointSetup,
    RangerSetup,
    ReportSetup,
    Setup,
    SolverSetup,
    SphereSetup,
    ToolSetup,
)
from calib_pin.solvers import DifferentialEvolution
from documentation.setup_reference import json_schema, resolved

Keys = tuple[str | int, ...]
Schema = dict[str, Any]


@pytest.fixture
def write(tmp_path):
    def write(text: str | bytes) -> Path:
        file = tmp_path / "setup.yaml"
        file.write_bytes(text.encode() if isinstance(text, str) else text)
        return file

    return write


@pytest.fixture
def bad(write, refused):
    """A file that cannot be used: `bad(text, line=3, value="x")`, see `refused`."""

    def bad(text: str | bytes, words="", **fields) -> None:
        file = write(text)
        with refused(InputError, words, file=str(file), **fields):
            read_setup(file)

    return bad


# --- the schema, walked ------------------------------------------------------------


schema = cache(json_schema)


def plain(part: Schema) -> Schema:
    """A part of the schema without references; of alternatives the first."""
    part = resolved(schema(), part)
    return {**part, **part["anyOf"][0]} if "anyOf" in part else part


def parts(part: Schema, path: Keys = ()) -> Iterator[tuple[Keys, Schema]]:
    """Every key of a setup file by its path, and the whole under the empty path."""
    part = plain(part)
    yield path, part
    for key, value in part.get("properties", {}).items():
        yield from parts(value, (*path, key))
    if part.get("additionalProperties"):
        yield from parts(part["additionalProperties"], (*path, "name"))
    if "$ref" in part.get("items", {}):
        yield from parts(part["items"], (*path, 0))


def example(part: Schema, number: int = 1) -> Any:
    """A value that the schema allows and no default, another one for each number."""
    part = plain(part)
    if "enum" in part:
        return part["enum"][-number % len(part["enum"])]
    if part["type"] == "object":
        if part.get("additionalProperties"):
            return {"name": example(part["additionalProperties"])}
        required = part.get("required", ())
        return {key: example(part["properties"][key]) for key in required}
    if part["type"] == "array":
        count = part.get("maxItems", 1)
        return [example(part["items"], k) for k in range(number, number + count)]
    if part["type"] in ("number", "integer"):
        return number + (part.get("default") == number)
    if part["type"] == "string":
        return "2026-11-23" if part.get("format") == "date" else chr(96 + number)
    return not part.get("default", False)


def document(path: Keys, text: str, **beside: Any) -> str:
    """A file with this text at a path, in its last line, and what is required there.

    In the place of what the schema requires beside the key may stand something else.
    """
    lines, part = ["# a setup file", ""], schema()
    for depth, step in enumerate(path):
        part = plain(part)
        needed = {
            key: example(part["properties"][key]) for key in part.get("required", ())
        }
        if depth == len(path) - 1:
            needed |= beside
        needed.pop(step, None)
        lines += [f"{'  ' * depth}{k}: {json.dumps(v)}" for k, v in needed.items()]
        lines.append("  " * depth + ("-" if step == 0 else f"{step}:"))
        below = part["items"] if step == 0 else part.get("properties", {}).get(step)
        part = below or part.get("additionalProperties") or {}
    return "\n".join(lines) + f" {text}\n"


def wrong(part: Schema) -> Iterator[tuple[str, float | None]]:
    """What a key must refuse: of a wrong type, and beyond a limit, which follows."""
    kind = "enum" if "enum" in part else part["type"]
    # A single number may stand for a list of them, also for one of one.
    alone = "[1]" if "anyOf" in part else ""
    yield from ((text, None) for text in WRONG[kind] if text != alone)
    if part.get("minLength"):
        yield "''", None
    if "maxLength" in part:
        yield "a" * (part["maxLength"] + 1), part["maxLength"]
    for key, out in OUTSIDE.items():
        if key in part:
            yield repr(out(part[key])), part[key]
    if part.get("type") != "array":
        return
    *most, last = example(part)
    if "maxItems" in part:
        yield json.dumps([*most, last, last]), None
        yield json.dumps(most[: part.get("minItems", 0) - 1]), None
    for text, _ in wrong(plain(part["items"])):
        yield f"[{', '.join([*map(json.dumps, most), text])}]", None


WRONG = {
    "enum": ["one", "[a]", "{a: b}", "''"],
    "number": ["one", "true", "[1]", ".nan", "-.inf", "1:30", "0x10", "1_000", "''"],
    "integer": ["one", "true", "[1]", ".nan", "2.5"],
    "string": ["12", "no", "[a]", "{a: b}"],
    "boolean": ["1", "one", "'true'"],
    "array": ["{a: b}", "true"],
    "object": ["12", "[a]", "true"],
}
"""What is no value of a type."""

OUTSIDE: dict[str, Callable[[float], float]] = {
    "minimum": lambda limit: limit - 1e-3 * max(abs(limit), 1e-9),
    "maximum": lambda limit: limit + 1e-3 * abs(limit),
    "exclusiveMinimum": lambda limit: limit,
    "exclusiveMaximum": lambda limit: limit,
}
"""The nearest numbers that limits of the schema exclude."""

INSIDE: dict[str, Callable[[float], float]] = {
    "minimum": lambda limit: limit,
    "maximum": lambda limit: limit,
    "exclusiveMinimum": lambda limit: limit + 1e-9,
    "exclusiveMaximum": lambda limit: limit - 1e-9,
}
"""The nearest numbers that they allow."""


def dotted(path: Keys) -> str:
    return re.sub(r"\.0(?=\.|$)", "[0]", ".".join(map(str, path)))


KEYS = list(schema()["properties"])


def said(limit: float, allowed: str) -> bool:
    """Whether what is allowed states a limit, however it is rounded."""
    numbers = map(float, re.findall(r"\d+\.?\d*(?:e-?\d+)?", allowed))
    return any(math.isclose(abs(limit), n, rel_tol=1e-3) for n in numbers)


@pytest.mark.parametrize("key", KEYS)
def test_every_key_refuses_what_it_cannot_be(write, key):
    """By line, key, value and limits; and takes what is just within the limits."""
    for path, part in parts(schema()):
        if path[:1] != (key,):
            continue
        name = dotted(path)
        for text, limit in wrong(part):
            file = write(written := document(path, text))
            with pytest.raises(InputError) as caught:
                read_setup(file)
            error, about = caught.value, (name, text, str(caught.value))
            assert (error.file, error.line) == (str(file), written.count("\n")), about
            assert re.search(rf"'{re.escape(name)}['\[]", error.reason), about
            if part.get("type") == "array":  # Its wrong entry may be named.
                assert error.value in text, about
            else:
                assert error.value == text.strip("'"), about
            if limit:
                assert said(limit, error.allowed), about
        for limit, inside in INSIDE.items():
            if limit in part and "anyOf" not in part:
                file = write(document(path, repr(inside(part[limit]))))
                try:
                    read_setup(file)
                except InputError as error:  # Another key must then stand beside it.
                    assert f"'{name}'" not in error.reason, (name, limit)


def sections() -> Iterator[tuple[Keys, Schema]]:
    return ((path, part) for path, part in parts(schema()) if "properties" in part)


def test_unknown_keys_are_told_their_neighbors(bad):
    # Of the sections that are alike one.
    alike = {tuple(part["properties"]): path for path, part in sections()}
    for known, path in alike.items():
        key = max(known, key=len)
        text = document((*path, key + "_"), "1")
        words = [f"'{dotted((*path, key + '_'))}'", f"'{key}'"]
        bad(text, words, line=text.count("\n"), allowed=", ".join(known))


def test_missing_keys(bad):
    for path, part in sections():
        for key in part.get("required", ()):
            rest = {k: v for k, v in example(part).items() if k != key}
            for text in (json.dumps(rest), json.dumps({**rest, key: None})):
                text = document(path, text)
                bad(text, f"'{dotted((*path, key))}'", line=text.count("\n"))


BOARD = {"columns": 2, "rows": 2, "square": 9}
BESIDE = {
    "chains.name.base": {"tip": "b"},
    "spheres.name.estimate": {"xyz": [1, 2, 3]},
    "anchors.name.estimate": {"xyz": [1, 2, 3]},
    "board.marker": {"type": "charuco", **BOARD},
    "board.legacy": {"type": "charuco", **BOARD},
    "board.gap": {"type": "apriltag", **BOARD},
    "reading.orientation.hold": {"columns": "roll-pitch-yaw"},
    "reading.converted[0].lines": {"each": True},
    "obstacles[0].scale": {"mesh": "/a"},
    "obstacles[0].xyz": {"sphere": 1},
    "obstacles[0].rpy": {"sphere": 1},
}
"""What a key needs beside it."""

STORED = {
    "reading.drift": [1, 0, 0],
    "reading.exchanged": [["1", "2"]],
    "reading.converted[0].lines": ["1"],
    **{f"reading.{key}": ["1"] for key in ("moved", "remounted", "without")},
    "region.cone.range": [0, 1],
    "ranger.range": [0, 1],
    "obstacles[0].scale": [1, 1, 1],
}
"""What a document states where it is not what a file does."""

ELSEWHERE = {
    "tools.name.on",
    "solver.population_size",
    "obstacles[0].mesh",
    "reading.axes",
}
"""Keys whose values depend on more than the schema says."""


@pytest.mark.parametrize("key", KEYS)
def test_every_key_is_read_and_stored(write, key):
    """What a file says stands in the document of its setup, under the same key."""
    for path, part in parts(schema()):
        name = dotted(path)
        if path[:1] != (key,) or part.get("type") == "object":
            continue
        if name in ELSEWHERE or "$ref" in part.get("items", {}):
            continue
        value = example(part)
        setup = read_setup(
            write(document(path, json.dumps(value), **BESIDE.get(name, {})))
        )
        found = json.loads(json.dumps(setup_document(setup)))
        if key != "reading":  # It is applied to the rows and never stored.
            assert setup_of(found) == setup
            assert read_setup(write(yaml_text(found))) == setup
        for step in path:
            found = found[step]
        assert found == STORED.get(name, value), name


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
camera: {mount: world, focal: [9, 9], center: [0, 0], distortion: [0.1, 0.2, 3, -4]}
"""


def test_what_keys_mean(write):
    """Where a file says it otherwise than the setup, in other types, or by defaults."""
    setup = read_setup(write(FULL))
    assert setup.base_frame == FrameSetup(estimate=True)
    assert setup.tool_frame == FrameSetup((0.0, 0.0, 0.1), (0.0, -1.5, 1e-5), False)
    assert setup.tools["cap"] == ToolSetup(on="stylus")
    assert setup.planes == {"floor": PlaneSetup((0.0, 0.0, 1.0), -0.69, True)}
    assert setup.spheres == {"knob": SphereSetup(None, 0.01, True, None)}
    assert setup.anchors == {"spring": AnchorSetup(None, 0.0, True, False)}
    assert setup.distances == (
        DistanceSetup(("front/0", "front/1"), 0.05, 1e-5),
        DistanceSetup(("ball", "12"), 0.2, 1e-4),
    )
    assert setup.joints == {
        "J3": JointMap("joint_3", -1, 0.01, 1.57, {"J2": 1.0}),
        "4": JointMap("joint_4"),
    }
    assert setup.bounds == {"*.placement.x": 0.01, "*.dh.*": (-0.1, 0.2)}
    assert setup.noise == {"position": 1e-4, "orientation": 5e-4, "distance": 2e-4}
    options = {"population_size": 60, "mutation": 0.7, "maxiter": 500, "atol": 1e-9}
    assert setup.solver == SolverSetup("hybrid", options)
    assert isinstance(setup.solver.evolution["maxiter"], int)
    scales = [obstacle.scale for obstacle in setup.obstacles]
    assert scales == [None, (0.001,) * 3, (1.0, 2.0, 1.0), None]
    assert setup.camera.distortion == (0.1, 0.2, 3.0, -4.0, 0.0)
    assert setup.ranger == RangerSetup((0.0, 3.0), 1.2)
    assert setup.report == ReportSetup("KR 7", temperature=20.5, date="2026-11-23")


# --- the documents that are made from the schema ---------------------------------


def test_the_names_that_there_are_stand_in_the_schema(bad) -> None:
    keys, solver = schema()["properties"], schema()["$defs"]["SolverSetup"]
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

    described(schema(), "")
    for name, part in schema()["$defs"].items():
        described(part, name)


def test_the_keys_of_a_setup_and_of_its_file() -> None:
    ours = {field.name for field in fields(Setup)} - {"file"}
    assert ours ^ set(KEYS) == {"base_frame", "tool_frame", "frames"}
    assert set(meanings(Setup)) == ours | {"file"}


# --- what is written reads back ----------------------------------------------------


@settings(max_examples=80, derandomize=True, suppress_health_check=list(HealthCheck))
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
    spring = Setup(anchors={"a": AnchorSetup()}, targets={"b": PointSetup()})
    assert setup_document(spring)["targets"] == {"b": {}}
    assert "xyz" not in setup_document(spring)["anchors"]["a"]


def test_keys_of_a_later_version_are_passed_over():
    setup = Setup(tip="a", planes={"p": PlaneSetup((0.0, 0.0, 1.0), 0.0)})
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


@pytest.mark.parametrize("name", MEASUREMENT_MODELS)
def test_models(write, name):
    other = "pose" if name != "pose" else "position"
    for model in (name, f"{other}+{name}"):
        assert read_setup(write(f"model: {model}")).model == model


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
MISTAKES = [
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
    ("model: pose+cam\n", 1, "'model'"),
    ("model: pose+\n", 1, "'model'"),
    ("model: pose+camera+pose\n", 1, "'model'"),
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
    ("obstacles: [{box: [1, 1, 1], sphere: 1}]\n", 1, "'obstacles[0]'"),
    ("obstacles: [{sphere: 1, scale: 2}]\n", 1, "'obstacles[0]'"),
    ("region: {}\n", 1, "'region'"),
    # What refers to something else.
    ("tools:\n  probe: {}\n  tip:\n    on: prob\n", 4, "'probe'"),
    ("tools: {a: {on: a}}", 1, "'tools.a.on'"),
    ("tools:\n  d: {on: a}\n  a: {on: b}\n  b: {on: a}\n", 4, "'tools.b.on'"),
    ("joints:\n  a:\n    joint: j\n  b:\n    joint: j\n", 5, "'joints.a.joint'"),
    (f"{APART}  - {{between: [b, a], value: 1}}\n", 3, "distances[0]"),
    # Numbers together, or where the schema says less.
    ("planes:\n  w:\n    offset: 0\n    normal: [0, 0, 0]\n", 4, "normal'"),
    ("bounds: {a: [1, 1]}", 1, "'bounds.a'"),
    ("bounds:\n  a:\n    - 2 # m\n    - 1\n", 2, "'bounds.a'"),
    ("limits: {j: [2, 1]}", 1, "'limits.j'"),
    ("limits:\n  a: [0, 1]\n  j: [-90, 90]", 3, "'limits.j'"),
    ("frames: {tool: {rpy: [0, 0, 90]}}", 1, "'frames.tool.rpy'"),
    ("joints: {a: {joint: b, gear: 0}}", 1, "'joints.a.gear'"),
    *(
        (f"distances:\n  - between: {pair}\n    value: 1\n", 2, "[0].between")
        for pair in ("a", "[a, a]", "[1, 2]", "[a, '']")
    ),
    ("region: {box: [[0, 0, 2], [1, 1, 1]]}", 1, "'region.box'"),
    ("region: {box: [[0, 0, 0], [1, 1, 0]]}", 1, "'region.box'"),
    ("ranger: {range: [2, 1]}", 1, "'ranger.range'"),
    ("ranger: {range: 0}", 1, "'ranger.range'"),
    ("solver: {mutation: 0}", 1, "'solver.mutation'"),
    ("solver: {population_size: 3}", 1, "'solver.population_size'"),
    ('report: {customer: "7\\x1b[2J"}', 1, "'report.customer'"),
    ("report: {date: 2026-02-30}", 1, "'report.date'"),
    # Of several mistakes the first.
    ("noise: {position: 0}\nprior: {a: 0}\nbase: 1\nfoo: 1\n", 1, "noise.position"),
    # What is YAML, but not for us.
    ("base: a\ntip: b\nbase: c\n", 3, "'base'"),
    ("frames:\n  base: {}\n  base: {}\n", 3, "'base'"),
    ("<<: {base: a}", 1, "'<<'"),
    ("base: &x a\ntip: *x\n", 1, "(&x)"),
    ("base: a\ntip: *x\n", 2, '"*.placement.z"'),
    ("base: a\ntip: !!str b\n", 2),
    ("[a, b]: c\n", 1),
    ("- a\n", 1),
    ("placement\n", 1),
    ('tip: tool\n"\\uDCFF": 1\n', 2),
    ('tip: tool\nfixed: ["\\uD800"]\n', 2),
    ("base: " + "[" * 3000, None),
    # What is not YAML.
    ("base: a\ntip: [b\n", 3),
    ("base: a\n\ttip: b\n", 2),
    ("base: a: b\n", 1),
    ("base: a\n---\nbase: b\n", 2),
    ("fixed: [*.x]\n", 1, '"*.placement.z"'),
    (b"base: a\ntip: \xff\n", 2),
    (b"base: a\x00\n", None),
]


@pytest.mark.parametrize("case", MISTAKES)
def test_mistakes(bad, case):
    text, line, *words = case
    bad(text, words, line=line)


def test_long_values_are_shortened(write):
    with pytest.raises(InputError) as caught:
        read_setup(write("tip:\n" + "  - a very long item in a list\n" * 20))
    assert len(caught.value.value) < 80
    assert "..." in caught.value.value


def test_the_path_is_named_as_given(tmp_path, monkeypatch, refused):
    with refused(InputError, file=str(tmp_path / "s.yaml"), line=None):
        read_setup(tmp_path / "s.yaml")  # It is not there.
    (tmp_path / "s.yaml").write_text("tip: 1")
    monkeypatch.chdir(tmp_path)
    with refused(InputError, file="s.yaml", line=1):
        read_setup("s.yaml")


@pytest.mark.parametrize("module", ["calib_pin.io.setup", "calib_pin.setup"])
def test_importing_does_not_load_what_reads_files(module):
    slow = "{'yaml', 'pydantic', 'scipy'}"
    code = f"import sys, {module}; sys.exit(not {slow}.isdisjoint(sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
