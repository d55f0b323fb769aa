"""The commands as users run them: what they print, write and leave alone."""

from __future__ import annotations

import hashlib
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import calib_pin
from calib_pin.cli import main
from calib_pin.errors import InputError
from calib_pin.io.setup import read_setup, setup_document
from calib_pin.parameterizations import PARAMETERIZATIONS
from calib_pin.residual_models import RESIDUAL_MODELS

POSITION = "calibrate arm.urdf rows.csv --setup setup.yaml"


def process(*words: str, code: int) -> subprocess.CompletedProcess[str]:
    """Run a command as its own process."""
    result = subprocess.run(
        [sys.executable, "-m", "calib_pin.cli", *words],
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == code, result.stderr
    return result


def document(folder: str) -> dict:
    return json.loads(Path(folder, "calibration.json").read_text())


# --- as processes ------------------------------------------------------------------


@pytest.mark.slow
def test_a_calibration_as_a_process(here):
    result = process(*POSITION.split(), "-o", "out", code=0)
    assert result.stdout.startswith("GOOD: ")
    assert result.stderr == ""
    assert {path.name for path in Path("out").iterdir()} == {
        "arm.urdf",
        "calibration.json",
        "nominal.urdf",
        "measurements.csv",
        "report.html",
    }


def test_the_status_of_a_process(here):
    result = process("robots", "--colour", code=1)
    assert result.stdout == ""
    assert result.stderr.startswith("calib-pin: ")
    assert result.stderr.count("\n") == 1
    Path("few.csv").write_text("\n".join(Path("rows.csv").read_text().split("\n")[:4]))
    result = process("calibrate", "arm.urdf", "few.csv", code=2)
    assert result.stdout.startswith("UNCHECKED: ")
    assert result.stderr == ""


@pytest.mark.parametrize("words", [[], ["--help"], ["calibrate", "--help"]])
def test_help_is_fast(words):
    program = (
        "import sys; from calib_pin.cli import main; "
        f"status = main({words!r}); "
        "heavy = {'numpy', 'scipy', 'pinocchio', 'yaml', 'rich'} & set(sys.modules); "
        "sys.exit(f'imported {heavy}' if heavy else status)"
    )
    result = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""
    assert result.stdout.startswith("Usage: calib-pin ")


def test_a_reader_that_goes_away_is_no_error():
    program = f"{sys.executable} -m calib_pin robots | head -n 1"
    result = subprocess.run(
        program, shell=True, capture_output=True, text=True, check=False
    )
    assert result.stdout.startswith("name ")
    assert result.stdout.count("\n") == 1
    assert result.stderr == ""


@pytest.mark.parametrize(
    ("redirection", "status"),
    [
        pytest.param(">&-", 0, marks=pytest.mark.slow),
        pytest.param("2>&-", 0, marks=pytest.mark.slow),
        (">&- 2>&- <&-", 0),
        ("> /dev/full", 1),
    ],
)
def test_closed_and_full_streams(redirection, status):
    program = f"{sys.executable} -m calib_pin robots"
    result = subprocess.run(
        f"{program} {redirection}", shell=True, capture_output=True, text=True
    )
    assert result.returncode == status
    assert "internal" not in result.stderr
    if status:
        assert result.stderr == "calib-pin: output: No space left on device\n"


# --- help and the command line itself ----------------------------------------------


def test_help(run):
    result = run("--help")
    assert result.status == 0
    assert "..." not in result.out.replace("[ARGS]...", "")  # nothing is cut off
    for command in (
        "calibrate",
        "identify",
        "evaluate",
        "simulate",
        "plan",
        "robots",
    ):
        assert f"\n  {command} " in result.out


@pytest.mark.parametrize(
    ("command", "arguments", "options"),
    [
        (
            "calibrate",
            "ROBOT MEASUREMENTS...",
            "-o --setup --model --base --tip --parameters --solver --loss --validation "
            "--holdout --seed --force --quiet",
        ),
        (
            "identify",
            "ROBOT [MEASUREMENTS...]",
            "--setup --model --base --tip --parameters --seed --json",
        ),
        (
            "evaluate",
            "ROBOT|calibration.json MEASUREMENTS...",
            "--setup --model --base --tip --register --json",
        ),
        (
            "simulate",
            "ROBOT",
            "-o --model --count --configurations --errors --seed --noise --repeats "
            "--average --truth --setup --base --tip --parameters --force",
        ),
        (
            "plan",
            "ROBOT",
            "-o --model --count --add --to --criterion --method --candidates --tests "
            "--seed --limits --distance --srdf --package-dir --clearance "
            "--ignore-collisions --setup --base --tip --parameters --force --quiet "
            "--json",
        ),
        ("robots", "[NAME]", "-o --force"),
    ],
)
def test_help_of_a_command(command, arguments, options, run):
    result = run(f"{command} --help")
    assert result.status == 0
    usage = f"Usage: calib-pin {command} [OPTIONS] {arguments}".rstrip()
    assert result.out.splitlines()[0] == usage
    for option in options.split():
        assert f"  {option}" in result.out
    assert not re.search(r"<(str|int|float|list|file|path)", result.out)
    assert max(map(len, result.out.splitlines())) <= 80


def test_help_names_every_parameterization(run):
    # A name that is broken at its hyphen is still one name.
    words = re.sub(r"-\s+", "-", run("identify --help").out)
    assert set(PARAMETERIZATIONS) <= set(re.findall(r"[a-z]+(?:-[a-z]+)*", words))


def test_without_a_command(run):
    assert run("").out == run("--help").out


def test_version(run):
    assert run("--version").out.startswith("calib-pin 0.")


def test_debug_shows_where_it_failed(here):
    with pytest.raises(InputError):
        main(["--debug", "calibrate", "arm.urdf", "none.csv"])
    with pytest.raises(InputError):
        main(["calibrate", "arm.urdf", "none.csv", "--debug"])


def test_a_defect_of_ours_is_one_line_too(here, run, monkeypatch):
    def fail(*_: object, **__: object) -> None:
        raise ZeroDivisionError("division\nby zero")

    monkeypatch.setattr("calib_pin.calibration.calibrate", fail)
    result = run(POSITION)
    assert result.status == 1
    assert result.err == (
        "calib-pin: internal error, please report it with --debug: "
        "ZeroDivisionError: division by zero\n"
    )


# --- calibrate ---------------------------------------------------------------------

NUMBER = (int, float)
CONTRACT = {
    "format": str,
    "version": int,
    "verdict": {"status": str, "reason": str},
    "robot": {
        "name": str,
        "file": str,
        "sha256": str,
        "base": str,
        "tip": str,
        "joints": [str],
    },
    "measurements": {
        "files": [{"file": str, "sha256": str}],
        "model": str,
        "training": int,
        "validation": int,
    },
    "parameters": [
        {
            "name": str,
            "unit": str,
            "value": NUMBER,
            "sigma": (*NUMBER, type(None)),
            "status": str,
            "groups": [int],
        }
    ],
    "identifiability": {
        "parameters": int,
        "rank": int,
        "structural_rank": int,
        "condition": NUMBER,
        "singular_values": [NUMBER],
        "observability": dict.fromkeys(("O1", "O2", "O3", "O4", "O5"), NUMBER),
        "coupled": [
            {
                "group": int,
                "expression": str,
                "unit": str,
                "value": NUMBER,
                "sigma": (*NUMBER, type(None)),
                "terms": [{"parameter": str, "coefficient": NUMBER}],
            }
        ],
    },
    "findings": list,
    "statistics": {
        "chi2": NUMBER,
        "dof": int,
        "sigma0": NUMBER,
        "noise": list,
        "outliers": list,
        "gains": list,
    },
    "solver": {
        "name": str,
        "evaluator": str,
        "history": list,
        "status": str,
        "iterations": int,
        "evaluations": int,
        "seconds": float,
        "seed": int,
    },
    "frames": dict,
    "targets": dict,
    "planes": dict,
    "residual_model": type(None),
    "provenance": {
        "calib_pin": str,
        "pinocchio": str,
        "numpy": str,
        "command": [str],
        "created": str,
    },
}
SIZES = {"mean": NUMBER, "rms": NUMBER, "max": NUMBER}
QUANTITY = {
    "unit": str,
    "training": {"before": SIZES, "after": SIZES},
    "validation": {"method": str, "before": SIZES, "after": SIZES},
}


def check_form(value, form, place="document"):
    """Compare keys and types with a form; further keys are allowed."""
    if isinstance(form, dict):
        assert isinstance(value, dict), place
        for key, part in form.items():
            assert key in value, f"{place}.{key} is missing"
            check_form(value[key], part, f"{place}.{key}")
    elif isinstance(form, list):
        assert isinstance(value, list), place
        for k, item in enumerate(value):
            check_form(item, form[0], f"{place}[{k}]")
    else:
        assert isinstance(value, form), f"{place} is {value!r}"
        assert form is dict or not isinstance(value, bool), place


@pytest.mark.parametrize(
    ("command", "quantities"),
    [
        (POSITION, ["position"]),
        ("calibrate arm.urdf poses.csv", ["position", "orientation"]),
        ("calibrate arm.urdf distances.csv --setup plane.yaml", ["distance"]),
    ],
)
def test_what_is_written(command, quantities, here, run):
    result = run(f"{command} -o out --seed 7")
    assert (result.status, result.err) == (0, "")
    assert result.out.endswith(
        "wrote out/arm.urdf\nwrote out/nominal.urdf\nwrote out/calibration.json\n"
        "wrote out/measurements.csv\n"
        "wrote out/report.html\n"
    )

    found = document("out")
    check_form(found, CONTRACT)
    assert list(found)[:5] == ["format", "version", "verdict", "findings", "robot"]
    assert found["format"] == "calib-pin/calibration"
    assert found["version"] == 1
    assert found["verdict"]["status"] == "good"
    words = " ".join(result.out.split())
    assert words.startswith(f"GOOD: {found['verdict']['reason']}.")
    assert list(found["errors"]) == quantities
    for quantity in found["errors"].values():
        check_form(quantity, QUANTITY)
        assert quantity["validation"]["method"] == "5-fold"
        assert (
            quantity["training"]["after"]["rms"] < quantity["training"]["before"]["rms"]
        )
    robot, measurements = found["robot"], found["measurements"]
    assert robot["file"] == "arm.urdf"
    assert (robot["base"], robot["tip"]) == ("base_link", "tool")
    assert robot["joints"] == ["joint1", "joint2", "joint3", "joint4"]
    for entry in (robot, *measurements["files"]):
        data = Path(entry["file"]).read_bytes()
        assert entry["sha256"] == hashlib.sha256(data).hexdigest()
    assert measurements["model"] in ("position", "pose", "plane-distance")
    assert measurements["training"] == measurements["validation"]
    ranks = found["identifiability"]
    free = [p for p in found["parameters"] if p["status"] != "fixed"]
    assert ranks["parameters"] == len(free)
    assert len({p["name"] for p in found["parameters"]}) == len(found["parameters"])
    numbers = [group["group"] for group in ranks["coupled"]]
    assert numbers == list(range(1, len(numbers) + 1))
    for parameter in found["parameters"]:
        assert (parameter["sigma"] is not None) == (
            parameter["status"] == "identifiable"
        )
        assert set(parameter["groups"]) <= set(numbers)
        if parameter["status"] == "coupled":
            assert parameter["groups"]
    assert found["solver"]["name"] == "gauss-newton"
    assert found["solver"]["status"] == "converged"
    assert found["solver"]["seed"] == 7
    assert found["provenance"]["command"] == [
        "calib-pin",
        *f"{command} -o out --seed 7".split(),
    ]
    assert ("wall" in found["planes"]) == ("plane" in command)


# Hybrid is differential evolution and more, by an option that wins over the file.
@pytest.mark.parametrize(
    "solver", [pytest.param("de", marks=pytest.mark.slow), "hybrid"]
)
def test_solvers_by_option_and_by_setup_file(here, run, solver):
    assert run(f"{POSITION} -o plain").status == 0
    with Path("setup.yaml").open("a") as file:
        file.write("solver: {name: de, population_size: 40}\n")
    result = run(f"{POSITION} --solver {solver} -o out")
    assert (result.status, result.err) == (0, "")
    found, plain = document("out"), document("plain")
    assert found["solver"]["name"] == solver
    assert found["solver"]["evaluator"] == "kernel"
    history = found["solver"]["history"]
    assert history == sorted(history, reverse=True)
    assert found["solver"]["iterations"] >= len(history) - 1 > 10
    assert found["setup"]["solver"] == {"name": solver, "population_size": 40}
    assert found["statistics"]["chi2"] == pytest.approx(
        plain["statistics"]["chi2"], rel=1e-9 if solver == "hybrid" else 0.02
    )
    # A result says how it was solved, and reads back.
    assert run("evaluate out/calibration.json new.csv").status == 0


def test_the_corrected_robot_is_better(here, run):
    assert run(f"{POSITION} -o out").status == 0

    def rms(robot):
        result = run(f"evaluate {robot} new.csv --json")
        assert (result.status, result.err) == (0, "")
        return json.loads(result.out)["errors"]["position"]["rms"]

    nominal, corrected, true = map(rms, ("arm.urdf", "out/arm.urdf", "truth.urdf"))
    assert nominal > 5 * corrected
    # 0.1 mm of noise in each of three coordinates.
    assert corrected == pytest.approx(true, rel=0.1)
    assert true == pytest.approx(np.sqrt(3) * 1e-4, rel=0.3)


def test_inputs_stay_as_they_are(here, run, listing):
    before = listing(here)
    for words in (
        f"{POSITION} -o out --validation new.csv",
        f"{POSITION} -o out --force",
        "identify arm.urdf rows.csv",
        "evaluate done/calibration.json new.csv",
        "simulate arm.urdf --model pose --configurations new.csv "
        "--errors errors.yaml --parameters joint-offset -o out/a.csv "
        "--truth out/a.urdf",
    ):
        assert run(words).status == 0
    after = listing(here)
    assert {name: after[name] for name in before} == before
    assert {name.split("/")[0] for name in after if name not in before} == {"out"}


def test_the_same_input_gives_the_same_bytes(here, run):
    pairs = []
    for _ in range(2):
        assert run(f"{POSITION} -o out --force --seed 3").status == 0
        found = document("out")
        found["provenance"].pop("created")
        found["solver"].pop("seconds")
        pairs.append((json.dumps(found), Path("out/arm.urdf").read_bytes()))
    assert pairs[0] == pairs[1]


def test_quiet(here, run):
    Path("rows.csv").write_text(Path("rows.csv").read_text().replace("sigma_x", "hum"))
    text = Path("rows.csv").read_text()
    Path("rows.csv").write_text(text.replace("sigma_y", "hun").replace("sigma_z", "hu"))
    result = run(POSITION)
    assert result.err == ("calib-pin: note: rows.csv: columns ignored: hum, hun, hu\n")
    result = run(f"{POSITION} -o out --quiet")
    assert (result.status, result.out, result.err) == (0, "", "")
    assert document("out")["verdict"]["status"] == "good"


def test_without_a_folder_nothing_is_written(here, run, listing):
    before = listing(here)
    result = run(POSITION)
    assert result.status == 0
    assert "wrote" not in result.out
    assert listing(here) == before


def test_force_replaces(here, run):
    old = Path("done/calibration.json").read_bytes()
    result = run("calibrate arm.urdf new.csv --setup setup.yaml -o done --force")
    assert result.status == 0
    assert document("done")["measurements"]["files"][0]["file"] == "new.csv"
    assert Path("done/calibration.json").read_bytes() != old
    assert len(list(Path("done").iterdir())) == 5


def test_options_win_over_the_setup_file(here, run):
    Path("setup.yaml").write_text(
        "base: link1\ntip: link4\nmodel: pose\nparameters: [placement]\n"
    )
    words = f"{POSITION} -o out --quiet"
    assert (
        run(
            f"{words} --base base_link --tip tool --model position --parameters dh,"
            "joint-offset"
        ).status
        == 0
    )
    found = document("out")
    assert found["robot"]["base"] == "base_link"
    assert found["robot"]["tip"] == "tool"
    assert found["measurements"]["model"] == "position"
    kinds = {parameter["name"].split(".")[1] for parameter in found["parameters"]}
    assert kinds == {"frame", "dh", "joint-offset"}
    assert found["setup"]["parameters"] == ["dh", "joint-offset"]

    # And the file over the defaults.
    Path("setup.yaml").write_text("base: link1\nparameters: [joint-offset]\n")
    # These rows belong to a longer chain, and the verdict notices.
    assert run(f"{words} --force").status == 2
    found = document("out")
    assert found["robot"]["joints"] == ["joint2", "joint3", "joint4"]


def test_validation_file(here, run):
    result = run(f"{POSITION} --validation new.csv -o out")
    assert result.status == 0
    assert "Validation measurements (file)" in result.out
    found = document("out")
    assert found["errors"]["position"]["validation"]["method"] == "file"
    assert found["measurements"]["training"] == 40
    assert found["measurements"]["validation"] == 25
    files = [entry["file"] for entry in found["measurements"]["files"]]
    assert files == ["rows.csv", "new.csv"]


def test_measurements_from_a_pipe(here, run):
    """As `cat rows.csv | calib-pin calibrate arm.urdf /dev/stdin`."""
    reader, writer = os.pipe()
    # A pipe holds 64 kB, more than this file.
    with os.fdopen(writer, "wb") as pipe:
        pipe.write(Path("rows.csv").read_bytes())
    file = f"/dev/fd/{reader}"
    words = f"calibrate arm.urdf {file} --setup setup.yaml -o out --quiet"
    assert run(words).status == 0
    os.close(reader)
    files = document("out")["measurements"]["files"]
    assert files == [{"file": file, "sha256": ""}]


COLOR = re.compile(r"\x1b\[(\d+;)*(3|9)[0-7](;\d+)*m")
"""Bold is no color; colors of text are 30 to 37 and 90 to 97."""


def test_a_narrow_terminal_cuts_no_number_off(here, run, monkeypatch):
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "40")
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    result = run(POSITION)
    assert result.status == 0
    assert COLOR.search(result.out)
    assert "…" not in result.out
    assert "GOOD" in result.out
    monkeypatch.setenv("NO_COLOR", "1")
    result = run(POSITION)
    assert "GOOD" in result.out
    assert not COLOR.search(result.out)


def test_holdout(here, run):
    result = run(f"{POSITION} --holdout 0.25 -o out")
    assert result.status == 0
    found = document("out")
    assert found["errors"]["position"]["validation"]["method"] == "holdout"
    assert found["measurements"]["training"] == 30
    assert found["measurements"]["validation"] == 10


def test_set_column(here, run):
    comment, header, *rows = Path("rows.csv").read_text().splitlines()
    marks = ["validate" if k % 4 == 0 else "train" for k in range(len(rows))]
    marked = [f"{row},{mark}" for row, mark in zip(rows, marks, strict=True)]
    Path("rows.csv").write_text("\n".join([comment, f"{header},set", *marked]) + "\n")
    assert run(f"{POSITION} -o out").status == 0
    found = document("out")
    assert found["errors"]["position"]["validation"]["method"] == "set"
    assert found["measurements"]["training"] == 30
    assert found["measurements"]["validation"] == 10

    result = run(f"{POSITION} --validation new.csv")
    assert result.status == 0
    assert "'set' marks for validation are not used with --validation" in result.err


def test_several_files(here, run):
    assert run("calibrate arm.urdf rows.csv new.csv -o out --quiet").status == 0
    files = document("out")["measurements"]["files"]
    assert [entry["file"] for entry in files] == ["rows.csv", "new.csv"]
    assert document("out")["measurements"]["training"] == 65


def test_names_that_a_file_system_cannot_hold(here, run):
    text = Path("arm.urdf").read_text()
    Path("arm.urdf").write_text(text.replace('name="arm"', 'name="../[red] ärm: 1"'))
    result = run(f"{POSITION} -o out")
    assert result.status == 0
    assert "../[red] ärm: 1: 4 joints" in result.out
    assert {path.name for path in Path("out").iterdir()} == {
        "__red__ärm__1.urdf",
        "calibration.json",
        "nominal.urdf",
        "measurements.csv",
        "report.html",
    }
    assert document("out")["robot"]["name"] == "../[red] ärm: 1"


def test_mapped_columns(here, run):
    text = Path("rows.csv").read_text()
    for k in range(1, 5):
        text = text.replace(f"joint{k}", f"J{k}", 1)
    Path("rows.csv").write_text(text.replace("calib-pin", ""))
    Path("setup.yaml").write_text(
        "parameters: [joint-offset]\njoints:\n"
        + "".join(f"  J{k}: {{joint: joint{k}}}\n" for k in range(1, 5))
    )
    assert run(f"{POSITION} -o out").status == 0
    # The calibration knows the columns it was made from.
    assert run("evaluate out/calibration.json rows.csv").status == 0


# --- beyond geometry ---------------------------------------------------------------

CORRECTED = """\
model: position
parameters: [placement, transmission, compliance]
frames: {tool: {xyz: [0.05, 0.08, 0.1], estimate: true}}
gravity: [0.5, 0, -9.8]
payloads: {gripper: {mass: 6, com: [0.02, 0, 0.1]}}
gear_ratios: {joint_2: 50}
noise: {position: 2.0e-5}
"""


def test_gears_and_compliance_from_simulation_to_evaluation(tmp_path, monkeypatch, run):
    monkeypatch.chdir(tmp_path)
    Path("setup.yaml").write_text(CORRECTED)
    words = "simulate pa10 --setup setup.yaml --count 80 --seed 3 -o rows.csv"
    assert run(words).status == 0
    result = run("calibrate pa10 rows.csv --setup setup.yaml --holdout 0.2 -o out")
    assert (result.status, result.err) == (0, "")
    text = " ".join(result.out.split())
    assert "A URDF cannot hold transmission and compliance" in text
    assert "urad/Nm" in text and "joint_4 k" in text
    found = document("out")
    check_form(found, CONTRACT)
    units = {p["name"]: p["unit"] for p in found["parameters"]}
    assert units["joint_4.compliance.k"] == "rad/Nm"
    assert units["joint_4.transmission.gain"] == "rad/rad"
    assert units["joint_2.transmission.motor_cos"] == "rad"
    status = {p["name"]: p["status"] for p in found["parameters"]}
    assert status["joint_4.compliance.k"] == "identifiable"
    accuracy = found["errors"]["position"]
    # Twenty times worse without them, on the same unseen rows.
    unseen = accuracy["validation"]["after"]["rms"]
    assert unseen < 1e-4
    alone = found["urdf"]["errors"]["position"]
    assert (alone["unit"], found["urdf"]["reason"]) == ("m", "")
    assert alone["validation"]["after"]["rms"] > 10.0 * unseen
    assert (
        json.loads(json.dumps(setup_document(read_setup("setup.yaml"))))
        == (found["setup"])
    )

    def rms(words: str) -> float:
        result = run(f"evaluate {words} --json")
        assert result.status == 0
        return json.loads(result.out)["errors"]["position"]["rms"]

    # What is read back has it all; the URDF has the geometry alone.
    parts = accuracy["training"]["after"]["rms"] ** 2 * 64 + unseen**2 * 16
    assert rms("out/calibration.json rows.csv") == pytest.approx(np.sqrt(parts / 80))
    assert rms("out/pa10.urdf rows.csv --setup setup.yaml") > 10.0 * unseen


def test_several_payloads(here, run):
    Path("load.yaml").write_text(
        "parameters: [compliance]\nframes: {tool: {xyz: [0.05, 0, 0.1]}}\n"
        "payloads: {a: {mass: 1, com: [0, 0, 0]}, b: {mass: 9, com: [0.1, 0, 0]}}\n"
    )
    head, *rows = Path("rows.csv").read_text().splitlines()[1:]
    cells = [f"{row},{'ab'[k % 2]}" for k, row in enumerate(rows)]
    Path("loaded.csv").write_text("\n".join([f"{head},payload", *cells, ""]))
    result = run("identify arm.urdf loaded.csv --setup load.yaml --json")
    assert (result.status in (0, 2), result.err) == (True, "")


def test_parameters_beyond_geometry_on_the_command_line(here, run):
    Path("load.yaml").write_text(
        "payloads: {load: {mass: 5, com: [0.1, 0.05, 0]}}\n"
        "frames: {tool: {xyz: [0.05, 0.02, 0.1], estimate: true}}\n"
    )
    Path("errors.yaml").write_text(
        "joint2.transmission.sin2: 5.0e-4\njoint3.transmission.gain: -1.0e-3\n"
        "joint2.compliance.k: 2.0e-5\njoint3.compliance.k: 4.0e-5\n"
    )
    kinds = "--setup load.yaml --parameters placement,transmission,compliance"
    words = f"simulate arm.urdf --model position --count 60 --noise 0 {kinds}"
    assert run(f"{words} --errors errors.yaml -o out.csv").status == 0
    assert run(f"calibrate arm.urdf out.csv {kinds} -o out --quiet").status == 0
    found = document("out")
    assert found["setup"]["parameters"] == ["placement", "transmission", "compliance"]
    assert found["errors"]["position"]["validation"]["after"]["max"] < 1e-9
    alone = {
        p["name"]: p["value"]
        for p in found["parameters"]
        if p["status"] == "identifiable" and ".frame." not in p["name"]
    }
    expected = {
        "joint2.transmission.sin2": 5e-4,
        "joint3.transmission.gain": -1e-3,
        "joint2.compliance.k": 2e-5,
        "joint3.compliance.k": 4e-5,
    }
    assert expected.keys() <= alone.keys()
    for name, value in alone.items():
        assert value == pytest.approx(expected.get(name, 0.0), abs=1e-10), name

    result = run(f"identify arm.urdf --model position {kinds}")
    assert (result.status, result.err) == (0, "")
    assert "joint3.compliance.k" in result.out


def test_a_model_ladder(here, run, monkeypatch):
    # Last first: what is put back then stands in its old order.
    for name in reversed(list(RESIDUAL_MODELS)):
        monkeypatch.delitem(RESIDUAL_MODELS, name)
    result = run("calibrate arm.urdf rows.csv --model-ladder -o out")
    assert (result.status, result.err) == (0, "")
    shown = result.out[result.out.index("Model selection") :]
    lines = [" ".join(line.split()) for line in shown.splitlines()]
    (kept,) = (line for line in lines if line.startswith("joint offset "))
    assert kept.endswith(" selected") and len(kept.split()) == 5
    (geometric,) = (line for line in lines if line.startswith("geometric "))
    assert geometric.endswith(" no significant gain")
    assert "no mass that loads a joint" in " ".join(result.out.split())
    found = document("out")
    ladder = found["model_ladder"]
    assert ladder["chosen"] == "joint offset"
    names = [rung["name"] for rung in ladder["rungs"]]
    # The lines of a file stand in the order of measuring: sides are known.
    effects = ("transmission", "compliance", "hysteresis", "cross-compliance")
    beyond = [*(f"+ {name}" for name in effects), "+ transmission + compliance"]
    assert names == ["joint offset", "geometric", *beyond]
    assert ladder["rungs"][3]["score"] is None
    assert found["setup"]["parameters"] == ["joint-offset"]
    validation = found["errors"]["position"]["validation"]
    assert validation["method"] == "5-fold"
    assert ladder["rungs"][0]["errors"]["position"] == {
        "unit": "m",
        "mean": validation["after"]["mean"],
    }
    # The calibration is that of the kept rung.
    assert run("evaluate out/calibration.json new.csv").status == 0
    assert run(f"{POSITION} -o plain --quiet").status == 0
    plain = document("plain")
    assert "rungs" not in (plain["model_ladder"] or {})
    assert plain["parameters"] == found["parameters"]


# --- identify ----------------------------------------------------------------------


def test_structure(here, run):
    result = run("identify arm.urdf --model pose --parameters placement")
    assert (result.status, result.err) == (0, "")
    assert "structural rank        22" in result.out
    assert "4R + 2P + 6 = 22" in result.out
    assert "std. dev." not in result.out
    assert run("identify arm.urdf --setup plane.yaml").status == 0


def test_structure_as_json(here, run):
    result = run("identify arm.urdf --model pose --json")
    found = json.loads(result.out)
    check_form(found["parameters"], CONTRACT["parameters"])
    form = {
        key: value
        for key, value in CONTRACT["identifiability"].items()
        if key != "observability"
    }
    check_form(found["identifiability"], form)
    assert found["identifiability"]["rank"] == 22
    assert found["verdict"] == {"status": "good", "reason": ""}


def test_identification_with_measurements(here, run, listing):
    before = listing(here)
    result = run("identify arm.urdf rows.csv --setup setup.yaml")
    assert (result.status, result.err) == (0, "")
    assert "practical rank" in result.out
    assert "std. dev." in result.out
    found = json.loads(run("identify arm.urdf rows.csv --setup setup.yaml --json").out)
    check_form(found["identifiability"], CONTRACT["identifiability"])
    assert listing(here) == before


# --- evaluate ----------------------------------------------------------------------


def test_evaluation_of_a_robot(here, run):
    result = run("evaluate arm.urdf new.csv")
    assert (result.status, result.err) == (0, "")
    assert "registered on these measurements" in result.out
    assert "25" in result.out
    found = json.loads(run("evaluate arm.urdf new.csv --json").out)
    assert found["registered"] is True
    assert found["rows"] == 25
    check_form(found["errors"]["position"], {"unit": str, **SIZES})


def test_evaluation_of_a_calibration(here, run):
    result = run("evaluate done/calibration.json rows.csv")
    told = "rows.csv: the calibration has used it already, to fit or to check\n"
    assert (result.status, result.err) == (0, f"calib-pin: note: {told}")
    assert "Nothing was fitted to these measurements." in result.out

    def errors(words):
        found = json.loads(run(f"evaluate {words} --json").out)
        return found["registered"], found["errors"]["position"]["rms"]

    stored = document("done")["errors"]["position"]["training"]["after"]["rms"]
    registered, fitted = errors("done/calibration.json rows.csv")
    assert not registered
    assert fitted == pytest.approx(stored, rel=1e-9)
    # A tracker that was moved: as it is the calibration fails, registered it does not.
    header, *rows = Path("rows.csv").read_text().splitlines()[1:]
    column = header.split(",").index("x")
    moved = [row.split(",") for row in rows]
    for row in moved:
        row[column] = str(float(row[column]) + 0.5)
    Path("moved.csv").write_text("\n".join([header, *map(",".join, moved)]) + "\n")
    registered, elsewhere = errors("done/calibration.json moved.csv")
    assert not registered
    assert elsewhere == pytest.approx(0.5, rel=1e-2)
    registered, again = errors("done/calibration.json moved.csv --register")
    assert registered
    assert again == pytest.approx(fitted, rel=0.05)


# --- simulate ----------------------------------------------------------------------


def table(file: str) -> tuple[list[str], np.ndarray]:
    header, *rows = [
        row.split(",")
        for row in Path(file).read_text().splitlines()
        if not row.startswith("#")
    ]
    return header, np.array(rows, float)


def test_simulation_is_repeatable(here, run):
    words = "simulate arm.urdf --model position --count 6 --seed 4 -o out.csv"
    result = run(words)
    assert (result.status, result.out) == (0, "wrote 6 measurements to out.csv\n")
    first = Path("out.csv").read_bytes()
    assert f"# simulated by: calib-pin {words}\n".encode() in first
    assert run(f"{words} --force").status == 0
    assert Path("out.csv").read_bytes() == first
    assert run(words.replace("--seed 4", "--seed 5 --force")).status == 0
    assert Path("out.csv").read_bytes() != first


def test_simulation_of_given_configurations(here, run):
    assert (
        run(
            "simulate arm.urdf --model pose --configurations new.csv --noise 0 "
            "-o out.csv"
        ).status
        == 0
    )
    header, rows = table("out.csv")
    old_header, old_rows = table("new.csv")
    assert header[:4] == old_header[:4]
    np.testing.assert_array_equal(rows[:, :4], old_rows[:, :4])
    assert header[4:] == ["x", "y", "z", "qx", "qy", "qz", "qw"]  # and no sigma


def test_simulation_without_noise_and_with_its_truth(here, run):
    assert (
        run(
            "simulate arm.urdf --model position --count 30 --errors errors.yaml "
            "--parameters joint-offset --noise 0 -o out.csv --truth out.urdf"
        ).status
        == 0
    )
    found = json.loads(run("evaluate out.urdf out.csv --json").out)
    assert found["errors"]["position"]["max"] < 1e-9
    found = json.loads(run("evaluate truth.urdf out.csv --json").out)
    assert found["errors"]["position"]["max"] < 1e-9
    # The errors come back.
    words = "calibrate arm.urdf out.csv --parameters joint-offset -o out --quiet"
    assert run(words).status == 0
    values = {p["name"]: p["value"] for p in document("out")["parameters"]}
    assert values["joint2.joint-offset.q"] == pytest.approx(2e-3, abs=1e-9)
    assert values["joint3.joint-offset.q"] == pytest.approx(-3e-3, abs=1e-9)


def test_repeated_readings(here, run):
    words = "simulate arm.urdf --model position --count 4 --noise 1e-3 --repeats 25"
    assert run(f"{words} -o kept.csv").status == 0
    assert run(f"{words} -o mean.csv --average").status == 0
    header, kept = table("kept.csv")
    _, mean = table("mean.csv")
    assert len(kept) == 100
    assert len(mean) == 4
    sigma = header.index("sigma_x")
    assert (kept[:, sigma] == 1e-3).all()
    np.testing.assert_allclose(mean[:, sigma], 2e-4)
    np.testing.assert_array_equal(kept[:25, :4], np.tile(mean[0, :4], (25, 1)))
    x = header.index("x")
    assert kept[:25, x].mean() == pytest.approx(mean[0, x], abs=1e-3)


def test_images_of_a_board(here, run):
    Path("board.yaml").write_text(
        "model: camera\n"
        "camera: {mount: world, focal: [900, 900], center: [640, 480]}\n"
        "board: {type: charuco, columns: 4, rows: 3, square: 0.03}\n"
        "frames: {base: {xyz: [0, 0, 3]}}\n"
    )
    words = "simulate arm.urdf --setup board.yaml --count 30 --seed 1 -o out.csv"
    assert run(words).status == 0
    rows = calib_pin.read_measurements("out.csv", calib_pin.load_chain("arm.urdf")).only
    assert rows.configurations == 30 and len(rows) > 5 * 30
    assert set(rows.target.distinct) == set("012345")


def test_noise_of_the_setup_file(here, run):
    Path("setup.yaml").write_text("noise: {position: 2.0e-5}\n")
    words = "simulate arm.urdf --setup setup.yaml --model position --count 3 -o out.csv"
    assert run(words).status == 0
    header, rows = table("out.csv")
    assert (rows[:, header.index("sigma_z")] == 2e-5).all()


# --- robots ------------------------------------------------------------------------

OTHERS = ("space7", "pa10")
"""Bundled robots of the slow tier."""


def test_robots(run):
    result = run("robots")
    assert (result.status, result.err) == (0, "")
    for name in ("pa10", "space6", "space7"):
        assert f"\n{name} " in f"\n{result.out}"
    assert "base_link -> tool" in result.out


def test_a_bundled_robot_is_copied(tmp_path, monkeypatch, run):
    monkeypatch.chdir(tmp_path)
    assert run("robots space7 -o copy").status == 0
    words = "calibrate copy/robot.urdf copy/measurements.csv --setup copy/setup.yaml"
    assert run(words).out.startswith("Warning: the origin of joint_5")
    again = run("robots space7 -o copy")
    assert again.status == 1 and "exists already" in again.err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("robots space8 -o copy", "did you mean 'space7'"),
        ("robots space7", "robots NAME -o DIR"),
        ("robots -o copy", "robots NAME -o DIR"),
    ],
)
def test_a_copy_needs_a_robot_and_a_folder(words, said, tmp_path, monkeypatch, run):
    monkeypatch.chdir(tmp_path)
    result = run(words)
    assert result.status == 1 and said in result.err
    assert not Path("copy").exists()


@pytest.mark.parametrize(
    "robot", ["space6", *(pytest.param(r, marks=pytest.mark.slow) for r in OTHERS)]
)
def test_bundled_robots_from_simulation_to_evaluation(
    robot, tmp_path, monkeypatch, run
):
    monkeypatch.chdir(tmp_path)
    setup = calib_pin.robot_file(robot, "setup.yaml")
    for words in (
        f"simulate {robot} --setup {setup} --count 60 -o rows.csv --truth true.urdf",
        f"simulate true.urdf --setup {setup} --count 60 --seed 1 --errors none.yaml "
        "-o new.csv",
        f"calibrate {robot} rows.csv --setup {setup} -o out --quiet",
        "evaluate out/calibration.json new.csv",
        f"evaluate out/{robot}.urdf new.csv --setup {setup}",
        f"identify {robot} --setup {setup}",
    ):
        Path("none.yaml").write_text("base.frame.x: 0\n")
        result = run(words)
        assert (result.status, result.err) == (0, "")
    found = document("out")
    assert found["robot"]["file"] == robot
    assert read_setup(setup).parameters == tuple(found["setup"]["parameters"])
    assert json.loads(json.dumps(setup_document(read_setup(setup)))) == found["setup"]


def test_no_urdf_that_is_worse_than_the_nominal_one(tmp_path, monkeypatch, run):
    """Geometry that takes compliance for its own errors goes wrong elsewhere."""
    monkeypatch.chdir(tmp_path)
    Path("setup.yaml").write_text(
        "tip: tool\nmodel: position\nparameters: [placement, compliance]\n"
        "payloads: {load: {mass: 5, com: [0, 0, 0.1]}}\n"
    )
    Path("err.yaml").write_text(
        "joint_2.compliance.k: 5.0e-5\njoint_3.compliance.k: 1.0e-4\n"
        "joint_4.compliance.k: 2.0e-4\n"
    )
    words = "simulate pa10 --setup setup.yaml --errors err.yaml --count 14 --seed 3"
    assert run(f"{words} --noise 2e-5 -o rows.csv").status == 0
    Path("out").mkdir()
    Path("out/pa10.urdf").write_text("of somebody else")
    result = run("calibrate pa10 rows.csv --setup setup.yaml -o out --force")
    assert result.status == 0 and result.out.startswith("GOOD")
    said = " ".join(result.out.split())
    assert "A URDF cannot hold compliance. No URDF is written: " in said
    assert result.err == (
        "calib-pin: note: out/pa10.urdf is not from this run, which has no such file\n"
    )
    assert Path("out/pa10.urdf").read_text() == "of somebody else"
    assert "pa10.urdf" not in document("out")["files"]
    assert document("out")["urdf"]["reason"]

    words = "calibrate pa10 rows.csv --setup setup.yaml --parameters compliance -o bare"
    result = run(words)
    assert result.status == 0
    assert "nothing of this calibration has a place in a URDF" in " ".join(
        result.out.split()
    )
    assert not Path("bare/pa10.urdf").exists()


def test_measurements_that_were_used_are_told(tmp_path, monkeypatch, run):
    monkeypatch.chdir(tmp_path)
    words = "simulate space6 --model position --noise 1e-4 --seed 1"
    assert run(f"{words} --count 40 -o fitted.csv").status == 0
    assert run("plan space6 --model position --count 10 -o plan.csv").status == 0
    assert run(f"{words} --configurations plan.csv -o other.csv").status == 0
    assert run("calibrate space6 fitted.csv --model position -o out").status == 0
    words = "evaluate out/calibration.json"
    assert "fitted.csv: the calibration has used it" in run(f"{words} fitted.csv").err
    assert run(f"{words} other.csv").err == ""
