"""`fleet`: many calibrations, rows and folders; a broken job stops nothing."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from calib_pin.io.trials import read_trials

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
            document = json.loads(path.read_text())
            document["provenance"].pop("created")
            document["provenance"]["command"].remove(f"{folder}/{path.parent.name}")
            document["solver"].pop("seconds")
            found[name] = document
        elif path.is_file():
            found[name] = path.read_bytes()
    return found


def test_a_fleet_is_a_row_and_a_folder_each(jobs, run):
    result = run("fleet jobs.csv -o out --no-pages --workers 2")
    assert result.status == 2
    assert result.out.startswith("4 calibrations: 3 good, 1 failed.")
    rows = rows_of("out")
    # The one that failed comes first, then the one that has drifted.
    assert list(rows)[:2] == ["C3", "A1-2026-03-10"]
    assert rows["C3"]["verdict"] == "failed"
    assert rows["C3"]["reason"].startswith("missing.csv: no such file")
    assert not Path("out", "C3").exists()
    good = rows["A1-2026-01-10"]
    assert good["verdict"] == "good" and good["drift_previous"] == ""
    assert float(good["calibrated"]) < 0.5 * float(good["nominal"])
    document = json.loads(Path("out", "A1-2026-01-10", "calibration.json").read_text())
    expected = document["errors"]["position"]["validation"]["after"]["rms"]
    assert float(good["calibrated"]) == expected
    later = rows["A1-2026-03-10"]
    assert later["drift_previous"] == "A1-2026-01-10"
    assert later["drift_beyond"] == "True"
    assert float(later["drift_size"]) > 2.0 * float(later["drift_explained"])
    names = {path.name for path in Path("out", "B2").iterdir()}
    assert names == {"arm.urdf", "calibration.json", "measurements.csv", "nominal.urdf"}
    page = Path("out", "fleet.html").read_text()
    assert "missing.csv: no such file" in page and "errors-in-fleet" in page
    # Three robots are too few to tell what their type has in common.
    assert good["joint_name"] == "" and not Path("out", "fleet.json").exists()

    # What is there is replaced by force only.
    assert run(f"fleet jobs.csv -o out {QUICKLY}").err.startswith(
        "calib-pin: out/A1-2026-01-10: exists; --resume goes on, --force begins again"
    )
    # As a kill leaves it: one folder is missing, one not whole, no table.
    whole = contents("out")
    kept = Path("out", "B2", "calibration.json").stat().st_mtime_ns
    shutil.rmtree("out/A1-2026-01-10")
    Path("out", "A1-2026-03-10", "measurements.csv").write_text("damaged")
    Path("out", "fleet.csv").unlink()
    # Fewer workers have the same bytes.
    run(f"fleet jobs.csv -o out {QUICKLY} --resume")
    assert contents("out") == whole
    assert Path("out", "B2", "calibration.json").stat().st_mtime_ns == kept


def test_a_folder_is_that_of_the_command_that_stands_in_it(jobs, run):
    Path("jobs.csv").write_text(JOBS.split("arm.urdf,foreign")[0])
    assert run("fleet jobs.csv -o out --quiet --workers 2").status == 0
    assert b"<svg" in Path("out", "A1", "report.html").read_bytes()
    folder = Path("out", "B2")
    before = json.loads((folder / "calibration.json").read_text())
    words = before["provenance"]["command"]
    assert words[:4] == ["calib-pin", "calibrate", "arm.urdf", "new.csv"]
    assert run(" ".join([*words[1:], "--force"])).status == 0
    after = json.loads((folder / "calibration.json").read_text())
    assert after["parameters"] == before["parameters"]
    # Other measurements are another calibration, and its page can be written later.
    shutil.copy("rows.csv", "new.csv")
    assert run(f"fleet jobs.csv -o out {QUICKLY} --resume").status == 0
    other = json.loads((folder / "calibration.json").read_text())
    assert other["parameters"] != before["parameters"]
    assert not (folder / "report.html").exists()
    assert run("report out/B2 --quiet").status == 0
    assert (folder / "report.html").exists()


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_any_workers_have_the_same_bytes(jobs, run):
    for name, words in {
        "one": "--workers 1",
        "two": "--workers 2",
        "many": "--cluster local",
    }.items():
        run(f"fleet jobs.csv -o {name} --no-pages --quiet {words}")
    assert contents("one") == contents("two") == contents("many")


def test_robots_of_a_type_are_a_prior_and_compared(here, run):
    """Robots with one error in common, and one of them with a joint of its own."""
    lines, rng = ["robot,measurements,setup,serial_number"], np.random.default_rng(1)
    for k in range(14):
        drawn = rng.normal(0.0, 5e-4, 2)
        # Offsets of the first and the last joint are those of base and tool.
        offsets = {"joint2": 2e-3 + drawn[0], "joint3": drawn[1]}
        if k == 5:
            offsets["joint3"] = 1e-2
        Path("own.yaml").write_text(
            "".join(f"{name}.joint-offset.q: {v:.9f}\n" for name, v in offsets.items())
        )
        words = (
            "simulate arm.urdf --model position --noise 1e-4 --count 30 --errors "
            f"own.yaml --parameters joint-offset --seed {10 + k} -o r{k}.csv"
        )
        assert run(words).status == 0
        lines.append(f"arm.urdf,r{k}.csv,setup.yaml,R{k}")
    Path("jobs.csv").write_text("\n".join(lines) + "\n")
    result = run("fleet jobs.csv -o out --no-pages --workers 2")
    assert result.status == 0
    assert "14 robots 'arm' are the prior of the next one of their type." in result.out
    assert "joint2.joint-offset.q" in result.out
    rows = rows_of("out")
    assert next(iter(rows)) == "R5" and rows["R5"]["joint_name"] == "joint3"
    assert rows["R5"]["joint_significant"] == "True"
    assert rows["R1"]["joint_significant"] == "False"
    prior = json.loads(Path("out", "fleet.json").read_text())
    assert prior["format"] == "calib-pin/fleet-prior" and prior["robots"] == 14
    (mean,) = (
        one["mean"]
        for one in prior["parameters"]
        if one["name"] == "joint2.joint-offset.q"
    )
    assert abs(mean - 2e-3) < 6e-4
    setup = Path("setup.yaml").read_text() + "prior: out/fleet.json\n"
    Path("next.yaml").write_text(setup)
    words = "calibrate arm.urdf rows.csv --setup next.yaml -o next --quiet"
    assert run(words).status == 0


def test_jobs_in_yaml_share_what_stands_above_them(here, run):
    Path("tables").mkdir()
    Path("tables/jobs.yaml").write_text(
        "robot: ../arm.urdf\nsetup: ../setup.yaml\njobs:\n"
        "  - {name: first, measurements: [../rows.csv]}\n"
        "  - {name: second, measurements: ../ne*.csv, holdout: 0.3, seed: 4}\n"
        "  - {name: third, measurements: [../nothing*.csv]}\n"
        "  - {name: fourth, measurements: ../rows.csv, previous: ../done}\n"
    )
    result = run("fleet tables/jobs.yaml -o out --no-pages --workers 1")
    assert result.status == 2
    rows = rows_of("out")
    assert "no file has such a name" in rows["third"]["reason"]
    document = json.loads(Path("out", "second", "calibration.json").read_text())
    assert document["validation"]["method"] == "holdout"
    assert document["solver"]["seed"] == 4
    assert rows["fourth"]["drift_previous"] == "tables/../done"
    assert rows["fourth"]["drift_beyond"] == "False"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("robot\narm.urdf\n", "the column 'measurements' is missing"),
        (
            "robot,measurments\narm.urdf,a.csv\n",
            "no column of a job (did you mean 'measurements'?)",
        ),
        ("robot,measurements\narm.urdf,\n", "jobs.csv:2: 'measurements' is missing"),
        (
            "robot,measurements,holdout\narm.urdf,a.csv,20\n",
            "jobs.csv:2: the job cannot have this (column 'holdout', value '20'); "
            "allowed: a number between 0 and 1",
        ),
        (
            "robot,measurements,date\narm.urdf,a.csv,3.4.2026\n",
            "allowed: a date, such as 2026-11-23",
        ),
        (
            "robot,measurements,name\narm.urdf,a.csv,../up\n",
            "allowed: a name for a folder",
        ),
        (
            "robot,measurements,name\narm.urdf,a.csv,one\narm.urdf,b.csv,One\n",
            "jobs.csv:3: the job has the folder of that in line 2",
        ),
        (
            "robot,measurements,name\narm.urdf,a.csv,fleet.csv\n",
            "a job cannot have this name",
        ),
        ("robot,measurements\n", "the file has a header but no rows"),
    ],
)
def test_tables_that_are_wrong_are_one_line(here, run, text, words):
    Path("jobs.csv").write_text(text)
    result = run("fleet jobs.csv -o out")
    assert result.status == 1 and words in result.err, result.err
    assert result.err.count("\n") == 1 and not Path("out").exists()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("jobs: []\n", "the file must be a mapping with a list 'jobs'"),
        ("- a\n", "the file must be a mapping with a list 'jobs'"),
        ("jobs: [3]\n", "a job is a mapping of keys to values"),
        (
            "robto: a.urdf\njobs: [{robot: a.urdf, measurements: b.csv}]\n",
            "jobs.yaml:1: unknown key 'robto' (did you mean 'robot'?)",
        ),
        (
            "robot: a.urdf\njobs:\n  - {measurements: b.csv}\n  - {seed: 1.5}\n",
            "jobs.yaml:4: 'measurements' is missing",
        ),
        (
            "jobs:\n  - robot: a.urdf\n    measurements: b.csv\n    seed: 1.5\n",
            "jobs.yaml:4: 'seed' cannot have this value",
        ),
    ],
)
def test_lists_that_are_wrong_are_one_line(here, run, text, words):
    Path("jobs.yaml").write_text(text)
    result = run("fleet jobs.yaml -o out")
    assert result.status == 1 and words in result.err, result.err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("-o out", "give either a table of JOBS, or --monte-carlo SETUP"),
        ("jobs.csv -o out --monte-carlo setup.yaml", "give either a table"),
        ("jobs.csv -o out --workers 0", "--workers cannot be '0'"),
        ("jobs.csv -o out --workers 2 --cluster local", "exclude each other"),
        ("none.csv -o out", "none.csv: no such file"),
        ("--monte-carlo setup.yaml -o out", "'monte_carlo.robot' is missing"),
    ],
)
def test_options_that_are_wrong_are_one_line(jobs, run, words, said):
    result = run(f"fleet {words}")
    assert result.status == 1 and said in result.err
    assert not Path("out").exists()


STUDY = """\
tip: tool
model: position
parameters: [joint-offset]
frames: {base: {xyz: [0.1, 0.2, 0.3], estimate: true}}
noise: {position: 1.0e-4}
limit: {position: 3.0e-4}
monte_carlo: {robot: arm.urdf, robots: 12, configurations: [20, 8]}
"""


def test_a_study_goes_on_where_it_was_stopped(here, run):
    Path("study.yaml").write_text(STUDY)
    words = "fleet --monte-carlo study.yaml --seed 3"
    result = run(f"{words} -o out --workers 1")
    assert result.status == 0
    assert "configurations 100 % of the robots (76 % to 100 %)" in result.out
    whole = Path("out", "monte-carlo.csv").read_bytes()
    assert len(whole.splitlines()) == 2 + 24
    document = json.loads(Path("out", "monte-carlo.json").read_text())
    few, many = document["outlooks"]
    assert (few["configurations"], many["configurations"]) == (8, 20)
    assert many["position"][1] < few["position"][1] < few["nominal"][1]
    assert "accuracy-by-configurations" in Path("out", "monte-carlo.html").read_text()
    # Killed in the middle of a line, and of a robot.
    for end in (len(whole) // 2, whole.index(b"\n4,8,") + 5, 150):
        Path("out", "monte-carlo.csv").write_bytes(whole[:end])
        assert run(f"{words} -o out --resume --quiet --workers 2").status == 0
        assert Path("out", "monte-carlo.csv").read_bytes() == whole
    # More robots of the same study.
    Path("study.yaml").write_text(STUDY.replace("robots: 12", "robots: 14"))
    assert run(f"{words} -o out --resume --quiet --workers 1").status == 0
    assert Path("out", "monte-carlo.csv").read_bytes().startswith(whole)


def test_a_study_does_not_go_on_with_trials_of_another(here, run):
    Path("study.yaml").write_text(STUDY.replace("12", "2"))
    assert run("fleet --monte-carlo study.yaml -o out --quiet --workers 1").status == 0
    result = run("fleet --monte-carlo study.yaml -o out --seed 1 --resume")
    assert result.status == 1
    assert "holds trials of another study; use --force" in result.err
    assert run("fleet --monte-carlo study.yaml -o out").status == 1
    file = Path("out", "monte-carlo.csv")
    lines = file.read_text().splitlines(keepends=True)
    study = lines[0].split()[-1]
    assert len(read_trials(file, study, 2)) == 2
    file.write_text("".join([*lines[:2], lines[4], *lines[3:]]))
    result = run("fleet --monte-carlo study.yaml -o out --resume")
    assert result.status == 1 and "monte-carlo.csv:3: damaged" in result.err


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("robots: 2", "robots: 0", "'monte_carlo.robots' cannot have this value"),
        ("[20, 8]", "[8, 8]", "at least one name and each at most once"),
        ("[20, 8]", "[8], plan: poses.csv", ""),
        ("[20, 8]", "[80], plan: poses.csv", "the plan has 20 configurations"),
        ("[20, 8]", "[8], errors: {elbow*: 1}", "no parameter matches 'elbow*'"),
        ("robot: arm.urdf", "robot: leg.urdf", "leg.urdf: no such file"),
    ],
)
def test_studies_that_are_wrong_are_one_line(here, run, old, new, words):
    Path("study.yaml").write_text(STUDY.replace("12", "2").replace(old, new))
    result = run("fleet --monte-carlo study.yaml -o out --quiet --workers 1")
    assert result.status == bool(words) and words in result.err, result.err
