"""YAML as a tree that knows the line of every key.

A small, strict part of YAML: no anchors, aliases or tags, every key once, and numbers
as in YAML 1.2. PyYAML follows YAML 1.1, in which `1e-5` is text, `010` is eight and
`1:30` is ninety.

PyYAML is slow to import; import this module where a file is read.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from calib_pin.errors import InputError
from calib_pin.io.files import read_bytes
from calib_pin.units import as_number

_DEEPEST = 20
_HALVES = re.compile("[\ud800-\udfff]")
_LARGEST = 1 << 20  # Bytes; some seconds, and a tree of hundreds of times as many.
_GLOB = '"*.placement.z"'

Keys = tuple[str | int, ...]
Places = dict[Keys, tuple[int, yaml.Node]]
"""Line and value node of every key and list item, by its path."""


@dataclass(frozen=True)
class Tree:
    """A YAML document.

    Attributes:
        file: Path as the caller gave it.
        data: Mappings with text keys, lists, text, numbers, truth values and None.
    """

    file: str
    data: Any
    _places: Places
    _text: str

    def line(self, path: Sequence[str | int]) -> int:
        """Line of a key or list item, or of the last part of the path that exists."""
        return self._find(path)[0]

    def written(self, path: Sequence[str | int]) -> str:
        """The value at a path as it stands in the file, on one line and shortened."""
        node = self._find(path)[1]
        if isinstance(node, yaml.ScalarNode):
            return str(node.value)
        # A block ends where the next one starts, beyond the comments between them.
        text = self._text[node.start_mark.index : node.end_mark.index]
        return textwrap.shorten(text.split("#")[0], 60, placeholder=" ...")

    def error(
        self,
        reason: str,
        path: Sequence[str | int],
        value: object = None,
        allowed: str | None = None,
    ) -> InputError:
        """An error about the key at a path."""
        return InputError(
            reason, file=self.file, line=self.line(path), value=value, allowed=allowed
        )

    def _find(self, path: Sequence[str | int]) -> tuple[int, yaml.Node]:
        """Line and value node of the last part of a path that exists."""
        ends = (tuple(path[:count]) for count in range(len(path), -1, -1))
        return next(self._places[end] for end in ends if end in self._places)


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
    return tree_of(read_bytes(path, _LARGEST), str(path))


def tree_of(content: bytes, file: str) -> Tree:
    """The content of a YAML file, see `read_tree`."""
    try:
        text = content.decode("utf-8-sig")
        _check_events(text, file)
        root = yaml.compose(text, yaml.SafeLoader)
        if root is None:  # There is nothing, or nothing but comments.
            begin = yaml.Mark(file, 0, 0, 0, None, 0)
            root = yaml.ScalarNode("tag:yaml.org,2002:null", "", begin, begin)
        places: Places = {}
        data = _build(root, file, (), _line(root), places)
        return Tree(file, data, places, text)
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        raise InputError("not UTF-8 text", file=file, line=line) from None
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        reason = ", ".join(filter(None, (error.context, error.problem)))
        if error.context == "while scanning an alias":
            reason = f"a glob needs quotes, as in {_GLOB}"
        raise InputError(
            f"not valid YAML: {reason}",
            file=file,
            line=None if mark is None else mark.line + 1,
        ) from None
    except yaml.YAMLError:
        # The reader's own error, about a control character, has no line.
        raise InputError("not a text file", file=file) from None


def _check_events(text: str, file: str) -> None:
    """Refuse anchors, aliases and tags, and what is nested too deeply to compose.

    Raises:
        InputError: Names the line.
    """
    depth = 0
    for event in yaml.parse(text, yaml.SafeLoader):
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        anchor, tag = (getattr(event, name, None) for name in ("anchor", "tag"))
        refused = ""
        if isinstance(event, yaml.AliasEvent):
            refused = f"an alias, '*{anchor}', (a glob needs quotes, as in {_GLOB})"
        elif anchor is not None:
            refused = f"an anchor, '&{anchor}',"
        elif tag is not None:
            refused = f"a tag, '{tag}',"
        elif depth > _DEEPEST:
            refused = "so deep a nesting"
        elif _HALVES.search(getattr(event, "value", "")):
            refused = "half of a character, in an escape,"
        if refused:
            reason = f"{refused} is not allowed here"
            raise InputError(reason, file=file, line=_line(event))


def _build(node: yaml.Node, file: str, path: Keys, line: int, places: Places) -> Any:
    """The data of a node, whose place and those of all below it are noted."""
    places[path] = line, node
    if isinstance(node, yaml.SequenceNode):
        return [
            _build(item, file, (*path, k), _line(item), places)
            for k, item in enumerate(node.value)
        ]
    if isinstance(node, yaml.ScalarNode):
        return _scalar(node)
    result: dict[str, Any] = {}
    for key, value in node.value:
        if not isinstance(key, yaml.ScalarNode):
            raise InputError("a key must be a name", file=file, line=_line(key))
        if key.value in result:
            raise InputError(
                f"the key '{key.value}' occurs twice", file=file, line=_line(key)
            )
        below = (*path, key.value)
        result[key.value] = _build(value, file, below, _line(key), places)
    return result


def _scalar(node: yaml.ScalarNode) -> str | float | bool | None:
    if node.style is not None:
        return str(node.value)
    if node.tag.endswith(":null"):
        return None
    if node.tag.endswith(":bool"):
        return node.value.lower() in ("true", "yes", "on")
    number = as_number(node.value)
    return str(node.value) if number is None else number


def _line(item: yaml.Node | yaml.Event) -> int:
    assert item.start_mark is not None
    return int(item.start_mark.line) + 1
