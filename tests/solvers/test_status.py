"""How solvers end."""

from __future__ import annotations

import pytest

from calib_pin.solvers import Status


@pytest.mark.parametrize("status", Status, ids=lambda status: status.value)
def test_every_status_gives_advice(status: Status) -> None:
    assert status.advice.endswith(".")
    assert status.value == status.value.lower()


def test_no_advice_is_given_twice() -> None:
    assert len({status.advice for status in Status}) == len(Status)


def test_unfinished_evolution_names_the_way_on() -> None:
    assert "'hybrid'" in Status.GENERATIONS.advice
