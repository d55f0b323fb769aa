"""YAML as plain data that know the line of every key.

A small, strict part of YAML: no anchors, aliases or tags, every key once, and numbers
as in YAML 1.2. PyYAML follows YAML 1.1, in which `1e-5` is text, `010` is eight and
`1:30` is ninety.

PyYAML is slow to import; import this module where a file is read.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from calib_pin.errors import InputError
from calib_pin.io.files import read_bytes
from calib_pin.units import as_number

_HALVES = re.compile("[\ud800-\udfff]")
_LARGEST = 1 << 20  # Bytes; some seconds, and a tree of hundreds of times as many.
_QUOTED = 'a glob needs quotes, as in "*.placement.z"'


Place = Sequence[str | int]
"""Keys and positions that lead to a value."""

Nodes = dict[tuple[str | int, ...], tuple[int, yaml.Node | None]]
"""Line of each key or list item, and the node of its value, by its place."""


@dataclass(frozen=True)
class Tree:
    """A YAML document.

    Attributes:
        file: Path as the caller gave it; empty for data that are in no file.
        data: Mappings with text keys, lists, text, numbers, truth values and None.
        nodes: What it was made from.
    """

    file: str
    data: Any
    nodes: Nodes = field(default_factory=dict)

    def line(self, path: Place) -> Any:
        """Line of a key or list item, or of the last part of the path that exists."""
        return self._find(path)[0]

    def written(self, path: Place) -> str | None:
        """The value at a path as it stands in the file, on one line and shortened."""
        node = self._find(path)[1]
        if node is None:
            return None
        if isinstance(node, yaml.ScalarNode):
            return str(node.value)
        # A block ends where the next one starts, beyond the comments between them.
        text = str(node.start_mark.buffer)[node.start_mark.index : node.end_mark.index]
        return textwrap.shorten(text.split("#")[0], 60, placeholder=" ...")

    def error(
        self, reason: str, path: Place, value: object = None, allowed: Any = None
    ) -> InputError:
        """An error about the key at a path."""
        file, line = self.file or None, self.line(path)
        return InputError(reason, file=file, line=line, value=value, allowed=allowed)

    def _find(self, path: Place) -> tuple[int | None, yaml.Node | None]:
        """Line and value node of the last part of a path that exists."""
        ways = (tuple(path[:k]) for k in range(len(path), -1, -1))
        return next((self.nodes[k] for k in ways if k in self.nodes), (None, None))


class _Loader(yaml.SafeLoader):
    """Composes nodes of the part of YAML that is allowed here."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        """The next node."""
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]
        alias = isinstance(event, yaml.AliasEvent)
        halves = _HALVES.search(getattr(event, "value", ""))
        if alias or event.anchor or event.tag or halves:
            reason = "an alias (*x), an anchor (&x), a tag (!x) or half of a character"
            raise InputError(f"{reason} is not allowed; {_QUOTED}", line=_line(event))
        return super().compose_node(parent, index)


def read_tree(path: str | Path) -> Tree:
    """Read a YAML file.

    Args:
        path: UTF-8 file with one document.

    Raises:
        InputError: If it is not such YAML, or uses an anchor, an alias, a tag, the
            same key twice or a key that is not a plain name.

    Examples:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     file = Path(folder) / "errors.yaml"
        ...     _ = file.write_text("elbow_joint.placement.x: 1e-5")
        ...     read_tree(file).data
        {'elbow_joint.placement.x': 1e-05}
    """
    return parse_tree(read_bytes(path, _LARGEST), str(path))


def parse_tree(content: bytes, file: str) -> Tree:
    """The same of bytes; the file is for messages."""
    line = None
    try:
        root = _Loader(content.decode("utf-8-sig")).get_single_node()
        nodes: Nodes = {(): (_line(root) if root else 1, root)}
        return Tree(file, root and _plain(root, (), nodes), nodes)
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        reason = "not UTF-8 text"
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = None if mark is None else mark.line + 1
        words = ", ".join(filter(None, (error.context, error.problem)))
        alias = error.context == "while scanning an alias"
        reason = f"not valid YAML: {_QUOTED if alias else words}"
    except yaml.YAMLError:
        # The reader's own error, about a control character, has no line.
        reason = "not a text file"
    except RecursionError:
        reason = "lists or mappings are nested too deeply"
    except InputError as error:
        line, reason = error.line, error.reason
    raise InputError(reason, file=file, line=line)


def _plain(node: yaml.Node, path: tuple[str | int, ...], nodes: Nodes) -> Any:
    """The data of a node, and the nodes of its parts."""
    if isinstance(node, yaml.ScalarNode):
        if node.style is None and node.tag.endswith(":null"):
            return None
        if node.style is None and node.tag.endswith(":bool"):
            return node.value.lower() in ("true", "yes", "on")
        number = as_number(node.value) if node.style is None else None
        return str(node.value) if number is None else number
    listed, result = isinstance(node, yaml.SequenceNode), dict[str | int, Any]()
    for k, item in enumerate(node.value):
        key, value = (item, item) if listed else item
        if not (listed or isinstance(key, yaml.ScalarNode)):
            raise InputError("a key must be a name", line=_line(key))
        if (step := k if listed else key.value) in result:
            reason = f"the key '{step}' occurs twice"
            raise InputError(reason, line=_line(key))
        nodes[*path, step] = _line(key), value
        result[step] = _plain(value, (*path, step), nodes)
    return [*result.values()] if listed else result


def _line(item: Any) -> int:
    return int(item.start_mark.line) + 1
