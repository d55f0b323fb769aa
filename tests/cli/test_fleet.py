"""`fleet`: many calibrations, rows and folders; a broken job stops nothing."""

from __future__ import annotations

import csv
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib_pin
from calib_pin.io.json_text import encode
from calib_pin.io.results import read_result
from calib_pin.io.setup import prior_document
from calib_pin.io.trials import read_trials
from calib_pin.setup import PopulationPrior
from calib_pin.validation.robot_state import robot_evidence
from tests.cli.files import document

JOBS = """\
robot,measurements,serial_number,date,setup
arm.urdf,rows.csv,A1,2026-01-10,setup.yaml
arm.urdf,new.csv,B2,2026-01-11,setup.yaml
arm.urdf,foreign.csv,A1,2026-03-10,setup.yaml
arm.urdf,missing.csv,C3,2026-01-12,setup.yaml
"""

QUICKLY = "--no-pages --quiet --workers 1"


@pytest.fixture
def jobs(here: Path) -> Path:
    Path("jobs.csv").write_text(JOBS)
    return here


def rows_of(folder: str) -> dict[str, dict[str, str]]:
    with Path(folder, "fleet.csv").open() as stream:
        return {row["job"]: row for row in csv.DictReader(stream)}


def contents(folder: str) -> dict[str, object]:
    """All files of a fleet, but for times."""
    found: dict[str, object] = {}
    for path in sorted(Path(folder).rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.name == "calibration.json":
            stated = document(path)
            stated["provenance"].pop("created")
            stated["provenance"]["command"].remove(f"{folder}/{path.parent.name}")
            stated["solver"].pop("seconds")
            found[name] = stated
        elif path.is_file():
            found[name] = path.read_bytes()
    return found


def test_a_fleet_is_a_row_and_a_folder_each(jobs, run, fails, inside):
    """What is missing or damaged is made up for, byte for byte."""
    assert run("fleet jobs.csv -o out --no-pages").status == 2
    rows = rows_of("out")
    # The one that failed comes first, then the one that has drifted.
    assert list(rows)[:2] == ["C3", "A1-2026-03-10"]
    assert rows["C3"]["verdict"] == "failed" and not Path("out", "C3").exists()
    assert rows["C3"]["reason"].startswith("missing.csv")
    good, later = rows["A1-2026-01-10"], rows["A1-2026-03-10"]
    assert good["verdict"] == "good" and good["drift_previous"] == ""
    assert float(good["calibrated"]) < 0.5 * float(good["nominal"])
    stated = document("out/A1-2026-01-10")["errors"]["position"]["validation"]
    assert float(good["calibrated"]) == stated["after"]["rms"]
    assert later["drift_previous"] == "A1-2026-01-10"
    assert later["drift_beyond"] == "True"
    assert float(later["drift_size"]) > 2.0 * float(later["drift_explained"])
    names = {path.name for path in Path("out", "B2").iterdir()}
    assert names == {"arm.urdf", "calibration.json", "measurements.csv", "nominal.urdf"}
    page = Path("out", "fleet.html").read_text()
    assert "missing.csv" in page
    # Three robots are too few to tell what their type has in common.
    assert not Path("out", "fleet.json").exists()

    # What is there is replaced by force only.
    fails(f"fleet jobs.csv -o out {QUICKLY}", "out/A1-2026-01-10", "--resume")
    # As a kill leaves it: one folder is missing, one not whole, no table.
    whole = contents("out")
    kept = Path("out", "B2", "calibration.json").stat().st_mtime_ns
    shutil.rmtree("out/A1-2026-01-10")
    Path("out", "A1-2026-03-10", "measurements.csv").write_text("damaged")
    Path("out", "fleet.csv").unlink()
    run(f"fleet jobs.csv -o out {QUICKLY} --resume")
    assert contents("out") == whole
    assert Path("out", "B2", "calibration.json").stat().st_mtime_ns == kept


def test_a_folder_is_that_of_the_command_that_stands_in_it(jobs, run, inside):
    Path("jobs.csv").write_text("\n".join(JOBS.splitlines()[:3:2]))
    assert run("fleet jobs.csv -o out --quiet").status == 0
    folder = Path("out", "B2")
    assert (folder / "report.html").exists()
    before = document(folder)
    words = before["provenance"]["command"]
    assert words[:4] == ["calib-pin", "calibrate", "arm.urdf", "new.csv"]
    assert run(" ".join([*words[1:], "--force"])).status == 0
    assert document(folder)["parameters"] == before["parameters"]
    # Other measurements are another calibration, and its page can be written later.
    shutil.copy("rows.csv", "new.csv")
    assert run(f"fleet jobs.csv -o out {QUICKLY} --resume").status == 0
    assert document(folder)["parameters"] != before["parameters"]
    assert not (folder / "report.html").exists()
    assert run("report out/B2 --quiet").status == 0
    assert (folder / "report.html").exists()


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize(
    "workers", ["local", pytest.param("dask", marks=pytest.mark.needs("cluster"))]
)
def test_any_workers_have_the_same_bytes(jobs, run, workers, request):
    option = "--workers 2"
    if workers == "dask":
        option = f"--cluster {request.getfixturevalue('dask').file}"
    run(f"fleet jobs.csv -o many --no-pages --quiet {option}")
    request.getfixturevalue("inside")
    run("fleet jobs.csv -o one --no-pages --quiet")
    assert contents("one") == contents("many")


@pytest.mark.slow
def test_robots_of_a_type_are_a_prior(here, run, inside):
    """Robots with one error in common."""
    lines, rng = ["robot,measurements,setup,serial_number"], np.random.default_rng(1)
    for k in range(12):
        drawn = rng.uniform(-8e-4, 8e-4, 2)
        # Offsets of the first and the last joint are those of base and tool.
        offsets = {"joint2": 2e-3 + drawn[0], "joint3": drawn[1]}
        Path("own.yaml").write_text(
            "".join(f"{name}.joint-offset.q: {v:.9f}\n" for name, v in offsets.items())
        )
        words = (
            "simulate arm.urdf --model position --noise 1e-4 --count 24 --errors "
            f"own.yaml --parameters joint-offset --seed {10 + k} -o r{k}.csv"
        )
        assert run(words).status == 0
        lines.append(f"arm.urdf,r{k}.csv,setup.yaml,R{k}")
    Path("jobs.csv").write_text("\n".join(lines) + "\n")
    result = run("fleet jobs.csv -o out --no-pages")
    assert result.status == 0 and "12 robots" in result.out
    prior = document("out/fleet.json")
    assert prior["format"] == "calib-pin/fleet-prior" and prior["robots"] == 12
    means = {one["name"]: one["mean"] for one in prior["parameters"]}
    assert abs(means["joint2.joint-offset.q"] - 2e-3) < 1e-3
    setup = Path("setup.yaml").read_text() + "prior: out/fleet.json\n"
    Path("next.yaml").write_text(setup)
    assert run("calibrate arm.urdf rows.csv --setup next.yaml").status == 0


def test_jobs_in_yaml_share_what_stands_above_them(here, run, inside):
    Path("tables").mkdir()
    Path("tables/jobs.yaml").write_text(
        "robot: ../arm.urdf\nsetup: ../setup.yaml\njobs:\n"
        "  - {name: first, measurements: ../ne*.csv, holdout: 0.3, seed: 4}\n"
        "  - {name: second, measurements: [../nothing*.csv]}\n"
        "  - {name: third, measurements: ../rows.csv, previous: ../done}\n"
    )
    assert run("fleet tables/jobs.yaml -o out --no-pages").status == 2
    rows = rows_of("out")
    assert "nothing*.csv" in rows["second"]["reason"]
    assert document("out/first")["validation"]["method"] == "holdout"
    assert document("out/first")["solver"]["seed"] == 4
    assert rows["third"]["drift_previous"] == "tables/../done"
    assert rows["third"]["drift_beyond"] == "False"


def test_a_table_of_a_spreadsheet(here, run, inside):
    """With a mark, semicolons, a decimal comma and an empty line."""
    lines = ["Robot;Measurements;Serial number;Date;Setup;Holdout"]
    lines += ["arm.urdf;rows.csv;007;2026-01-05;setup.yaml;0,3", ";;;;;", ""]
    Path("jobs.csv").write_text("\r\n".join(lines), encoding="utf-8-sig")
    assert run("fleet jobs.csv -o out --no-pages").status == 0
    row = rows_of("out")["007"]
    assert (row["date"], row["held_out"]) == ("2026-01-05", "12")


STUDY = """\
tip: tool
model: position
parameters: [joint-offset]
frames: {base: {xyz: [0.1, 0.2, 0.3], estimate: true}}
noise: {position: 1.0e-4}
limit: {position: 3.0e-4}
monte_carlo: {robot: arm.urdf, robots: 3, configurations: [20, 8]}
"""
SEED = "fleet --monte-carlo study.yaml --quiet --seed"


@pytest.mark.slow
def test_a_study_goes_on_where_it_was_stopped(here, run, inside):
    Path("study.yaml").write_text(STUDY)
    words = f"{SEED} 3 -o out"
    assert run(words).status == 0
    file = Path("out", "monte-carlo.csv")
    whole = file.read_bytes()
    assert len(whole.splitlines()) == 2 + 6
    few, many = document("out/monte-carlo.json")["outlooks"]
    assert (few["configurations"], many["configurations"]) == (8, 20)
    assert many["position"][1] < few["position"][1] < few["nominal"][1]
    assert "accuracy-by-configurations" in Path("out", "monte-carlo.html").read_text()
    # Killed in the middle of a line, and of a robot.
    for end in (whole.index(b"\n1,8,") + 5, 150):
        file.write_bytes(whole[:end])
        assert run(f"{words} --resume").status == 0
        assert file.read_bytes() == whole
    # More robots of the same study.
    Path("study.yaml").write_text(STUDY.replace("robots: 3", "robots: 4"))
    assert run(f"{words} --resume").status == 0
    assert file.read_bytes().startswith(whole)


def test_a_study_does_not_go_on_with_trials_of_another(here, run, fails, inside):
    Path("study.yaml").write_text(STUDY.replace("robots: 3", "robots: 2"))
    assert run(f"{SEED} 0 -o out").status == 0
    fails(f"{SEED} 1 -o out --resume", "--force")
    fails(f"{SEED} 0 -o out", "monte-carlo")
    file = Path("out", "monte-carlo.csv")
    lines = file.read_text().splitlines(keepends=True)
    assert len(read_trials(file, lines[0].split()[-1], 2)) == 2
    file.write_text("".join([*lines[:2], lines[4], *lines[3:]]))
    fails(f"{SEED} 0 -o out --resume", "monte-carlo.csv")


# --- a fleet's prior in a setup file ----------------------------------------------


CALIBRATE = "calibrate space6 rows.csv --setup setup.yaml -o out"


@pytest.fixture
def bench(fleet, alone) -> Path:
    """Measurements of one more robot, and the prior of its fleet."""
    data, _ = fleet.measured(600, 12)
    calib_pin.write_measurements("rows.csv", data)
    prior = fleet.prior
    Path("fleet.json").write_bytes(encode(prior_document(prior)))
    Path("setup.yaml").write_text("prior: fleet.json\n")
    return alone


def test_few_measurements_are_enough(bench, run) -> None:
    """Verdict and folder: the latter holds the prior and tells fleets no more."""
    assert run(f"{CALIBRATE} --details").status == 0
    stated = document("out")
    assert stated["verdict"]["status"] == "good"
    assert stated["setup"]["prior"]["format"] == "calib-pin/fleet-prior"
    # What the measurements tell, whatever the prior holds.
    found = stated["identifiability"]
    assert found["rank"] + found["weak"] == found["structural_rank"]
    Path("fleet.json").unlink()
    there = read_result("out")
    assert isinstance(there.model.setup.prior, PopulationPrior)
    assert len(robot_evidence(there).values) < len(robot_evidence(there).names)


def test_priors_of_others(bench, fleet, fails) -> None:
    """Of another robot, of other parameters, and of the same robot otherwise made."""
    fails(CALIBRATE.replace("space6", "space7"))
    fails(f"{CALIBRATE} --parameters dh", "parameters")
    prior = fleet.prior
    first = replace(prior.robot.joints[1], axis=(0.0, 0.6, 0.8))
    joints = (prior.robot.joints[0], first, *prior.robot.joints[2:])
    other = replace(prior, robot=replace(prior.robot, joints=joints))
    Path("fleet.json").write_bytes(encode(prior_document(other)))
    fails(CALIBRATE, "fleet.json", "'space6'", "axis")
