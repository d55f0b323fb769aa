"""Batches over seats that do their work at once, out of order, or not at all."""

from __future__ import annotations

import random
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from itertools import count
from typing import Any

import pytest

from calib_pin.workers.base import SERIAL, WorkerLost
from calib_pin.workers.distributed import AHEAD, QUEUED, Share, distribute
from calib_pin.workers.remote import KEPT, Done, keep, run


def double(shared: int, item: int) -> int:
    if item == 13:
        raise ValueError("thirteen")
    return 2 * item + shared


class Fake:
    """A seat whose batches wait until `finish` is called, or are done at once."""

    died = (BrokenProcessPool,)
    tries = 3

    def __init__(self, seconds: float = 1.0, at_once: bool = True, all_lost=True):
        self.batches: list[tuple[Future[Done], Share, Sequence[Any]]] = []
        self.sizes: list[int] = []
        self.renewed = 0
        self.seconds, self.at_once, self.all_lost = seconds, at_once, all_lost
        self.deadly: Callable[[Any], bool] = lambda item: False

    def submit(self, share: Share, items: Sequence[Any]) -> Future[Done]:
        future: Future[Done] = Future()
        self.sizes.append(len(items))
        self.batches.append((future, share, items))
        if self.at_once:
            self.finish()
        return future

    def finish(self, place: int = 0) -> None:
        future, share, items = self.batches.pop(place)
        if any(map(self.deadly, items)):
            future.set_exception(BrokenProcessPool("died"))
            if self.all_lost:
                for other, _, _ in self.batches:
                    other.set_exception(BrokenProcessPool("died with it"))
                self.batches.clear()
            return
        done = run(share.digest, share.payload, items)
        seconds = self.seconds * len(items)
        future.set_result(done._replace(seconds=seconds))

    def renew(self) -> bool:
        self.renewed += 1
        return self.all_lost


def over(seats: Sequence[Fake], items: Any, lost: Any = None) -> Iterator[int]:
    return distribute(seats, double, 1, items, lost)


def test_results_are_those_of_one_process_in_their_order():
    items = [*range(10), *range(14, 400)]
    expected = list(SERIAL.map(double, 1, items))
    for number in (1, 2, 7):
        seats = [Fake(seconds=1e-3) for _ in range(number)]
        assert list(over(seats, items)) == expected
        assert list(over(seats, iter(items))) == expected


def test_batches_that_end_in_any_order_change_nothing():
    items = [*range(13), *range(14, 200)]
    seats, rng = [Fake(0.1, at_once=False) for _ in range(3)], random.Random(1)
    stop = threading.Event()

    def work() -> None:
        while not stop.wait(0.001):
            seat = rng.choice(seats)
            if seat.batches:
                seat.finish(rng.randrange(len(seat.batches)))

    thread = threading.Thread(target=work)
    thread.start()
    try:
        assert list(over(seats, items)) == list(SERIAL.map(double, 1, items))
    finally:
        stop.set()
        thread.join()


def test_an_error_comes_at_the_place_of_its_item():
    found = over([Fake(1e-3)], range(30))
    assert [next(found) for _ in range(13)] == [2 * k + 1 for k in range(13)]
    with pytest.raises(ValueError, match="thirteen"):
        next(found)


def test_batches_grow_to_a_second_and_shrink_at_the_end():
    seat = Fake(seconds=0.01)
    items = [item for item in range(1001) if item != 13]
    list(over([seat], items))
    assert seat.sizes[0] == 1
    assert max(seat.sizes) == 100
    assert seat.sizes[-1] == 1  # Nobody waits for the last batch.
    alone = Fake(seconds=5.0)
    list(over([alone], range(10)))
    assert alone.sizes == [1] * 10


def test_items_are_read_no_further_than_the_work_has_come():
    read: list[int] = []

    def items() -> Iterator[int]:
        for item in count(14):
            read.append(item)
            yield item

    found = over([Fake(), Fake()], items())
    for _ in range(5):
        next(found)
    assert len(read) <= 5 + 2 * (AHEAD + QUEUED)
    found.close()


def test_a_dead_worker_loses_its_batches_only():
    deaths = iter([True, False, False])
    seats = [Fake(1e-3), Fake(1e-3)]
    items = [*range(13), *range(14, 300)]
    seats[1].deadly = lambda item: item == 100 and next(deaths)
    assert list(over(seats, items)) == list(SERIAL.map(double, 1, items))
    assert (seats[0].renewed, seats[1].renewed) in ((0, 1), (0, 0))


def test_an_item_that_kills_workers_is_given_up_and_the_others_are_done():
    for all_lost in (True, False):
        seats = [Fake(1e-3, all_lost=all_lost) for _ in range(2)]
        for seat in seats:
            seat.deadly = lambda item: item == 100
        items = [*range(13), *range(14, 300)]
        found = list(over(seats, items, lost=lambda item: -item))
        expected = [-100 if k == 100 else 2 * k + 1 for k in items]
        assert found == expected
        assert sum(seat.renewed for seat in seats) == Fake.tries


def test_without_a_substitute_such_an_item_is_an_error():
    seat = Fake(1e-3)
    seat.deadly = lambda item: item == 5
    found = over([seat], range(10))
    assert [next(found) for _ in range(5)] == [1, 3, 5, 7, 9]
    with pytest.raises(WorkerLost, match="6"):
        next(found)


def fail(shared: int, item: int) -> int:
    raise RuntimeError(item, lambda: "no module has this function")


def test_errors_that_cannot_be_sent_are_told_in_words():
    share = Share.of(fail, 2)
    done = run(share.digest, share.payload, [1])
    assert str(done.failure).startswith("RuntimeError: (1, <function")


def test_a_worker_keeps_few_shared_values():
    shares = [Share.of(double, k) for k in range(KEPT + 1)]
    for share in shares:
        keep(share.digest, share.payload)
    assert run(shares[-1].digest, None, [1]).results == [2 + KEPT]
    with pytest.raises(KeyError):
        run(shares[0].digest, None, [1])
