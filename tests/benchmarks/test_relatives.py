"""Relatives of layouts: damaged files are read rightly, or refused by what was done.

A few of them; `scripts/benchmark relatives` takes as many as are asked for.
"""

from __future__ import annotations

import pytest

from benchmarks.relatives import run


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 300, 301, 302])
def test_no_file_is_silently_wrong(seed: int) -> None:
    found = run(seed)
    assert found.kind in ("right", "told"), (found.damages, found.line)
