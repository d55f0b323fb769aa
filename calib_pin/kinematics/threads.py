"""Objects that Pinocchio's functions write: threads must not share them."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, Generic, TypeVar

import pinocchio as pin

T = TypeVar("T")


class PerThread(threading.local, Generic[T]):
    """An object that Pinocchio's functions write, of each thread its own.

    Args:
        make: Makes one.
        args: Its arguments, which nobody writes.

    Attributes:
        own: The object of this thread.
    """

    def __init__(self, make: Callable[..., T], *args: Any) -> None:
        """Make one; called in each thread that looks at an attribute."""
        self._make, self._args = make, args
        self.value: T = make(*args)

    def __reduce__(self) -> tuple[type[PerThread[T]], tuple[Any, ...]]:
        """A copy, or another process, makes its own."""
        return PerThread, (self._make, *self._args)


def workspace(model: pin.Model) -> tuple[pin.Model, pin.Data]:
    """A copy of a model, whose placements may be written, and data for it."""
    copy = model.copy()
    return copy, copy.createData()
