"""Files of cells as text: what they are, where their header is, and their rows."""

from __future__ import annotations

import gzip
import io
import zipfile

import numpy as np
import pytest

from calib_pin.errors import InputError
from calib_pin.io import table as cells_module
from calib_pin.io.table import Cells, read_cells

LINES = ["# p\xe4th", "a,b", "", "1,\xe4", '" x ","#"', "  ", " # c", "2,"]
KEPT = [(4, ("1", "\xe4")), (5, (" x ", "#")), (8, ("2", ""))]


def rows_of(found: Cells) -> list[tuple[str, ...]]:
    texts = [column.texts() for column in found.columns()]
    return [*zip(*texts, strict=True)]


@pytest.mark.parametrize("count", [1, 2, 1000])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("last", [False, True])
@pytest.mark.parametrize("code", ["utf-8", "utf-8-sig", "utf-16", "latin-1"])
def test_rows_however_they_are_written(monkeypatch, count, end, last, code):
    monkeypatch.setattr(cells_module, "LINES", count)
    progress: list[float] = []
    data = (end.join(LINES) + end * last).encode(code)
    found = read_cells(data, "a.csv", progress.append)
    assert (tuple(found.heading.names), found.heading.line) == (("a", "b"), 2)
    assert [*zip(found.lines, rows_of(found), strict=True)] == KEPT
    assert len(found.remarks) == (code == "latin-1")
    assert progress == sorted(progress) and progress[-1] == 1.0


@pytest.mark.parametrize(
    ("text", "header", "line", "rows"),
    [
        ('a;b\n0,5;"1;5"\n', "a b", 1, [("0.5", "1;5")]),
        ("sep=;\na;b\n1,5;2\n", "a b", 2, [("1.5", "2")]),
        ("a\tb,c\n0,5\t1\n", "a b,c", 1, [("0.5", "1")]),
        # Behind the sign of a comment, as numpy.savetxt and MATLAB write it.
        ("# a,b\n1.5,2\n", "a b", 1, [("1.5", "2")]),
        ("# made by\n% a,b\n1.5,2\n", "a b", 2, [("1.5", "2")]),
        ("//a;b\n1,5;2,5\n", "a b", 1, [("1.5", "2.5")]),
        # Below lines about the recording.
        ("Robot: R1\nDate;2026\n\na;b;c\n1;0,5;2\n", "a b c", 4, None),
        ("Take,1\na,b,c\n1,0.5,2\n", "a b c", 2, None),
        # Blank cells behind the last column.
        ("a,b\n1.5,2,\n3.5,4, ,\n", "a b", 1, [("1.5", "2"), ("3.5", "4")]),
        # Numbers may name columns, and texts alone are rows, too.
        ("1,2\n0.5,0.25\n", "1 2", 1, [("0.5", "0.25")]),
        ("robot,file\nr1,a.csv\n", "robot file", 1, [("r1", "a.csv")]),
        ("a b\n0.5\n", "a b", 1, [("0.5",)]),
    ],
)
def test_headers(text, header, line, rows):
    found = read_cells(text.encode(), "a.csv")
    assert list(found.heading.names) == (
        header.split() if "," in text + ";" else [header]
    )
    assert found.heading.line == line
    assert not found.remarks
    assert rows is None or rows_of(found) == rows


@pytest.mark.parametrize("sign", ["", "# "])
def test_blanks_separate_where_nothing_else_does(sign):
    data = f"{sign}a b [mm]  c\n1.5 2  3\n4.5 x 6\n".encode()
    found = read_cells(data, "a.csv")
    assert tuple(found.heading.names) == ("a", "b [mm]", "c")
    assert rows_of(found) == [("1.5", "2", "3"), ("4.5", "x", "6")]


@pytest.mark.parametrize(
    ("count", "names"),
    [(9, "j1,j2,j3,j4,j5,j6,x,y,z"), (10, "j7,x,y,z"), (12, "rx,ry,rz"), (2, "column")],
)
def test_a_header_to_paste_where_there_is_none(count, names):
    with pytest.raises(InputError) as caught:
        read_cells((",".join(["0.5"] * count) + "\n").encode(), "a.csv")
    assert (caught.value.line, str(count) in caught.value.allowed) == (1, True)
    pasted = caught.value.allowed.split()[-1]
    assert names in pasted and len(pasted.split(",")) == count


def zipped(*names: str) -> bytes:
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w") as archive:
        for name in names:
            archive.writestr(name, "")
    return data.getvalue()


def saved() -> bytes:
    data = io.BytesIO()
    np.save(data, np.zeros((3, 9)))
    return data.getvalue()


@pytest.mark.parametrize(
    ("data", "word"),
    [
        (zipped("[Content_Types].xml", "xl/workbook.xml"), "Excel"),
        (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(512), "Excel"),
        (zipped("q.npy"), "NumPy"),
        (saved(), "NumPy"),
        (zipped("m.csv"), "zip"),
        (gzip.compress(b"a,b\n1,2\n"), "gzip"),
        (b"MATLAB 5.0 MAT-file, Platform: GLNXA64" + bytes(200), "MATLAB"),
        (b'{"joints": [1, 2]}', "JSON"),
        (b"[[0.1, 0.2]]", "JSON"),
        (b"SQLite format 3\x00" + bytes(80), "join"),
        (b"a,b\n1,\x00\n", "NUL"),
        (b"\xff\xfex\x00,", "UTF-16"),
        (b"# only\n\n", "empty"),
        (b"", "empty"),
    ],
    ids=range(14),
)
def test_files_that_are_no_text_are_told_by_what_they_are(data, word):
    with pytest.raises(InputError) as caught:
        read_cells(data, "m.csv")
    assert word in caught.value.reason and caught.value.file == "m.csv"


@pytest.mark.parametrize("count", [1, 2, 1000])
@pytest.mark.parametrize(
    ("data", "line"),
    [
        ('a,b\n1,2\n3,"4\n5,6\n', 3),
        ('a,b\n1,2\n3,"4\n5,"6\n', 3),
        ('a,b\n1,2\n3,"4"4\n', 3),
        ("a,b\n1,2\n\n3\n", 4),
        ("a,b\n1,2\n3,4,5\n", 3),
    ],
)
def test_errors_name_the_line(monkeypatch, count, data, line):
    monkeypatch.setattr(cells_module, "LINES", count)
    with pytest.raises(InputError) as caught:
        read_cells(data.encode(), "a.csv")
    assert (caught.value.file, caught.value.line) == ("a.csv", line)
