"""What several tests need. Test modules cannot import each other, so all are fixtures.

A test that asks for `example_robot` runs once for every URDF of example-robot-data.
"""

from __future__ import annotations

import importlib.metadata
import io
import logging
import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pinocchio as pin
import pytest

from calib_pin.chain import Chain
from calib_pin.io.urdf import parse_robot


def example_robots() -> list[Path]:
    """Every URDF of example-robot-data, sorted."""
    data = importlib.metadata.distribution("example-robot-data").locate_file(
        "cmeel.prefix/share/example-robot-data"
    )
    # ur3.urdf is what xacro made of a file of macros: no name, no links.
    found = sorted(Path(str(data)).rglob("*.urdf"))
    return [path for path in found if path.name != "ur3.urdf"]


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "example_robot" in metafunc.fixturenames:
        metafunc.parametrize("example_robot", example_robots(), ids=lambda p: p.stem)


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """Folder of the real measurements, which are not in the repository."""
    beside = Path(__file__).parents[2] / "shared" / "data"
    folder = Path(os.environ.get("CALIB_PIN_DATA", beside))
    if not folder.is_dir():
        pytest.skip(f"no real measurements in {folder}: set CALIB_PIN_DATA to them")
    return folder


@pytest.fixture(scope="session")
def urdf_of() -> Callable[..., str]:
    """Text of a URDF: `urdf_of({"name": "j", "parent": "a", "child": "b", ...}, ...)`.

    Further keys of a joint: `type` (revolute), `placement` (SE3), `axis` (0 0 1),
    `limits` (lower, upper), `more` (XML inside the joint). Joints to come later in
    the tree may come first.
    """

    def text(*joints: Mapping[str, Any]) -> str:
        links = dict.fromkeys(
            link for joint in joints for link in (joint["parent"], joint["child"])
        )
        lines = [f'<link name="{link}"/>' for link in links]
        for joint in joints:
            kind = joint.get("type", "revolute")
            placement = joint.get("placement", pin.SE3.Identity())
            angles = pin.rpy.matrixToRpy(placement.rotation)
            axis = joint.get("axis", (0, 0, 1))
            lines += [
                f'<joint name="{joint["name"]}" type="{kind}">',
                f'  <origin xyz="{_numbers(placement.translation)}" '
                f'rpy="{_numbers(angles)}"/>',
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
        return "\n".join(['<robot name="test">', *lines, "</robot>"])

    return text


@pytest.fixture(scope="session")
def chain_of() -> Callable[..., Chain]:
    """Chain of a URDF given as text: `chain_of(text, base, tip)`."""

    def make(urdf: str, base: str | None = None, tip: str | None = None) -> Chain:
        return Chain(parse_robot(urdf.encode(), "test.urdf"), base, tip)

    return make


@pytest.fixture(scope="session")
def independent_poses() -> Callable[..., Any]:
    """Forward kinematics that share no code with ours or with Pinocchio.

    Call with the bytes of a URDF, joint positions by name, and pairs (base, tip);
    returns `T_base_tip` of each pair, from yourdfpy.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import yourdfpy
    logging.getLogger("yourdfpy").setLevel(logging.ERROR)

    def poses(
        urdf: bytes, q: Mapping[str, float], frames: Sequence[tuple[str, str]]
    ) -> list[Any]:
        robot = yourdfpy.URDF.load(
            io.BytesIO(urdf), load_meshes=False, build_collision_scene_graph=False
        )
        robot.update_cfg(dict(q))
        return [robot.get_transform(tip, base) for base, tip in frames]

    return poses


def _numbers(values: Any) -> str:
    return " ".join(repr(float(value)) for value in values)
