"""Jobs of several stations, tools and chains, from the command line."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calib_pin.io.results import read_calibration
from calib_pin.viewer.scene import Scene

JOINT = """  <joint name="{name}" type="revolute">
    <origin xyz="{xyz}"/>
    <parent link="{parent}"/><child link="{child}"/><axis xyz="{axis}"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/>
  </joint>
"""

ARM = (("0.3 0.1 0.1", "0 1 0"), ("0.5 0 0.05", "0 1 0"), ("0.4 0 0", "0 0 1"))
"""Origin and axis of each joint of an arm."""

CHAINS = """\
chains: {left: {tip: left_3}, right: {tip: right_3}}
parameters: [joint-offset]
tools: {lamp: {xyz: [0.1, 0.05, 0.02], estimate: true}}
noise: {position: 1.0e-4}
"""

STATIONS = """\
tip: tool
parameters: [joint-offset]
stations:
  day1: {xyz: [2, 0, 0.5], rpy: [0, 0.1, 3]}
  day2: {xyz: [0, 2, 0.5], rpy: [0.2, 0, -1.5]}
tools: {ball: {xyz: [0.1, 0, 0]}, probe: {xyz: [0, 0.1, 0.1]}}
noise: {position: 1.0e-4}
"""


def twins() -> str:
    """A robot with a waist and two arms."""
    links, joints = ["base_link", "waist"], [("turn", "base_link", "waist")]
    text = JOINT.format(
        name="turn", xyz="0 0 0.4", parent="base_link", child="waist", axis="0 0 1"
    )
    for side in ("left", "right"):
        parent = "waist"
        for k, (xyz, axis) in enumerate(ARM, 1):
            link = f"{side}_{k}"
            links.append(link)
            joints.append((f"{side}_joint{k}", parent, link))
            text += JOINT.format(
                name=f"{side}_joint{k}", xyz=xyz, parent=parent, child=link, axis=axis
            )
            parent = link
    bodies = "".join(f'  <link name="{link}"/>\n' for link in links)
    return f'<?xml version="1.0"?>\n<robot name="twins">\n{bodies}{text}</robot>\n'


def column(file: str, name: str) -> list[str]:
    lines = [k for k in Path(file).read_text().splitlines() if not k.startswith("#")]
    return [row[name] for row in csv.DictReader(lines)]


def owners(file: str, kind: str) -> list[str]:
    """Owners of parameters of a kind in a calibration, each once."""
    names = [p["name"] for p in json.loads(Path(file).read_text())["parameters"]]
    found = (name.rsplit(".", 2) for name in names)
    return list(dict.fromkeys(owner for owner, k, _ in found if k == kind))


@pytest.fixture
def two_arms(here: Path, run: Callable[..., Any]) -> None:
    """Measurements and a calibration of a robot with two arms."""
    Path("twins.urdf").write_text(twins())
    Path("chains.yaml").write_text(CHAINS)
    for words in (
        "simulate twins.urdf --model position --setup chains.yaml --count 60 "
        "-o arms.csv --truth true.urdf --seed 1",
        "calibrate twins.urdf arms.csv --setup chains.yaml -o both --quiet",
    ):
        result = run(words)
        assert result.status == 0, (words, result.err)


# --- stations and tools ------------------------------------------------------------


def test_stations_and_tools_of_a_setup(here: Path, run: Callable[..., Any]) -> None:
    Path("stations.yaml").write_text(STATIONS)
    simulate = "simulate arm.urdf --model position --setup stations.yaml --count 60"
    assert run(f"{simulate} -o job.csv").status == 0
    assert set(column("job.csv", "station")) == {"day1", "day2"}
    assert set(column("job.csv", "tool")) == {"ball", "probe"}
    result = run("calibrate arm.urdf job.csv --setup stations.yaml -o out")
    assert result.status == 0
    said = "position (2 stations, 2 tools), 60 measurements fitted"
    assert said in " ".join(result.out.split())
    assert owners("out/calibration.json", "station") == ["day1", "day2"]
    assert owners("out/calibration.json", "tool") == ["ball", "probe"]
    assert run("evaluate out/calibration.json job.csv").status == 0


def test_a_station_for_each_file(here: Path, run: Callable[..., Any]) -> None:
    for k, place in enumerate(("[2, 0, 0]", "[0, 1, 1]")):
        setup = f"frames: {{base: {{xyz: {place}, rpy: [0, 0, {k}]}}}}\n"
        Path("place.yaml").write_text(f"tip: tool\n{setup}")
        assert (
            run(
                "simulate arm.urdf --model position --setup place.yaml --count 25 "
                "--errors errors.yaml --parameters joint-offset --noise 1e-4 "
                f"--seed {k} -o day{k}.csv"
            ).status
            == 0
        )
    calibrate = "calibrate arm.urdf day0.csv day1.csv --setup setup.yaml"
    result = run(f"{calibrate} --station-per-file -o out")
    assert result.status == 0
    assert owners("out/calibration.json", "station") == ["day0", "day1"]
    assert run(calibrate).status == 2
    same = "identify arm.urdf day0.csv day1.csv --setup setup.yaml"
    assert run(f"{same} --station-per-file --json").status == 0
    new = "evaluate arm.urdf day0.csv day1.csv --tip tool"
    sizes = []
    for option in ("", " --station-per-file"):
        found = json.loads(run(f"{new}{option} --json").out)
        sizes.append(found["errors"]["position"]["rms"])
    assert sizes[0] > 10.0 * sizes[1]


def test_files_that_name_their_stations(
    here: Path, refuses: Callable[..., None]
) -> None:
    lines = Path("rows.csv").read_text().splitlines()
    start = next(k for k, line in enumerate(lines) if not line.startswith("#"))
    named = [lines[start] + ",station", *(f"{k},day1" for k in lines[start + 1 :])]
    Path("named.csv").write_text("\n".join(named))
    refuses(
        "calibrate arm.urdf named.csv --setup setup.yaml --station-per-file",
        file="named.csv",
        column="station",
    )


# --- chains ------------------------------------------------------------------------


def test_two_arms_in_one_fit(two_arms: None) -> None:
    assert set(column("arms.csv", "chain")) == {"left", "right"}
    truth = Path("true.urdf").read_text()
    found = read_calibration("both/calibration.json")
    assert found.measured_chains == ("left", "right")
    assert (
        truth != Path("both/twins.urdf").read_text() != Path("twins.urdf").read_text()
    )


def test_one_of_the_chains_is_evaluated(
    two_arms: None, run: Callable[..., Any], refuses: Callable[..., None]
) -> None:
    evaluate = "evaluate both/calibration.json arms.csv"
    counts = {}
    for option in ("", " --chain left", " --chain right"):
        found = json.loads(run(f"{evaluate}{option} --json").out)
        counts[option] = found["rows"]
        assert found["errors"]["position"]["rms"] < 3e-4
    assert counts == {"": 60, " --chain left": 30, " --chain right": 30}
    refuses(f"{evaluate} --chain lift", reason=("chain 'lift'", "mean 'left'"))
    # Measurements that name no chain are of the one that is asked for.
    lines = [k for k in Path("arms.csv").read_text().splitlines() if k[0] != "#"]
    place = lines[0].split(",").index("chain")
    left = [k.split(",") for k in lines if k.split(",")[place] != "right"]
    text = [",".join(w for k, w in enumerate(row) if k != place) for row in left]
    Path("left.csv").write_text("\n".join(text))
    found = json.loads(
        run("evaluate both/calibration.json left.csv --chain left --json").out
    )
    assert found["rows"] == 30
    assert found["errors"]["position"]["rms"] < 3e-4
    found = json.loads(run("evaluate true.urdf left.csv --tip left_3 --json").out)
    assert found["errors"]["position"]["rms"] < 3e-4
    setup = "--setup chains.yaml --chain left"
    found = json.loads(run(f"evaluate true.urdf left.csv {setup} --json").out)
    assert found["errors"]["position"]["rms"] < 3e-4


def test_names_of_chains_in_files(two_arms: None, refuses: Callable[..., None]) -> None:
    text = Path("arms.csv").read_text().replace(",left,", ",lefty,", 1)
    Path("bad.csv").write_text(text)
    refuses(
        "calibrate twins.urdf bad.csv --setup chains.yaml",
        file="bad.csv",
        line=3,
        column="chain",
        value="lefty",
        reason="did you mean 'left'",
    )


def test_commands_of_one_chain(
    two_arms: None, run: Callable[..., Any], refuses: Callable[..., None]
) -> None:
    arm = read_calibration("both/calibration.json").of("right")
    q = arm.chain.random_configurations(4, np.random.default_rng(0)) * 0.5
    positions = arm.poses(q)[:, :3, 3]
    rows = "\n".join(",".join(map(str, row)) for row in positions)
    Path("targets.csv").write_text(f"x,y,z\n{rows}\n")
    compensate = "compensate both/calibration.json targets.csv -o commands.csv"
    refuses(compensate, reason="several chains", allowed="left, right")
    refuses(f"{compensate} --chain rihgt", reason=("chain 'rihgt'", "mean 'right'"))
    refuses(
        f"{compensate} --chain right --tool lmp", reason=("tool 'lmp'", "mean 'lamp'")
    )
    assert run(f"{compensate} --chain right --position").status == 0
    names = arm.chain.joints
    found = np.array([column("commands.csv", joint) for joint in names], float).T
    np.testing.assert_allclose(arm.poses(found)[:, :3, 3], positions, atol=1e-9)


def test_a_plan_for_one_chain_and_for_both(
    two_arms: None, run: Callable[..., Any]
) -> None:
    plan = "plan twins.urdf --model position --setup chains.yaml --count 12 "
    plan += "--method greedy --candidates 150 --ignore-collisions --force -o plan.csv"
    result = run(plan)
    assert result.status == 0, result.err
    assert set(column("plan.csv", "chain")) == {"left", "right"}
    assert "Configurations: " in result.out and " of left" in result.out
    assert run(f"{plan} --chain right").status == 0
    assert set(column("plan.csv", "chain")) == {"right"}
    # A plan is a list of configurations to simulate at.
    words = "simulate twins.urdf --model position --setup chains.yaml -o new.csv"
    assert run(f"{words} --configurations plan.csv --force").status == 0
    assert column("new.csv", "chain") == ["right"] * 12
    assert run(plan).status == 0
    assert run(f"{words} --configurations plan.csv --force").status == 0
    assert column("new.csv", "chain") == column("plan.csv", "chain")


def test_all_chains_are_shown(
    two_arms: None,
    run: Callable[..., Any],
    opened: list[Scene],
    refuses: Callable[..., None],
) -> None:
    view = "view both/calibration.json --port 5"
    assert run(f"{view} arms.csv --plan arms.csv").status == 0
    assert run("view true.urdf arms.csv --setup chains.yaml --port 5").status == 0
    for scene in opened:
        assert scene.chains is not None and scene.rows is not None
        assert scene.chains.names == ("left", "right")
        assert scene.bodies[0].skeleton.links[0] == "base_link"
        assert {k: m.sum() for k, m in scene.rows.blocks.items()} == {
            "all": 60,
            "left": 30,
            "right": 30,
        }
    assert opened[0].plan is not None and len(opened[0].plan.paths) == 2
    before, after = opened[0].rows.stages.values()
    sizes = [e.quantities["position"].sizes.mean() for e in (before, after)]
    assert sizes[0] > 2.0 * sizes[1]
    (alone,) = opened[1].rows.stages.values()
    assert alone.quantities["position"].sizes.mean() < 3e-4
    assert run(f"{view} arms.csv --chain left").status == 0
    assert len(opened[-1].rows.data) == 30
    refuses(f"{view} arms.csv --chain lift", reason=("chain 'lift'", "mean 'left'"))
