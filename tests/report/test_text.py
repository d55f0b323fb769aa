"""The report as people read it: plain, 80 columns, mm and degrees, nothing cut off."""

from __future__ import annotations

import io
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from calib_pin.calibration import calibrate
from calib_pin.estimation.evidence import Outlier
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.io.urdf import load_robot
from calib_pin.io.urdf_tree import parse_robot
from calib_pin.kinematics.chain import Chain
from calib_pin.report.accuracy import evaluated
from calib_pin.report.identification import identified
from calib_pin.report.tables import significant
from calib_pin.report.terminal import laid_out, plain_text
from calib_pin.report.text import format_report, report
from calib_pin.setup import PlaneSetup, Setup
from calib_pin.simulation import draw_errors, simulate
from calib_pin.validation.accuracy import Accuracy
from calib_pin.validation.assessment import identify
from calib_pin.validation.evaluation import evaluate
from calib_pin.validation.result import CalibrationResult

ARM = """<robot name="arm">
  <link name="base"/><link name="a"/><link name="b"/><link name="c"/>
  <joint name="{0}" type="revolute">
    <origin xyz="0 0 0.4"/><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
    <limit lower="-2.5" upper="2.5" effort="1" velocity="1"/>
  </joint>
  <joint name="{1}" type="revolute">
    <origin xyz="0.1 0.3 0"/><parent link="a"/><child link="b"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/>
  </joint>
  <joint name="{2}" type="prismatic">
    <origin xyz="0.5 0 0.05" rpy="0.5 0.1 0"/>
    <parent link="b"/><child link="c"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="0.4" effort="1" velocity="1"/>
  </joint>
</robot>
"""


def solve(
    names: tuple[str, str, str] = ("j1", "j2", "j3"),
    model: str = "pose",
    setup: Setup | None = None,
    count: int = 30,
    **options: object,
) -> CalibrationResult:
    chain = Chain(parse_robot(ARM.format(*names).encode(), "arm.urdf"))
    setup = setup or Setup()
    problem = nominal_problem(chain, model, setup)
    rng = np.random.default_rng(1)
    theta = draw_errors(problem.parameters, rng)
    rows = simulate(problem, theta, rng, count=count)
    return calibrate(chain, rows, setup, **options)


@pytest.fixture(scope="module")
def result() -> CalibrationResult:
    return solve(setup=Setup(fixed=("base.frame.r*",)))


def full_report(result: CalibrationResult) -> str:
    """The report with all details."""
    return format_report(result, details=True)


def section(text: str, title: str) -> list[str]:
    """The lines from a title to the next empty line."""
    lines = text.splitlines()
    start = next(k for k, line in enumerate(lines) if line.startswith(title))
    end = next((k for k in range(start, len(lines)) if not lines[k]), len(lines))
    return lines[start:end]


# --- form --------------------------------------------------------------------------


def test_plain_text_of_80_columns(result):
    text = full_report(result)
    assert text.isascii()
    assert "\x1b" not in text
    assert text.endswith("\n")
    assert not re.search(r" $", text, re.MULTILINE)
    assert "\n\n\n" not in text
    assert max(map(len, text.splitlines())) <= 80


def test_colors_on_a_terminal(result):
    stream = io.StringIO()
    Console(file=stream, force_terminal=True, width=100).print(laid_out(report(result)))
    assert "\x1b[" in stream.getvalue()


@pytest.mark.parametrize("variable", ["FORCE_COLOR", "TTY_COMPATIBLE"])
def test_plain_whatever_the_environment_says(result, variable, monkeypatch):
    expected = full_report(result)
    monkeypatch.setenv(variable, "1")
    monkeypatch.setenv("COLUMNS", "40")
    assert full_report(result) == expected


def test_in_a_notebook_the_text_is_returned(result, monkeypatch):
    expected = full_report(result)
    monkeypatch.setattr("rich.console._is_jupyter", lambda: True)
    assert full_report(result) == expected


def test_names_are_neither_markup_nor_emoji():
    names = ("[bold]a[/red]", ":robot:", "[b")
    text = full_report(solve(names))
    for name in names:
        assert f"{name}.placement.x" in text


def test_long_names_are_wrapped_and_not_cut():
    names = tuple(f"left_arm_{'very_' * k}long_{k}_joint" for k in (1, 7, 20))
    text = full_report(solve(names, setup=Setup(parameters=("dh",))))
    assert max(map(len, text.splitlines())) <= 80
    assert "…" not in text
    solid = re.sub(r"\s+", "", text)
    for name in names:
        assert f"{name}.dh." in solid


# --- content -----------------------------------------------------------------------


def changed(result: CalibrationResult, **changes: Any) -> CalibrationResult:
    """A result with other values, each in the group that holds it."""
    own = {key: changes.pop(key) for key in [*changes] if hasattr(result.accuracy, key)}
    result = replace(result, accuracies={"": replace(result.accuracy, **own)})
    for name in ("statistics", "solver", "validation"):
        part = getattr(result, name)
        own = {key: changes.pop(key) for key in [*changes] if hasattr(part, key)}
        result = replace(result, **{name: replace(part, **own)})
    return replace(result, **changes)


def opening(result: CalibrationResult, **changes: object) -> list[str]:
    """Verdict and subject."""
    text = full_report(changed(result, **changes))
    *verdict, subject = text.split("\n\n")[0].splitlines()
    return [" ".join(verdict), subject]


def test_verdicts(result):
    position = next(e for e in result.errors if e.name == "position")
    before, after = (
        f"{1e3 * accuracy.rms:.3g} mm"
        for accuracy in (position.validation_before, position.validation_after)
    )
    nominal, calibrated = (
        f"{1e3 * size[0]:.3g} mm"
        for size in (
            result.accuracy.workspace.nominal,
            result.accuracy.workspace.calibrated,
        )
    )
    assert opening(result)[0] == (
        f"GOOD: position error {after} rms instead of {before} on 30 independent "
        f"held-out configurations; over the workspace {calibrated} instead of "
        f"{nominal} are expected."
    )
    for reason in ("it did not converge", "it did not converge."):
        text = opening(result, verdict="untrusted", reason=reason)[0]
        assert text == "UNTRUSTED: it did not converge."


def test_the_subject(result):
    said = "arm: 3 joints from base to c; pose, 30 measurements fitted"
    assert opening(result)[1] == said


def test_accuracy_in_millimeters_and_degrees(result):
    lines = section(full_report(result), "Accuracy")
    assert len(lines) == 1 + 1 + 2 * 2 * 2 + 3
    position = next(e for e in result.errors if e.name == "position")
    words = lines[2].split()
    assert words[:3] == ["position", "fitted", "nominal"]
    assert words[-1] == "mm"
    assert float(words[3]) == pytest.approx(1e3 * position.before.mean, rel=1e-3)
    orientation = next(e for e in result.errors if e.name == "orientation")
    words = lines[-4].split()
    assert words[0] == "calibrated"
    assert words[-1] == "deg"
    after = orientation.validation_after
    assert after is not None
    assert float(words[4]) == pytest.approx(np.degrees(after.max), abs=1e-4)
    assert lines[4].split()[0] == "validation"
    assert " ".join(lines[-3:-1]) == (
        "Validation measurements (5-fold): each fold, predicted by a fit to the other "
        "folds. Registered for both (nominal and calibrated): base frame, tool frame."
    )


def test_how_far_the_robot_moves(result):
    line = section(full_report(result), "Accuracy")[-1]
    found = re.fullmatch(
        r"Largest correction of a joint origin: ([\d.]+) mm \((\w+)\), ([\d.]+) deg "
        r"\((\w+)\)\.",
        line,
    )
    assert found is not None
    corrections = result.model.urdf_corrections()
    shifts = {j: 1e3 * np.linalg.norm(M.translation) for j, M in corrections.items()}
    turns = {
        j: np.degrees(np.arccos((np.trace(M.rotation) - 1.0) / 2.0))
        for j, M in corrections.items()
    }
    assert float(found[1]) == pytest.approx(max(shifts.values()), rel=1e-3)
    assert float(found[3]) == pytest.approx(max(turns.values()), abs=1e-4)
    assert shifts[found[2]] == max(shifts.values())
    assert turns[found[4]] == max(turns.values())


def test_without_frames_nothing_is_registered():
    known = Setup(fixed=("base.frame.*", "tool.frame.*"), parameters=("joint-offset",))
    text = full_report(solve(setup=known))
    assert "Frames and instrument are known; nothing is registered." in text


def test_planes_are_fitted_in_either_case():
    setup = Setup(
        planes={"wall": PlaneSetup((0, 0, 1), -2.0)},
        fixed=("tool.frame.*",),
        parameters=("joint-offset",),
    )
    lines = section(full_report(solve(model="plane-distance", setup=setup)), "Accuracy")
    said = "Registered for both (nominal and calibrated): wall plane."
    assert said in " ".join(lines)
    assert lines[2].split()[0] == "distance"


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (0.0, "0.0000"),
        (8.1e-3, "8.100"),
        (0.0123456, "12.35"),
        (1.2345678, "1235"),
        (0.5e-3, "0.5000"),
        (1e-12, "1.0e-09"),
        (99.9996e-3, "100.00"),
        (123.45, "1.2e+05"),
        (float("inf"), "inf"),
        (float("nan"), "unknown"),
    ],
)
def test_numbers(result, value, shown):
    size = Accuracy(value, value, value, value)
    errors = (replace(result.errors[0], before=size),)
    text = full_report(replace(result, errors=errors))
    assert section(text, "Accuracy")[2].split()[-5:] == [shown] * 4 + ["mm"]


def test_ranks(result):
    lines = section(full_report(result), "Identifiability")
    text = " ".join(" ".join(lines).split())
    ranks = result.identifiability
    known = sum(p.status == "identifiable" for p in result.parameters)
    assert f"free parameters {ranks.parameters} (" in text
    assert f"{known} identifiable" in text
    # 4 * 2 + 2 * 1 + 6, of which three rotations of the base are held.
    assert "Everett's count 4R + 2P + 6 = 16, for geometry and full poses" in text
    assert f"practical rank {ranks.rank} " in text
    assert "condition number" in text
    for index in ("O1", "O2", "O3", "O4", "O5"):
        assert index in text


def test_every_parameter_is_listed_with_its_status(result):
    text = full_report(result)
    lines = section(text, "Identifiable parameters")[2:]
    names = [line.split()[0] for line in lines]
    known = [p for p in result.parameters if p.status == "identifiable"]
    assert names == [p.name for p in known]
    for line, parameter in zip(lines, known, strict=True):
        _, value, sigma, unit = line.split()
        factor = 1e3 if unit == "mm" else np.degrees(1.0)
        assert unit == {"m": "mm", "rad": "deg"}[parameter.unit]
        # Two digits of the standard deviation, and the value to the same place.
        assert float(sigma) == pytest.approx(factor * parameter.sigma, rel=0.05)
        assert len(value.partition(".")[2]) == len(sigma.partition(".")[2])
        last = 0.5 * 10.0 ** -len(sigma.partition(".")[2])
        assert float(value) == pytest.approx(factor * parameter.value, abs=1.001 * last)
    assert section(text, "fixed:") == ["fixed:", "  base.frame.rx|ry|rz"]
    solid = re.sub(r"\s+", "", text)
    for parameter in result.parameters:
        if parameter.status == "coupled":
            assert parameter.name in solid


def test_groups_are_formulae(result):
    lines = section(full_report(result), "Identifiable linear combinations")
    for group in result.groups:
        # A long sum goes on in the next lines, the value stands beside the first.
        first, _ = group.terms[0]
        start = next(
            k for k, x in enumerate(lines) if x.split()[0] == str(group.number)
        )
        assert first in lines[start]
        below = "".join(lines[start : start + len(group.terms)])
        for name, _ in group.terms:
            assert name in below
        factor = {"m": 1e3, "rad": np.degrees(1.0)}[group.unit]
        if group.sigma is None:
            assert f"{factor * group.value:+.4f}" in lines[start]
        else:
            assert significant(factor * group.sigma) in lines[start]
    first = lines[2].split()
    assert first[0] == "1"
    assert first[-1] in ("mm", "deg")
    assert "coefficients in SI units" in lines[0]


def test_weak_and_unidentifiable_parameters():
    # A tracker that is far worse than the robot tells nothing of its joints.
    result = solve(model="position", setup=Setup(noise={"position": 0.05}))
    text = full_report(result)
    weak = section(text, "weakly observable (held wholly or partly at nominal)")
    assert any("placement" in line for line in weak)
    assert "directions held at nominal" in text
    dead = section(text, "unobservable")
    assert dead[1:] == ["  tool.frame.rx|ry|rz"]


def test_parameters_at_a_bound():
    result = solve(setup=Setup(bounds={"j2.placement.*": 1e-5}))
    assert result.solver.at_bounds
    lines = section(full_report(result), "at a bound:")
    assert all(line.startswith("  j2.placement.") for line in lines[1:])


@pytest.mark.parametrize(
    ("factor", "where"), [(0.1, "below"), (1.0, "inside"), (9.0, "above")]
)
def test_chi_square(result, factor, where):
    chi2 = factor * result.statistics.dof
    text = full_report(changed(result, chi2=chi2, stated_sigma=True))
    lines = section(text, "Statistics")
    assert f"with {result.statistics.dof} dof" in lines[1]
    assert f"{where} its 95 % interval" in lines[2]
    assumed = full_report(changed(result, chi2=chi2, stated_sigma=False))
    assert f"{where} its 95 % interval" in assumed
    assert "times the assumed sigma" in assumed


def test_correlations_and_outliers_are_counted(result):
    pairs = tuple((f"a{k}", f"b{k}", -0.99) for k in range(8))
    rows = tuple(Outlier(f"rows.csv:{k}", k, 1234.6 - k) for k in range(7))
    ranks = replace(result.identifiability, correlated=pairs)
    text = full_report(changed(result, identifiability=ranks, outliers=rows))
    lines = section(text, "Correlations, abs(rho) > 0.95")
    assert lines[1] == "  -0.990  a0  |  b0"
    assert lines[-1] == "  and 3 more pairs in calibration.json"
    lines = section(text, "Outliers (7 of 30)")
    assert lines[1].split() == ["normalized", "residual", "weight"]
    assert lines[2].split() == ["rows.csv:0", "1234.6", "1.0"]
    assert lines[-1] == "  and 2 more in calibration.json"
    none = replace(result.identifiability, correlated=())
    text = full_report(changed(result, identifiability=none, outliers=()))
    assert "Correlations" not in text
    assert "Outliers" not in text


def test_structure_without_estimates():
    chain = Chain(load_robot("pa10"))
    found = identify(chain, "pose")
    text = plain_text(identified(found, fitted=False))
    assert text.startswith("Identifiability\n")
    assert "std. dev." not in text
    assert "practical rank" not in text
    assert re.search("structural rank +34 ", text)
    lines = section(text, "Identifiable errors of the robot")
    assert len([x for x in lines[2:] if ".placement." in x]) == 22
    assert lines[2].split()[:3] == ["joint", "offset", "joint_2"]
    assert lines[2].endswith(" joint_2.placement.rz + joint_3.placement.ry")
    assert max(map(len, text.splitlines())) <= 80
    assert "linear combinations" not in text
    text = plain_text(identified(found, fitted=False, details=True))
    assert section(text, "identifiable:")[1] == "  joint_2.placement.x|rx"
    assert section(text, "Identifiable linear combinations")
    assert max(map(len, text.splitlines())) <= 80


def test_evaluations(result):
    chain = Chain(parse_robot(ARM.format("j1", "j2", "j3").encode(), "arm.urdf"))
    problem = nominal_problem(chain, "pose", Setup())
    rng = np.random.default_rng(2)
    rows = simulate(problem, np.zeros(len(problem.parameters)), rng, count=12)
    text = plain_text(evaluated(evaluate(chain, rows)))
    assert text.splitlines()[2].split()[:2] == ["position", "12"]
    assert "mm" in text
    assert "deg" in text
    assert "Unknown frames and instrument parameters were registered" in text
    text = plain_text(evaluated(evaluate(result.model, rows)))
    assert "Nothing was fitted to these measurements." in text


def test_a_search_and_what_it_reveals() -> None:
    """The line under the verdict names the solver; the ranks say what is new."""
    result = solve()
    ranks = replace(result.identifiability, revealed=1)
    text = full_report(
        changed(
            result,
            solver=replace(
                result.solver,
                name="hybrid",
                evaluator="kernel",
                evaluations=1234,
                history=(3.0, 2.0),
            ),
            identifiability=ranks,
        )
    )
    assert "hybrid, 1234 evaluations (kernel)" in " ".join(text.split())
    assert "(1 observable only at the calibrated geometry)" in text
    plain = full_report(result)
    assert "evaluations" not in plain and "observable only" not in plain
