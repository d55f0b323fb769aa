"""Tables: what files are, where their header is, their rows, and cells by column."""

from __future__ import annotations

import csv
import gzip
import random
from dataclasses import replace

import numpy as np
import pytest

from calib_pin.errors import InputError
from calib_pin.io import table as table_module
from calib_pin.io.columns import LENGTH, MISSING, PURE
from calib_pin.io.table import Cells, read_cells, read_table, require_columns
from calib_pin.units import as_number
from tests.shared import refused

ODD = [
    *("1_000", "inf", "nan", "+1", "-0", "1e5", ".5", "5.", "0x1p3", "1j", "1#2", ""),
    *("true", "null", "ball", "1e400", "0.10", "007", "  ", " 1.5 ", '"1.0"', '"a,b"'),
    *('"a""b"', "\u00a01", "\u0663", "9007199254740993", "2.2250738585072011e-308"),
]
COMMENTS = ("# c", "", "  ", ' # "x', "\t")


def spoiled(rng: random.Random) -> list[str]:
    """Lines of a table with odd cells and lines that are no rows."""
    width = rng.randint(1, 5)
    named = rng.random() < 0.5
    lines = [",".join(f"c{k}" for k in range(width))]
    for _ in range(rng.randint(1, 20)):
        cells = [repr(rng.uniform(-4.0, 4.0)) for _ in range(width)]
        if named:
            cells[-1] = rng.choice(["ball", "ball_1", "01", "2"])
        if rng.random() < 0.2:
            cells[rng.randrange(width)] = rng.choice(ODD)
        lines.append(",".join(cells) or '""')
        if rng.random() < 0.1:
            lines.append(rng.choice(COMMENTS))
    return lines


@pytest.mark.parametrize("count", [3, 4096])
def test_cells_and_numbers_are_those_of_every_line_alone(monkeypatch, table, count):
    monkeypatch.setattr(table_module, "LINES", count)
    rng = random.Random(1)
    for _ in range(25):
        lines = spoiled(rng)
        found = table(rng.choice(["\n", "\r\n"]).join([*lines, ""]), names=None)
        rows = {
            at: next(csv.reader([line], skipinitialspace='"' in line))
            for at, line in enumerate(lines, start=1)
            if line.strip() and not line.strip().startswith("#")
        }
        assert [found.header_line, *found.lines] == list(rows)
        header, *body = rows.values()
        for name, expected in zip(header, zip(*body, strict=True), strict=True):
            column = found.columns[name]
            assert found.texts([name])[name] == tuple(map(str.strip, expected))
            gone = [bool(MISSING.fullmatch(cell.strip())) for cell in expected]
            assert column.missing().tolist() == gone
            known = map(as_number, map(str.strip, expected))
            numbers = np.array([np.nan if n is None else n for n in known])
            assert column.numbers.tobytes() == numbers.tobytes()
            for row, cell in enumerate(expected):
                assert column.text(row) == cell.strip()
            if np.isfinite(numbers).all():
                assert found.numbers(name, PURE).tobytes() == numbers.tobytes()
                continue
            row = int(np.argmin(np.isfinite(numbers)))
            with pytest.raises(InputError) as caught:
                found.numbers(name, PURE)
            assert caught.value.line == found.lines[row]
            assert caught.value.column == name
            assert caught.value.value == expected[row].strip()


def test_numbers_are_texts_in_columns_of_names(table):
    found = table("# c\ntarget,x [mm]\n 01,1.50\n\n1e0,2.50\n3,7\n")
    assert found.texts(["target", "note"]) == {"target": ("01", "1e0", "3")}
    some = found.rows(np.array([2, 1]))
    assert some.texts(["target"]) == {"target": ("3", "1e0")}
    assert some.columns["x"].texts() == ("7", "2.5")
    assert some.numbers("x", LENGTH).tolist() == [7e-3, 2.5e-3]
    error = some.error("too large", "x", row=1)
    assert (error.line, error.value) == (5, "2.5")
    found = table("target,x\n1.10,01\n1.10,02\n1.1,03\n1.1,a\n1.10,04\n")
    assert found.labels("target") == ("1.10", "1.10", "1.1", "1.1", "1.10")
    assert found.labels("x") == ("1", "2", "3", "a", "4")


def test_repeated_names_are_kept_once(table):
    found = table("x,name\n" + "1,ball\n2,wall\n" * 50)
    assert found.columns["name"].words == ("ball", "wall")
    with pytest.raises(ValueError):
        found.numbers("x", PURE)[0] = 0.0
    found = table("x,name\n1, wall\n2,ball\n3,wall \n").texts(["name"])["name"]
    assert (found.names, found.codes.tolist()) == (("wall", "ball"), [0, 1, 0])


def test_columns_that_are_there_twice(table):
    assert table("x,n,x\n1,a,1\n,b,\n").columns.keys() == {"x", "n"}
    for text in ("x,x\n1,1\n1,2\n", "n,n\na,a\na,b\n", "x,x [mm]\n1,1\n"):
        with pytest.raises(InputError, match="two columns"):
            table(text)


LOG = "Zeit;Ort;X (mm);Y [mm]\n0,5;Wand, links;1,25;-,5e3\n1;v1.5;3;-7\n"


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-be"])
@pytest.mark.parametrize("mark", [";", "\t"])
def test_foreign_files_are_read_as_the_setup_says(tmp_path, encoding, mark):
    file = tmp_path / "log.csv"
    text = LOG.replace(";", mark)
    bom = "\ufeff" * (encoding == "utf-16-be")
    file.write_bytes((bom + text).encode(encoding))
    names = {"x": "X (mm) [mm]", "y": "Y [mm]", "target": "Ort", "time": "Zeit"}
    table = read_table(file, columns=names)
    assert list(table.columns) == ["time", "target", "x", "y"]
    assert table.numbers("x", LENGTH).tolist() == [0.00125, 0.003]
    assert table.numbers("y", LENGTH).tolist() == [-0.5, -0.007]
    assert list(table.texts(["target"])["target"]) == ["Wand, links", "v1.5"]
    assert list(table.texts(["time"])["time"]) == ["0.5", "1"]
    assert table.columns["x"].text(0) == "1.25"


def test_a_column_that_has_the_name_of_another_meaning_keeps_its_place(table):
    found = table("x,y,X\n1,2,3\n", {"x": "X", "z": "Z"})
    assert found.numbers("x", LENGTH).tolist() == [3.0]
    assert found.ignored([n for n in found.columns if n != "x"]).endswith("x, y")
    assert found.missing == {"z": "Z"}


@pytest.mark.parametrize(
    ("columns", "names"),
    [
        ({"x": "XX"}, ("'x'", "'XX'")),
        ({"x": "X (m)"}, ("'X (mm)'",)),
        ({"x": "Y", "y": "Y"}, ("'x'", "'y'")),
        ({"y": "Y [m]"}, ("[mm]", "[m]")),
    ],
)
def test_wrong_columns_are_told(table, columns, names):
    with pytest.raises(InputError) as caught:
        require_columns([table(LOG, columns)])
    assert all(name in str(caught.value) for name in names)
    assert caught.value.line == 1
    # A wrong unit is mended there, too.
    found, small = table(LOG, {"x": "X (mm)"}), replace(LENGTH, largest=0.5)
    with refused(InputError, "'X (mm) [mm]'", column="X (mm) (x)"):
        found.check("x", found.numbers("x", LENGTH), small)


@pytest.mark.parametrize(
    ("rows", "line", "column"),
    [
        # In one column, and in two: 2.168 is two thousand there.
        ("a;b\n1,5;2\n1.5;3\n", 3, "a"),
        ("a;b\n1,5;2.168\n2,5;-690\n", 2, "b"),
        ("a;b\n1.000;2,5\n2.500;1,5\n", 2, "a"),
        *(
            (f"a\tb\n1\t{cell}\n", 2, "b")
            for cell in (
                "2.168,00",
                '"2,168.00"',
                "2'168.00",
                '"1,145,240"',
                "2\u202f168",
            )
        ),
    ],
)
def test_marks_that_may_separate_thousands(table, rows, line, column):
    with pytest.raises(InputError, match=r"comma \(line [23]\)|thousands") as caught:
        table(rows).numbers(column, PURE)
    assert (caught.value.line, caught.value.column) == (line, column)
    # Seconds of another software have their point.
    assert table("t;a\n0.5;1,5\n1.25;2,5\n").numbers("t", PURE).tolist() == [0.5, 1.25]


# --- cells ----------------------------------------------------------------------

LINES = ["# p\xe4th", "a,b", "", "1,\xe4", '" x ","#"', "  ", " # c", "2,"]
KEPT = [(4, ("1", "\xe4")), (5, (" x ", "#")), (8, ("2", ""))]


GROUPED = "A~x~[m] y~[m] B~x~[m] z w"


def rows_of(found: Cells) -> list[tuple[str, ...]]:
    texts = [column.texts() for column in found.columns()]
    return [*zip(*texts, strict=True)]


@pytest.mark.parametrize("count", [1, 2, 1000])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("last", [False, True])
@pytest.mark.parametrize("code", ["utf-8", "utf-8-sig", "utf-16", "latin-1"])
def test_rows_however_they_are_written(monkeypatch, count, end, last, code):
    monkeypatch.setattr(table_module, "LINES", count)
    progress: list[float] = []
    data = (end.join(LINES) + end * last).encode(code)
    found = read_cells(data, "a.csv", progress.append, names=None)
    assert (tuple(found.heading.names), found.heading.line) == (("a", "b"), 2)
    assert [*zip(found.lines, rows_of(found), strict=True)] == KEPT
    assert len(found.remarks) == (code == "latin-1")
    assert progress == sorted(progress) and progress[-1] == 1.0


@pytest.mark.parametrize(
    ("text", "header", "line", "rows"),
    [
        ('a;b\n0,5;"1;5"\n', "a b", 1, [("0.5", "1;5")]),
        ("sep=;\na;b\n", "a b", 2, []),
        # Behind the sign of a comment, as numpy.savetxt and MATLAB write it.
        ("# made by\n% a,b\n1.5,2\n", "a b", 2, [("1.5", "2")]),
        # Below lines about the recording.
        ("Robot: R1\nDate;2026\n\na;b;c\n1;0,5;2\n", "a b c", 4, None),
        # Sheets fill up the lines of a title, and write the groups of columns.
        ("Air;21,5;;\na;b;c;d\n1;0,5;2;3\n", "a b c d", 2, None),
        ("A,A,B\na,b,c\n1,0.5,2\n", "a b c", 2, None),
        ("# made by two\n# a b c\n# m m s\n1.5 2 3\n", "a b c", 2, None),
        # Units below the names, and the minus of typesetting.
        ("a;b;c\n;\u00b0;[mm]\n1;0,5;2\n", "a b~[deg] c~[mm]", 2, None),
        ("a,b\nm,s\n\u22121.5,2\n", "a~[m] b~[s]", 2, [("\u22121.5", "2")]),
        ("a,b,c,d\n-,deg,[C],mm\n1,0.5,2,3\n", "a b~[deg] c~[C] d~[mm]", 2, None),
        # Groups of columns above their names, where these stand several times.
        ("A,,B,\na,x,x,c\n1,0.5,2,3\n", "a A~x B~x c", 2, None),
        ("A,,B,,\nx,y,x,z,w\nm,m,m,,\n1,0.5,2,3,4\n", GROUPED, 3, None),
        # Names with line ends in quotes, as those of a sheet.
        ('"a\n[mm]","b\n\nc"\n0.5,2\n', "a~[mm] b~~c", 4, None),
        ("a|b\n0.5|2\n", "a b", 1, [("0.5", "2")]),
        ("a,b\n0.5,p;q\n1.5,p;r\n", "a b", 1, [("0.5", "p;q"), ("1.5", "p;r")]),
        # Decimal commas between commas.
        ('a,b\n"0,5",2\n"1,2345",3\n', "a b", 1, [("0.5", "2"), ("1.2345", "3")]),
        ('a,b\n"1,5",0.5\n', "a b", 1, [("1,5", "0.5")]),
        ('a,b\n"1,500",2\n', "a b", 1, [("1,500", "2")]),
        # Blank cells behind the last column.
        ("a,b\n1.5,2,\n3.5,4, ,\n", "a b", 1, [("1.5", "2"), ("3.5", "4")]),
        # Numbers may name columns, and texts alone are rows, too.
        ("1,2\n0.5,0.25\n", "1 2", 1, [("0.5", "0.25")]),
        ("a b\n0.5\n", "a~b", 1, [("0.5",)]),
        # Files behind each other.
        ("a,b\n0.5,1\n\ufeffa,b\n2,3\n", "a b", 1, [("0.5", "1"), ("2", "3")]),
        ("t\na,b\nm,m\n0.5,1\n" * 2, "a~[m] b~[m]", 3, [("0.5", "1")] * 2),
    ],
)
def test_headers(text, header, line, rows):
    found = read_cells(text.encode(), "a.csv", names=None)
    names = [name.replace("~", " ") for name in header.split()]
    assert list(found.heading.names) == names
    assert found.heading.line == line
    assert not found.remarks
    assert rows is None or rows_of(found) == rows


@pytest.mark.parametrize("name", ["target", "tool [of the arm]", "Point"])
@pytest.mark.parametrize("ending", ["{k:03d}", "{k}.50", "{k}.5000"])
def test_names_stay_as_they_are_written(monkeypatch, name, ending):
    """However many there are; one by one they would be other names in other files."""
    monkeypatch.setattr(table_module, "LINES", 1000)
    names = [ending.format(k=k) for k in range(600)]
    data = f"a,{name}\n" + "".join(f"0.5,{cell}\n" for cell in names)
    table = read_table(
        data.encode(), columns={"target": "Point"} if "P" in name else {}
    )
    found = table.columns["tool" if "tool" in name else "target"]
    assert [*found.texts()] == names


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


@pytest.mark.parametrize(
    ("data", "word"),
    [
        (b"PK\x03\x04.. [Content_Types].xml", "Excel"),
        (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(512), "Excel"),
        (b"PK\x03\x04.. q.npy", "NumPy"),
        (b"\x93NUMPY\x01\x00", "NumPy"),
        (b"PK\x03\x04.. m.csv", "zip"),
        (gzip.compress(b"a,b\n1,2\n"), "gzip"),
        (b"MATLAB 5.0 MAT-file, Platform: GLNXA64" + bytes(200), "MATLAB"),
        (b'{"joints": [1, 2], "x": 1}', "JSON"),
        (b'[{"q": 1}, {"q": 2}]', "JSON"),
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
    monkeypatch.setattr(table_module, "LINES", count)
    with pytest.raises(InputError) as caught:
        read_cells(data.encode(), "a.csv")
    assert (caught.value.file, caught.value.line) == ("a.csv", line)
