"""Workers: many independent items of work, wherever they are done.

The result of an item must depend on nothing but the shared value and the item itself: a
seed belongs to an item, never to a worker. Then results are the same bytes for any
number of workers, and when a worker dies its items are simply done again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Protocol, TypeVar

from calib_pin.errors import CalibPinError

_Shared = TypeVar("_Shared")
_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


class WorkerLost(CalibPinError):
    """Workers died over the same item, again and again, or all of them are gone."""


class Workers(Protocol):
    """Processes that do independent items of work."""

    @property
    def count(self) -> int:
        """Number of items that may be under way at once."""
        ...

    def map(
        self,
        work: Callable[[_Shared, _Item], _Result],
        shared: _Shared,
        items: Iterable[_Item],
        lost: Callable[[_Item], _Result] | None = None,
    ) -> Iterator[_Result]:
        """Results of items, in their order.

        Args:
            work: A function of a module: it is sent by its name.
            shared: A value that all items need; each worker gets it once.
            items: The items; read little further than the work has come.
            lost: Result of an item over which workers died again and again.

        Raises:
            WorkerLost: At the place of such an item, where `lost` is not given.
            Exception: Whatever the work raises, at the place of its item.
        """
        ...


class Serial:
    """Work in this process, one item after the other."""

    count = 1

    def map(
        self,
        work: Callable[[_Shared, _Item], _Result],
        shared: _Shared,
        items: Iterable[_Item],
        lost: Callable[[_Item], _Result] | None = None,
    ) -> Iterator[_Result]:
        """Results of items, in their order; see `Workers.map`."""
        return (work(shared, item) for item in items)


SERIAL: Workers = Serial()
"""The default of whatever takes workers."""
