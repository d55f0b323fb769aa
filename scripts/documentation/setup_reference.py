"""The JSON schema and the reference of setup files, from the declared keys."""

from __future__ import annotations

import inspect
import json
import math
import re
import typing
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, get_args, get_origin

from calib_pin import setup as declared
from calib_pin.cli.options import meanings
from calib_pin.io.setup import FAMILIES, NOISE
from calib_pin.measurement_models import MEASUREMENT_MODELS
from calib_pin.setup import values
from calib_pin.setup.arguments import keys_of
from calib_pin.setup.values import REST, SMALLEST, Section
from calib_pin.solvers.differential_evolution import (
    INITS,
    STRATEGIES,
    DifferentialEvolution,
)

Json = dict[str, Any]

DOCS = Path(__file__).parents[2] / "docs"

INTRODUCTION = """\
# Setup file

A setup file states what a robot and its measurements do not show. It is YAML; every key
is optional unless the table says *required*, and a key without a value counts as not
written. An unknown key is an error that names the nearest known one. Options of the
command line win over the file. Numbers are in SI units; numbers in quotes are numbers.

An editor with a YAML language server completes and checks the keys if the first line
names the schema, by its path or its address:

```yaml
# yaml-language-server: $schema=setup.schema.json
tip: tool0
parameters: [placement, joint-offset]
frames:
  tool: {xyz: [0, 0, 0.1], estimate: false}
```

`setup.schema.json` stands beside this page. Both are made by `scripts/document` from
the declarations in `calib_pin/setup`; members that other packages add to a family
(measurement models, parameterizations) are known to calib-pin where they are installed
and are not listed here.
"""


CHECKS: Mapping[Any, Json] = {
    values.WORDS: {"minLength": 1},
    declared.DISTINCT: {"uniqueItems": True},
    declared.PRINTED: {"maxLength": declared.LONGEST},
    declared.DAY: {"format": "date"},
}
"""What checks of texts and lists say in a schema."""

PLAIN = {bool: "boolean", int: "integer", float: "number", str: "string"}


def schema_text() -> str:
    """The text of docs/setup.schema.json."""
    return json.dumps(json_schema(), indent=2) + "\n"


def json_schema() -> Json:
    """The JSON schema of setup files, with the names that there are.

    A number has its `unit` beside its limits.
    """
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Setup file of calib-pin",
        "$defs": {
            name: _section(kind)
            for name, kind in sorted(vars(declared).items())
            if isinstance(kind, type) and issubclass(kind, Section)
            if is_dataclass(kind) and not issubclass(declared.Setup, kind)
        },
        **_section(declared.Setup),
        "description": "A setup file of calib-pin.",
    }


def resolved(schema: Json, part: Json) -> Json:
    """The definition that a part of the schema refers to, or the part itself."""
    name = str(part.get("$ref", "")).rpartition("/")[2]
    return dict(schema["$defs"][name]) if name else part


def _schema(hint: Any) -> Json:
    """The schema of what a file may write for a type."""
    kind, inner = get_origin(hint) or hint, get_args(hint)
    if kind is typing.Annotated:
        return _limited(inner[0], hint.__metadata__)
    if kind in (typing.Union, UnionType):
        found = [_schema(one) for one in inner if one is not NoneType]
        return found[0] if len(found) == 1 else {"anyOf": found}
    if kind is typing.Literal:
        return {"enum": list(inner)}
    if kind in (list, tuple):
        found = {"type": "array", "items": _schema(inner[0])}
        fixed = kind is tuple and inner[-1] is not ...
        limits = {"minItems": len(inner), "maxItems": len(inner)}
        return found | (limits if fixed else {})
    if isinstance(kind, type) and issubclass(kind, Mapping):
        return {"type": "object", "additionalProperties": _schema(inner[1])}
    if isinstance(kind, type) and issubclass(kind, Section):
        return {"$ref": f"#/$defs/{kind.__name__}"}
    return {"type": PLAIN.get(kind, "string")}  # A prior is the name of a file.


def _limited(kind: Any, marks: tuple[Any, ...]) -> Json:
    found = _schema(kind)
    for mark in marks:
        if isinstance(mark, values.Written):
            found = _schema(mark.kind)
        elif isinstance(mark, values.Value):
            found = _numbers(found, mark)
        elif isinstance(mark, values.OneOf):
            found = {"enum": list(mark.values)}
        elif isinstance(mark, values.Family):
            found = _names(found, mark)
        else:
            found = found | CHECKS.get(mark, {})
    return found


def _numbers(found: Json, limits: values.Value) -> Json:
    """The schema of numbers within limits, those of a list in its entries."""
    if "anyOf" in found:
        found = {"anyOf": [_numbers(one, limits) for one in found["anyOf"]]}
    elif found["type"] == "array":
        few = min(limits.shorter, default=found["minItems"])
        found = {**found, "items": _numbers(found["items"], limits), "minItems": few}
        found["items"].pop("unit", None)
        if few == 1:
            found = {
                "anyOf": [found["items"], {**found, "minItems": found["maxItems"]}]
            }
    else:
        lowest = "exclusiveMinimum" if limits.least == SMALLEST else "minimum"
        least = 0.0 if limits.least == SMALLEST else limits.least
        stated = {lowest: least, "maximum": limits.most}
        found = found | {k: v for k, v in stated.items() if math.isfinite(v)}
    return {**found, "unit": limits.unit} if limits.unit else found


def _names(found: Json, family: values.Family) -> Json:
    known: Json = {"enum": list(FAMILIES[family.name])}
    if family.joined:
        several, between = "|".join(map(re.escape, known["enum"])), family.joined
        pattern = f"^({several})({re.escape(between)}({several}))+$"
        return {"anyOf": [known, {"type": "string", "pattern": pattern}]}
    return {**found, "items": known} if "items" in found else known


def _section(kind: Any) -> Json:
    """The schema of a section, with the words of its docstring."""
    hints, told = typing.get_type_hints(kind, include_extras=True), meanings(kind)
    by_name = {f.name: f for f in fields(kind)}
    found: Json = {
        "type": "object",
        "additionalProperties": False,
        "description": (inspect.getdoc(kind) or "").split("\n\n")[0],
        "properties": {},
    }
    required = []
    for name, stated in keys_of(kind).items():
        (*above, key), section = stated.path, found["properties"]
        field = by_name[name]
        for step in above:
            group = {"type": "object", "additionalProperties": False, "properties": {}}
            group["description"] = "Frames at both ends: known, or estimated."
            section = section.setdefault(step, group)["properties"]
        if key == REST:
            section |= _evolution()
            continue
        words = re.sub(r"\bNone\b", "left out", told[name])
        if name == "noise":
            section[key] = _quantities()
        else:
            section[key] = _schema(hints[name])
        section[key] = {**section[key], "description": words}
        default = field.default
        if default is field.default_factory is MISSING:
            required.append(key)
        elif isinstance(default, bool | int | float | str | tuple):
            section[key]["default"] = json.loads(json.dumps(default))
    return found | ({"required": required} if required else {})


def _quantities() -> Json:
    """The schema of `noise`: the quantities of all measurement models."""
    found: Json = {"type": "object", "additionalProperties": False, "properties": {}}
    for model in MEASUREMENT_MODELS.values():
        for quantity in model.declaration.quantities:
            limits = NOISE[quantity.unit]
            found["properties"][quantity.name] = _numbers({"type": "number"}, limits)
    return found


def _evolution() -> Json:
    """The schemas of the options of differential evolution."""
    told, found = meanings(DifferentialEvolution), {}
    known = {"strategy": STRATEGIES, "init": INITS}
    for option in fields(DifferentialEvolution):
        default: Any = option.default
        part: Json = {"type": PLAIN[type(default)]}
        part = {"enum": [*known[option.name]]} if option.name in known else part
        # JSON has no infinity, which here stands for no target.
        part |= {} if default == -math.inf else {"default": default}
        found[option.name] = {**part, "description": told[option.name]}
    return found


def reference_text() -> str:
    """The text of docs/setup.md: a table for every section."""
    paths: dict[str, list[str]] = {}
    sections: dict[str, Json] = {}
    schema = json_schema()
    for path, section in _sections(schema, schema, ""):
        key = json.dumps(section)
        sections[key] = section
        paths.setdefault(key, []).append(path)
    parts = [INTRODUCTION]
    for key, section in sections.items():
        title = ", ".join(f"`{path}`" for path in paths[key] if path) or "All keys"
        parts.append(f"## {title}\n\n{section.get('description', '')}\n")
        parts.append(_table(schema, section))
    return "\n".join(parts)


def _sections(schema: Json, part: Json, path: str) -> Iterator[tuple[str, Json]]:
    """Every mapping with known keys, with its path, from the outside in."""
    part = resolved(schema, part)
    if "properties" in part:
        yield path, part
    for key, value in part.get("properties", {}).items():
        yield from _sections(schema, value, f"{path}.{key}" if path else key)
    if isinstance(part.get("additionalProperties"), dict):
        yield from _sections(schema, part["additionalProperties"], f"{path}.<name>")
    if "items" in part:
        yield from _sections(schema, part["items"], f"{path}[]")


def _table(schema: Json, section: Json) -> str:
    lines = ["| key | value | unit | default | meaning |", "|---|---|---|---|---|"]
    for key, part in section["properties"].items():
        unit = _unit(part)
        meaning = part.get("description", "").replace(f" [{unit}]", "")
        default = ""
        if "default" in part:
            default = f"`{json.dumps(part['default'])}`"
        elif key in section.get("required", ()):
            default = "*required*"
        cells = (f"`{key}`", _value(schema, part), unit, default, meaning)
        lines.append(
            "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
        )
    return "\n".join(lines) + "\n"


def _unit(part: Json) -> str:
    inner = part.get("additionalProperties") or part.get("items")
    return part.get("unit") or (_unit(inner) if isinstance(inner, dict) else "")


def _value(schema: Json, part: Json) -> str:
    """What may stand there, in words."""
    part = resolved(schema, part)
    if "enum" in part:
        return ", ".join(f"`{value}`" for value in part["enum"])
    if "anyOf" in part:
        return " or ".join(_value(schema, choice) for choice in part["anyOf"])
    if "pattern" in part:
        return "several, joined by `+`"
    if part["type"] == "array":
        few, many = part.get("minItems"), part.get("maxItems")
        count = f" of {many}" if few == many and many else f" of {few} to {many}"
        return f"list{count if many else ''}: {_value(schema, part['items'])}"
    if part["type"] == "object":
        inner = part.get("additionalProperties")
        return f"name: {_value(schema, inner)}" if inner else "section"
    names = {"string": "text", "boolean": "`true`, `false`", "integer": "whole number"}
    return names.get(part["type"], part["type"])
