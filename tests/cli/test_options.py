"""Options: declared once, and named as they are."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import calib_pin
from calib_pin.cli.application import application

ADDED = '''
import sys
from pathlib import Path
from typing import Annotated
import calib_pin.calibration
import calib_pin.cli.options as request

class More(request.Request):
    """One more field.

    Attributes:
        pose_weight: How much poses count.
    """

    pose_weight: Annotated[float | None, request.Spec("W")] = None

request.Request = More
from calib_pin import robot_file
from calib_pin.cli import main
from calib_pin.cli.jobs import read_jobs, request_of

def fitted(*chains, pose_weight, **others):
    print("python:", pose_weight)
    sys.exit(0)

calib_pin.calibration.calibrate = fitted
main(["calibrate", "--help"])
Path("jobs.csv").write_text("robot,measurements,pose_weight\\nspace7,a.csv,2.5\\n")
(job,) = read_jobs("jobs.csv")
asked = request_of(job, Path("out"))
print("job:", asked.pose_weight, *asked.words(Path("out")))
rows = str(robot_file("space7", "measurements.csv"))
main(["calibrate", "space7", rows, "--pose-weight", "2.5"])
'''


def test_a_new_field_is_an_option_a_key_a_word_and_an_argument(tmp_path) -> None:
    ran = subprocess.run(
        [sys.executable, "-c", ADDED], cwd=tmp_path, capture_output=True, text=True
    )
    assert ran.returncode == 0, ran.stderr
    assert "--pose-weight W" in ran.stdout and "How much poses count." in ran.stdout
    assert "job: 2.5 calib-pin calibrate space7 a.csv --pose-weight 2.5" in ran.stdout
    assert ran.stdout.endswith("python: 2.5\n")


# --- options that are named -------------------------------------------------------


FOREIGN = {"--frame-id", "--child-frame-id"}
"""Options of other programs."""

NAMED = re.compile(r"(?:\b([a-z-]+) )?(--[a-z][a-z-]*[a-z])")


def test_every_option_that_is_named_exists() -> None:
    """And of the command that is named before it."""
    commands = application([]).commands
    options = {
        name: {word for p in command.params for word in (*p.opts, *p.secondary_opts)}
        for name, command in commands.items()
    }
    every = set().union(*options.values(), {"--help", "--version", "--debug"})
    for file in Path(calib_pin.__file__).parent.rglob("*.py"):
        for command, option in NAMED.findall(file.read_text()):
            known = options.get(command, every) | {"--help"}
            assert option in known | FOREIGN, f"{file}: {command} {option}"
