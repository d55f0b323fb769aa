"""The process that reads foreign robots: whatever becomes of it costs one line."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from calib_pin.errors import OptionError, RobotError
from calib_pin.io import children
from calib_pin.io.children import converted

ANSWERS = [
    ("import os; os.abort()", "crashes"),
    ("print('{')", "crashes"),
    ("""print('{"reason": "it is wrong", "file": null}')""", "it is wrong"),
]


@pytest.mark.parametrize(("program", "said"), ANSWERS)
def test_no_urdf(tmp_path, refused, monkeypatch, program, said):
    script, file = tmp_path / "script.py", tmp_path / "arm.xml"
    script.write_text(program)
    monkeypatch.setattr(children, "__file__", str(script))
    with refused(RobotError, said, file=str(file)):
        converted("MJCF", file)


def test_an_extra_that_is_missing(refused, monkeypatch):
    monkeypatch.setattr(children, "find_spec", lambda _: None)
    for kind, extra in (("MJCF", "mujoco"), ("xacro", "ros")):
        with refused(OptionError, f"calib-pin[{extra}]"):
            converted(kind, Path("arm"))


REPLICAS = """<mujoco><worldbody><body><joint/>
<replicate count="200000000" offset="1 0 0"><geom size="1"/></replicate>
</body></worldbody></mujoco>"""
LIST = '<robot><link name="${list(range(10 ** 10))}"/></robot>'


@pytest.mark.skipif(sys.platform == "win32", reason="needs limits of memory")
@pytest.mark.parametrize(
    ("kind", "text", "said"),
    [("xacro", LIST, "memory"), ("MJCF", REPLICAS, "more than 3 s")],
)
def test_what_needs_the_limits(tmp_path, refused, monkeypatch, kind, text, said):
    import resource

    pytest.importorskip("mujoco" if kind == "MJCF" else "xacro")
    if kind == "MJCF":
        monkeypatch.setattr(children, "SECONDS", 3.0)
    file = tmp_path / "arm.xml"
    file.write_text(text)
    about = {"arguments": {}, "folders": []} if kind == "xacro" else {}
    with refused(RobotError, said, file=str(file)):
        converted(kind, file, **about)
    used = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    assert used < 2_000_000  # In kB; of all processes that this one has waited for.
