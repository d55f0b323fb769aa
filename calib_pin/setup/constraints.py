"""Constraints on the values of a setup, declared in the annotations of its fields.

A constraint checks a value as it stands in a file and returns it as the type of the
field. Where the value cannot be used it raises a `ValueError` whose message is what is
allowed instead. pydantic asks the constraints for their schemas where a file is read;
it imports slowly, and most commands read no setup, so nothing here imports it before.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, fields
from typing import Annotated, Any, ClassVar

LENIENT = "lenient"
"""Key of the validation context that is true where unknown keys are passed over."""


class Section:
    """Base of the dataclasses that are the sections of a setup file.

    Its fields are the keys. pydantic takes their constraints from the annotations and
    the JSON schema takes their descriptions from the docstring. A key without a value
    counts as not written.
    """

    __pydantic_config__: ClassVar[Mapping[str, str]] = {"extra": "forbid"}

    def _check(self) -> None:
        """Refuse keys that contradict each other.

        Raises:
            ValueError: If they do; the message is what is allowed.
        """

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: Any) -> Any:
        """The schema of the dataclass, after empty keys and before contradictions."""
        from pydantic_core import core_schema

        def prepare(data: Any, info: Any) -> Any:
            known = {field.name for field in fields(source)}
            data = without_empty(data, known)
            if isinstance(data, Mapping) and info.context.get(LENIENT):
                return {key: data[key] for key in data if key in known}
            return data

        def check(section: Section) -> Section:
            section._check()
            return section

        # A section that occurs again is taken by its reference, which must be that of
        # the checks and not of the bare dataclass within.
        plain = dict(handler(source))
        reference = plain.pop("ref", None)
        return core_schema.no_info_after_validator_function(
            check,
            core_schema.with_info_before_validator_function(prepare, plain),
            ref=reference,
        )

    @classmethod
    def __get_pydantic_json_schema__(cls, core: Any, handler: Any) -> dict[str, Any]:
        """The schema of the dataclass with the words of its docstring."""
        schema = handler(core)
        section: dict[str, Any] = handler.resolve_ref_schema(schema)
        section["description"] = (inspect.getdoc(cls) or "").split("\n\n")[0]
        for key, meaning in meanings(cls).items():
            if key in section["properties"]:
                # A key that is None is one that a file leaves out.
                words = re.sub(r"\bNone\b", "left out", meaning)
                section["properties"][key]["description"] = words
        return dict(schema)


def meanings(cls: type) -> dict[str, str]:
    """The attributes in the docstrings of a class and of its bases.

    Returns:
        Text on one line, by attribute.
    """
    found: dict[str, str] = {}
    for base in reversed(cls.__mro__):
        _, _, text = inspect.cleandoc(base.__doc__ or "").partition("Attributes:\n")
        text = text.split("\n\n")[0]
        for entry in re.split(r"\n    (?=\w)", "\n" + text)[1:]:
            name, _, meaning = entry.partition(": ")
            found[name] = " ".join(meaning.split())
    return found


Json = dict[str, Any]


class Constraint:
    """A check of one value and its JSON schema, for pydantic and for editors."""

    def check(self, value: object) -> Any:
        """The value as the type of the field.

        Raises:
            ValueError: If it cannot be used; the message is what is allowed.
        """
        raise NotImplementedError

    def schema(self) -> Json:
        """The JSON schema of the value; `unit` is the unit of its numbers."""
        raise NotImplementedError

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        """The check, in place of pydantic's own."""
        from pydantic_core import core_schema

        return core_schema.no_info_plain_validator_function(self.check)

    def __get_pydantic_json_schema__(self, core: Any, handler: Any) -> Json:
        """The JSON schema of the value."""
        return self.schema()


@dataclass(frozen=True)
class Names(Constraint):
    """The name of a member of a family.

    Attributes:
        known: The names of the members.
        joined: Separator of several names; empty for a single name.
    """

    known: Collection[str]
    joined: str = ""

    def check(self, value: object) -> str:
        """The name."""
        allowed = ", ".join(self.known)
        names = [value] if isinstance(value, str) else []
        if self.joined:
            names = value.split(self.joined) if isinstance(value, str) else []
            allowed += f", or several of them with a {self.joined} between"
            allowed += ", each at most once"
        if not names or not set(names) <= set(self.known):
            raise ValueError(allowed)
        if len(set(names)) < len(names):
            raise ValueError(allowed)
        return self.joined.join(names)

    def schema(self) -> Json:
        """The names."""
        known: Json = {"enum": list(self.known)}
        if not self.joined:
            return known
        several = "|".join(map(re.escape, self.known))
        pattern = f"^({several})({re.escape(self.joined)}({several}))+$"
        return {"anyOf": [known, {"type": "string", "pattern": pattern}]}


@dataclass(frozen=True)
class Registered(Constraint):
    """A value whose constraint is known only where the file is read.

    The families (measurement models, solvers, ...) stand above the setup. Their
    constraints come in with pydantic's validation context, by family.

    Attributes:
        family: Key of the constraint in the context.
    """

    family: str

    def schema(self) -> Json:
        """A placeholder, for the reader of files to fill."""
        return {"registered": self.family}

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        """A check by the constraint in the validation context."""
        from pydantic_core import core_schema

        def check(value: object, info: Any) -> Any:
            return info.context[self.family].check(value)

        return core_schema.with_info_plain_validator_function(check)


@dataclass(frozen=True, eq=False)  # Annotations are hashed, mappings cannot be.
class Keys(Constraint):
    """A mapping with known keys, each with its own constraint; all are optional.

    Attributes:
        known: Gives the constraint by key, once a file is read.
        meanings: Meaning by key, for the documentation.
    """

    known: Callable[[], Mapping[str, Constraint]]
    meanings: Mapping[str, str] = field(default_factory=dict)

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        """A dictionary that refuses other keys; None counts as not written."""
        from pydantic_core import core_schema

        known = self.known()
        fields = {
            key: core_schema.typed_dict_field(
                handler.generate_schema(Annotated[Any, value]), required=False
            )
            for key, value in known.items()
        }

        def prepare(data: object) -> object:
            if not isinstance(data, Mapping):
                raise ValueError("a mapping of keys to values")
            return without_empty(data, known)

        return core_schema.no_info_before_validator_function(
            prepare, core_schema.typed_dict_schema(fields, extra_behavior="forbid")
        )

    def __get_pydantic_json_schema__(self, core: Any, handler: Any) -> Json:
        """The schema of each key."""
        found: Json = {"type": "object", "additionalProperties": False}
        found["properties"] = {
            key: {**value.schema()}
            | ({"description": self.meanings[key]} if key in self.meanings else {})
            for key, value in self.known().items()
        }
        return found


@dataclass(frozen=True, eq=False)  # Annotations are hashed, mappings cannot be.
class Checked(Constraint):
    """A value with a check of its own.

    Attributes:
        function: The check, see `Constraint.check`.
        json: The JSON schema.
    """

    function: Callable[[object], Any]
    json: Mapping[str, Any]

    def check(self, value: object) -> Any:
        """The value as the function returns it."""
        return self.function(value)

    def schema(self) -> Json:
        """The JSON schema."""
        return dict(self.json)


@dataclass(frozen=True)
class Distinct:
    """At least one name in a list, and each at most once."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        """The check after that of the list."""
        from pydantic_core import core_schema

        def check(names: tuple[str, ...]) -> tuple[str, ...]:
            if not names or len(set(names)) < len(names):
                raise ValueError("at least one name and each at most once")
            return names

        return core_schema.no_info_after_validator_function(check, handler(source))


@dataclass(frozen=True, eq=False)  # Annotations are hashed, types need not be.
class OrFile:
    """A value, or the path of a file that the reader of the setup puts in its place.

    Attributes:
        kind: Type of the value, a mapping.
        words: What is allowed.
    """

    kind: Any
    words: str

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        """A text as it is; the checks of the type for any other value."""
        from pydantic_core import core_schema

        def check(value: object, checked: Callable[[object], Any]) -> Any:
            if isinstance(value, str) and value.strip():
                return value
            if not isinstance(value, Mapping):
                raise ValueError(self.words)
            return checked(value)

        return core_schema.no_info_wrap_validator_function(
            check, handler.generate_schema(self.kind)
        )

    def __get_pydantic_json_schema__(self, core: Any, handler: Any) -> Json:
        """The schema of the value, or a text."""
        return {"anyOf": [handler(core["schema"]), {"type": "string"}]}


def listed(entry: Json, count: int, few: int | None = None) -> Json:
    """The JSON schema of a list.

    Args:
        entry: Schema of each entry.
        count: Number of entries.
        few: Least number of entries; None if no fewer.
    """
    least = count if few is None else few
    return {"type": "array", "items": entry, "minItems": least, "maxItems": count}


def without_empty(data: Any, known: Collection[str]) -> Any:
    """Known keys without a value count as not written."""
    if not isinstance(data, Mapping):
        return data
    return {
        k: value for k, value in data.items() if value is not None or k not in known
    }
