"""The list that decides, when the run that wrote it is no more."""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path

import pytest

from calib_pin.errors import InputError
from calib_pin.io.journal import JOURNAL, settled, temporary
from calib_pin.io.staging import write_folder

OLD = {"a.json": b"old a", "b.urdf": b"old b", "gone.json": b"old gone"}
NEW = {"a.json": b"new a", "b.urdf": b"new b"}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, data in OLD.items():
        (tmp_path / name).write_bytes(data)
    return tmp_path


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_a_folder_that_cannot_be_written_is_read_as_decided(folder: Path) -> None:
    """As on a medium that is mounted for reading, after a kill."""
    files = {}
    for name in NEW:
        temporary(folder / name).write_bytes(NEW[name])
        files[name] = hashlib.sha256(NEW[name]).hexdigest()
    journal = {"files": files, "remove": ["gone.json"]}
    (folder / JOURNAL).write_text(json.dumps(journal))
    with pytest.MonkeyPatch.context() as patch:

        def refuse(*_: object) -> None:
            raise PermissionError(30, "Read-only file system")

        patch.setattr(os, "replace", refuse)
        patch.setattr(os, "unlink", refuse)
        with settled(folder) as waiting:
            for name in files:
                assert waiting[folder / name].read_bytes() == NEW[name]
    with settled(folder) as waiting:
        assert waiting == {}
    assert content(folder) == NEW


@pytest.mark.parametrize(
    "journal",
    [
        b"",
        b"[]",
        b'{"files": {}}',
        b'{"files": {"../x": ""}, "remove": []}',
        b'{"files": {}, "remove": ["../x"]}',
        b'{"files": {}, "remove": ["/etc/passwd"]}',
    ],
)
def test_lists_that_reach_out_of_their_folder(journal: bytes, folder: Path) -> None:
    (folder / JOURNAL).write_bytes(journal)
    with pytest.raises(InputError) as caught, settled(folder):
        pass
    assert caught.value.reason == "no list of files to put in place; remove it"
    assert caught.value.file == str(folder / JOURNAL)


def test_what_waits_was_damaged(folder: Path) -> None:
    temporary(folder / "a.json").write_bytes(b"cut off")
    journal = {"files": {"a.json": "0" * 64}, "remove": ["b.urdf"]}
    (folder / JOURNAL).write_text(json.dumps(journal))
    with (
        pytest.raises(InputError, match="damaged or unreadable") as caught,
        settled(folder),
    ):
        pass
    assert caught.value.file == str(temporary(folder / "a.json"))
    # A new set does not need it.
    contents = {folder / "a.json": b"new"}
    with write_folder(folder, contents, force=True, notice=print):
        pass
    assert content(folder) == {**OLD, "a.json": b"new"}
