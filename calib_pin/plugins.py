"""Plug-ins: members of families that are registered, or found by entry points.

A package declares them in its own metadata:

    [project.entry-points."calib_pin.measurement_models"]
    theodolite = "my_package:Theodolite"
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import cache
from importlib import import_module
from typing import Any, ClassVar, TypeVar

from calib_pin.errors import CalibPinError, require_known

T = TypeVar("T")


def upper(module: str, name: str, *args: Any, **options: Any) -> Any:
    """Call a function of an upper layer, by the name of its module in the package."""
    function = getattr(import_module(f"calib_pin.{module}"), name)
    return function(*args, **options)


FAMILIES = {
    "measurement_models": "measurement_models",
    "parameterizations": "parameterizations",
    "dialects": "io.dialects",
}
"""The module of each family that others may extend."""


def register(family: str, name: str, member: Any) -> None:
    """Add a member to a family from Python, without a package and its entry point.

    It is known in this process from then on, best before anything is read. Worker
    processes import the module that defines it and know it if that module registers it
    where it is imported; a member that is defined in a notebook or in an interpreter is
    for this process alone.

    Args:
        family: `measurement_models`, `parameterizations` or `dialects`.
        name: The name that users write.
        member: The class.

    Raises:
        OptionError: If there is no such family.
        CalibPinError: If the name is taken, or the class cannot be a member.

    Examples:
        >>> register("dialects", "motive", object)
        Traceback (most recent call last):
        calib_pin.errors.CalibPinError: the dialects have a member 'motive'
    """
    require_known("family", family, FAMILIES)
    import_module(f"calib_pin.{FAMILIES[family]}")
    members = Members.known[f"calib_pin.{family}"]
    if name in members:
        raise CalibPinError(f"the {family} have a member '{name}'")
    if reason := members.fault(name, member):
        raise CalibPinError(f"'{name}' cannot be one of the {family}: {reason}")
    members.registered[name] = member


@cache
def every_entry_point() -> Any:
    """All entry points; to list them reads a file of every package there is."""
    # Imported here: it takes a tenth of a second, and not every command needs it.
    from importlib.metadata import entry_points

    return entry_points()


@cache
def extensions(group: str) -> Mapping[str, Any]:
    """The objects of all entry points of a group, by name in alphabetical order.

    Raises:
        CalibPinError: If one cannot be loaded, or two have the same name.
    """
    members: dict[str, Any] = {}
    entries = every_entry_point().select(group=group)
    for entry in sorted(entries, key=lambda entry: entry.name):
        subject = f"the plug-in '{entry.name}' of {group} ({entry.value})"
        try:
            member = entry.load()
        except Exception as error:
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            raise CalibPinError(f"{subject} cannot be loaded: {reason}") from error
        # An editable installation may show the same package twice.
        if members.setdefault(entry.name, member) is not member:
            raise CalibPinError(f"{subject} is there twice; uninstall one")
    return members


class Members(Mapping[str, T]):
    """The members of a family by name: the bundled ones, then those of entry points.

    Entry points are loaded when the mapping is first read, not before: their modules
    import the family that they extend.
    """

    known: ClassVar[dict[str, Members[Any]]] = {}

    def __init__(
        self,
        group: str,
        bundled: Mapping[str, T],
        fault: Callable[[str, object], str] = lambda name, member: "",
    ) -> None:
        """The members of a group.

        Args:
            group: Group of the entry points, such as `calib_pin.measurement_models`.
            bundled: The members that come with calib-pin.
            fault: Reason why an object from another package cannot be a member, given
                its name and the object; empty if it can.
        """
        self._group, self._bundled, self.fault = group, bundled, fault
        self.registered = dict[str, T]()
        Members.known[group] = self

    @property
    def _all(self) -> Mapping[str, T]:
        """All members.

        Raises:
            CalibPinError: If an entry point cannot be loaded, has the name of another
                member, or cannot be a member.
        """
        outside = {**self.registered, **extensions(self._group)}
        for name, member in outside.items():
            reason = self.fault(name, member)
            if name in self._bundled:
                reason = "a bundled member has this name"
            if reason:
                subject = f"the plug-in '{name}' of {self._group}"
                raise CalibPinError(f"{subject} cannot be used: {reason}")
        return {**self._bundled, **outside}

    def __getitem__(self, name: str) -> T:
        """The member of a name."""
        # A bundled member must not fail because of a broken package.
        return self._bundled[name] if name in self._bundled else self._all[name]

    def __iter__(self) -> Iterator[str]:
        """The names of the members."""
        return iter(self._all)

    def __len__(self) -> int:
        """Number of members."""
        return len(self._all)
