"""Golden messages: what a user reads, word by word, for one mistake of each kind.

All other tests compare the fields of errors, so a change of wording breaks these alone.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

MESSAGES = yaml.safe_load(Path(__file__).with_name("messages.yaml").read_text())


@pytest.mark.parametrize("case", MESSAGES, ids=lambda case: case["run"])
def test_messages(case: dict[str, Any], here: Path, run: Callable[..., object]) -> None:
    for name, text in case.get("files", {}).items():
        (here / name).write_text(text)
    result = run(case["run"])
    assert (result.status, result.out) == (1, "")
    assert result.err == f"calib-pin: {case['says']}\n"
