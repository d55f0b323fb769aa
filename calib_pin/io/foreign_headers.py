"""The meaning of columns with foreign names, by their words, numbers and units.

A file of another software says `J1 (deg)`, `TCP_x`, `X_ist` or `Achse 3 [Grad]`. The
meaning is read off the last word or the first, the unit off brackets or an ending;
several columns of the same meaning are told apart by words such as *measured*.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib_pin.errors import InputError
from calib_pin.io.columns import (
    ANGLE,
    GRAD,
    LENGTH,
    NAMES,
    UNITS,
    Column,
    Floats,
    split_header,
    unit_called,
)
from calib_pin.io.measured_columns import POSITION, optional, reserved
from calib_pin.io.measured_columns import measured as measured_kinds
from calib_pin.io.table import Table
from calib_pin.setup import STATED

GAUGES = {
    "deviation": "deviation|abweichung",
    "dial": "(?:dial|test)*(?:gauge|gage|indicator)|dial|dti|lvdt|plunger|comparator|"
    "messuhr|messtaster|taster|reading",
}
"""Words of how far a contact is off, and of gauges, where pushed in is positive."""

MEANINGS: Mapping[str, str] = {
    **{axis: rf"(?:pos|p|t|position|tcp)?{axis}" for axis in "xyz"},
    **{
        f"q{axis}": rf"(?:quat(?:ernion)?|orientation|rot(?:ation)?|q|r){axis}"
        for axis in "xyzw"
    },
    **{f"r{axis}": rf"(?:rot|rvec|rotvec|rv|r){axis}" for axis in "xyz"},
    **{name: name for name in ("roll", "pitch", "yaw")},
    "distance": "distance|dist|abstand|entfernung|range|length|wire|cable|string|"
    "extension|seil|seilzug|ballbar",
    **{
        name + axis: f"(?:{words}){axis[1:]}"
        for name, words in GAUGES.items()
        for axis in ("", "_x", "_y", "_z")
    },
    **{axis: rf"(?:pixel|px|p)?{axis}" for axis in "uv"},
    "target": "target|point|punkt|ziel|socket|pfanne|marker|corner|ecke|feature|ball|"
    "kugel",
    "station": "station|standpunkt|setup|instrument|tracker",
    "tool": "tool|werkzeug",
    "chain": "chain|arm|kette|limb|side",
    "payload": "payload|nutzlast",
    "time": "time|timestamp|zeit|stamp|times|zeitstempel|uhrzeit|datetime",
    "temperature": "temperature|temperatur|temp|temperaturec|tempc",
    "set": "set",
}
"""A word of a header, or two joined, that has a meaning, as patterns."""

SHARED = 3
"""Measurements of each name of a column with a foreign name, on the average, from which
it names what they have in common; one that numbers the measurements names nothing."""

VECTORS = (POSITION, *STATED.values(), ("u", "v"))
"""Columns that mean something together only: positions, orientations, pixels."""

OTHER = re.compile(
    r"(?:^|[ _.\-])(?:sigma|std|dev|var|err|abw|diff|delta|vel|speed|acc|force|torque|"
    r"moment|effort|current|volt|load|pwm|direction|temperature|"
    r"(?:cov|d|qd|dq|dot|tau|temp|lim|min|max)(?![a-z]))"
)
"""Words of uncertainties, differences, speeds, forces and the like."""

TURNED = re.compile(
    rf"rvec|rotvec|quat|orient|rot|angle|normal|euler|^[qr]$|^(?:{GAUGES['dial']})$"
)
"""Words with which an x is none of a position."""

LABEL = re.compile(r"(?:id|no|nr|num|number|nummer|name|label|index)?")
"""Words that say no more than that a column has names."""

MEASURED = re.compile(
    r"meas|mess|track|laser|actual|observ|(?:\b|_)(?:ist|act(?![a-z]))|real|reflector|smr"
)
COMPUTED = re.compile(
    r"tcp|\bee\b|flange|effector|robot|ctrl|controller|\bfk\b|computed|"
    r"(?:gripper|hand|end)2base|base2(?:gripper|hand|end)"
)
"""Words of what a controller computes from the joints, more often than not."""

PLACES = re.compile(r"\b(?:pos|position|translation|tvecs?|p|t)\b")
"""Words with which an x is one of a position, and that say no more."""

TURNS = re.compile(r"\b(?:rotation|rvecs?|rot|r)\b")
"""The same of orientations."""

COMMANDED = re.compile(
    r"goal|soll|nominal|cmd|command|desired|action|(?:\b|_)(?:set|nom(?![a-z]))|ref|"
    r"target|diff?\b"
)

ELEMENT = re.compile(
    r"((?:.*[\W_])?(?:pos|position|p|xyz|point|t|tvecs?|translation|meas|measured|"
    r"coordinates?|rvecs?|rotvec|[rt]_[a-z]+2[a-z]+))"
    r"[ _.\-]*\[?([0-3])\]?"
)
"""Elements of positions and of rotation vectors, by their number."""

ANGLES = {
    "a b c": ("yaw", "pitch", "roll"),  # KUKA
    "u v w": ("yaw", "pitch", "roll"),  # Epson
    "w p r": STATED["roll-pitch-yaw"],  # Fanuc
    "ex ey ez": STATED["roll-pitch-yaw"],  # ABB
    "a e r": STATED["roll-pitch-yaw"],  # Comau, Z-Y-Z
    "o a t": STATED["roll-pitch-yaw"],  # Kawasaki, Z-Y-Z
    "alpha beta gamma": STATED["roll-pitch-yaw"],  # Mecademic, X-Y-Z
    "phi theta psi": STATED["roll-pitch-yaw"],
}
"""Angles behind a position, as controllers call them, and ours. The robot has to tell
the convention, for others give the same names to other angles."""

ELEMENTS = {
    "q1 q2 q3 q4": ("qw", "qx", "qy", "qz"),  # ABB
    "q0 q1 q2 q3": ("qw", "qx", "qy", "qz"),
}
"""Elements of quaternions with the real part first; others have it last."""

NUMBERED = re.compile(r"^(.*?)[ _.\-#]*(\d+)(\D*)$")
JOINTED = re.compile(r"j|a|q|theta|axis|axe|achse|gelenk|joint|phi|motor|servo")


@dataclass(frozen=True)
class Foreign:
    """A column as another software names it.

    Attributes:
        name: Name in the file, without a unit in square brackets.
        words: The name in lower case without its unit.
        unit: Its unit as calib-pin writes it; None where it states none.
        column: The column.
    """

    name: str
    words: str
    unit: str | None
    column: Column

    def setup_name(self, unit: str | None) -> str:
        """How `columns` in a setup file names it with a unit."""
        if self.column.unit in ANGLE.units or self.column.unit in LENGTH.units:
            return self.name  # Its header says so already.
        return self.column.header if unit is None else f"{self.name} [{unit}]"

    @property
    def numbers(self) -> Floats:
        """Those of its numbers that are finite."""
        return self.column.numbers[np.isfinite(self.column.numbers)]

    @property
    def largest(self) -> float:
        """Largest absolute number; zero where there is none."""
        return float(np.abs(self.numbers).max(initial=0.0))

    @property
    def moves(self) -> bool:
        """Whether it holds numbers that are not all the same."""
        return self.numbers.size > 1 and float(np.ptp(self.numbers)) > 0.0

    @property
    def numeric(self) -> bool:
        """Whether it holds numbers that may be positions of a joint."""
        return self.column.numeric and not OTHER.search(self.words)


def foreign(columns: Mapping[str, Column]) -> tuple[Foreign, ...]:
    """The columns of a file with their units, however these are written.

    Where none is an x, elements of vectors are: `p_1`, `p_2`, `p_3` or `tvec[0]`.

    Raises:
        InputError: If a column that means something has a unit that is none of ours.
    """
    result = [_split(name, column) for name, column in columns.items()]
    if "x" not in (known := measured(result)):
        result = _with_axes(result)
        known = measured(result)
    require_units(one for ours in measured_kinds() for one in known.get(ours, ()))
    return tuple(result)


def require_units(columns: Iterable[Foreign]) -> None:
    """Refuse columns that mean something, in a unit that is none of ours.

    Raises:
        InputError: If there is one.
    """
    for foreign in columns:
        if foreign.column.unit and foreign.unit is None:
            reason = f"the unit '{foreign.column.unit}' is not known"
            allowed = ", ".join(dict.fromkeys((*UNITS, *ANGLE.units)))
            raise InputError(reason, column=foreign.name, allowed=allowed)


def _with_axes(columns: Sequence[Foreign]) -> list[Foreign]:
    """The same, elements of vectors of three called by their axes."""
    named = dict[str, str]()
    for three in (family for family in families(columns) if len(family) == 3):
        for axis, one in zip("xyz", three, strict=True):
            if match := ELEMENT.fullmatch(one.words):
                named[one.name] = f"{match[1]} {axis}"
    return [replace(one, words=named.get(one.name, one.words)) for one in columns]


def _split(name: str, column: Column) -> Foreign:
    """A column, with the unit in any brackets or at the end of its name."""
    words, unit = split_header(column.header)[0], _unit(column.unit or "")
    endings = (r"\(([^()]*)\)$", r"[ _/](?:in )?([^\W\d_]+|°)$")
    for ending in endings if unit is None else ():
        match = re.search(ending, words)
        if match and (unit := _unit(match[1])) is not None:
            words = words[: match.start()]
            break
    return Foreign(name, _split_words(words).strip(" _-/"), unit, column)


def _split_words(text: str) -> str:
    """Words that capitals tell apart with spaces between them, in lower case."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", " ", text).lower()


def _unit(text: str) -> str | None:
    """The unit that is meant: *Grad* is German for degrees, elsewhere gon is meant."""
    return "deg" if text.strip().lower() == GRAD else unit_called(text)


def measured(columns: Sequence[Foreign]) -> dict[str, list[Foreign]]:
    """The columns that may be each of ours, the likeliest first."""
    return {ours: [*choices.values()] for ours, choices in _choices(columns).items()}


def _choices(columns: Sequence[Foreign]) -> dict[str, dict[str, Foreign]]:
    """The columns that may be each of ours, the likeliest first, by the words beside.

    Vectors are whole, and their columns are alike but for the word of the axis: those
    of the same words are of one vector.
    """
    options, kinds = defaultdict[str, dict[str, Foreign]](dict), measured_kinds()
    likely = sorted(columns, key=_likelihood)
    for ours in MEANINGS:
        for column in sorted(likely, key=lambda column: column.name != ours):
            fits = ours not in kinds or column.unit in (None, *kinds[ours].units)
            stem = _stem(column, ours) if fits else None
            if stem is not None and (ours not in NAMES or _names(column, ours)):
                options[ours].setdefault(stem, column)
    for vector in VECTORS:
        # Points of a sheet have no z.
        needed = [v for v in vector if v != "z" or options[v]]
        whole = [s for s in options[vector[0]] if all(s in options[v] for v in needed)]
        options |= {v: {stem: options[v][stem] for stem in whole} for v in needed}
    return {ours: choices for ours, choices in options.items() if choices}


def with_turns(columns: Sequence[Foreign]) -> tuple[Foreign, ...]:
    """The same columns, those of an orientation behind a z called as ours.

    They have its other words. Four numbered ones are a quaternion if its norm is 1.
    """
    named = dict[str, str]()
    for k, z in enumerate(columns):
        words, beside = _parts(z.words), columns[k + 1 : k + 5]
        parts = (re.findall(r"[^\W_]+", one.words) for one in beside)
        names = [" ".join(p for p in of if p not in words) for of in parts]
        ours = ANGLES.get(" ".join(names[:3]), ())
        if len(beside) == 4 and all(map(NUMBERED.match, names)):
            norms = np.linalg.norm([one.column.numbers for one in beside], axis=0)
            if (abs(norms - 1.0) < 1e-2).mean() > 0.5:
                ours = ELEMENTS.get(" ".join(names), STATED["quaternion"])
        plain = {one.unit or one.column.unit or "deg" for one in beside[: len(ours)]}
        if "z" in words and plain <= ANGLE.units.keys():
            stem = " ".join(word for word in words if word != "z")
            turns = zip(beside, ours, strict=False)
            named |= {one.name: f"{stem} {name}" for one, name in turns}
    return tuple(replace(k, words=named.get(k.name, k.words)) for k in columns)


def vectors(columns: Sequence[Foreign]) -> list[dict[str, Foreign]]:
    """Positions that a file may state, the likeliest first, each with an orientation.

    The orientation is that of the same words; of another position's words it is not.
    One that never moves, while others do, is none. Behind each is the position alone.
    """
    options, result = _choices(columns), list[dict[str, Foreign]]()
    stems = options.get("x", {})
    for stem in stems:
        position = {axis: options[axis][stem] for axis in POSITION if axis in options}
        beside = PLACES.sub("", stem).strip()
        for names in (names for names in STATED.values() if names[0] in options):
            ways = {TURNS.sub("", other).strip(): other for other in options[names[0]]}
            # The only orientation is that of the only position.
            alone = next(iter(ways.values())) if len(stems) == 1 else None
            way = ways.get(beside, alone)
            turned = {name: options[name][way] for name in names if way is not None}
            if any(column.moves for column in turned.values()):
                result.append(position | turned)
                break
        result.append(position)
    return result


def with_our_names(table: Table) -> Table:
    """A file whose measured columns have our names, and the units of their headers.

    Of several that may be one of ours, the likeliest is; a column of ours stays.
    """
    columns = foreign(table.columns)
    units = {one.name: one.unit or one.column.unit for one in columns}
    with_units = {n: replace(c, unit=units[n]) for n, c in table.columns.items()}
    names = {ours: one.name for ours, (one, *_) in measured(columns).items()}
    known = reserved()
    free = {o: n for o, n in names.items() if o not in table and n not in known}
    return replace(table, columns=with_units).renamed(free)


def check_gauges(table: Table, names: Iterable[str]) -> None:
    """Refuse columns of a file of contacts that nobody reads and a gauge has written.

    Args:
        table: The file.
        names: The columns that nobody reads.

    Raises:
        InputError: If there is one; says how to name it.
    """
    choices = measured(foreign({name: table.columns[name] for name in names}))
    for ours, (column, *_) in choices.items():
        # Whole numbers without a unit count readings.
        if ours in optional() and (column.unit or (column.numbers % 1.0 != 0.0).any()):
            remedy = f"columns: {{{ours}: '{column.setup_name(column.unit)}'}}"
            reason = f"looks like readings of a gauge: state in the setup '{remedy}' "
            reason += "('dial' where pushed in is positive), or leave it out"
            raise table.error(reason, column.name)


def _stem(column: Foreign, ours: str) -> str | None:
    """The words of a header beside one of our meanings; None if it has another.

    Capitals are words of their own: a file may have `x` and `X`.
    """
    if column.name == ours:
        return ""
    parts = re.findall(r"[^\W_]+", column.words)
    single = any(ours in vector for vector in VECTORS)
    splits = [(parts[:-2], "".join(parts[-2:])), (parts[:-1], "".join(parts[-1:]))]
    if ours in VECTORS[1]:
        splits.append((parts[1:-1], "".join(parts[:1] + parts[-1:])))  # As in q_RS_w.
    for rest, word in [*splits, (parts[1:], "".join(parts[:1]))]:
        # Several points may be called pos_x and tcp_x, or x1 and x2.
        letters, before = word, ""
        if ours in VECTORS[0]:
            letters = word.rstrip("0123456789")
            before = letters[:-1] + word[len(letters) :]
        stem = " ".join(filter(None, [*rest, before]))
        matches = re.fullmatch(MEANINGS[ours], letters) and not OTHER.search(stem)
        turned = ours in VECTORS[0] and TURNED.search(stem)
        first = rest == parts[1:] and len(parts) > 1
        if matches and not turned and (single or not first or LABEL.fullmatch(stem)):
            return stem + "^" * column.name.isupper()
    return None


def _names(foreign: Foreign, ours: str) -> bool:
    """Whether a column says what several measurements have in common."""
    count = max(len(foreign.column.words), len(np.unique(foreign.numbers)), 1)
    return foreign.name == ours or len(foreign.column.numbers) >= SHARED * count


def _likelihood(column: Foreign) -> int:
    """Order in which columns of the same meaning are tried."""
    wrong = COMMANDED.search(column.words) or COMPUTED.search(column.words)
    return bool(wrong) - bool(MEASURED.search(column.words))


def joints_by_name(
    columns: Sequence[Foreign], joints: Collection[str]
) -> dict[str, Foreign]:
    """Columns that are called like joints of the robot, but for case and signs.

    Other words may stand around the name of a joint, as in
    `observation.state.elbow.pos`; of several such columns the likeliest is meant, which
    is a measured one.
    """
    words = {joint: _parts(_split_words(joint)) for joint in joints}
    # The longest name that is there: the elbow of the left arm is no other elbow.
    longest = sorted(joints, key=lambda joint: len(words[joint]), reverse=True)
    matches = {one.name: one for one in columns if one.name in words}
    # Of several the likeliest, with the fewest other words.
    for one in sorted(columns, key=lambda k: (_likelihood(k), len(_parts(k.words)))):
        header = _parts(one.words)
        named = (joint for joint in longest if _holds(header, words[joint]))
        if one.numeric and (joint := next(named, None)):
            matches.setdefault(joint, one)
    return {joint: matches[joint] for joint in joints if joint in matches}


def _parts(text: str) -> list[str]:
    return re.findall(r"[^\W\d_]+|\d+", text)


def _holds(words: Sequence[str], name: Sequence[str]) -> bool:
    """Whether a name is the words, or some of them and longer than a letter."""
    starts = range(len(words) - len(name) + 1)
    among = any(words[k : k + len(name)] == name for k in starts)
    among = among or sorted(words) == sorted(name)  # As `Axis X` for `X_axis`.
    return "".join(words) == "".join(name) or (among and any(len(w) > 1 for w in name))


def families(columns: Sequence[Foreign]) -> list[list[Foreign]]:
    """Columns with the same name and numbers one after the other, likeliest first.

    Those whose name is that of joints come first, then measured before commanded ones.
    """
    groups = defaultdict[tuple[str, str], dict[int, Foreign]](dict)
    for column in columns:
        if column.numeric and (match := NUMBERED.match(column.words)):
            key = match[1].strip(" _-."), match[3].strip(" _-.")
            groups[key][int(match[2])] = column

    def order(key: tuple[str, str]) -> tuple[bool, int]:
        noun = re.split(r"[ _.\-]", key[0])[-1]
        first = groups[key][min(groups[key])]
        return not JOINTED.fullmatch(noun), _likelihood(first)

    whole = [k for k, of in groups.items() if 1 < len(of) == max(of) - min(of) + 1]
    return [[groups[k][n] for n in sorted(groups[k])] for k in sorted(whole, key=order)]
