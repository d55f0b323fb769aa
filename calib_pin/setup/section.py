"""A section of a setup file: a mapping with known keys, as a frozen dataclass."""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping
from dataclasses import fields
from typing import Any, ClassVar

from calib_pin.setup.constraints import without_empty

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
