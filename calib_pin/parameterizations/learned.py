"""The protocol of a learned correction, as an error model needs it."""

from __future__ import annotations

from typing import Literal, Protocol

from calib_pin.kinematics.spatial import Floats


class Learned(Protocol):
    """A learned correction, which has no error parameters."""

    @property
    def space(self) -> Literal["joint", "tip"]:
        """Space of the correction: joint positions, or a body twist of the tool."""
        ...

    @property
    def shift(self) -> Floats:
        """Change of the parameters that belongs to it, shape (P,).

        A fit without the correction is biased by what the correction explains.
        """
        ...

    def weight(self, q: Floats) -> Floats:
        """Weight from 1 near training configurations to 0 far away, shape (N,)."""
        ...

    def __call__(self, q: Floats) -> Floats:
        """Corrections of commanded joint positions, (N, n) -> (N, n) or (N, 6)."""
        ...
