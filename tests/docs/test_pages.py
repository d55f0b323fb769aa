"""Pages that quote: the code of an instrument, and files of others as they are."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import pytest

from calib_pin.cli import main
from documentation.blocks import ROOT, blocks

EXTENDING = ROOT / "docs" / "extending.md"


@pytest.mark.parametrize(
    "file",
    ["tests/data/plugins/theodolite.py", "tests/parameterizations/outside/poe.py"],
)
def test_the_code_of_a_page_is_that_of_a_file_that_is_tested(file: str):
    shown = [b.text for b in blocks(EXTENDING.read_text()) if b.language == "python"]
    assert (ROOT / file).read_text() in shown


@pytest.mark.slow
def test_the_setup_of_a_published_file_reads_it(
    data_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
):
    """The UR10's measurements with the separators and names of their authors."""
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs" / "benchmarks.md").read_text()
    setup = next(b.text for b in blocks(page) if b.text.startswith("# ur10.yaml"))
    Path("ur10.yaml").write_text(setup)
    with (data_folder / "ur10_tmac" / "train.csv").open() as file:
        rows = list(csv.DictReader(line for line in file if line[0] != "#"))
    with Path("published.csv").open("w", newline="") as file:
        writer = csv.writer(file, delimiter=";")
        joints = [name for name in rows[0] if name.endswith("_joint")]
        named = {f"measurement_{axis}": axis for axis in "xyz"}
        writer.writerow(["Timestamp", *joints, *named])
        for number, row in enumerate(rows):
            values = [float(row[joint]) for joint in joints]
            values += [float(row[f"{axis} [mm]"]) for axis in named.values()]
            cells = (f"{value:.9f}".replace(".", ",") for value in values)
            writer.writerow([20200714163904 + number, *cells])
    words = "calibrate example:ur10_robot published.csv --setup ur10.yaml -o out"
    assert main([*words.split(), "--holdout", "0.2"]) == 0
    said = re.sub(r"\s+", " ", capsys.readouterr().out)
    after, before = re.findall(r"(0\.\d+) mm rms instead of (0\.\d+) mm", said)[0]
    assert float(after) < 0.75 * float(before) and 0.7 < float(before) < 1.0
