"""Text that is safe to draw, and ticks that people can read."""

from __future__ import annotations

import numpy as np
import pytest

from calib_pin.report.figures.labels import log_ticks, plain, shortened


def test_long_names_keep_both_ends():
    name = "left_arm_shoulder_lift_joint.placement.rx"
    short = shortened(name, 21)
    assert len(short) == 21
    assert name.startswith(short.split("…")[0]) and name.endswith(short.split("…")[1])
    assert shortened("elbow", 5) == "elbow"


def test_what_xml_cannot_hold_is_replaced():
    for bad in "\0\n\x1b\ud800\u202e\ufffe":
        assert shortened(f"a{bad}b") == "a\N{REPLACEMENT CHARACTER}b"


@pytest.mark.parametrize(
    ("low", "high", "ticks"),
    [
        (0.011, 12.0, ["0.1", "1", "10"]),
        (1.5, 3.5, ["1.5", "2", "2.5", "3", "3.5"]),
        (0.9, 11.0, ["1", "2", "5", "10"]),
        (1e-14, 2e3, ["10⁻¹²", "10⁻⁹", "10⁻⁶", "0.001", "1", "1000"]),
    ],
)
def test_ticks_are_few_and_round(low, high, ticks):
    assert [plain(tick) for tick in log_ticks(low, high)] == ticks


def test_every_log_axis_has_ticks():
    for low in (1e-20, 3e-3, 7.7, 4e9):
        for span in np.geomspace(1.3, 1e18, 40):
            ticks = log_ticks(low, low * span)
            assert 2 <= len(ticks) <= 9
            assert all(low <= tick <= low * span for tick in ticks)
            assert len({plain(tick) for tick in ticks}) == len(ticks)
