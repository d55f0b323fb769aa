"""Every mishap is named with its code, and nothing clean is accused.

Each spoils the file of a job that is good without it, so grossly that chance plays no
part; the lines that its finding states make the job good again. How often subtle ones
are found, and clean jobs accused, is what `scripts/benchmark findings` counts.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib_pin
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.io.setup import read_setup
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Conditions, Measurements
from calib_pin.setup import DistanceSetup, FrameSetup, PointSetup, Setup
from calib_pin.simulation import draw_errors, simulate

ARM = calib_pin.load_chain("space6", tip="link_3")
_, J2, J3 = ARM.joints
TURN, DEGREE = 2.0 * np.pi, np.pi / 180.0
BASE = FrameSetup((1.5, -0.4, 0.3), (0.3, 0.2, 2.0), estimate=True)
TOOL = FrameSetup((0.05, 0.08, 0.12), (0.2, -0.3, 0.1), estimate=True)
HELD = Setup(parameters=("joint-offset",), tool_frame=replace(TOOL, estimate=False))
KNOWN = replace(HELD, base_frame=replace(BASE, estimate=False))
TARGETS = {n: PointSetup((0.1 * k, 0.05, 0.2)) for k, n in enumerate("abc")}
NOISE, COUNT = 1e-4, 42
GEARS = {f"{name}.transmission.gain": 2e-3 for name in ARM.joints} | {
    f"{name}.transmission.cos2": 3e-4 for name in (J2, J3)
}

Spoil = Callable[[Measurements], Measurements]


def measured(
    model: str = "position",
    count: int = COUNT,
    shape: Callable[[Floats], Floats] | None = None,
    names: str = "",
    changes: Mapping[str, float] | None = None,
    effects: tuple[str, ...] = (),
) -> Measurements:
    """Measurements of a robot with errors, at configurations of some shape.

    Its effects beside the geometry are the changes alone.
    """
    setup = Setup(
        parameters=("placement", *effects),
        base_frame=BASE,
        tool_frame=FrameSetup() if names else TOOL,
        targets={name: TARGETS[name] for name in names},
        gear_ratios={J2: 80.0},
    )
    problem, rng = nominal_problem(ARM, model, setup), np.random.default_rng(0)
    known = problem.parameters.names
    theta = draw_errors(problem.parameters, rng)
    theta[[any(f".{effect}." in name for effect in effects) for name in known]] = 0.0
    for name, change in (changes or {}).items():
        theta[known.index(name)] += change
    q = ARM.random_configurations(count, rng)
    q = q if shape is None else shape(q)
    target = tuple((names * count)[: len(q)])
    rows = simulate(problem, theta, rng, q=q, target=target, noise=NOISE).only
    # As from a file, which states neither noise nor sides.
    return replace(
        rows, sigma=None, conditions=replace(rows.conditions, source="order")
    )


@dataclass(frozen=True)
class Mishap:
    """What went wrong, and what must be said of it.

    Attributes:
        code: Code of the finding.
        spoil: Makes spoiled measurements of good ones.
        lines: Lines of a setup file that it states; None if they are not compared.
        setup: Setup of the calibration.
        job: Arguments of `measured`.
        severity: Severity of the finding.
        cured: Whether the job is calibrated again with the lines.
    """

    code: str
    spoil: Spoil = lambda rows: rows
    lines: Mapping[str, Any] | None = None
    setup: Setup = field(default_factory=Setup)
    job: Mapping[str, Any] = field(default_factory=dict)
    severity: str = "error"
    cured: bool = True


warned = partial(Mishap, severity="warning")
POSES = {"model": "pose"}


def reading(**lines: Any) -> Mapping[str, Any]:
    return {"reading": lines}


def read_as(name: str, **how: Any) -> Mapping[str, Any]:
    """The lines of a joint whose column is read otherwise."""
    return {"joints": {name: {"joint": name, **how}}}


def positions(change: Callable[[Floats], Floats]) -> Spoil:
    return lambda rows: replace(rows, q=change(rows.q))


def values(change: Callable[[Floats], Floats]) -> Spoil:
    return lambda rows: replace(rows, values=change(rows.values))


def joint(k: int, change: Callable[[Floats], Floats]) -> Spoil:
    """One joint that is read otherwise."""
    return positions(lambda q: np.where(np.arange(3) == k, change(q), q))


def axes(order: tuple[int, ...], signs: tuple[float, ...] = (1.0, 1.0, 1.0)) -> Spoil:
    """Columns x, y and z that hold other axes, or these negated."""
    return values(lambda v: np.hstack([v[:, order] * signs, v[:, 3:]]))


def wxyz(v: Floats) -> Floats:
    return v[:, [0, 1, 2, 6, 3, 4, 5]]


def inverted(v: Floats) -> Floats:
    turned = Rotation.from_quat(v[:, 3:]).inv()
    return np.hstack([-turned.apply(v[:, :3]), turned.as_quat()])


def computed(rows: Measurements) -> Measurements:
    """Six digits of what the controller takes the tool point for."""
    return replace(rows, values=ARM.poses(rows.q)[:, :3, 3].round(6))


def lagging(q: Floats) -> Floats:
    """Joint 2 is read with a part of its last motion still before it."""
    read = q.copy()
    for k in range(1, len(q)):
        read[k, 1] = (q[k, 1] - 0.01 * read[k - 1, 1]) / 0.99
    return read


def stuck(q: Floats) -> Floats:
    """The reading of joint 2 stands still for a while."""
    read = q.copy()
    read[20:30, 1] = q[20, 1]
    return read


def of_another(rows: Measurements) -> Measurements:
    """The last quarter is of a robot with other errors."""
    sizes = {f"{J2}.placement.{axis}": 8e-3 for axis in "xyz"}
    turns = {f"{J3}.placement.r{axis}": 1e-2 for axis in "xyz"}
    other = measured(changes=sizes | turns)
    behind = np.arange(len(rows))[:, None] >= 3 * len(rows) // 4
    return replace(rows, values=np.where(behind, other.values, rows.values))


def rounded(rows: Measurements) -> Measurements:
    """The same to a tenth of a millimeter."""
    return replace(rows, values=ARM.poses(rows.q)[:, :3, 3].round(4))


def by_steps(degrees: float) -> Spoil:
    """What the controller computes of joints that it shows in steps."""
    step = np.radians(degrees)
    return lambda rows: replace(computed(rows), q=(rows.q / step).round() * step)


def repeated(*again: int) -> Spoil:
    """Some measurements again, each with noise of its own."""

    def spoil(rows: Measurements) -> Measurements:
        rows = rows.rows(np.array([*range(COUNT), *again]))
        noise = NOISE * np.random.default_rng(1).normal(size=rows.values.shape)
        return replace(rows, values=rows.values + noise)

    return spoil


def stated(times: float) -> Spoil:
    """Noise of which the file states so many times as much."""
    return lambda rows: replace(rows, sigma=np.full(rows.values.shape, times * NOISE))


def path(q: Floats) -> Floats:
    """A smooth motion of all joints."""
    t, k = np.linspace(0.0, TURN, 80)[:, None], np.arange(3.0)
    return sum(0.5 * np.sin(n * t + n * k + k**2) for n in (1, 2, 3))


def ruler(length: float) -> Setup:
    return Setup(distances=(DistanceSetup(("a", "b"), length, 1e-3),))


MISHAPS = [
    Mishap("joint-reversed", joint(2, lambda q: -q), read_as(J3, sign=-1), KNOWN),
    warned(
        "joint-offset",
        joint(1, lambda q: q - 30.0 * DEGREE),
        read_as(J2, offset=pytest.approx(30.0 * DEGREE)),
    ),
    Mishap(
        "joints-exchanged",
        positions(lambda q: q[:, [0, 2, 1]]),
        {"joints": {J2: {"joint": J3}, J3: {"joint": J2}}},
        KNOWN,
    ),
    Mishap(
        "joint-gear",
        joint(2, lambda q: q / 1.03),
        read_as(J3, gear=pytest.approx(1.03, abs=1e-3)),
    ),
    Mishap(
        "gear-ripple",
        lines={"parameters": ["placement", "motor-ripple"], "gear_ratios": {J2: 80.0}},
        job={
            "count": 120,
            "effects": ("transmission",),
            "changes": {f"{J2}.transmission.motor_sin": 4e-4},
        },
        severity="info",
    ),
    warned(
        "model-lacks",
        lines={"parameters": ["placement"]},
        setup=Setup(parameters=("joint-offset",)),
    ),
    warned(
        "model-lacks",
        lines={"parameters": ["placement", "transmission"]},
        job={"count": 60, "effects": ("transmission",), "changes": GEARS},
    ),
    Mishap("stuck-encoder", positions(stuck)),
    Mishap("outlying-stretch", of_another),
    Mishap(
        "joint-turns",
        joint(2, lambda q: q + TURN),
        read_as(J3, offset=pytest.approx(-TURN)),
        severity="info",
    ),
    Mishap("lag", positions(lagging), reading(lag={J2: pytest.approx(0.01, abs=5e-4)})),
    Mishap(
        "lines-shifted",
        positions(lambda q: np.roll(q, -3, axis=0)),
        reading(shift=-3),
        KNOWN,
    ),
    Mishap(
        "lines-shifted",
        positions(lambda q: np.delete(q, 24, axis=0)[[*range(len(q) - 1), -1]]),
        reading(shift=-1, shift_from=[26]),
        job={"count": 60},
    ),
    Mishap(
        "lines-reversed", positions(lambda q: q[::-1]), reading(reversed=True), KNOWN
    ),
    Mishap("axes-exchanged", axes((1, 2, 0)), reading(axes=["y", "z", "x"]), KNOWN),
    Mishap(
        "axes-negated",
        axes((0, 1, 2), (-1.0, -1.0, 1.0)),
        reading(axes=["-x", "-y", "z"]),
        KNOWN,
        POSES,
    ),
    Mishap("left-handed-frame", axes((1, 0, 2)), setup=HELD),
    Mishap(
        "orientation-convention",
        values(wxyz),
        reading(orientation={"columns": "quaternion", "hold": "wxyz"}),
        KNOWN,
        POSES,
    ),
    Mishap("pose-inverted", values(inverted), reading(inverted=True), KNOWN, POSES),
    Mishap("unit", values(lambda v: v / 0.3048), reading(scale=0.3048), KNOWN),
    Mishap("scale", values(lambda v: 1.05 * v)),
    Mishap(
        "constant-orientation",
        values(lambda v: np.hstack([v[:, :3], np.eye(4)[[3] * len(v)]])),
        job=POSES,
    ),
    Mishap("constant-positions", values(lambda v: v[[0] * len(v)])),
    Mishap("constant-positions", values(lambda v: v * [1.0, 0.0, 0.0])),
    Mishap("constant-positions", values(lambda v: v[:, [0, 0, 2]])),
    Mishap("computed-values", computed),
    Mishap("computed-values", rounded),
    Mishap("computed-values", by_steps(0.001)),
    warned("computed-values", by_steps(0.02)),
    warned("coarse-steps", values(lambda v: np.round(v, 3))),
    Mishap("known-distance", setup=ruler(0.11), job={"names": "ab"}),
    warned("noise", stated(5.0)),
    warned(
        "copied-measurements",
        lambda rows: rows.rows(np.array([*range(COUNT), 3, 3])),
        reading(without=[COUNT + 2, COUNT + 3]),
    ),
    warned("few-configurations", job={"shape": lambda q: np.repeat(q[:6], 20, axis=0)}),
    warned("one-configuration", repeated(*[0] * 100)),
    warned(
        "backlash",
        lines={"parameters": ["placement", "hysteresis"]},
        job={
            "count": 60,
            "effects": ("hysteresis",),
            "changes": {f"{J2}.hysteresis.backlash": 5e-4},
        },
        cured=False,
    ),
    warned("unmoved-joints", job={"shape": lambda q: q * [1, 1, 0]}),
    warned("small-range", job={"shape": lambda q: q * [1, 1, 0.02]}),
    warned("one-path", job={"shape": path}),
    warned(
        "joints-move-together",
        job={"shape": lambda q: np.outer(q[:, 0], [1.0, -0.7, 0.5])},
    ),
    warned("large-correction", job={"changes": {f"{J3}.placement.rx": 0.05}}),
]


LIKE = {"axes-negated", "joints-exchanged", "left-handed-frame", "lines-reversed"}
LIKE |= {"pose-inverted", "unit"}
"""Mishaps of the slow tier: another member of their family is in the quick one."""


@pytest.mark.parametrize(
    "mishap",
    [
        pytest.param(one, marks=[pytest.mark.slow] if one.code in LIKE else [])
        for one in MISHAPS
    ],
    ids=lambda mishap: mishap.code,
)
def test_a_mishap_is_named_and_its_lines_undo_it(
    mishap: Mishap, tmp_path: Path
) -> None:
    rows = mishap.spoil(measured(**mishap.job))
    rows = replace(
        rows, lines=np.arange(len(rows)) + 2, files=("rows.csv",) * len(rows)
    )
    result = calib_pin.calibrate(ARM, rows, mishap.setup, validate=False)
    finding = {f.code: f for f in result.findings}[mishap.code]
    assert finding.severity == mishap.severity
    errors = [f.code for f in result.findings if f.severity == "error"]
    assert errors == [mishap.code] * (mishap.severity == "error")
    assert result.verdict == "untrusted" or not errors
    if mishap.lines is not None:
        assert finding.setup == mishap.lines
    if mishap.cured and finding.setup:
        again = cured(mishap, rows, finding.setup, tmp_path)
        assert again.verdict == "good"
        assert [f.code for f in again.findings if f.severity != "info"] == []
        assert mishap.code not in {f.code for f in again.findings}
        assert again.errors[0].after.rms < 3.0 * NOISE


@pytest.mark.parametrize(
    "spoil", [values(lambda v: v / 1000.0), joint(2, lambda q: -q)], ids=["mm", "sign"]
)
def test_errors_of_the_nominal_robot_are_told_as_the_result_shows_them(spoil) -> None:
    """The best four fifths of them, as sizes of a position in the unit of the file."""
    rows = measured()
    right, wrong = (
        calib_pin.calibrate(ARM, read, validate=False) for read in (rows, spoil(rows))
    )
    (told,) = (f.evidence for f in wrong.findings if f.severity == "error")
    for said, result in (("rms_before", wrong), ("rms_after", right)):
        assert 0.6 < told[said] / result.errors[0].before.rms < 1.0


def test_a_file_that_was_copied_into_itself_shows_no_further_family() -> None:
    """Copies are no further values that one could have explained."""
    rows = measured(count=8).rows(np.tile(np.arange(8), 3))
    found = calib_pin.calibrate(ARM, rows, validate=False).findings
    expected = ["copied-measurements", "few-configurations"]
    assert [finding.code for finding in found] == expected


def cured(
    mishap: Mishap, rows: Measurements, lines: Mapping[str, Any], folder: Path
) -> calib_pin.CalibrationResult:
    """The calibration of a file with these lines in the setup."""
    file, stated = folder / "rows.csv", folder / "setup.yaml"
    calib_pin.write_measurements(file, replace(rows, conditions=Conditions()))
    stated.write_text(json.dumps(lines), encoding="utf-8")
    read = read_setup(stated)
    setup = replace(mishap.setup, parameters=("placement",))
    for key in {"parameters", "gear_ratios", "noise"} & set(lines):
        setup = replace(setup, **{key: getattr(read, key)})
    data = calib_pin.read_measurements(
        file, ARM, model=rows.model, joints=read.joints, reading=read.reading
    )
    return calib_pin.calibrate(ARM, data, setup, validate=False)


CLEAN = [
    Mishap("positions"),
    Mishap("poses", job=POSES),
    Mishap(
        "in the order of a path",
        lambda rows: rows.rows(np.argsort(rows.q[:, 0])),
        job={"count": 60},
    ),
    Mishap("another axis up", axes((1, 2, 0))),
    Mishap("a tenth of the noise in digits", values(lambda v: np.round(v, 5))),
    Mishap("sigma nearly right", stated(1.4)),
    Mishap("repetitions", repeated(*range(20))),
    Mishap("a right distance", setup=ruler(0.1), job={"names": "ab"}),
]
"""Of which nothing must be said."""


@pytest.mark.parametrize("clean", CLEAN, ids=lambda clean: clean.code)
def test_a_clean_job_is_not_accused(clean: Mishap) -> None:
    rows = clean.spoil(measured(**clean.job))
    result = calib_pin.calibrate(ARM, rows, clean.setup, validate=False)
    assert (result.verdict, result.findings) == ("good", ())


ELSEWHERE = {
    "test_explanations": "joint-coupled joint-degrees",
    "test_readings": "joint-columns target targets-exchanged target-frames robot "
    "tip-link base-link tool-frame base-frame camera-mount camera-intrinsics "
    "image-axes held-number",
    "test_facts": "gauge-sign hidden-joints",
    "test_course": "instrument-moved tool-remounted joint-rehomed instrument-drift "
    "robot-drift",
    "test_plausibility": "outliers measurements-exchanged unit-of-some "
    "implausible-correction unlike-fleet",
    "test_joint_motions": "approach-by-order",
    "test_robot_state": "old-calibration-holds old-calibration-no-longer-holds",
    "test_held_out": "repeated-validation moved-instrument",
    "test_evaluation": "frames-moved",
    "test_fit": "modeled-warm-up modeled-drift",
    "test_compare": "different-robots",
}
"""Codes with tests of their own, by the module that has them."""


def test_every_code_is_documented_and_tested() -> None:
    root = Path(__file__).parents[3]
    page = (root / "docs" / "reference" / "findings.md").read_text("utf-8")
    documented = re.findall(r"^\| `([a-z-]+)` \|", page, re.MULTILINE)
    assert len(set(documented)) == len(documented)
    elsewhere = {c: module for module, cs in ELSEWHERE.items() for c in cs.split()}
    assert set(documented) == {m.code for m in MISHAPS} | set(elsewhere)
    files = [*(root / "calib_pin").rglob("*.py")]
    source = "".join(path.read_text("utf-8") for path in files)
    here = "".join(p.read_text("utf-8") for p in files if p.parent.name == "findings")
    code = r'\(\s*"([a-z]+(?:-[a-z]+)*)"'
    stated = {*re.findall(rf"\b(?:Finding|Alternative|Other){code}", source)}
    stated |= {*re.findall(rf"\b(?:finding|_too_similar|_joint){code}", here)}
    stated |= {*re.findall(r':\s*\("([a-z]+(?:-[a-z]+)+)",', here)}  # In tables.
    assert len(stated) > 20 and stated <= set(documented)
    assert all(f'"{code}"' in source for code in documented)
    for code, name in elsewhere.items():
        found = (root / "tests").rglob(f"{name}.py")
        assert any(f'"{code}"' in p.read_text("utf-8") for p in found), code


def test_an_encoder_is_stuck_and_others_are_wrong() -> None:
    rows = measured(count=60)
    q, values = rows.q.copy(), rows.values.copy()
    q[40:55, 1] = q[40, 1]
    values[[3, 17, 30]] += 0.03
    rows = replace(rows, q=q, values=values)
    result = calib_pin.calibrate(ARM, rows, Setup(), validate=False)
    found = {f.code: (f.severity, f.evidence["outliers"]) for f in result.findings}
    # The first of them is where it stopped.
    assert found == {"stuck-encoder": ("error", 14), "outliers": ("info", 3)}


def test_measurements_are_accused_by_the_model_that_was_chosen() -> None:
    """What a poorer one has set aside may fit; with the gears it is told what does."""
    rows = measured(count=60, effects=("transmission",), changes=GEARS)
    away = np.zeros((60, 3))
    away[[7, 31, 48]] = 0.02
    rows = replace(rows, values=rows.values + away)
    severities = []
    for parameters in (("placement",), ("placement", "transmission")):
        setup = Setup(parameters=parameters)
        result = calib_pin.calibrate(ARM, rows, setup, validate=False)
        (one,) = (f for f in result.findings if f.code == "outliers")
        severities.append((one.severity, bool(one.setup), one.evidence["outliers"]))
    assert severities == [("info", False, 3.0), ("warning", True, 3.0)]
