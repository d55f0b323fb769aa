"""Jobs of several stations, tools and chains, from the command line."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from contextlib import chdir
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calib_pin.cli import main
from calib_pin.io.results import read_calibration
from tests.cli.files import column, document, table, undrawn, write
from tests.shared import joint, urdf_of

ARM = (("0.3 0.1 0.1", "0 1 0"), ("0.5 0 0.05", "0 1 0"), ("0.4 0 0", "0 0 1"))
"""Origin and axis of each joint of an arm."""

CHAINS = """\
chains: {left: {tip: left_3}, right: {tip: right_3}}
parameters: [joint-offset]
tools: {lamp: {xyz: [0.1, 0.05, 0.02], estimate: true}}
noise: {position: 1.0e-4}
"""


def twins() -> str:
    """A robot with a waist and two arms."""
    joints = [joint("turn", "base_link waist", "0 0 0.4", limits="-2 2")]
    for side in ("left", "right"):
        links = ["waist", *(f"{side}_{k}" for k in (1, 2, 3))]
        for k, (place, axis) in enumerate(ARM):
            name, ends = f"{side}_joint{k + 1}", f"{links[k]} {links[k + 1]}"
            joints.append(joint(name, ends, place, axis, limits="-2 2"))
    return urdf_of(*joints, name="twins")


def owners(folder: str, kind: str) -> list[str]:
    """Owners of parameters of a kind in a calibration, each once."""
    names = [p["name"] for p in document(folder)["parameters"]]
    found = (name.rsplit(".", 2) for name in names)
    return list(dict.fromkeys(owner for owner, k, _ in found if k == kind))


@pytest.fixture(scope="module")
def arms(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Measurements and a calibration of a robot with two arms."""
    folder = tmp_path_factory.mktemp("arms") / "work"
    folder.mkdir()
    with chdir(folder), undrawn():
        Path("twins.urdf").write_text(twins())
        Path("chains.yaml").write_text(CHAINS)
        for words in (
            "simulate twins.urdf --model position --setup chains.yaml --count 60 "
            "-o arms.csv --truth true.urdf --seed 1",
            "calibrate twins.urdf arms.csv --setup chains.yaml -o both --quiet "
            "--holdout 0.2",
        ):
            assert main(words.split()) == 0
    return folder


@pytest.fixture
def two_arms(arms: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A copy of them, as the working folder."""
    shutil.copytree(arms, tmp_path / "arms")
    monkeypatch.chdir(tmp_path / "arms")


# --- stations and tools ------------------------------------------------------------


def test_a_station_for_each_file(
    here: Path, run: Callable[..., Any], refuses: Callable[..., None]
) -> None:
    for k, place in enumerate(("[2, 0, 0]", "[0, 1, 1]")):
        setup = f"frames: {{base: {{xyz: {place}, rpy: [0, 0, {k}]}}}}\n"
        Path("place.yaml").write_text(f"tip: tool\n{setup}")
        words = "simulate arm.urdf --model position --setup place.yaml --count 25"
        words += " --errors errors.yaml --parameters joint-offset --noise 1e-4"
        assert run(f"{words} --seed {k} -o day{k}.csv").status == 0
    calibrate = "calibrate arm.urdf day0.csv day1.csv --setup setup.yaml"
    result = run(f"{calibrate} --station-per-file -o out")
    assert result.status == 0
    assert owners("out", "station") == ["day0", "day1"]
    # Targets that say where they were seen are not taken for those of the first one.
    write("targets.csv", "x,y,z,station", [[0.5, 0.4, 0.6, "day1"]])
    words = "compensate out targets.csv -o commands.csv"
    refuses(words, reason="'day0'", line=3, column="station", value="day1")
    assert run(f"{words} --station day1").status in (0, 2)
    same = "identify arm.urdf day0.csv day1.csv --setup setup.yaml"
    assert run(f"{same} --station-per-file --json").status == 0
    new = "evaluate arm.urdf day0.csv day1.csv --tip tool"
    sizes = []
    for option in ("", " --station-per-file"):
        found = json.loads(run(f"{new}{option} --json").out)
        sizes.append(found["errors"]["position"]["rms"])
    assert sizes[0] > 10.0 * sizes[1]


# --- chains ------------------------------------------------------------------------


def test_one_of_the_chains_is_evaluated(two_arms, run, refuses):
    evaluate = "evaluate both/calibration.json arms.csv"
    counts = {}
    for option in ("", " --chain left", " --chain right"):
        found = json.loads(run(f"{evaluate}{option} --json").out)
        counts[option] = found["rows"]
        assert found["errors"]["position"]["rms"] < 3e-4
    assert counts == {"": 60, " --chain left": 30, " --chain right": 30}
    refuses(f"{evaluate} --chain lift", reason="'lift'")
    # Measurements that name no chain are of the one that is asked for.
    header, rows, _ = table("arms.csv")
    at = header.index("chain")
    left = [row[:at] + row[at + 1 :] for row in rows if row[at] == "left"]
    write("left.csv", ",".join(header[:at] + header[at + 1 :]), left)
    for words in (
        "both/calibration.json left.csv --chain left",
        "true.urdf left.csv --tip left_3",
        "true.urdf left.csv --setup chains.yaml --chain left",
    ):
        found = json.loads(run(f"evaluate {words} --json").out)
        assert found["rows"] == 30
        assert found["errors"]["position"]["rms"] < 3e-4


def test_commands_of_one_chain(two_arms, run, refuses):
    arm = read_calibration("both/calibration.json").of("right")
    q = arm.chain.random_configurations(4, np.random.default_rng(0)) * 0.5
    positions = arm.poses(q)[:, :3, 3]
    write("targets.csv", "x,y,z", positions.tolist())
    compensate = "compensate both/calibration.json targets.csv -o commands.csv"
    refuses(compensate, allowed="left, right")
    write("others.csv", "x,y,z,chain", [[*positions[0], "left"]])
    others = compensate.replace("targets", "others")
    refuses(f"{others} --chain right", line=3, column="chain", value="left")
    assert run(f"{compensate} --chain right --position").status == 0
    names = arm.chain.joints
    found = np.array([column("commands.csv", joint) for joint in names], float).T
    np.testing.assert_allclose(arm.poses(found)[:, :3, 3], positions, atol=1e-9)


def test_a_calibration_is_named_by_its_folder(two_arms, run, refuses):
    folder, file = (
        run(f"evaluate {name} arms.csv") for name in ("both", "both/calibration.json")
    )
    assert folder.status == 0
    assert (folder.out, folder.err) == (file.out, file.err)
    refuses("compare both both/calibration.json", reason="twice")
    write("targets.csv", "x,y,z", [[0.5, 0.4, 0.6]])
    words = "compensate both targets.csv --chain left --frame base -o commands.csv"
    assert run(words).status in (0, 2)


def test_frames_of_one_chain(two_arms: None, run: Callable[..., Any]) -> None:
    for option, ends in (("", {"left_3", "right_3"}), (" --chain left", {"left_3"})):
        words = f"export both --format tf -o frames.yaml --force{option}"
        assert run(words).status == 0
        text = Path("frames.yaml").read_text()
        assert {
            end for end in ("left_3", "right_3") if f"frame_id: {end}" in text
        } == ends


@pytest.mark.slow
def test_visits_of_one_chain_are_read_back(two_arms, run):
    """The command that the schedule names takes the file, once it is filled in."""
    plan = "plan twins.urdf --setup chains.yaml --accept --cycles 3 -o visits.csv"
    result = run(f"{plan} --chain left --ignore-collisions")
    assert result.status == 0, result.err
    assert set(column("visits.csv", "chain")) == {"left"}
    assert set(column("visits.csv", "tool")) == {"lamp"}
    header, rows, _ = table("visits.csv")
    measured = [[*row[:-3], "500", str(k), "700"] for k, row in enumerate(rows)]
    write("visits.csv", ",".join(header), measured)
    (words,) = [line for line in result.out.splitlines() if "calib-pin accept" in line]
    assert run(words.split("calib-pin ")[1]).status in (0, 2)


def test_a_plan_for_one_chain_and_for_both(two_arms, run):
    plan = "plan twins.urdf --model position --setup chains.yaml --count 12 "
    plan += "--method greedy --candidates 150 --ignore-collisions --force -o plan.csv"
    result = run(plan)
    assert result.status == 0, result.err
    assert set(column("plan.csv", "chain")) == {"left", "right"}
    assert run(f"{plan} --chain right").status == 0
    assert set(column("plan.csv", "chain")) == {"right"}
    # A plan is a list of configurations to simulate at.
    words = "simulate twins.urdf --model position --setup chains.yaml -o new.csv"
    assert run(f"{words} --configurations plan.csv --force").status == 0
    assert column("new.csv", "chain") == ["right"] * 12


def test_all_chains_are_shown(two_arms, run, opened, refuses):
    view = "view both/calibration.json --port 5"
    assert run(f"{view} arms.csv --plan arms.csv").status == 0
    assert run("view true.urdf arms.csv --setup chains.yaml --port 5").status == 0
    for scene in opened:
        assert scene.chains is not None and scene.rows is not None
        assert scene.chains.names == ("left", "right")
        assert scene.bodies[0].skeleton.links[0] == "base_link"
    assert opened[0].plan is not None
    before, after = opened[0].rows.stages.values()
    sizes = [e.sizes["position"].mean() for e in (before, after)]
    assert sizes[0] > 2.0 * sizes[1]
    (alone,) = opened[1].rows.stages.values()
    assert alone.sizes["position"].mean() < 3e-4
    assert run(f"{view} arms.csv --chain left").status == 0
    assert len(opened[-1].rows.data) == 30
    refuses(f"{view} arms.csv --chain lift", reason="'lift'")
