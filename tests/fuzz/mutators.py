"""Damage to files: bytes, lines, numbers, words, columns, elements, nodes, sizes.

A mutator takes a generator and the text of a file and returns another text. What is not
UTF-8 stands in it as surrogates, see `damaged`.
"""

from __future__ import annotations

import json
import random
import re
from collections.abc import Callable
from typing import Any

import yaml

Mutator = Callable[[random.Random, str], str]

NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
WORD = re.compile(r"[A-Za-z_][\w.-]*")
TAG = re.compile(r"<[^<>]*>")
ATTRIBUTE = re.compile(r'(\w+)="([^"]*)"')

NUMBERS = (
    *("nan", "inf", "-inf", "NaN", "Infinity", "1e308", "-1e308", "1e-320", "1e400"),
    *("1_000", "\uff11", "\u0663", "4 kg", "1,5", "0x10", "1e", ".", "-", "", "--1"),
    *("1/3", "1 2", "0", "-0", "-1", "1", "2", "1e5", "1e6", "1e12", "1e30", "-1e-9"),
    *("1e-12", "3.2", "9" * 30, "0." + "1" * 400, "true", "null", "1.0.0", "+5", "5."),
    *(".5", "1e+5"),
)
TEXTS = (
    *("", " ", "a" * 5000, "\x1b[31mred", "\x07", "\x00", "\x7f", "\u202eevil"),
    *("\u2066", "\u200b", "\u2028", "\ufeff", "é", "e\u0301", "日本", "\U0001f916"),
    *("\udcff\udcfe", "'", '"', "'" * 70, "%s", "{}", "{0}", "${x}", "$(find x)"),
    *("../../x", "/", "\\", "None", "nan", "*", "[", "]", "**", "a/b", "a@b", "a.b"),
    *("joint:base", "base", "tool", "universe", "&amp;", "&#0;", "&x;", "<!--", "]]>"),
    *("a\nb", "a\tb", "#", ":", ", ".join(f"name{k}" for k in range(200)), "x" * 300),
    *("word " * 80, "=cmd|' /C'!A0"),
)


def replaced(found: re.Match[str], new: str) -> str:
    """A text with something else in the place of a match."""
    return found.string[: found.start()] + new + found.string[found.end() :]


def pick(
    rng: random.Random, pattern: re.Pattern[str], text: str
) -> re.Match[str] | None:
    """A random match of a pattern."""
    found = list(pattern.finditer(text))
    return rng.choice(found) if found else None


def bytes_(rng: random.Random, text: str) -> str:
    """Some bytes other, added, taken away, or said twice."""
    data = bytearray(text.encode("utf-8", "surrogateescape"))
    for _ in range(rng.choice((1, 1, 2, 8))):
        a = rng.randrange(len(data) + 1)
        b = min(a + rng.choice((1, 2, 16, 300)), len(data))
        new = rng.choice(
            (
                rng.randbytes(b - a),
                b"",
                bytes(data[a:b]) * 2,
                bytes(byte ^ (1 << rng.randrange(8)) for byte in data[a:b]),
                bytes(b - a),
            )
        )
        data[a:b] = new
    return data.decode("utf-8", "surrogateescape")


def encoding(rng: random.Random, text: str) -> str:
    """Another encoding, a mark of the order of bytes, or other line ends."""
    plain = text.encode("utf-8", "replace").decode()
    data = rng.choice(
        (
            plain.encode("utf-16"),
            plain.encode("utf-16-le"),
            plain.encode("utf-32"),
            b"\xef\xbb\xbf" + plain.encode(),
            plain.replace("\n", "\r\n").encode(),
            plain.replace("\n", "\r").encode(),
            plain.replace("\n", "\u2028").encode(),
            plain.replace("o", "ö").encode("latin-1", "replace"),
        )
    )
    return data.decode("utf-8", "surrogateescape")


def lines(rng: random.Random, text: str) -> str:
    """A line moved, taken away, repeated, cut, or joined with the next."""
    rows = text.split("\n")
    k = rng.randrange(len(rows))
    row = rows.pop(k)
    there = rng.randrange(len(rows) + 1)
    cut = rng.randrange(len(row) + 1)
    rows[there if rng.random() < 0.3 else k : k] = rng.choice(
        (
            [row],
            [],
            [row, row],
            [row] * 40,
            [row[:cut]],
            [row[:cut], row[cut:]],
            [f"# {row}"],
            ["", row],
            [f"  {row}"],
            [row + row],
            [row.replace(" ", "\t")],
        )
    )
    return "\n".join(rows)


def numbers(rng: random.Random, text: str) -> str:
    """A number that is none, that cannot be meant, or just another."""
    for _ in range(rng.choice((1, 1, 1, 3))):
        if found := pick(rng, NUMBER, text):
            scaled = f"{_float(found[0]) * rng.choice((-1, 1e3, 57.3, 1.1, 1.001)):.9g}"
            new = scaled if rng.random() < 0.5 else rng.choice(NUMBERS)
            text = replaced(found, new)
    return text


def _float(text: str) -> float:
    try:
        return float(text)
    except ValueError:  # Digits of other scripts, from an earlier mutator.
        return 1.0


def words(rng: random.Random, text: str) -> str:
    """A name that is another of the file, misspelled, or no name at all."""
    found = pick(rng, WORD, text)
    if found is None:
        return text
    other = pick(rng, WORD, text)
    cut = rng.randrange(len(found[0]) + 1)
    new = rng.choice(
        (
            other[0] if other else "",
            found[0][:cut] + found[0][cut + 1 :],
            found[0] + rng.choice(TEXTS),
            rng.choice(TEXTS),
            rng.choice(NUMBERS),
        )
    )
    if rng.random() < 0.3:  # Everywhere, so that what refers to it goes along.
        return text.replace(found[0], new)
    return replaced(found, new)


def columns(rng: random.Random, text: str) -> str:
    """A column of a CSV file missing, doubled, renamed, shifted, blank or constant."""
    table = [row.split(",") for row in text.split("\n")]
    width = max(map(len, table))
    a, b = rng.randrange(width), rng.randrange(width)
    new, factor = rng.choice((*NUMBERS, *TEXTS)), rng.choice((-1, 57.3, 1e3, 1e-3, 0))
    kind = rng.randrange(9)
    head = next((k for k, row in enumerate(table) if len(row) == width), 0)
    for k, row in enumerate(table):
        if len(row) <= max(a, b):
            continue
        if kind == 0:
            del row[a]
        elif kind == 1:
            row.insert(b, row[a])
        elif kind == 2:
            row[a], row[b] = row[b], row[a]
        elif kind == 3 and k == head:
            row[a] = rng.choice((new, f"{row[a]} [{new}]", f"{row[a]} [deg]"))
        elif kind == 4 and k > head:
            row[a] = new
        elif kind == 5 and k > head and NUMBER.fullmatch(row[a]):
            row[a] = repr(_float(row[a]) * factor)
        elif kind == 6 and k == head + 1:
            row.append(new)
        elif kind == 7:
            row += [f"{row[a]}{k}" for k in range(200)]
        elif kind == 8 and k > head:
            before = table[min(max(k - rng.randrange(1, 3), head + 1), len(table) - 1)]
            row[a] = before[a % len(before)] if before else new
    if rng.random() < 0.2:
        del table[head + 1 + rng.randrange(4) :]
    mark = rng.choice((",",) * 9 + (";", "\t", " ", ", "))
    return "\n".join(map(mark.join, table))


def elements(rng: random.Random, text: str) -> str:
    """An element of an XML file missing, doubled, moved, nested or renamed."""
    found = pick(rng, TAG, text)
    if found is None:
        return text
    tag = found[0]
    if attribute := pick(rng, ATTRIBUTE, tag):
        new = rng.choice((*NUMBERS, *TEXTS)).replace('"', "&quot;")
        tag = rng.choice(
            (
                replaced(attribute, ""),
                replaced(attribute, f"{attribute[0]} {attribute[0]}"),
                replaced(attribute, f'{attribute[1]}="{new}"'),
                replaced(attribute, f'{attribute[1]}="{attribute[2]} {new}"'),
                replaced(attribute, f"{attribute[1]}='{attribute[2]}' {new}=''"),
            )
        )
    other = pick(rng, TAG, text)
    new = rng.choice(
        (
            tag,
            tag,
            tag,
            "",
            found[0] * 2,
            other[0] if other else "",
            f"<!-- {found[0]} -->",
            f"<a>{found[0]}</a>",
            "<a>" * 300 + "</a>" * 300 + found[0],
            f'<link name="many"/>{found[0]}' * 20,
            "".join(f'<link name="n{k}"/>' for k in range(300)) + found[0],
            f"<![CDATA[{found[0]}]]>",
            f'<!DOCTYPE r [<!ENTITY x "y">]>{found[0]}',
        )
    )
    return replaced(found, new)


def nodes(rng: random.Random, text: str) -> str:
    """A node of a JSON or YAML file other, missing, doubled or nested."""
    json_like = text.lstrip().startswith("{")
    try:
        data = json.loads(text) if json_like else yaml.safe_load(text)
    except (ValueError, yaml.YAMLError, RecursionError):
        return numbers(rng, text)
    places: list[tuple[Any, Any]] = []
    todo, seen = [data], set()
    while todo:
        place = todo.pop()
        if id(place) in seen:  # What YAML names may contain itself.
            continue
        seen.add(id(place))
        keys = list(place) if isinstance(place, dict) else []
        keys = list(range(len(place))) if isinstance(place, list) else keys
        # Of a long list the first entries stand for all.
        places += [(place, key) for key in keys[:5]]
        todo += [place[key] for key in keys]
    if not places:
        return text
    place, key = rng.choice(places)
    old = place[key]
    deep: Any = old
    for _ in range(rng.choice((1, 30, 300))):
        deep = [deep]
    new = rng.choice(
        (
            *(None, True, -1, 0, 1, 2, 10**30, 1e308, 1e-320, 0.5, float("nan")),
            *(float("inf"), "", [], {}, [old], {"a": old}, [old, old], [old] * 300),
            *(deep, rng.choice(places)[0], rng.choice(TEXTS), rng.choice(NUMBERS)),
        )
    )
    if rng.random() < 0.15:
        del place[key]
    elif rng.random() < 0.15 and isinstance(place, dict):
        place[rng.choice((*TEXTS, str(key) + "s"))] = place.pop(key)
    elif new is not place:
        place[key] = new
    try:
        return json.dumps(data) if json_like else yaml.safe_dump(data)
    except (ValueError, RecursionError, yaml.YAMLError):  # It contains itself.
        return text


def sizes(rng: random.Random, text: str) -> str:
    """A file cut off, empty, many times itself, or with a long line."""
    cut = rng.randrange(len(text) + 1)
    return rng.choice(
        (
            "",
            "\n",
            text[:cut],
            text[cut:],
            text[:cut] + "\n" * 5000 + text[cut:],
            text[:cut] + "x" * 30000 + text[cut:],
            text[:cut] + "[" * 3000 + text[cut:],
            text * 2,
            text[:cut] + text,
            "\n".join([text.split("\n")[0], *text.split("\n")[1:] * 20]),
        )
    )


COMMON: tuple[Mutator, ...] = (bytes_, encoding, lines, numbers, numbers, words, words)
OF_KIND: dict[str, tuple[Mutator, ...]] = {
    "csv": (columns,) * 4,
    "urdf": (elements,) * 5,
    "srdf": (elements,) * 5,
    "dae": (elements,) * 5,
    "json": (nodes,) * 8,
    "yaml": (nodes,) * 5,
}


def damaged(rng: random.Random, name: str, data: bytes) -> tuple[bytes, str]:
    """A damaged file, and the names of the mutators."""
    text = data.decode("utf-8", "surrogateescape")
    chosen = (*COMMON, sizes, *OF_KIND.get(name.rpartition(".")[2], ()))
    told = []
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        mutator = rng.choice(chosen)
        text = mutator(rng, text)[:300_000]
        told.append(mutator.__name__.strip("_"))
    # Lone surrogates that stand for no byte become something else.
    try:
        return text.encode("utf-8", "surrogateescape"), ", ".join(told)
    except UnicodeEncodeError:
        return text.encode("utf-8", "replace"), ", ".join(told)
