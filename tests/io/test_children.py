"""The process that reads foreign robots: whatever becomes of it costs one line."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from calib_pin.errors import OptionError, RobotError
from calib_pin.io import children
from calib_pin.io.children import converted
from tests.shared import refused

ANSWERS = [
    ("import os; os.abort()", "crashes"),
    ("print('{')", "crashes"),
    ("""print('{"reason": "it is wrong", "file": null}')""", "it is wrong"),
]


@pytest.mark.needs("mujoco")
@pytest.mark.parametrize(("program", "said"), ANSWERS)
def test_no_urdf(tmp_path, monkeypatch, program, said):
    script, file = tmp_path / "script.py", tmp_path / "arm.xml"
    script.write_text(program)
    monkeypatch.setattr(children, "__file__", str(script))
    with refused(RobotError, said, file=str(file)):
        converted("MJCF", file)


def test_an_extra_that_is_missing(monkeypatch):
    monkeypatch.setattr("calib_pin.errors.find_spec", lambda _: None)
    for kind, extra in (("MJCF", "mujoco"), ("xacro", "ros")):
        with refused(OptionError, f"calib-pin[{extra}]"):
            converted(kind, Path("arm"))


REPLICAS = """<mujoco><worldbody><body><joint/>
<replicate count="200000000" offset="1 0 0"><geom size="1"/></replicate>
</body></worldbody></mujoco>"""
LIST = '<robot><link name="${list(range(10 ** 10))}"/></robot>'


MEASURED = """import json, resource, sys
from pathlib import Path
from calib_pin.errors import RobotError
from calib_pin.io import children
kind, file, children.SECONDS = sys.argv[1], Path(sys.argv[2]), float(sys.argv[3])
try:
    children.converted(kind, file, **json.loads(sys.argv[4]))
except RobotError as error:
    print(error)
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="needs limits of memory")
@pytest.mark.parametrize(
    ("kind", "text", "said"),
    [("xacro", LIST, "memory"), ("MJCF", REPLICAS, "more than 1 s")],
)
def test_what_needs_the_limits(tmp_path, kind, text, said):
    pytest.importorskip("mujoco" if kind == "MJCF" else "xacro")
    file = tmp_path / "arm.xml"
    file.write_text(text)
    about = {"arguments": {}, "folders": []} if kind == "xacro" else {}
    seconds = "1" if kind == "MJCF" else "30"
    # Asked by a process of its own: this one has had children and memory of all kinds.
    command = [sys.executable, "-c", MEASURED, kind, str(file), seconds]
    done = subprocess.run(
        [*command, json.dumps(about)], capture_output=True, text=True, check=True
    )
    reason, used = done.stdout.splitlines()
    assert str(file) in reason
    assert said in reason
    assert int(used) < 2_000_000  # In kB.
