"""Columns of directions of approach, temperature and time."""

import numpy as np
import pytest

from calib_pin import load_chain
from calib_pin.errors import InputError
from calib_pin.io.measurements import read_held, read_measurements, write_measurements

ROWS = """
0,0,0,0,0,0,1,0,1,0,20.5,1
0.1,0.2,0,0,0,0,1,0,1,2,21,-1
0.0,0.2,0,0,0,0,1,0,1,1,22,
"""


@pytest.fixture
def chain():
    return load_chain("space6")


@pytest.fixture
def file(tmp_path, chain):
    header = [*chain.joints, "x,y,z,time [min],temperature", chain.joints[1]]
    (tmp_path / "m.csv").write_text(",".join(header) + ".direction" + ROWS)
    return tmp_path / "m.csv"


def test_conditions_are_read_and_written(tmp_path, chain, file):
    again = tmp_path / "again.csv"
    data = read_measurements(file, chain, notice=pytest.fail)
    held = data.conditions
    assert held.time.tolist() == [0, 120, 60]
    assert held.temperature.tolist() == [20.5, 21, 22]
    # What is not stated is by time: the last line was measured second.
    assert held.direction[:, :3].tolist() == [[0, 1, 0], [1, -1, 0], [0, 0, 0]]
    assert held.source == "time"
    write_measurements(again, data)
    assert again.read_text().splitlines()[0].endswith("x,y,z,temperature,time")
    read = read_measurements(again, chain)
    assert read.conditions.time.tobytes() == held.time.tobytes()
    q = read_held(file, chain.joints, data.q)
    np.testing.assert_array_equal(q.direction[:, 1], [1, -1, 0])


def test_stated_directions_are_written(tmp_path, chain):
    ends = [f"{joint}.direction" for joint in chain.joints]
    file, again = tmp_path / "m.csv", tmp_path / "again.csv"
    head = ",".join([*chain.joints, "x", "y", "z", *ends])
    file.write_text(f"{head}\n" + "0,0,0,0,0,0,1,0,1,1,-1,1,1,1,1\n" * 2)
    data = read_measurements(file, chain, notice=pytest.fail)
    assert data.conditions.source == "columns"
    write_measurements(again, data)
    read = read_measurements(again, chain)
    np.testing.assert_array_equal(read.conditions.direction, data.conditions.direction)
    assert read.conditions.source == "columns"


def test_a_date_is_no_time(tmp_path, chain):
    notices: list[str] = []
    file = tmp_path / "m.csv"
    file.write_text(
        f"{','.join(chain.joints)},x,y,z,time,temperature\n"
        "0,0,0,0,0,0,1,0,1,2026-11-24,20\n1,0,0,0,0,0,1,0,1,2026-11-25,\n"
    )
    held = read_measurements(file, chain, notice=notices.append).conditions
    assert (held.time.size, held.temperature.size, held.source) == (0, 0, "order")
    assert notices == [f"{file}: columns ignored: time, temperature"]


def test_a_direction_that_is_none(chain, file):
    file.write_text(file.read_text().replace("21,-1", "21,up"))
    with pytest.raises(InputError) as caught:
        read_measurements(file, chain)
    assert (caught.value.line, caught.value.value) == (3, "up")
    assert caught.value.column == f"{chain.joints[1]}.direction"
