"""`scripts/reproduce` from outside: its files, and what it refuses."""

from __future__ import annotations

import io
import json
import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.io.measurements import read_configurations
from calib_pin.kinematics.spatial import Floats, adjoint
from studies import aoyagi2010_study
from studies.__main__ import STUDIES, main
from studies.aoyagi2010 import COMES_NEAR, LOWERS, STALLS
from studies.liu2012 import REACHES, SAME_COST
from studies.liu2012_study import MUTATIONS, Settings, study
from studies.liu2022_arm import Arm, SpatialTwist, condition


@dataclass(frozen=True)
class Few(aoyagi2010_study.Settings):
    """With fewer configurations to choose from and to verify."""

    candidates: int = 200
    verification: int = 200


@dataclass(frozen=True)
class Ended:
    """A run: its exit code and all that it said."""

    code: object
    out: str
    err: str


def reproduce(*words: str) -> Ended:
    """What the command does, in this process."""
    out, err = io.StringIO(), io.StringIO()
    code: object = 0
    with redirect_stdout(out), redirect_stderr(err), pytest.MonkeyPatch.context() as it:
        it.setattr(sys, "argv", ["reproduce", *words])
        try:
            main()
        except SystemExit as end:
            code = end.code
    return Ended(code, out.getvalue(), err.getvalue())


def test_help_tells_what_there_is() -> None:
    ended = reproduce("--help")
    assert ended.code == 0 and all(study in ended.out for study in STUDIES)


def written(folder: Path, study: str, *words: str, others: int = 0) -> Any:
    """The JSON document of a run, whose figures and lines are checked.

    Besides the document and the figures, as many other files are named.
    """
    ended = reproduce(study, *words, "-o", str(folder))
    # A line of progress for each stage, and a status that tells of the conditions.
    assert all(line.startswith("reproduce: ") for line in ended.err.splitlines())
    document = json.loads((folder / f"{study}.json").read_text())
    assert ended.code == (0 if all(document["conditions"].values()) else 2)
    names = {file.name for file in folder.iterdir()}
    figures = {name for name in names if name.endswith(".png")}
    assert len(names) == len(figures) + 1 + others
    # Paths of any length may stand in the last lines.
    lines = ended.out.splitlines()
    assert {Path(line.split()[-1]).name for line in lines[-len(names) :]} == names
    assert all(len(line) <= 80 for line in lines[: -len(names)])
    for name in figures:
        assert (folder / name).read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    return document


@pytest.mark.slow
def test_aoyagi2010_writes_numbers_and_figures(tmp_path, monkeypatch):
    folder = tmp_path / "new"
    monkeypatch.setattr("studies.aoyagi2010.Settings", Few)
    document = written(folder, "aoyagi2010", "--seeds", "1", "--points", "40")
    names = {"points.png", "verification.png", "aoyagi2010.json"}
    assert {file.name for file in folder.iterdir()} == names
    assert document["settings"]["seeds"] == 1
    assert document["settings"]["counts"] == [40]
    selected = document["selections"]["40"]
    assert np.shape(selected["q_rad"]) == (40, 7)
    assert selected["O1"] > selected["random_median_O1"]
    cases = document["seeds"][0]["cases"]["40"]
    assert cases == document["medians"]["40"]
    assert cases["genetic"]["O1"] == selected["O1"] > cases["random"]["O1"]
    for case in cases.values():
        assert case["nominal_mean_m"] > case["geometric_mean_m"] > 1e-4
        assert case["structure_over_floor"] < 1.5
        means = case["geometric_mean_m"], case["network_mean_m"]
        assert case["geometric_over_network"] == pytest.approx(means[0] / means[1])
    # 40 points do not suffice for the network, and the conditions say so.
    met = document["conditions"]
    assert met[STALLS] and not (met[LOWERS] and met[COMES_NEAR])


@pytest.mark.slow
def test_liu2012_writes_numbers_and_figures(tmp_path: Path) -> None:
    folder = tmp_path / "new"
    document = written(folder, "liu2012", "--seeds", "1", "--generations", "20")
    names = {"convergence.png", "distances.png", "validation.png", "liu2012.json"}
    assert {file.name for file in folder.iterdir()} == names
    assert document["settings"]["seeds"] == 1
    assert document["settings"]["generations"] == 20
    histories = document["convergence"]["median_squares_m2"]["35"]
    assert set(histories) == set(MUTATIONS)
    assert {len(history) for history in histories.values()} == {21}
    # 20 generations do not suffice, and the conditions say so.
    met = document["conditions"]
    assert not met[REACHES] and met[SAME_COST]
    # The same seed gives the same numbers in this process.
    settings = Settings(counts=(35, 100), generations=20, mutations=("best/1",))
    case = study(settings, 0).cases[35]
    found = document["seeds"][0]["cases"]["35"]
    assert found["best/1"]["squares_m2"] == case["best/1"].squares
    np.testing.assert_array_equal(
        found["distance_errors_m"]["nominal"], case.before.errors
    )


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a short run of `reproduce liu2022`."""
    folder = tmp_path_factory.mktemp("liu2022")
    words = ("--seeds", "1", "--starts", "1", "--iterations", "10")
    written(folder, "liu2022", *words, others=1)
    return folder


@pytest.mark.slow
def test_liu2022_writes_numbers_figures_and_a_plan(planned: Path) -> None:
    names = {"search.png", "trajectory.png", "plan.csv", "liu2022.json"}
    assert {file.name for file in planned.iterdir()} == names
    arm, document = Arm.load(), json.loads((planned / "liu2022.json").read_text())
    q = read_configurations(planned / "plan.csv", arm.problem.chains)
    assert q.shape == (6, 7) and np.degrees(np.abs(q)).max() <= 120 + 1e-9
    found = document["sets"]["ours"]["condition"]
    assert condition(arm, q) == pytest.approx(found, rel=1e-9)
    assert document["ours_without_self_collision"]["condition"] == found < 5.5
    assert arm.collisions().free(q).all()
    assert document["ours"]["condition"] < 5.5
    assert len(document["swarms"]) == 1
    assert len(document["swarms"][0]["best"]) == 11


@pytest.mark.slow
def test_liu2022_compares_with_what_is_published(planned: Path) -> None:
    document = json.loads((planned / "liu2022.json").read_text())
    sets = document["sets"]
    assert sets["hand-picked"]["condition"] == pytest.approx(354.8, abs=0.1)
    assert sets["swarm"]["condition"] == pytest.approx(25.2, abs=0.1)
    assert 70.0 < document["random"]["median"] < 150.0
    means = {}
    for name, numbers in sets.items():
        means[name] = numbers["linear_step"]["mean_relative_error"]
        solved, noisy = numbers["calibration"], numbers["calibration_with_noise"]
        assert solved["largest_relative_error"] < 1e-10
        assert solved["largest_component_m"] < 1e-13
        assert solved["largest_component_rad"] < 1e-13
        assert len(noisy) == 1
        assert noisy[0]["mean_relative_error"] > 1e-3
    # Published: 11.95 % and 1.11 %; the second needs another residual than the first.
    assert means["hand-picked"] == pytest.approx(0.12, abs=0.003)
    assert means["swarm"] == pytest.approx(0.022, abs=0.002)
    assert means["ours"] < means["swarm"]
    before = document["nominal_tip"]
    assert before["largest_component_m"] == pytest.approx(0.0257, abs=5e-5)
    assert np.degrees(before["largest_component_rad"]) == pytest.approx(0.49, abs=5e-3)
    step = sets["swarm"]["linear_step"]
    assert step["largest_component_m"] < 1e-3
    assert np.degrees(step["largest_component_rad"]) < 0.1


def poses(seed: int) -> Floats:
    arm, rng = Arm.load(), np.random.default_rng(seed)
    q = arm.problem.chains.random_configurations(5, rng)
    return arm.poses(q, arm.preset)


def test_spatial_twists_against_central_differences() -> None:
    model, T, instrument, step = SpatialTwist(), poses(0), np.zeros(0), 1e-6
    target = ("",) * len(T)
    empty = Arm.load().measure(np.zeros((5, 7)), Arm.load().preset, {}, 0)
    data = replace(empty, values=model.predict(T, instrument, target))
    linear = model.linearize(T, instrument, data)
    assert np.abs(linear.residual).max() < 1e-12  # Of poses a meter away.
    np.testing.assert_array_equal(linear.J_pose, adjoint(T))
    for k in range(6):
        ahead, behind = (
            T @ pin.exp6(s * np.eye(6)[k]).homogeneous for s in (step, -step)
        )
        moved = model.residual(ahead, instrument, data) - model.residual(
            behind, instrument, data
        )
        np.testing.assert_allclose(
            linear.J_pose[:, :, k], moved / (2 * step), atol=1e-8
        )


def test_rows_of_the_matrix_against_central_differences() -> None:
    arm, rng = Arm.load(), np.random.default_rng(3)
    q, aim = arm.problem.chains.random_configurations(6, rng), np.zeros(6, int)
    rows, pullback = arm.rows.linearize(q, aim)
    by_rows, step = rng.normal(size=rows.shape), 1e-6
    expected = np.empty_like(q)
    for k in range(7):
        shift = step * np.eye(7)[k]
        change = arm.rows.rows(q + shift, aim) - arm.rows.rows(q - shift, aim)
        expected[:, k] = np.sum(by_rows * change, axis=(1, 2)) / (2 * step)
    np.testing.assert_allclose(pullback(by_rows), expected, atol=1e-7)


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (["lieu"], ["unknown study 'lieu'", "aoyagi2010, klimchik, liu2012, liu2022"]),
        ([], ["name a study", "aoyagi2010, klimchik, liu2012, liu2022"]),
        (["liu2012", "--seeds", "0"], ["liu2012: argument --seeds: '0'", "from 1 on"]),
        (["liu2012", "-o", __file__], [f"-o/--output: '{__file__}' is not a folder"]),
    ],
)
def test_what_it_refuses(words: list[str], parts: list[str]) -> None:
    ended = reproduce(*words)
    assert isinstance(ended.code, str) and ended.code.startswith("reproduce")
    assert all(part in ended.code for part in parts)
    assert ended.out == "" and "\n" not in ended.code
