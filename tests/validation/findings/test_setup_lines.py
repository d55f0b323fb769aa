"""What explains measurements in memory is what its lines in a setup file do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import calib_pin
from calib_pin.setup import JointMap
from calib_pin.validation.findings.explanations import JointReading

ARM = calib_pin.load_chain("space6")
JOINTS = ARM.joints


def read(path: Path, columns: np.ndarray, names: list[str], joints: dict) -> np.ndarray:
    header = [*names, "x", "y", "z"]
    rows = np.column_stack([columns, np.full((len(columns), 3), 0.5)])
    text = "\n".join(",".join(map(repr, row)) for row in rows.tolist())
    path.write_text(f"{','.join(header)}\n{text}\n", encoding="utf-8")
    return calib_pin.read_measurements(path, ARM, joints=joints).q


def drawn(rng: np.random.Generator) -> JointReading:
    """Joints that are exchanged, reversed, geared, offset and coupled."""
    order = np.arange(6)
    if rng.uniform() < 0.7:
        some = rng.choice(6, rng.integers(2, 4), replace=False)
        order[some] = np.roll(some, 1)
    factors = np.eye(6)[order] * rng.choice([-1.0, 1.0, 1.01], 6)[:, None]
    for _ in range(rng.integers(3)):
        j, k = sorted(rng.choice(6, 2, replace=False))
        factors[k] += rng.choice([-1.0, 1.0, 0.01]) * factors[j]
    return JointReading(factors, rng.choice([0.0, np.pi / 2, -0.1], 6))


@pytest.mark.parametrize("seed", range(6))
def test_a_file_with_the_lines_is_what_was_tried(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    names, stated = list(JOINTS), {}
    if seed % 2:
        # The user's own maps: other names, a sign and a coupling.
        names = [f"A{k}" for k in range(6)]
        stated = {name: JointMap(j) for name, j in zip(names, JOINTS, strict=True)}
        stated["A1"] = JointMap(JOINTS[1], sign=-1, gear=0.5, offset=0.2)
        stated["A2"] = JointMap(JOINTS[2], coupled={"A1": 1.0})
    columns = rng.uniform(-0.8, 0.8, (4, 6))
    before = read(tmp_path / "before.csv", columns, names, stated)
    reading = drawn(rng)
    lines = reading.maps(JOINTS, stated)
    maps = stated | {name: JointMap(**entry) for name, entry in lines.items()}
    after = read(tmp_path / "after.csv", columns, names, maps)
    np.testing.assert_allclose(after, reading.positions(before), atol=1e-12)


def test_what_a_joint_was_stated_to_be_is_stated_anew() -> None:
    """A map that is undone does not stay in the setup."""
    stated = {JOINTS[0]: JointMap(JOINTS[0], sign=-1)}
    factors = np.diag([-1.0, *[1.0] * 5])
    lines = JointReading(factors, np.zeros(6)).maps(JOINTS, stated)
    assert lines == {JOINTS[0]: {"joint": JOINTS[0]}}
