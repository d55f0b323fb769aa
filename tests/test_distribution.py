"""The wheel and the source distribution, installed where nothing else of us is."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tarfile
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest

import calib_pin
from calib_pin.io.children import EXTRAS

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def run(words: list[str], folder: Path) -> str:
    """Run a program in a folder, without what this environment sets for Python."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    done = subprocess.run(
        words, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def distributions(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The files that would be uploaded, the wheel made from the source distribution."""
    folder = tmp_path_factory.mktemp("dist")
    words = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(folder)]
    run([*words, str(ROOT)], folder)
    return {path.suffix: path for path in folder.iterdir()}


@pytest.mark.slow
def test_the_wheel_holds_what_the_package_needs(distributions: dict[str, Path]):
    with zipfile.ZipFile(distributions[".whl"]) as wheel:
        names = wheel.namelist()
        (metadata,) = (n for n in names if n.endswith("METADATA"))
        told = wheel.read(metadata).decode()
    for name in (
        "calib_pin/py.typed",
        "calib_pin/report/page/report.html",
        "calib_pin/report/page/report.typ",
        "calib_pin/report/page/style.css",
        "calib_pin/robots/space7/robot.urdf",
        "calib_pin/robots/space7/measurements.csv",
    ):
        assert name in names
    assert any(name.endswith("licenses/LICENSE") for name in names)
    tops = {name.split("/")[0] for name in names}
    assert tops == {"calib_pin", f"calib_pin-{calib_pin.__version__}.dist-info"}
    assert not [name for name in names if "__pycache__" in name]
    assert f"Version: {calib_pin.__version__}" in told and "# calib-pin" in told


@pytest.mark.slow
def test_the_source_distribution_holds_the_sources_alone(distributions):
    with tarfile.open(distributions[".gz"]) as archive:
        names = archive.getnames()
    tops = {name.split("/")[1] for name in names if "/" in name}
    assert {"calib_pin", "robots", "pyproject.toml", "README.md", "LICENSE"} <= tops
    assert not tops & {".venv", "out", ".pytest_cache", ".mypy_cache", "dist"}


@pytest.mark.slow
def test_it_works_where_it_is_installed(distributions: dict[str, Path], tmp_path: Path):
    """In an environment of its own, which borrows what others have made.

    The wheel is what pip would make of the source distribution.
    """
    home = tmp_path / "venv"
    venv.create(home, with_pip=True)
    python = str(home / "bin" / "python")
    (site,) = (home / "lib").glob("python*/site-packages")
    install = [python, "-m", "pip", "install", "--quiet", "--no-deps"]
    own = [path for path in sys.path if path.endswith("site-packages")]
    # The borrowed ones hold no calib-pin: this checkout is known there by a hook only.
    (site / "borrowed.pth").write_text("\n".join(own) + "\n")
    run([*install, "--no-build-isolation", str(distributions[".whl"])], tmp_path)
    where = run([python, "-c", "import calib_pin; print(calib_pin.__file__)"], tmp_path)
    assert Path(where.strip()).is_relative_to(home)
    assert run([python, "-m", "calib_pin", "--version"], tmp_path) == (
        f"calib-pin {calib_pin.__version__}\n"
    )
    program = str(home / "bin" / "calib-pin")
    assert "space7" in run([program, "robots"], tmp_path)
    run([program, "robots", "space7", "-o", "job"], tmp_path)
    words = [program, "calibrate", "job/robot.urdf", "job/measurements.csv"]
    said = run([*words, "--setup", "job/setup.yaml", "-o", "out"], tmp_path)
    assert "GOOD" in said and (tmp_path / "out" / "report.html").is_file()


def test_messages_name_extras_that_there_are():
    named = {extra for extra, *_ in EXTRAS.values()}
    for path in (ROOT / "calib_pin").rglob("*.py"):
        text = path.read_text("utf-8")
        named |= {*re.findall(r'require_package\("[^)]*", "(\w+)"', text)}
        named |= {*re.findall(r"calib-pin\[(\w+)\]", text)}
    # Nothing needs scikit-learn any more; who asks for it gets it.
    assert named == {*PROJECT["optional-dependencies"]} - {"learn"}


def test_the_changelog_has_this_version():
    text = (ROOT / "CHANGELOG.md").read_text()
    assert re.search(
        rf"^## {re.escape(calib_pin.__version__)} - \d{{4}}-\d\d-\d\d$", text, re.M
    )
