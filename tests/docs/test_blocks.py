"""The documents do what they say: every block of code is run or compared."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from documentation.blocks import ROOT, Reader, blocks, difference

PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])
CODE = [page for page in PAGES if any(blocks(page.read_text()))]
DATA = Path(os.environ.get("CALIB_PIN_DATA", ROOT.parent / "shared" / "data"))


@pytest.mark.slow
@pytest.mark.parametrize("page", CODE, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_page_does_what_it_says(page, tmp_path, monkeypatch):
    needed = [b.text for b in blocks(page.read_text()) if b.language == "needs"]
    missing = [name for name in needed if not (DATA / name).is_dir()]
    if missing:
        pytest.skip(f"no real measurements {missing} in {DATA} (CALIB_PIN_DATA)")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    Reader(page, DATA).follow()


PRINTED = """\
GOOD: position error 0.447 mm rms instead of 0.847 mm.
  practical rank 25 (2 directions held)
wrote out/robot.urdf
"""


def test_an_output_is_as_expected():
    for expected in (
        PRINTED,
        PRINTED.replace("0.447", "0.450"),
        "GOOD: position error 0.447 mm\nrms instead of 0.847 mm.\n...",
        "GOOD:\n...\nrank 25\n...\nwrote out/robot.urdf",
    ):
        assert difference(expected.splitlines(), PRINTED) == ""


def test_an_output_that_differs_is_told():
    for expected in (
        PRINTED.replace("0.447", "0.497"),
        PRINTED.replace("25", "26"),
        "wrote out/robot.urdf\n...",
        "GOOD: position error 0.447 mm",
        "...\nwrote out/robot.urdf\n...\nGOOD:\n...",
    ):
        assert difference(expected.splitlines(), PRINTED), expected


def page(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "page.md"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("```python\nassert 1 == 2\n```\n", "page.md:1: AssertionError"),
        ("\n```yaml\ntop: tool0\n```\n", "page.md:2: "),
        ("```\nnothing said\n```\n", "language ''"),
        ("```bash\nrm -r .\n```\n", "unknown command 'rm'"),
        ("```bash\ncalib-pin calibrate nowhere.urdf a.csv\n```\n", "nowhere.urdf"),
        ("```bash\nscripts/benchmark magic\n```\n", "knows no ['magic']"),
        ("```console\n$ calib-pin robots\nnone\n```\n", "expected 'none'"),
    ],
)
def test_a_page_that_is_wrong_is_told(tmp_path, monkeypatch, text, said):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(AssertionError) as error:
        Reader(page(tmp_path, text)).follow()
    assert said in str(error.value)


def test_a_page_is_followed_in_its_order(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = """
<!-- run: calib-pin simulate space7 --model pose --count 3 --seed 1 -o made.csv -->

```yaml
# names.yaml
tip: tool
```

```python
from pathlib import Path

lines = Path("made.csv").read_text().splitlines()
```

```console
$ head -n 1 \\
    names.yaml
tip: tool
```

```python
assert len(lines) >= 4
Path("seen").write_text("yes")
```
"""
    Reader(page(tmp_path, text)).follow()
    assert (tmp_path / "seen").read_text() == "yes"
