"""CSV files as text: the same lines and cells wherever the file is cut."""

from __future__ import annotations

import pytest

from calib_pin.errors import InputError
from calib_pin.io import csv_text
from calib_pin.io.csv_text import CsvText, open_csv

LINES = ["# päth", "a,b", "", "1,ä", '" x ","#"', "  ", " # c", "2,"]
KEPT = [(2, "a,b"), (4, "1,ä"), (5, '" x ","#"'), (8, "2,")]


def read(text: CsvText) -> list[tuple[int, str]]:
    return [
        pair
        for stretch in text.stretches()
        for pair in zip(stretch.numbers, stretch.lines, strict=True)
    ]


@pytest.mark.parametrize("block", [1, 3, 8, 1000])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("last", [False, True])
@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_lines_wherever_the_file_is_cut(monkeypatch, tmp_path, block, end, last, mark):
    monkeypatch.setattr(csv_text, "BLOCK", block)
    data = (mark + end.join(LINES) + end * last).encode()
    file = tmp_path / "a.csv"
    file.write_bytes(data)
    assert read(open_csv(file)) == KEPT
    assert read(CsvText("pipe", len(data), data)) == KEPT
    assert open_csv(file).cells(5) == [" x ", "#"]
    progress: list[float] = []
    assert len(list(open_csv(file).stretches(progress.append))) <= len(KEPT)
    assert progress == sorted(progress) and progress[-1] == 1.0


def test_header_and_what_follows(tmp_path):
    file = tmp_path / "a.csv"
    file.write_text("# c\na,b\n\n1,2\n3,4\n")
    first, stretches = open_csv(file).split()
    header = first.cells(0)
    (rest,) = stretches
    assert (first.numbers[0], header) == (2, ["a", "b"])
    assert (rest.numbers, rest.columns(header)) == ([4, 5], [["1", "3"], ["2", "4"]])


def test_the_separator_is_one_parameter(tmp_path):
    file = tmp_path / "a.csv"
    file.write_text('a;b\n0,5;"1;5"\n')
    first, stretches = CsvText(str(file), 15, separator=";").split()
    assert next(iter(stretches)).columns(first.cells(0)) == [["0,5"], ["1;5"]]


@pytest.mark.parametrize("block", [4, 1000])
@pytest.mark.parametrize(
    ("data", "line"),
    [
        (b"a,b\n1,2\n3,\xff\n", 3),
        (b"a,b\n1,2\n\xef\xbb", 3),
        (b"a,b\n1,\x00\n", None),
        (b'a,b\n1,2\n3,"4\n', 3),
        (b"a,b\n1,2\n3\n", 3),
    ],
)
def test_errors_name_the_line(monkeypatch, tmp_path, block, data, line):
    monkeypatch.setattr(csv_text, "BLOCK", block)
    file = tmp_path / "a.csv"
    file.write_bytes(data)
    with pytest.raises(InputError) as caught:
        first, stretches = open_csv(file).split()
        for stretch in stretches:
            stretch.columns(first.cells(0))
    assert (caught.value.file, caught.value.line) == (str(file), line)


def test_lines_that_are_gone(tmp_path):
    file = tmp_path / "a.csv"
    file.write_text("a\n1\n")
    text = open_csv(file)
    file.write_text("# nothing\n")
    for job in (lambda: text.cells(2), text.split):
        with pytest.raises(InputError):
            job()
