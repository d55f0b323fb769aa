"""Which candidate helps, and which is chosen, near and away."""

from __future__ import annotations

import numpy as np
import pytest

from calib_pin.kinematics.spatial import Floats
from calib_pin.validation.model_selection import Judged, helps, simplest
from calib_pin.validation.result import Candidate


def sizes(mean: float, seed: int = 0) -> Floats:
    """Errors of forty configurations, which candidates share but for a little."""
    common = np.random.default_rng(9).uniform(0.5, 1.5, 40)
    own = 0.02 * np.random.default_rng(seed).normal(size=40)
    return mean * (common / common.mean() + own - own.mean())


def judged(*means: float, rank: int, learned: str | None = None) -> Judged:
    candidate = Candidate(f"of rank {rank}", (), learned, rank, helps=True)
    return Judged(candidate, sizes=tuple(sizes(m, rank) for m in means))


@pytest.mark.parametrize(
    ("near", "away", "expected"),
    [
        (0.9, 0.9, {"near", "away", "both"}),
        (0.9, 1.0, {"near", "both"}),
        (0.9, 1.2, {"near"}),
        (1.2, 0.9, {"away"}),
        (1.0, 1.0, set()),
    ],
)
def test_helping(near: float, away: float, expected: set[str]) -> None:
    """Somewhere better, and nowhere worse, where it is used."""
    before = sizes(1.0, 1), sizes(1.0, 1)
    # Exactly as good is no gain.
    after = tuple(sizes(m, 1) if m == 1.0 else sizes(m, 2) for m in (near, away))
    found = {use for use in ("near", "away", "both") if helps(after, before, use)}
    assert found == expected


def test_the_simplest_that_is_not_significantly_worse() -> None:
    plain, physics = judged(2.0, 3.0, rank=10), judged(1.0, 1.5, rank=20)
    more = judged(0.998, 1.499, rank=30)
    learned = judged(0.3, 2.5, rank=20, learned="network")
    ladder = [plain, physics, more]
    assert [simplest(ladder, use) for use in ("near", "away", "both")] == [1, 1, 1]
    ladder.append(learned)
    assert simplest(ladder, "near") == 3
    assert simplest(ladder, "away") == 1
    # No candidate is as good as the best in both: what carries over is safe.
    assert simplest(ladder, "both") == 1
    assert simplest([*ladder, judged(0.3, 1.5, rank=25)], "both") == 4


def test_without_regions_only_what_is_near_counts() -> None:
    first, second = judged(2.0, rank=10), judged(1.0, rank=20)
    assert simplest([first, second], "away") == 1
    # But what one of them alone could not be tried at is no gain.
    both = judged(1.5, 1.5, rank=10)
    assert [simplest([both, second], use) for use in ("away", "both")] == [0, 0]
    assert not helps(second.sizes, both.sizes, "away")
    assert helps(second.sizes, both.sizes, "near")
    untried = Judged(Candidate("c", (), None, reason="too few"))
    assert simplest([first, untried, second], "both") == 2
