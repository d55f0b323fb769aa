"""The commands as users run them: what they print, write and leave alone."""

from __future__ import annotations

import hashlib
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable, Mapping
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import yaml

import calib_pin
import calib_pin.calibration
from calib_pin.cli import main
from calib_pin.cli.asked import COMMANDS
from calib_pin.errors import InputError
from calib_pin.parameterizations import PARAMETERIZATIONS
from calib_pin.residual_models import RESIDUAL_MODELS
from tests.cli.files import document, marked, numbers, table, write

POSITION = "calibrate arm.urdf rows.csv --setup setup.yaml"


# --- as processes ------------------------------------------------------------------


def test_a_mistake_and_help_are_fast():
    """A process that ends with status 1, before anything heavy is imported."""
    program = (
        "import sys; from calib_pin.cli import main; "
        "status = [main(words.split()) for words in ('', '--help', 'calibrate --help', "
        "'robots --colour')]; "
        "heavy = {'numpy', 'scipy', 'pinocchio', 'yaml', 'rich'} & set(sys.modules); "
        "sys.exit(f'imported {heavy}' if heavy else status[-1] + 10 * sum(status))"
    )
    result = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    assert result.returncode == 11, result.stderr
    assert result.stderr.startswith("calib-pin: ") and result.stderr.count("\n") == 1
    assert result.stdout.count("Usage: calib-pin ") == 3


@pytest.mark.parametrize(
    ("redirection", "status"),
    [(">&- 2>&- <&-", 0), ("> /dev/full", 1), ("| head -n 1", 0)],
)
def test_closed_and_full_streams_and_a_reader_that_goes_away(redirection, status):
    program = f"{sys.executable} -m calib_pin --help"
    result = subprocess.run(
        f"{program} {redirection}", shell=True, capture_output=True, text=True
    )
    assert result.returncode == status
    assert result.stderr.count("\n") == status and "internal" not in result.stderr
    assert result.stdout.count("\n") == redirection.count("head")


# --- help and the command line itself ----------------------------------------------


def test_help(run):
    result = run("--help")
    assert result.status == 0
    assert "..." not in result.out.replace("[ARGS]...", "")  # nothing is cut off
    for command in COMMANDS:
        assert f"\n  {command} " in result.out
    assert run("").out == result.out
    assert run("--version").out.startswith("calib-pin 0.")


@pytest.mark.parametrize("command", [*COMMANDS])
def test_help_of_a_command(command, run):
    result = run(f"{command} --help")
    assert result.status == 0
    assert result.out.startswith(f"Usage: calib-pin {command} [OPTIONS]")
    assert not re.search(r"<(str|int|float|list|file|path)", result.out)
    assert max(map(len, result.out.splitlines())) <= 80


def test_help_names_every_parameterization(run):
    # A name that is broken at its hyphen is still one name.
    words = re.sub(r"-\s+", "-", run("identify --help").out)
    assert set(PARAMETERIZATIONS) <= set(re.findall(r"[a-z]+(?:-[a-z]+)*", words))


def test_debug_shows_where_it_failed(here):
    with pytest.raises(InputError):
        main(["--debug", "calibrate", "arm.urdf", "none.csv"])
    with pytest.raises(InputError):
        main(["calibrate", "arm.urdf", "none.csv", "--debug"])


def raising(error: Exception) -> Callable[..., None]:
    def fail(*_: object, **__: object) -> None:
        raise error

    return fail


def test_a_defect_of_ours_is_one_line_too(here, run, monkeypatch):
    fail = raising(ZeroDivisionError("division\nby zero"))
    monkeypatch.setattr("calib_pin.calibration.calibrate", fail)
    result = run(POSITION)
    assert result.status == 1
    assert result.err.count("\n") == 1
    assert "--debug" in result.err and "ZeroDivisionError" in result.err


def test_a_library_that_the_system_lacks_is_no_defect_of_ours(here, run, monkeypatch):
    """Pinocchio without OpenMP, as in the containers `python:3.12-slim`."""
    reason = "libgomp.so.1: cannot open shared object file: No such file or directory"
    lacking = ImportError(reason, name="pinocchio_pywrap_default", path="pywrap.so")
    monkeypatch.setattr("calib_pin.calibration.calibrate", raising(lacking))
    result = run(POSITION)
    assert result.status == 1
    assert result.err == (
        "calib-pin: pinocchio_pywrap_default needs a library of the system (Debian, "
        f"Ubuntu: apt install libgomp1): {reason}\n"
    )


# --- calibrate ---------------------------------------------------------------------

FORMS = yaml.safe_load(Path(__file__).with_name("contract.yaml").read_text())
CONTRACT, QUANTITY = FORMS["calibration"], FORMS["quantity"]
"""Keys by the place of their object."""


def check_form(value: object, form: Mapping[str, str], place: str = "") -> None:
    """Compare keys with a form; further keys are allowed."""
    if isinstance(value, list):
        for item in value:
            check_form(item, form, place)
    elif isinstance(value, dict):
        assert set(form.get(place, "").split()) <= value.keys(), place
        for key, part in value.items():
            check_form(part, form, f"{place}.{key}".strip("."))
    else:
        assert place not in form, f"{place} is {value!r}"


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
    for file in Path("out").iterdir():
        assert f"wrote {file}\n" in result.out

    found = document("out")
    check_form(found, CONTRACT)
    assert list(found)[:5] == ["format", "version", "verdict", "findings", "robot"]
    assert found["format"] == "calib-pin/calibration"
    assert found["version"] == 2
    assert found["verdict"]["status"] == "good"
    assert result.out.startswith("GOOD: ")
    assert list(found["errors"]) == quantities
    for quantity in found["errors"].values():
        check_form(quantity, QUANTITY)
        assert quantity["validation"]["method"] == "5-fold"
        fitted = quantity["training"]
        assert fitted["after"]["rms"] < fitted["before"]["rms"]
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
        status, groups = parameter["status"], parameter["groups"]
        assert (parameter["sigma"] is not None) == (status == "identifiable")
        assert set(groups) <= set(numbers)
        assert groups or status != "coupled"
    assert found["solver"]["name"] == "gauss-newton"
    assert found["solver"]["status"] == "converged"
    assert found["solver"]["seed"] == 7
    words = f"calib-pin {command} -o out --seed 7"
    assert found["provenance"]["command"] == words.split()
    assert ("wall" in found["planes"]) == ("plane" in command)


# Hybrid is differential evolution and more; the option wins over the file.
@pytest.mark.parametrize(
    "solver", [pytest.param("hybrid", marks=pytest.mark.slow), "two-step"]
)
def test_solvers_by_option_and_by_setup_file(here, run, solver):
    with Path("setup.yaml").open("a") as file:
        file.write("solver: {name: de, population_size: 5}\n")
    assert run(f"{POSITION} --solver {solver} -o out").status == 0
    found, plain = document("out"), document("done")
    assert found["solver"]["name"] == solver
    history = found["solver"]["history"]
    assert history == sorted(history, reverse=True)
    if solver == "hybrid":
        assert found["solver"]["evaluator"] == "kernel"
        assert found["solver"]["iterations"] >= len(history) - 1 > 10
    assert found["setup"]["solver"] == {"name": solver, "population_size": 5}
    # The same minimum, whose value rounding moves by less than this.
    expected = pytest.approx(plain["statistics"]["chi2"], rel=1e-6)
    assert found["statistics"]["chi2"] == expected
    # A result says how it was solved, and reads back.
    assert run("evaluate out/calibration.json new.csv").status == 0


def test_inputs_stay_as_they_are(here, run, listing):
    before = listing(here)
    assert run(POSITION).status == 0
    assert listing(here) == before, "without a folder nothing is written"
    for words in (
        f"{POSITION} -o out --validation new.csv",
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
    assert run(f"{POSITION} -o out --quiet").status == 0
    pairs = []
    for folder in ("done", "out"):
        found = document(folder)
        found["provenance"].pop("created")
        found["provenance"]["command"].remove(folder)
        found["solver"].pop("seconds")
        page = TIMES.sub("", Path(folder, "report.html").read_text())
        page = page.replace(f" -o {folder}", "")
        pairs.append((json.dumps(found), Path(folder, "arm.urdf").read_bytes(), page))
    assert pairs[0] == pairs[1]


def test_quiet(here, run):
    Path("rows.csv").write_text(Path("rows.csv").read_text().replace("sigma", "hum"))
    result = run(POSITION)
    assert "rows.csv" in result.err and "hum_x, hum_y, hum_z" in result.err
    result = run(f"{POSITION} -o out --quiet")
    assert (result.status, result.out, result.err) == (0, "", "")
    assert document("out")["verdict"]["status"] == "good"


def test_long_work_tells_each_stage_in_a_line(here, run, monkeypatch):
    monkeypatch.setattr("calib_pin.cli.printing.PATIENCE", -1.0)
    stages = run(POSITION).err.splitlines()
    assert {"calib-pin: read ...", "calib-pin: fit ..."} <= set(stages)
    assert all(one != other for one, other in pairwise(stages))
    assert run(f"{POSITION} --quiet").err == ""


def test_options_win_over_the_setup_file(here, run):
    Path("setup.yaml").write_text(
        "base: link1\ntip: link4\nmodel: pose\nparameters: [placement]\n"
    )
    words = f"{POSITION} -o out --quiet"
    options = "--base base_link --tip tool --model position"
    assert run(f"{words} {options} --parameters dh,joint-offset").status == 0
    found = document("out")
    assert found["robot"]["base"] == "base_link"
    assert found["robot"]["tip"] == "tool"
    assert found["measurements"]["model"] == "position"
    kinds = {parameter["name"].split(".")[1] for parameter in found["parameters"]}
    assert kinds == {"frame", "dh", "joint-offset"}
    assert found["setup"]["parameters"] == ["dh", "joint-offset"]

    # And the file over the defaults.
    Path("setup.yaml").write_text("base: link1\nparameters: [joint-offset]\n")
    words = "identify arm.urdf --setup setup.yaml --model pose --json"
    names = [p["name"] for p in json.loads(run(words).out)["parameters"]]
    assert any("joint2." in name for name in names)
    assert not any("joint1." in name for name in names)


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


@pytest.mark.parametrize("method", ["holdout", "set"])
def test_parts_that_are_held_out(method, here, run):
    if method == "set":
        marked("rows.csv", 4)
    words = " --holdout 0.25" if method == "holdout" else ""
    assert run(f"{POSITION}{words} -o out").status == 0
    found = document("out")
    assert found["errors"]["position"]["validation"]["method"] == method
    assert found["measurements"]["training"] == 30
    assert found["measurements"]["validation"] == 10
    result = run(f"{POSITION} --validation new.csv")
    assert result.status == 0 and ("'set'" in result.err) == (method == "set")


def test_names_that_a_file_system_cannot_hold(here, run):
    text = Path("arm.urdf").read_text()
    Path("arm.urdf").write_text(text.replace('name="arm"', 'name="../[red] ärm: 1"'))
    result = run(f"{POSITION} -o out")
    assert result.status == 0
    assert "../[red] ärm: 1: 4 joints" in result.out
    assert Path("out", "__red__ärm__1.urdf").exists()
    assert document("out")["robot"]["name"] == "../[red] ärm: 1"


# --- beyond geometry ---------------------------------------------------------------

CORRECTED = """\
model: position
parameters: [placement, compliance]
frames: {tool: {xyz: [0.05, 0.08, 0.1], estimate: true}}
payloads: {gripper: {mass: 6, com: [0.02, 0, 0.1]}}
noise: {position: 2.0e-5}
"""


def test_what_is_carried_is_said_and_not_what_a_target_says_otherwise(
    alone, run, refuses
):
    Path("setup.yaml").write_text(CORRECTED)
    words = "simulate pa10 --setup setup.yaml --count 60 --seed 3 -o rows.csv"
    assert run(words).status == 0
    assert run("calibrate pa10 rows.csv --setup setup.yaml -o out").status == 0
    header, rows, _ = table("rows.csv")
    at = header.index("payload")
    write("less.csv", ",".join(header[:at]), [row[:at] for row in rows])
    assert "carry 'gripper'" in run("evaluate out less.csv").err
    assert "carry" not in run("evaluate out rows.csv").err
    write("targets.csv", ",".join(header), rows[:3])
    words = "compensate out targets.csv -o commands.csv"
    assert "commands are for payload 'gripper'" in run(words).err
    rows[2][at] = "none"
    write("targets.csv", ",".join(header), rows[2:3])
    refuses(f"{words} --force", line=3, column="payload", value="none")
    assert "gripper" not in run(f"{words} --payload none --force").err


def test_a_model_ladder(here, run, monkeypatch):
    # Last first: what is put back then stands in its old order.
    for name in reversed(list(RESIDUAL_MODELS)):
        monkeypatch.delitem(RESIDUAL_MODELS, name)
    result = run("calibrate arm.urdf rows.csv --model-ladder -o out")
    assert (result.status, result.err) == (0, "")
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
    size = validation["after"]
    expected = {"unit": "m", "mean": size["mean"], "rms": size["rms"]}
    assert ladder["rungs"][0]["errors"]["position"] == expected
    # The calibration is that of the kept rung.
    assert run("evaluate out/calibration.json new.csv").status == 0
    plain = document("done")
    assert "rungs" not in (plain["model_ladder"] or {})
    assert plain["parameters"] == found["parameters"]


# --- identify ----------------------------------------------------------------------


def test_limits_in_degrees_are_told(here, run):
    text = (here / "arm.urdf").read_text()
    (here / "far.urdf").write_text(
        text.replace('"-2.5" upper="2.5"', '"-145" upper="145"')
    )
    told = run("identify far.urdf --model pose").err
    assert "limits of joint1" in told and "are many turns" in told
    assert "many turns" not in run("identify arm.urdf --model pose").err


def test_structure_as_json(here, run):
    result = run("identify arm.urdf --model pose --json")
    found = json.loads(result.out)
    form = {key: text.replace("observability", "") for key, text in CONTRACT.items()}
    for key in ("parameters", "identifiability"):
        check_form(found[key], form, key)
    assert found["identifiability"]["rank"] == 22
    assert found["verdict"] == {"status": "good", "reason": ""}
    result = run("identify arm.urdf --model pose --parameters placement")
    assert result.status == 0 and "4R + 2P + 6 = 22" in result.out


# --- evaluate ----------------------------------------------------------------------


def test_evaluation_of_a_calibration(here, run):
    result = run("evaluate done/calibration.json rows.csv")
    assert result.status == 0 and "note: rows.csv" in result.err
    # Configurations that were planned for it are not the same measurements.
    words = "simulate truth.urdf --model position --configurations rows.csv -o b.csv"
    assert run(words).status == 0
    assert run("evaluate done/calibration.json b.csv").err == ""

    def errors(words):
        found = json.loads(run(f"evaluate {words} --json").out)
        return found["registered"], found["errors"]["position"]["rms"]

    stored = document("done")["errors"]["position"]["training"]["after"]["rms"]
    registered, fitted = errors("done/calibration.json rows.csv")
    assert not registered
    assert fitted == pytest.approx(stored, rel=1e-9)
    # A tracker that was moved: as it is the calibration fails, registered it does not.
    header, rows, _ = table("rows.csv")
    at = header.index("x")
    for row in rows:
        row[at] = str(float(row[at]) + 0.005)
    write("moved.csv", ",".join(header), rows)
    registered, elsewhere = errors("done/calibration.json moved.csv")
    assert not registered
    assert elsewhere == pytest.approx(0.005, rel=1e-2)
    registered, again = errors("done/calibration.json moved.csv --register")
    assert registered
    assert again == pytest.approx(fitted, rel=0.05)


def test_evaluation_of_a_robot_that_has_changed(here, run):
    """A joint that was homed anew, which no frame takes along."""
    evaluate = "evaluate done/calibration.json {}.csv --register --json"
    assert json.loads(run(evaluate.format("new")).out)["findings"] == []
    header, rows, _ = table("new.csv")
    for row in rows:
        row[1] = str(float(row[1]) + 0.02)
    write("homed.csv", ",".join(header), rows)
    result = run(evaluate.format("homed"))
    (found,) = json.loads(result.out)["findings"]
    assert result.status == 0 and found["code"] == "old-calibration-no-longer-holds"
    assert found["evidence"]["rms"] > 3.0 * found["evidence"]["promised"] > 0.0


# --- simulate ----------------------------------------------------------------------


def test_simulation_of_given_configurations(here, run):
    words = "simulate arm.urdf --model pose --configurations new.csv --noise 0 -o o.csv"
    assert run(words).status == 0
    old, new = table("new.csv"), table("o.csv")
    assert new[0][:4] == old[0][:4]
    assert new[0][4:] == ["x", "y", "z", "qx", "qy", "qz", "qw"]  # and no sigma
    np.testing.assert_array_equal(numbers("o.csv")[:, :4], numbers("new.csv")[:, :4])


def test_simulation_without_noise_and_with_its_truth(here, run):
    words = "simulate arm.urdf --model position --count 30 --errors errors.yaml"
    words += " --parameters joint-offset --noise 0 -o out.csv --truth out.urdf"
    assert run(words).status == 0
    for robot in ("out.urdf", "truth.urdf"):
        found = json.loads(run(f"evaluate {robot} out.csv --json").out)
        assert found["errors"]["position"]["max"] < 1e-9
    # The errors come back.
    words = "calibrate arm.urdf out.csv --parameters joint-offset -o out --quiet"
    assert run(words).status == 0
    values = {p["name"]: p["value"] for p in document("out")["parameters"]}
    assert values["joint2.joint-offset.q"] == pytest.approx(2e-3, abs=1e-9)
    assert values["joint3.joint-offset.q"] == pytest.approx(-3e-3, abs=1e-9)


# --- robots ------------------------------------------------------------------------


def test_robots(run):
    result = run("robots")
    assert (result.status, result.err) == (0, "")
    for name in ("pa10", "space6", "space7"):
        assert f"\n{name} " in f"\n{result.out}"
    assert "base_link -> tool" in result.out


def test_a_bundled_robot_is_copied(alone, run, fails):
    assert run("robots space7 -o copy").status == 0
    words = "calibrate copy/robot.urdf copy/measurements.csv --setup copy/setup.yaml"
    assert run(words).status == 0
    fails("robots space7 -o copy", "copy")


def test_no_urdf_that_is_worse_than_the_nominal_one(alone, run):
    """Geometry that takes compliance for its own errors goes wrong elsewhere."""
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
    assert "note: out/pa10.urdf" in result.err
    assert Path("out/pa10.urdf").read_text() == "of somebody else"
    assert "pa10.urdf" not in document("out")["files"]
    assert document("out")["urdf"]["reason"]


# --- what the environment holds changes no byte of a result -----------------------


ENVIRONMENTS = (
    {
        **{"PYTHONHASHSEED": "0", "LC_ALL": "C", "TZ": "UTC", "COLUMNS": "200"},
        **{"OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"},
    },
    {
        **{"PYTHONHASHSEED": "1", "LC_ALL": "C.UTF-8", "TZ": "Asia/Tokyo"},
        **{"COLUMNS": "40", "OPENBLAS_NUM_THREADS": "3", "NUMBA_NUM_THREADS": "2"},
        **{"OMP_NUM_THREADS": "2"},
    },
)

TIMES = re.compile(
    r'"seconds": [^\n]*|"created": [^\n]*|<dt>(created|time)</dt><dd>[^<]*'
)


@pytest.mark.slow
def test_the_same_bytes_in_any_environment(tmp_path: Path) -> None:
    rows = calib_pin.robot_file("space7", "measurements.csv")
    setup = calib_pin.robot_file("space7", "setup.yaml")
    out, found = tmp_path / "out", []
    for k, environment in enumerate(ENVIRONMENTS):
        folder = tmp_path / f"folder{k}"
        folder.mkdir()
        words = f"calibrate space7 {rows} --setup {setup} -o {out} --force"
        words += " --solver two-step --learned gaussian-process --holdout 0.2"
        subprocess.run(
            [sys.executable, "-m", "calib_pin", *words.split()],
            env={**os.environ, **environment},
            cwd=folder,
            capture_output=True,
            check=True,
        )
        texts = {
            path.name: TIMES.sub("", path.read_text("utf-8")) for path in out.iterdir()
        }
        found.append(texts)
    assert {"calibration.json", "report.html"} <= found[0].keys()
    assert found[0] == found[1]
