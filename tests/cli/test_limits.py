"""Joint limits as words of the command line."""

from __future__ import annotations

import math

import pytest

from calib_pin.cli.limits import parse_limits
from calib_pin.errors import OptionError


@pytest.mark.parametrize(
    ("word", "name", "limits"),
    [
        ("elbow=-1:1.5", "elbow", (-1.0, 1.5)),
        ("elbow=-90:180 [deg]", "elbow", (-math.pi / 2, math.pi)),
        ("elbow=-90:180[deg]", "elbow", (-math.pi / 2, math.pi)),
        (" elbow = -1 : 1 ", "elbow", (-1.0, 1.0)),
        ("lift=0:350 [mm]", "lift", (0.0, 0.35)),
        ("joint_*=-1e-3:+2", "joint_*", (-1e-3, 2.0)),
        ("joint[12]=0:1", "joint[12]", (0.0, 1.0)),
        ("a=b=0:1", "a=b", (0.0, 1.0)),
        ("axis 1=0.25:0.25", "axis 1", (0.25, 0.25)),
    ],
)
def test_words(word: str, name: str, limits: tuple[float, float]) -> None:
    found = parse_limits([word])
    assert list(found) == [name]
    assert found[name] == pytest.approx(limits, rel=1e-12)


def test_several_words_and_none() -> None:
    assert parse_limits([]) == {}
    assert list(parse_limits(["b=0:1", "a=0:1"])) == ["b", "a"]
    # The later one of the same joint holds, as for every other option.
    assert parse_limits(["a=0:1", "a=0:2"]) == {"a": (0.0, 2.0)}


@pytest.mark.parametrize(
    "word",
    [
        "",
        "elbow",
        "elbow=",
        "=0:1",
        "elbow=1",
        "elbow=0:1:2",
        "elbow=a:b",
        "0:1",
        "elbow=0:1 [cm]",
        "elbow=0:1 [deg",
        "elbow=:",
        "elbow=0:",
        "elbow:0=1",
    ],
)
def test_malformed_words(word: str) -> None:
    with pytest.raises(OptionError, match="JOINT=LOWER:UPPER") as caught:
        parse_limits([word])
    assert repr(word) in str(caught.value)


@pytest.mark.parametrize(
    "word",
    [
        "elbow=1:-1",
        "elbow=nan:1",
        "elbow=0:nan",
        "elbow=-inf:inf",
        "elbow=0:1e9",
        "elbow=-120:120",
    ],
)
def test_limits_that_cannot_be_meant(word: str) -> None:
    with pytest.raises(OptionError, match="LOWER up to UPPER") as caught:
        parse_limits([word])
    assert repr(word) in str(caught.value)
