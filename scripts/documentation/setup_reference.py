"""The JSON schema and the reference of setup files, from the declared keys."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from calib_pin.io.setup import json_schema, resolved

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


def schema_text() -> str:
    """The text of docs/setup.schema.json."""
    return json.dumps(json_schema(), indent=2) + "\n"


def reference_text() -> str:
    """The text of docs/setup.md: a table for every section."""
    schema = json_schema()
    paths: dict[str, list[str]] = {}
    sections: dict[str, Json] = {}
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
