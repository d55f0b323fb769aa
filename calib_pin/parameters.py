"""Error parameters: their names, units, expected sizes, bounds and priors.

The numbers themselves are plain arrays in the order of a `ParameterSet`, which gives
each entry its meaning. Sets are immutable; a change makes a new one.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from functools import cached_property, lru_cache
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import OptionError, nearest
from calib_pin.kinematics.spatial import Floats

Value = TypeVar("Value")


@dataclass(frozen=True)
class Parameter:
    """One error parameter; zero is the nominal robot.

    Attributes:
        name: `<owner>.<kind>.<component>`.
        unit: Unit of the value, such as `m` or `rad`.
        scale: Expected size of the value, in its unit; makes parameters comparable.
        nuisance: True for parameters of the measurement rather than the robot:
            base frame, tool frame, planes. Nuisances absorb all that they can.
        outer: True for parameters of objects that stand where the base does, not on
            the tool: planes, sockets. In identifiable linear combinations it comes
            before the base, wherever it stands in a set.
        free: Whether the value is estimated.
        lower: Lower bound, in the unit.
        upper: Upper bound, in the unit.
        prior: Standard deviation of a normal prior about zero; infinite for none.
    """

    name: str
    unit: str
    scale: float
    nuisance: bool = False
    outer: bool = False
    free: bool = True
    lower: float = -np.inf
    upper: float = np.inf
    prior: float = np.inf


@dataclass(frozen=True)
class ParameterSet:
    """Parameters in a fixed order: base, joints from base to tip, tool, instrument.

    A parameter of several screws (of a joint and of those that mimic it) may stand at
    each of them.

    Raises:
        OptionError: If two parameters have one name.

    Examples:
        >>> names = ["elbow.placement.x", "elbow.placement.y"]
        >>> both = ParameterSet(tuple(Parameter(n, "m", 1e-3) for n in names))
        >>> both.with_fixed(["*.x"]).free.tolist()
        [False, True]
    """

    parameters: tuple[Parameter, ...]
    _positions: Mapping[str, int] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Index the names once."""
        positions: dict[str, int] = {}
        for k, parameter in enumerate(self.parameters):
            first = positions.setdefault(parameter.name, k)
            if first != k and self.parameters[first] != parameter:
                raise OptionError(f"parameter '{parameter.name}' is defined twice")
        object.__setattr__(self, "_positions", positions)

    def __len__(self) -> int:
        """Number of parameters."""
        return len(self.parameters)

    def __iter__(self) -> Iterator[Parameter]:
        """Iterate over the parameters in order."""
        return iter(self.parameters)

    def __getitem__(self, index: int) -> Parameter:
        """The parameter at a position."""
        return self.parameters[index]

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names in order."""
        return tuple(p.name for p in self.parameters)

    @cached_property
    def kinds(self) -> NDArray[np.str_]:
        """Kind of each parameter, the middle word of its name, shape (P,)."""
        return np.array([name.rsplit(".", 2)[-2] for name in self.names], str)

    @cached_property
    def scales(self) -> Floats:
        """Scales, shape (P,)."""
        return np.array([p.scale for p in self.parameters])

    @cached_property
    def free(self) -> NDArray[np.bool_]:
        """True where a parameter is estimated, shape (P,)."""
        return np.array([p.free for p in self.parameters], bool)

    @cached_property
    def nuisance(self) -> NDArray[np.bool_]:
        """True for base, tool and instrument, shape (P,)."""
        return np.array([p.nuisance for p in self.parameters], bool)

    @cached_property
    def eliminated(self) -> NDArray[np.intp]:
        """Positions in the order of elimination by linear combinations, shape (P,)."""
        return np.argsort([not p.outer for p in self.parameters], kind="stable")

    @cached_property
    def priors(self) -> Floats:
        """Prior standard deviations, shape (P,), infinite where there is none."""
        return np.array([p.prior for p in self.parameters])

    @cached_property
    def bounds(self) -> tuple[Floats, Floats]:
        """Lower and upper bounds, each of shape (P,)."""
        lower = np.array([p.lower for p in self.parameters])
        return lower, np.array([p.upper for p in self.parameters])

    def index(self, name: str) -> int:
        """First position of an exact name.

        Raises:
            OptionError: If there is no such parameter; names the nearest one.
        """
        if name not in self._positions:
            hint = nearest(name, self._positions)
            raise OptionError(f"there is no parameter '{name}'{hint}")
        return self._positions[name]

    def vector(self, values: Mapping[str, float]) -> Floats:
        """Array of values by name, zero for the others, shape (P,)."""
        for name in values:
            self.index(name)
        return np.array([values.get(name, 0.0) for name in self.names])

    def with_fixed(self, patterns: Iterable[str]) -> ParameterSet:
        """Hold the parameters that match a name or glob at zero.

        Raises:
            OptionError: If a pattern matches nothing.
        """
        matches = _matching_each(tuple(patterns), self.names)
        return self.without(set().union(*set(matches)))

    def without(self, positions: Iterable[int]) -> ParameterSet:
        """The set with the parameters at some positions not estimated."""
        return self._replace({k: {"free": False} for k in positions})

    def with_bounds(
        self, bounds: Mapping[str, float | tuple[float, float]]
    ) -> ParameterSet:
        """Bound the parameters that match a name or glob; later entries win.

        Args:
            bounds: Glob to the largest absolute value, or to (lower, upper).

        Raises:
            OptionError: If a glob matches nothing or an interval excludes zero.
        """
        changes: dict[int, dict[str, float]] = {}
        matches = _matching_each(tuple(bounds), self.names)
        for (pattern, limit), positions in zip(bounds.items(), matches, strict=True):
            lower, upper = limit if isinstance(limit, tuple) else (-limit, limit)
            if not lower <= 0.0 <= upper:
                reason = f"bounds of '{pattern}' exclude zero, the nominal robot"
                raise OptionError(reason, value=[lower, upper])
            changes |= {k: {"lower": lower, "upper": upper} for k in positions}
        return self._replace(changes)

    def with_priors(self, priors: Mapping[str, float]) -> ParameterSet:
        """Give a prior standard deviation about zero, by name or glob.

        Raises:
            OptionError: If a glob matches nothing.
        """
        matches = _matching_each(tuple(priors), self.names)
        entries = zip(priors.values(), matches, strict=True)
        changes = {k: {"prior": s} for s, positions in entries for k in positions}
        return self._replace(changes)

    def _replace(self, changes: Mapping[int, Mapping[str, float]]) -> ParameterSet:
        parameters = [*self.parameters]
        for k, change in changes.items():
            parameters[k] = replace(parameters[k], **change)  # type: ignore[arg-type]
        return ParameterSet(tuple(parameters)) if changes else self


def matching(pattern: str, names: Sequence[str]) -> list[int]:
    """Positions of the names that a name or glob of a setup file means.

    Examples:
        >>> matching("arm[1]", ["arm[1]", "arm1"]), matching("arm*", ["arm[1]", "leg"])
        ([0], [0])
    """
    if pattern in names:  # The name of a joint may hold brackets.
        return [k for k, name in enumerate(names) if name == pattern]
    return [k for k, name in enumerate(names) if fnmatchcase(name, pattern)]


def by_joint(
    entries: Iterable[tuple[str, Value]],
    joints: Sequence[str],
    column: str,
    file: str | None = None,
) -> dict[str, Value]:
    """Values by joint, of those by names or globs; later ones win.

    Args:
        entries: Names or globs, each with its value.
        joints: The joints that there are.
        column: Key of the setup file that states them, for messages.
        file: The setup file.

    Raises:
        OptionError: If one means no joint.
    """
    result = dict[str, Value]()
    for pattern, value in entries:
        matches = matching(pattern, joints)
        if not matches:
            reason, allowed = f"no joint matches '{pattern}'", ", ".join(joints)
            raise OptionError(reason, file=file, column=column, allowed=allowed)
        result |= {joints[k]: value for k in matches}
    return result


@lru_cache(maxsize=64)
def _matching_each(
    patterns: tuple[str, ...], names: tuple[str, ...]
) -> tuple[tuple[int, ...], ...]:
    """Positions for each pattern; a calibration asks the same hundreds of times.

    Raises:
        OptionError: If a pattern matches nothing.
    """
    result = []
    for pattern in patterns:
        result.append(tuple(matching(pattern, names)))
        if not result[-1]:
            raise OptionError(
                f"no parameter matches '{pattern}'{nearest(pattern, names)}"
            )
    return tuple(result)
