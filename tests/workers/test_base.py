"""Batches over workers that do their work at once, out of order, or not at all."""

from __future__ import annotations

import random
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import nullcontext
from functools import partial
from itertools import count
from typing import Any

import pytest

from calib_pin.workers.base import AHEAD, SERIAL, Done, WorkerLost, Workers, run

ITEMS = [*range(13), *range(14, 300)]
"""Those that do not fail."""


def double(shared: int, item: int) -> int:
    if item == 13:
        raise ValueError("thirteen")
    return 2 * item + shared


class Fake(Workers):
    """Workers whose batches wait until `finish` is called, or are done at once.

    Where one dies, all batches are lost that are not done.
    """

    patience, died = 0.0, BrokenProcessPool

    def __init__(self, number: int = 2, seconds: float = 1.0, at_once: bool = True):
        self.count, self.seconds, self.at_once = number, seconds, at_once
        self.waiting: list[tuple[Future[Done], partial[Done]]] = []
        self.sizes: list[int] = []
        self.deaths: dict[int, int] = {}

    def sharing(self, payload: bytes) -> nullcontext[Any]:
        return nullcontext(partial(self.submit, payload))

    def submit(self, payload: bytes, items: Sequence[Any]) -> Any:
        future: Future[Done] = Future()
        self.sizes.append(len(items))
        self.waiting.append((future, partial(run, payload, items)))
        if self.at_once:
            self.finish()
        return future

    def finish(self, place: int = 0) -> None:
        future, batch = self.waiting.pop(place)
        for item in batch.args[1]:
            if self.deaths.get(item, 0) > 0:
                self.deaths[item] -= 1
                others, self.waiting = self.waiting, []
                for lost, _ in [(future, batch), *others]:
                    lost.set_exception(BrokenProcessPool("died"))
                return
        seconds = self.seconds * len(batch.args[1])
        future.set_result(batch()._replace(seconds=seconds))


@pytest.mark.parametrize("number", [1, 2, 7])
def test_results_are_those_of_one_process_in_their_order(number: int):
    expected = list(SERIAL.map(double, 1, ITEMS))
    assert list(Fake(number, 1e-3).map(double, 1, ITEMS)) == expected
    assert list(Fake(number, 1e-3).map(double, 1, iter(ITEMS))) == expected
    assert list(Fake(number).map(double, 1, [])) == []


@pytest.mark.parametrize("deaths", [{}, {100: 1}])
def test_batches_that_end_in_any_order_change_nothing(deaths: dict[int, int]):
    fake, rng, stop = Fake(3, 0.1, at_once=False), random.Random(1), threading.Event()
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
    found = Fake(1, 1e-3).map(double, 1, range(30))
    assert [next(found) for _ in range(13)] == [2 * k + 1 for k in range(13)]
    with pytest.raises(ValueError, match="thirteen"):
        next(found)


def test_batches_grow_to_a_second():
    fake = Fake(1, 0.01)
    list(fake.map(double, 1, [0] * 3000))
    assert fake.sizes[0] == 1
    assert 80 < max(fake.sizes) <= 100
    slow = Fake(1, 5.0)
    list(slow.map(double, 1, range(10)))
    assert slow.sizes == [1] * 10


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
    fake = Fake(2, 1e-3)
    fake.deaths = {100: 1, 200: 1}
    assert list(fake.map(double, 1, ITEMS)) == list(SERIAL.map(double, 1, ITEMS))
    assert set(fake.deaths.values()) == {0}


def test_an_item_that_kills_workers_is_given_up_and_the_others_are_done():
    fake = Fake(2, 1e-3)
    fake.deaths = {100: 9}
    found = list(fake.map(double, 1, ITEMS, lost=lambda item: -item))
    assert found == [-100 if k == 100 else 2 * k + 1 for k in ITEMS]
    assert fake.deaths == {100: 7}


@pytest.mark.parametrize("patience", [0.0, 1e-9])
def test_without_a_substitute_such_an_item_is_an_error(patience: float):
    fake = Fake(2, 1e-3)
    fake.patience, fake.deaths = patience, {5: 2}
    found = fake.map(double, 1, range(10))
    assert [next(found) for _ in range(5)] == [1, 3, 5, 7, 9]
    with pytest.raises(WorkerLost, match="item 6"):
        next(found)


def unsendable(shared: bool, item: int) -> Any:
    if item < 2:
        return item
    if shared:
        raise RuntimeError(item, lambda: "no module has this function")
    return lambda: "nor this one"


@pytest.mark.parametrize(
    ("shared", "words"), [(True, r"RuntimeError: \(2, <function"), (False, "pickle")]
)
def test_what_cannot_be_sent_is_an_error_of_its_item(shared: bool, words: str):
    found = Fake(2).map(unsendable, shared, range(5))
    assert [next(found), next(found)] == [0, 1]
    with pytest.raises((RuntimeError, AttributeError), match=words):
        next(found)
