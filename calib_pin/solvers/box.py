"""The box of bounds within which a population lives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib_pin.errors import OptionError
from calib_pin.kinematics.spatial import Floats


@dataclass(frozen=True)
class Box:
    """The bounds of the members.

    Attributes:
        lower: Lower bounds, shape (D,).
        upper: Upper bounds, shape (D,); an equal pair holds its component fixed.
    """

    lower: Floats
    upper: Floats

    @staticmethod
    def of(bounds: Floats) -> Box:
        """The box of checked bounds, shape (D, 2).

        Raises:
            OptionError: If a bound is not finite, a pair is reversed, or the shape is
                not (D, 2).
        """
        pairs = np.array(bounds, float)
        if pairs.ndim != 2 or pairs.shape[1] != 2 or not len(pairs):
            raise OptionError(
                "bounds have the wrong shape", value=pairs.shape, allowed="(D, 2)"
            )
        for k, (lower, upper) in enumerate(pairs.tolist()):
            if not np.isfinite([lower, upper]).all():
                raise OptionError(
                    f"bounds of component {k} are not finite", value=(lower, upper)
                )
            if lower > upper:
                raise OptionError(
                    f"bounds of component {k} are reversed",
                    value=(lower, upper),
                    allowed="lower <= upper",
                )
        return Box(pairs[:, 0].copy(), pairs[:, 1].copy())

    def populate(
        self, size: int, init: str, x0: Floats | None, rng: np.random.Generator
    ) -> Floats:
        """A first population, shape (size, D).

        Args:
            size: Number of members.
            init: `random`, or `latinhypercube` for one member in each of `size` equal
                slices of every component.
            x0: First member, shape (D,), if there is a guess.
            rng: Source of chance.

        Raises:
            OptionError: If x0 is not within the bounds.
        """
        shape = size, len(self.lower)
        place = rng.random(shape)
        if init == "latinhypercube":
            slices = np.broadcast_to(np.arange(size)[:, None], shape)
            place = (rng.permuted(slices, axis=0) + place) / size
        members = self.lower + place * (self.upper - self.lower)
        # Rounding may have led past the upper bound.
        np.clip(members, self.lower, self.upper, out=members)
        if x0 is not None:
            members[0] = self.checked(x0)
        return members

    def checked(self, x0: Floats, rows: str = "") -> Floats:
        """The caller's first members, as an array of numbers.

        Args:
            x0: One member, shape (D,), or several as rows.
            rows: Name of the number of rows, where several are wanted.

        Raises:
            OptionError: If the shape is another, or a member leaves the bounds.
        """
        guess, size = np.asarray(x0, float), len(self.lower)
        dimensions = 2 if rows else 1
        if guess.ndim != dimensions or guess.shape[-1] != size or not guess.size:
            raise OptionError(
                "x0 has the wrong shape",
                value=guess.shape,
                allowed=f"({rows}, {size})" if rows else f"({size},)",
            )
        within = (self.lower <= guess) & (guess <= self.upper)
        for *row, k in np.argwhere(~within).tolist():
            place = f"component {k}" + (f" of row {row[0]}" if row else "")
            raise OptionError(
                f"x0 leaves the bounds at {place}",
                value=float(guess[*row, k]),
                allowed=f"{self.lower[k]} to {self.upper[k]}",
            )
        return guess

    def repair(self, trials: Floats, parents: Floats, rng: np.random.Generator) -> None:
        """Bring components that left the box back into it, in place, (S, D).

        They go anywhere between the parent and the bound that they crossed. Clipped to
        the bound instead, members would pile up there, and where all members agree
        no difference of members leads away again.
        """
        outside = np.flatnonzero((trials < self.lower) | (trials > self.upper))
        if not len(outside):
            return
        column = outside % trials.shape[1]
        lower, upper = self.lower[column], self.upper[column]
        strays, inner = trials.ravel(), parents.ravel()[outside]
        bound = np.where(strays[outside] < lower, lower, upper)
        # As random numbers are less than 1, rounding never leads past the parent.
        trials.flat[outside] = bound + rng.random(len(outside)) * (inner - bound)
