"""What tests of several folders make: robots of a text, problems, measurements."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from benchmarks.exact import exact_problem
from calib_pin.errors import InputError
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.nominal import named_targets, observable_configurations
from calib_pin.estimation.problem import Problem
from calib_pin.io.urdf import load_chain
from calib_pin.io.urdf_tree import parse_robot
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import BlockKey, Measurements, Observations, Targets
from calib_pin.parameterizations import frame_pose
from calib_pin.setup import (
    AnchorSetup,
    CameraSetup,
    DistanceSetup,
    DriftSetup,
    FrameSetup,
    Payload,
    PlaneSetup,
    PointSetup,
    Setup,
    SphereSetup,
    ToolSetup,
)
from calib_pin.simulation import draw_errors, simulate

FRAMED = Setup(
    base_frame=FrameSetup((0.1, -0.2, 0.05), (0.3, -0.2, 0.4), estimate=True),
    tool_frame=FrameSetup((0.02, 0.03, 0.1), (-0.1, 0.2, 0.3), estimate=True),
    planes={
        "floor": PlaneSetup((0.1, 0.2, 1.0), 1.5),
        "wall": PlaneSetup((1.0, 0.3, 0.2), -3.0),
    },
    gravity=(1.0, -2.0, -9.5),
    payloads={"load": Payload(2.0, (0.05, -0.1, 0.2))},
    gear_ratios={"*": -31.5},
    drift=DriftSetup({"base": (0.0, 3600.0)}, 1e-3, 1e-3),
)
"""Frames that are estimated, two planes, a payload, and motors behind gears.

Gravity does not run along any axis, what has no mass carries something, and the
instrument drifts for an hour.
"""


EQUIPPED = replace(
    FRAMED,
    targets={
        "probe": PointSetup((0.03, -0.02, 0.05), estimate=True),
        "nest": PointSetup((-0.04, 0.06, -0.01), estimate=True),
    },
    sockets={
        "left/0": PointSetup((0.6, 0.2, 0.3)),
        "left/1": PointSetup((0.3, 0.4, 0.5)),
    },
    spheres={"ball": SphereSetup((0.5, -0.3, 0.4), 0.15, estimate_radius=True)},
    anchors={"wire": AnchorSetup((1.4, 0.9, 0.2), 0.01, estimate_bias=True)},
    camera=CameraSetup(
        "world",
        (900.0, 910.0),
        (640.0, 500.0),
        (-0.02, 0.01, 1e-3, -2e-3, 1e-3),
        estimate=True,
    ),
    distances=(DistanceSetup(("left/0", "left/1"), 0.4, 1e-4),),
)
"""The same with everything that rows of any instrument can name."""


FAR = FrameSetup((0.1, -0.2, 3.0), (0.3, -0.2, 0.4), estimate=True)
"""Base in the frame of a camera that stands still and sees all of a robot."""


NEAR = ToolSetup((0.02, 0.05, -0.03), (0.1, 0.3, -0.2))
"""What a camera among other instruments looks at."""


@cache
def parsed(path: Path) -> ast.Module:
    """Syntax tree of a file; several tests look at those of the whole package."""
    return ast.parse(path.read_text())


@cache
def nodes_of(tree: ast.AST) -> list[ast.AST]:
    """All nodes of a syntax tree."""
    return [*ast.walk(tree)]


@contextmanager
def refused(
    kind: type[InputError], reason: str | Sequence[str] = (), **fields: Any
) -> Iterator[None]:
    """An error that a block must raise, by its fields: `with refused(kind, line=3):`.

    Fields that are not named may be anything. Of `reason` and `allowed` a part is
    enough, or several, so that wording may change; the others must be equal. Whole
    messages are tested in `test_errors.py`.
    """

    with pytest.raises(kind) as caught:
        yield
    assert "\n" not in str(caught.value)
    for name, expected in {"reason": reason, **fields}.items():
        found = getattr(caught.value, name)
        if name in ("reason", "allowed") and expected is not None:
            parts = (expected,) if isinstance(expected, str) else expected
            equal = all(part in found for part in parts)
        else:
            equal = found is expected or found == expected  # NaN is itself.
        assert equal, (name, found, expected)


TETRAHEDRON = """v 0 0 0\nv 0.2 0 0\nv 0 0.2 0\nv 0 0 0.2
f 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"""
"""An OBJ file: its edges are of 0.2 m, in the positive octant."""


def collada(corners: Sequence[Sequence[float]], faces: str) -> str:
    """A DAE file of triangles: `collada(corners, "0 1 2 0 2 3")`."""

    axes = "".join(f'<param name="{axis}" type="float"/>' for axis in "XYZ")
    points = " ".join(map(str, np.ravel(corners)))
    return (
        '<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" '
        'version="1.4.1"><asset><up_axis>Z_UP</up_axis></asset><library_geometries>'
        '<geometry id="g"><mesh><source id="s">'
        f'<float_array id="a" count="{np.size(corners)}">{points}</float_array>'
        f'<technique_common><accessor source="#a" count="{len(corners)}" stride="3">'
        f'{axes}</accessor></technique_common></source><vertices id="v"><input '
        'semantic="POSITION" source="#s"/></vertices>'
        f'<triangles count="{len(faces.split()) // 3}"><input semantic="VERTEX" '
        f'source="#v" offset="0"/><p>{faces}</p></triangles></mesh></geometry>'
        '</library_geometries><library_visual_scenes><visual_scene id="w"><node>'
        '<instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>'
        '<scene><instance_visual_scene url="#w"/></scene></COLLADA>'
    )


def joint(
    name: str,
    ends: str,
    place: pin.SE3 | str = "0 0 0",
    axis: str | Sequence[float] = "0 0 1",
    kind: str = "revolute",
    limits: str | Sequence[float] = "",
    **more: Any,
) -> dict[str, Any]:
    """A joint of `urdf_of` in words: `joint("j", "parent child", "0 0 0.4;0 1.5 0")`.

    The place is its xyz and, behind a semicolon, its rpy. Limits are +-2.9 rad, or 0
    and 0.5 m where it slides. What is given as numbers may be numbers.
    """

    def numbers(given: str | Sequence[float]) -> Sequence[Any]:
        return given.split() if isinstance(given, str) else given

    parent, child = ends.split()
    limits = limits or ("0 0.5" if kind == "prismatic" else "-2.9 2.9")
    given = {"placement": place, "axis": numbers(axis), "limits": numbers(limits)}
    return {"name": name, "parent": parent, "child": child, "type": kind} | given | more


def urdf_of(*joints: Mapping[str, Any], name: str = "test", inside: str = "") -> str:
    """Text of a URDF: `urdf_of({"name": "j", "parent": "a", "child": "b", ...}, ...)`.

    Further keys of a joint: `type` (revolute), `placement` (SE3, or xyz;rpy), `axis`
    (0 0 1), `limits` (lower, upper), `more` (XML inside the joint), `mass` (kg and
    center of the child), `inside` (XML inside the child). Joints to come later in the
    tree may come first. `inside` is XML of the first link.
    """

    links = dict.fromkeys(
        link for joint in joints for link in (joint["parent"], joint["child"])
    )
    links[joints[0]["parent"]] = inside
    for joint in joints:
        mass = _inertial(*joint["mass"]) if "mass" in joint else ""
        links[joint["child"]] = joint.get("inside", "") + mass
    lines = [f'<link name="{link}">{held or ""}</link>' for link, held in links.items()]
    for joint in joints:
        kind = joint.get("type", "revolute")
        axis = joint.get("axis", (0, 0, 1))
        lines += [
            f'<joint name="{joint["name"]}" type="{kind}">',
            _origin(joint.get("placement", "0 0 0")),
            f'  <parent link="{joint["parent"]}"/>',
            f'  <child link="{joint["child"]}"/>',
        ]
        if kind != "fixed":
            lines.append(f'  <axis xyz="{_numbers(axis)}"/>')
        if kind in ("revolute", "prismatic"):
            lower, upper = joint.get("limits", (-2.0, 2.0))
            bounds = f'lower="{lower}" upper="{upper}"'
            lines.append(f'  <limit {bounds} effort="1" velocity="1"/>')
        lines += [joint.get("more", ""), "</joint>"]
    return "\n".join([f'<robot name="{name}">', *lines, "</robot>"])


def chain_of(urdf: str, base: str | None = None, tip: str | None = None) -> Chain:
    """Chain of a URDF given as text: `chain_of(text, base, tip)`."""

    return Chain(parse_robot(urdf.encode(), "test.urdf"), base, tip)


def equipped_problem(
    chain: Chain, model: str | Sequence[BlockKey], **settings: Any
) -> Problem:
    """Problem with all that measurements name: `equipped_problem(chain, model, ...)`.

    Several blocks may stand for the model. A camera stands far enough away. Settings of
    the setup may follow by name.
    """

    frames = {"stations": {"camera": FAR}, "tools": {"camera": NEAR}}
    setup = replace(EQUIPPED, **frames | settings)
    if model == "camera":
        setup = replace(setup, base_frame=FAR)
    return nominal_problem(chain, model, setup)


def visited(
    problem: Problem,
    theta: Floats,
    count: int,
    rng: np.random.Generator,
    key: BlockKey | None = None,
) -> tuple[Floats, Targets]:
    """Configurations and targets of a block: `visited(problem, theta, count, rng)`.

    The instrument of the only block can measure there. Where it must touch something,
    or is one of several, whose key follows, they are random: away from contact there is
    a residual, as in any fit that begins.
    """

    key = key or problem.only.key
    contact = problem.terms[key].measurement.declaration.contact
    if not contact and len(problem.terms) == 1:
        at = observable_configurations(problem, key, theta, count, rng)
        return at.q, at.target
    names = named_targets(problem, key)
    q = problem.chains.random_configurations(count, rng)
    return q, tuple(names[k % len(names)] for k in range(count))


def measured(
    chain: Chain,
    model: str,
    parameterizations: Sequence[str],
    rows: int,
    seed: int = 0,
    **settings: Any,
) -> Problem:
    """Problem of a chain: `measured(chain, model, parameterizations, rows, seed)`.

    Base and tool are estimated. Rows stand away from what the nominal robot predicts,
    each with its own sigma; a ranger looks at two planes in turn, in an order that
    what it cannot see mixes. Further settings of the setup may follow by name.
    """

    rng = np.random.default_rng(seed)
    base, tool = EQUIPPED.base_frame, EQUIPPED.tool_frame
    # Each plane is hit at a right angle, 2 m in front, from one configuration.
    F = chain.poses(chain.random_configurations(2, rng))
    T = frame_pose(base).homogeneous @ F @ frame_pose(tool).homogeneous
    planes = {
        name: PlaneSetup(tuple(beam), -float(beam @ point) - 2.0)
        for name, beam, point in zip(
            ("floor", "wall"), T[:, :3, 2], T[:, :3, 3], strict=True
        )
    }
    setup = Setup(
        parameters=tuple(parameterizations),
        base_frame=FAR if model == "camera" else base,
        tool_frame=tool,
        planes=planes,
        **_instrument(model, T[:, :3, 3]),
        **settings,
    )
    problem = nominal_problem(chain, model, setup)
    zero = np.zeros(len(problem.parameters))
    q, target = visited(problem, zero, rows, rng)
    start = None
    measurement = problem.only.measurement
    if measurement.declaration.relative:
        start = chain.random_configurations(rows, rng)
    exact = exact_problem(problem, zero, q, target, start)
    noise = 0.05 * rng.normal(size=(rows, exact.only.components))
    data = replace(
        exact.data.only,
        values=measurement.disturb(exact.data.only.values, noise),
        sigma=rng.uniform(0.005, 0.02, noise.shape),
    )
    return replace(problem, data=Observations.of(data))


def simulated(
    model: str | Sequence[BlockKey],
    setup: Setup | None = None,
    count: int = 40,
    size: float = 0.0,
    seed: int = 0,
    *,
    robot: str | Chain | Chains = "space6",
    noise: float | None = 0.0,
    changes: Mapping[str, float] | None = None,
    again: int | None = None,
    **how: Any,
) -> tuple[Problem, Floats]:
    """Measurements of a robot: `simulated(model, setup, count, size, seed, ...)`.

    Returns the problem with the rows, and the true errors: those of the robot have so
    many times their expected size, and changes by name come on top. The robot, space6
    by default, is a name or a chain; without `noise` there is none. With a seed `again`
    it is the same robot at other configurations. Further arguments are those of
    `simulate`, where `q` takes the place of the count.
    """

    rng = np.random.default_rng(seed)
    chain = load_chain(robot) if isinstance(robot, str) else robot
    problem = nominal_problem(chain, model, setup or Setup())
    theta = size * draw_errors(problem.parameters, rng)
    for name, change in (changes or {}).items():
        theta[problem.parameters.index(name)] += change
    rng = rng if again is None else np.random.default_rng(again)
    how |= {} if "q" in how else {"count": count}
    rows = simulate(problem, theta, rng, noise=noise, **how)
    return replace(problem, data=rows), theta


def rows_of(model: str, values: Floats, *names: str) -> Measurements:
    """Values that no robot has, one row after another; named targets are in turn.

    They stand in m.csv, from line 2 on.
    """
    count = len(values)
    return Measurements(
        ("j",),
        np.zeros((count, 1)),
        model,
        values,
        target=tuple(names[k % len(names)] for k in range(count)) if names else (),
        lines=np.arange(2, count + 2),
        files=("m.csv",) * count,
    )


def _instrument(model: str, points: Floats) -> dict[str, Any]:
    """What a model needs besides planes, by two points that the tool reaches."""
    if model in ("position", "pose", "plane-distance"):
        return {}
    here, there = map(tuple, points)
    return {
        "targets": EQUIPPED.targets,
        "camera": EQUIPPED.camera,
        "sockets": {"left/0": PointSetup(here), "left/1": PointSetup(there)},
        "spheres": {
            "ball": SphereSetup(here, 0.15, estimate_radius=True),
            "dome": SphereSetup(there, 0.3),
        },
        "anchors": {
            "wire": AnchorSetup(tuple(points[0] + 1.0), 0.01, estimate_bias=True),
            "bar": AnchorSetup(tuple(points[1] - 1.0)),
        },
    }


def _origin(place: pin.SE3 | str) -> str:
    if isinstance(place, str):
        xyz, _, rpy = place.partition(";")
    else:
        xyz = _numbers(place.translation)
        rpy = _numbers(pin.rpy.matrixToRpy(place.rotation))
    return f'  <origin xyz="{xyz}" rpy="{rpy or "0 0 0"}"/>'


def _inertial(mass: float, center: Sequence[float]) -> str:
    inertia = 'ixx="1" ixy="0.1" ixz="0" iyy="2" iyz="0" izz="3"'
    return (
        f'<inertial><origin xyz="{_numbers(center)}"/><mass value="{mass}"/>'
        f"<inertia {inertia}/></inertial>"
    )


def _numbers(values: Any) -> str:
    return " ".join(repr(float(value)) for value in values)
