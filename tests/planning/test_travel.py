"""Whole turns of planned configurations: away where nothing depends on them."""

from __future__ import annotations

import numpy as np
import pytest

import calib_pin
from calib_pin.kinematics.turns import shortest_turns
from calib_pin.setup import Setup

CHAIN = calib_pin.load_chain("example:ur5_robot", tip="tool0")
QUICK = {"method": "greedy", "candidates": 150}


def test_what_a_gear_depends_on_keeps_its_turns():
    setup = Setup(parameters=("joint-offset", "transmission"))
    found = calib_pin.plan(CHAIN, "pose", 14, setup, **QUICK)
    assert np.abs(found.q).max() > 1.3 * np.pi


def test_turns_change_nothing_of_what_is_planned(monkeypatch):
    turned = calib_pin.plan(CHAIN, "position", 10, **QUICK)
    monkeypatch.setattr("calib_pin.planning.travel._same", lambda *about: False)
    as_found = calib_pin.plan(CHAIN, "position", 10, **QUICK)
    assert turned.value == pytest.approx(as_found.value, rel=1e-4)
    limits = CHAIN.lower + 0.01, CHAIN.upper - 0.01
    again = shortest_turns(turned.q, *limits, CHAIN.revolute)
    np.testing.assert_array_equal(again, turned.q)
    assert np.abs(np.diff(turned.q, axis=0)).max() < np.pi + 0.5
    travels = [
        np.abs(np.diff(p.q, axis=0)).max(axis=1).sum() for p in (turned, as_found)
    ]
    assert travels[0] < 0.8 * travels[1]
