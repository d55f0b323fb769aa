"""The measurements in one file, a block for each model, chain, station and tool."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence, Set
from dataclasses import replace

import numpy as np

from calib_pin.errors import InputError, RobotError, nearest
from calib_pin.io.columns import NO_READING, Column, Floats, closest
from calib_pin.io.condition_columns import read_conditions
from calib_pin.io.foreign_headers import check_gauges
from calib_pin.io.inferred_model import infer_model
from calib_pin.io.joint_columns import (
    kinds_of,
    own_columns,
    read_positions,
    spare_columns,
    spare_positions,
)
from calib_pin.io.measured_columns import (
    NAMES,
    ORIENTED,
    check_spread,
    check_targets,
    components,
    find_starts,
    measured,
    needed,
    optional,
    place_of,
    read_sigma,
    read_values,
    reserved,
    sigmas,
    stated_way,
)
from calib_pin.io.table import Table, with_readings
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.joint_columns import JointColumns, drives_of
from calib_pin.measurement_models import MEASUREMENT_MODELS, declared
from calib_pin.observations import (
    BlockKey,
    Booleans,
    Conditions,
    Indices,
    Labels,
    Measurements,
    Observations,
)
from calib_pin.progress import Progress
from calib_pin.setup import WORLD, JointMap, OrientationSetup
from calib_pin.units import steps_of

OURS = {"image", "pose", "cycle"}
"""Columns that our commands write for people, or for one another."""

POSITIONS = 0.95
"""Part of the time after which joint positions are read."""


def read_blocks(
    table: Table,
    chains: Chains,
    joints: Mapping[str, JointMap],
    orientation: OrientationSetup | None = None,
    asked: Sequence[str] = (),
    station: str | None = None,
    unnamed: str = "",
    notice: Callable[[str], None] | None = None,
    progress: Progress | None = None,
) -> list[Measurements]:
    """Measurements of one file, block by block in the order in which these begin.

    A measurement leaves blank what only the models of others read: a number there was
    meant to be read, and would be lost. Columns that none of them reads may hold
    anything.

    Args:
        table: The file.
        chains: The chains that it may name.
        joints: How file columns become joints; others are taken by their own name.
        orientation: How columns of an orientation are to be read.
        asked: Measurement models of a file without a column `model`.
        station: Station of all measurements; None takes the column `station`.
        unnamed: Chain of measurements that name none.
        notice: Called with one sentence that lists the columns without a meaning.
        progress: Told the part that is done, 0 to 1.

    Raises:
        InputError: If a measurement names a model or a chain that there is not, or has
            a value of another model, or the file does not hold such measurements.
    """
    texts, count = table.texts(NAMES), len(table.lines)
    if station is not None and "station" in texts:
        raise table.error(
            "the file names stations itself, so it cannot be one; leave out "
            "--station-per-file",
            "station",
        )
    absent = {"chain": unnamed, "station": station or ""}
    names = {
        name: texts.get(name, Labels.all(absent.get(name, ""), count)) for name in NAMES
    }
    names["chain"] = names["chain"].map(lambda name: name or unnamed)
    every, chains = chains, _named_chains(table, chains, names["chain"])
    table, columns = own_columns(table, chains, joints)
    table = _of_sheet(table, asked, notice)
    if "model" in table:
        _check_models(table, names["model"])
    else:
        names["model"] = Labels.all(infer_model(table, asked), count)
    kept = _with_readings(table, chains, columns, names)
    if not kept.all():
        table = with_readings(table, kept, "measurements", notice)
        return read_blocks(
            table, every, joints, orientation, asked, station, unnamed, notice, progress
        )
    q = read_positions(table, chains, columns, names["chain"])
    if progress is not None:
        progress(POSITIONS)
    blocks = _split(names)
    read = {name: _read_by(name) for name in names["model"].distinct}
    anybody = frozenset[str]().union(*read.values())
    spare, used = spare_columns(table, chains, joints), set(NAMES)
    conditions, stating = read_conditions(table, chains.joints)
    further = spare_positions(table, chains, columns, q, spare)
    conditions = replace(conditions, payload=names["payload"], spare=further)
    units = {
        j: table.columns[c].unit for j, (c, _) in columns.maps.items() if c in table
    }
    steps = {j: n[0] for j, u in units.items() if (n := steps_of(u or ""))}
    conditions, parts = replace(conditions, steps=steps), []
    for key, rows in blocks.items():
        own, texts, held = table, names, conditions
        if len(blocks) > 1:
            own = table.rows(rows, reserved())
            _check_blank(own, key.model, anybody - read[key.model])
            own = _without_blank(own, set(needed(key.model)))
            texts = {name: labels[rows].map(str) for name, labels in names.items()}
            held = replace(conditions.rows(rows), payload=texts["payload"])
        part, read_here = _read_block(
            own, chains, key, q[rows], texts, held, spare, orientation
        )
        parts.append(part)
        used |= read_here | stating
    unread = [name for name in spare if name not in used | OURS]
    if any(declared(part.model).contact for part in parts):
        check_gauges(table, unread)
    ignored = table.ignored(unread)
    if ignored and notice is not None:
        notice(ignored)
    return parts


def _of_sheet(
    table: Table, asked: Sequence[str], notice: Callable[[str], None] | None
) -> Table:
    """A file with z = 0 where it states x and y alone: points of a sheet."""
    hidden = "z" in table.missing or closest("z", [*table.columns])
    plain = {"x", "y"} <= table.columns.keys() and "z" not in table and not hidden
    if not plain or ORIENTED & table.columns.keys() or {*asked} - {"position"}:
        return table
    if notice is not None:
        notice(f"{table.file}: no z: a sheet, z = 0, on which the robot stands")
    z = Column("z", None, np.zeros(len(table.lines)))
    return replace(table, columns={**table.columns, "z": z})


def check_names(data: Observations) -> None:
    """Refuse stations and tools that some measurements name and others leave open."""
    for k in ("station", "tool"):
        named = {key[:2] for key in data.keys if getattr(key, k)}
        for block in data.blocks:
            if not getattr(block, k) and block.key[:2] in named:
                raise block.error(0, f"the row names no {k}, others do", column=k)


def check_places(data: Observations, sockets: Collection[str]) -> None:
    """Refuse places that some rows leave open, and sockets of one configuration.

    The places of one station are the same for all chains and tools.
    """
    for model, station in dict.fromkeys((key.model, key.station) for key in data.keys):
        own = [b for b in data.blocks if (b.model, b.station) == (model, station)]
        rows, naming = Observations(tuple(own)), declared(model).naming
        places = rows.target.map(place_of)
        nameless = places.where("")
        row, reason, allowed = None, "", None
        if naming.required == "all or none" and nameless.any() and not nameless.all():
            row = int(np.argmax(nameless))
            reason = f"the row names no {naming.noun}, others do"
        elif naming.configurations > 1:
            seen = np.unique(rows.groups() * len(places.names) + places.codes)
            count = np.bincount(seen % len(places.names))
            known = np.isin(places.names, list(sockets))
            lonely = ((count == 1) & ~known)[places.codes]
            if lonely.any():
                row = int(np.argmax(lonely))
                reason = f"the {naming.noun} '{places[row]}' has one configuration only"
                allowed = f"two configurations or more in every {naming.noun}"
        if row is not None:
            raise InputError(
                reason,
                file=rows.files[row],
                line=int(rows.lines[row]),
                column="target",
                value=rows.target[row],
                allowed=allowed,
            )


def _check_models(table: Table, models: Labels) -> None:
    for name in models.distinct:
        if name not in MEASUREMENT_MODELS:
            raise table.cell_error(
                f"unknown measurement model{nearest(name, MEASUREMENT_MODELS)}"
                if name
                else "the row names no measurement model",
                "model",
                int(np.argmax(models.where(name))),
                ", ".join(MEASUREMENT_MODELS),
            )


def _named_chains(table: Table, chains: Chains, chain_of: Labels) -> Chains:
    """The chains that a file measures."""
    for name in chain_of.names if "chain" in table else ():
        try:
            chains.named((name,))
        except RobotError as error:
            row = int(np.argmax(chain_of.where(name)))
            raise table.cell_error(error.reason, "chain", row, error.allowed) from None
    return chains.named(chain_of.distinct)


def _split(names: Mapping[str, Labels]) -> dict[BlockKey, Indices | slice]:
    """The rows of each block, in the order in which these begin."""
    columns = [names[field] for field in BlockKey._fields]
    code = np.zeros(len(columns[0]), np.int64)
    for column in columns:
        code = code * len(column.names) + column.codes
    if not (code != code[0]).any():
        return {BlockKey(*(column[0] for column in columns)): slice(None)}
    _, first, block = np.unique(code, return_index=True, return_inverse=True)
    ends = np.cumsum(np.bincount(block))[:-1]
    rows = np.split(np.argsort(block, kind="stable"), ends)
    return {
        BlockKey(*(column[int(first[k])] for column in columns)): rows[k]
        for k in np.argsort(first).tolist()
    }


def _with_readings(
    table: Table,
    chains: Chains,
    columns: JointColumns,
    names: Mapping[str, Labels],
) -> Booleans:
    """Whether measurements have all that their model and their joints read, shape (N,).

    Raises:
        InputError: If none has.
    """
    kept = np.ones(len(table.lines), bool)
    lacking = set[str]()
    for key, rows in _split(names).items():
        moved = drives_of(chains[key.chain])
        read = {c for joint in moved for c in kinds_of(columns, joint)}
        read |= {*needed(key.model)} | (ORIENTED & _read_by(key.model))
        for name in (read | optional(key.model)) & table.columns.keys():
            missing = table.columns[name].missing()[rows]
            if missing.any() and not (missing.all() and name in optional(key.model)):
                kept[rows] &= ~missing
                lacking.add(name)
    if not kept.any():
        column = next(name for name in table.columns if name in lacking)
        row = int(np.argmax(table.columns[column].missing()))
        raise table.cell_error(NO_READING, column, row)
    return kept


def _read_block(
    table: Table,
    chains: Chains,
    key: BlockKey,
    q: Floats,
    texts: Mapping[str, Labels],
    conditions: Conditions,
    spare: Sequence[str],
    orientation: OrientationSetup | None,
) -> tuple[Measurements, set[str]]:
    """Measurements of one block, and the columns that hold them."""
    value_columns, values = read_values(table, key.model, spare, orientation)
    check_targets(table, key, texts["target"])
    # How far apart points stand that stand still has nothing to do with the robot.
    if "x" in value_columns and key.chain != WORLD:
        check_spread(table, chains[key.chain], values[:, :3])
    start = np.zeros((0, 0))
    if declared(key.model).relative:
        row_of = find_starts(
            table, texts["target"], conditions.payload, values[:, 0], q
        )
        rows = np.flatnonzero(row_of != np.arange(len(row_of)))
        table, start = table.rows(rows, table.columns), q[row_of[rows]]
        q, values = q[rows], values[rows]
        texts = {name: labels[rows] for name, labels in texts.items()}
        conditions = conditions.rows(rows)
    sigma_columns, sigma = read_sigma(table, key.model)
    part = Measurements(
        joints=chains.joints,
        q=q,
        values=values,
        sigma=sigma,
        target=texts["target"],
        conditions=conditions,
        start=start,
        validate=_read_set(table, texts["set"]),
        lines=table.lines,
        files=Labels.all(table.file, len(q)),
        orientation=stated_way(value_columns),
        **key._asdict(),
    )
    return part, {*value_columns, *sigma_columns.values()}


def _read_set(table: Table, names: Labels) -> Booleans:
    """True for the measurements of the validation set, shape (N,)."""
    validate = names.where("validate")
    other = ~(validate | names.where("train"))
    if "set" in table and other.any():
        row = int(np.argmax(other))
        raise table.cell_error("unknown set", "set", row, "train, validate")
    return validate


def _read_by(name: str) -> frozenset[str]:
    """Columns that a model reads where it finds them, beside those that all do."""
    found = {*needed(name), *optional(name)}
    sigmas_of = {f"sigma_{c}" for c in (*components(name), *optional(name))}
    oriented = ORIENTED if declared(name).oriented else frozenset[str]()
    return oriented | found | sigmas_of


def _without_blank(table: Table, keep: Set[str]) -> Table:
    """A table without the measured columns and sigmas that are blank throughout."""
    others = (measured() | sigmas()) - keep
    columns = {
        name: column
        for name, column in table.columns.items()
        if name not in others or not column.blank().all()
    }
    return replace(table, columns=columns)


def _check_blank(table: Table, model: str, names: frozenset[str]) -> None:
    """Refuse values that the model of these rows does not read."""
    for name in table.columns:
        if name not in names:
            continue
        blank = table.columns[name].blank()
        if not blank.all():
            raise table.cell_error(
                f"the row measures '{model}', which has no {name}",
                name,
                int(np.argmin(blank)),
                "a blank cell; what else was measured stands in a row of its own",
            )
