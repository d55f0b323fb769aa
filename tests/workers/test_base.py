"""Items over workers that do their work at once, out of order, or not at all."""

from __future__ import annotations

import random
import threading
from collections.abc import Iterator
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import nullcontext
from functools import partial
from itertools import count
from typing import Any

import pytest

from calib_pin.workers.base import AHEAD, SERIAL, WorkerLost, Workers, run

ITEMS = [*range(13), *range(14, 300)]
"""Those that do not fail."""


def double(shared: int, item: int) -> int:
    if item == 13:
        raise ValueError("thirteen")
    return 2 * item + shared


class Fake(Workers):
    """Workers whose items wait until `finish` is called, or are done at once.

    Where one dies, all items are lost that are not done.
    """

    patience, died = 0.0, BrokenProcessPool

    def __init__(self, number: int = 2, at_once: bool = True):
        self.count, self.at_once = number, at_once
        self.waiting: list[tuple[Future[Any], partial[Any]]] = []
        self.deaths: dict[int, int] = {}

    def sharing(self, payload: bytes) -> nullcontext[Any]:
        return nullcontext(partial(self.submit, payload))

    def submit(self, payload: bytes, item: Any) -> Any:
        future: Future[Any] = Future()
        self.waiting.append((future, partial(run, payload, item)))
        if self.at_once:
            self.finish()
        return future

    def finish(self, place: int = 0) -> None:
        future, work = self.waiting.pop(place)
        item = work.args[1]
        if self.deaths.get(item, 0) > 0:
            self.deaths[item] -= 1
            others, self.waiting = self.waiting, []
            for lost, _ in [(future, work), *others]:
                lost.set_exception(BrokenProcessPool("died"))
            return
        try:
            future.set_result(work())
        except Exception as error:
            future.set_exception(error)


@pytest.mark.parametrize("number", [1, 2, 7])
def test_results_are_those_of_one_process_in_their_order(number: int):
    expected = list(SERIAL.map(double, 1, ITEMS))
    assert list(Fake(number).map(double, 1, ITEMS)) == expected
    assert list(Fake(number).map(double, 1, iter(ITEMS))) == expected
    assert list(Fake(number).map(double, 1, [])) == []


@pytest.mark.parametrize("deaths", [{}, {100: 1}])
def test_items_that_end_in_any_order_change_nothing(deaths: dict[int, int]):
    fake, rng, stop = Fake(3, at_once=False), random.Random(1), threading.Event()
    fake.deaths = deaths

    def work() -> None:
        while not stop.wait(0.001):
            if fake.waiting:
                fake.finish(rng.randrange(len(fake.waiting)))

    thread = threading.Thread(target=work)
    thread.start()
    try:
        assert list(fake.map(double, 1, ITEMS)) == list(SERIAL.map(double, 1, ITEMS))
    finally:
        stop.set()
        thread.join()


def test_an_error_comes_at_the_place_of_its_item():
    found = Fake(1).map(double, 1, range(30))
    assert [next(found) for _ in range(13)] == [2 * k + 1 for k in range(13)]
    with pytest.raises(ValueError, match="thirteen"):
        next(found)


def test_items_are_read_no_further_than_the_work_has_come():
    read: list[int] = []

    def items() -> Iterator[int]:
        for item in count(14):
            read.append(item)
            yield item

    found = Fake(2).map(double, 1, items())
    for _ in range(5):
        next(found)
    assert len(read) <= 5 + 2 * AHEAD
    found.close()


def test_what_a_dead_worker_had_is_done_again():
    fake = Fake(2)
    fake.deaths = {100: 1, 200: 1}
    assert list(fake.map(double, 1, ITEMS)) == list(SERIAL.map(double, 1, ITEMS))
    assert set(fake.deaths.values()) == {0}


def test_an_item_that_kills_workers_is_given_up_and_the_others_are_done():
    fake = Fake(2)
    fake.deaths = {100: 9}
    found = list(fake.map(double, 1, ITEMS, lost=lambda item: -item))
    assert found == [-100 if k == 100 else 2 * k + 1 for k in ITEMS]
    assert fake.deaths == {100: 7}


@pytest.mark.parametrize("patience", [0.0, 1e-9])
def test_without_a_substitute_such_an_item_is_an_error(patience: float):
    fake = Fake(2)
    fake.patience, fake.deaths = patience, {5: 2}
    found = fake.map(double, 1, range(10))
    assert [next(found) for _ in range(5)] == [1, 3, 5, 7, 9]
    with pytest.raises(WorkerLost, match="item 6"):
        next(found)
