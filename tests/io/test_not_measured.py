"""Rows that are no measurements: as a file says, or as trackers write a lost target."""

from __future__ import annotations

import pytest

from calib_pin.io.measurements import read_measurements

ROWS = [f"{k},a{k},0.{k},0,0,0.{k},1,2" for k in range(1, 9)]
HEADER = "nr,name,lift,elbow,wrist,x,y,z"


@pytest.fixture
def read(write, arm):
    """Lines of measurements of a file, and what is said of it."""

    def read(*rows: str, header: str = HEADER) -> tuple[list[int], str]:
        told = list[str]()
        file = write("\n".join([header, *rows, ""]))
        data = read_measurements(file, arm(), notice=told.append)
        return data.lines.tolist(), " ".join(told)

    return read


@pytest.mark.parametrize(
    "names", ["Mean", "Min Max Average Std.Dev.", "Mittelwert: Standardabweichung:"]
)
def test_statistics_end_a_file(read, names):
    tail = [f"9,{name},0.5,0,0,0.5,1,2" for name in names.split()]
    lines, told = read(*ROWS, *tail)
    assert lines == [*range(2, 10)] and "from line 10" in told
    tools = [row.replace(f"a{k}", "std") for k, row in enumerate(ROWS, 1)]
    assert len(read(*tools)[0]) == 8
    # These may be names of anything.
    assert len(read(*ROWS, "9,max,0.5,0,0,0.5,1,2")[0]) == 9


@pytest.mark.parametrize(
    ("name", "seen", "lost", "read_as_said"),
    [
        ("valid", "1", "0", True),
        ("body_tracked", "True", "False", True),
        ("Occluded", "no", "yes", True),
        ("Status", "OK", "LOST", True),
        ("status", "i.O.", "n.i.O.", True),
        ("Point status", "OK", "NOK", True),
        ("Status", "OK", "again", False),
        ("status", "0", "1", False),
        ("valid", "0.5", "0", False),
    ],
)
def test_flags(read, name, seen, lost, read_as_said):
    flags = [seen] * 3 + [lost] + [seen] * 4
    rows = (f"{row},{flag}" for row, flag in zip(ROWS, flags, strict=True))
    lines, told = read(*rows, header=f"{HEADER},{name}")
    assert (5 not in lines, "1 rows are left out as lost" in told) == (
        read_as_said,
    ) * 2
    assert len(read(*(f"{row},{lost}" for row in ROWS), header=f"{HEADER},{name}")[0])


@pytest.mark.parametrize("number", ["0", "-999.00", "9999", "inf"])
def test_one_number_three_times_is_no_position(read, number):
    lost = f"{number},{number},{number}"
    lines, told = read(*ROWS, f"9,a,0.1,0,0,{lost}", f"10,b,0.2,0,0,{lost}")
    assert lines == [*range(2, 10)] and "2 of 10 measurements have no reading" in told


def test_a_robot_that_stands_still_may_be_at_the_origin(read):
    assert len(read(*ROWS, *["9,a,0.1,0,0,0,0,0"] * 2)[0]) == 10


@pytest.mark.parametrize("cell", ["no target", "#DIV/0!", "-nan(ind)", "out of sight"])
def test_words_for_no_reading(read, cell):
    lines, told = read(*ROWS, f"9,a,0.1,0,0,1,{cell},2")
    assert lines == [*range(2, 10)] and "no reading" in told
