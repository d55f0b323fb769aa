"""The measurements in one file, one part for each model."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import InputError
from calib_pin.io.columns import Floats
from calib_pin.io.joint_columns import JointSource, read_positions, spare_columns
from calib_pin.io.measured_columns import (
    check_spread,
    check_targets,
    find_starts,
    read_sigma,
    read_values,
)
from calib_pin.io.models_of_files import split_by_model
from calib_pin.io.table import Table
from calib_pin.kinematics.chain import Chain
from calib_pin.measurement_models import declared
from calib_pin.observations import AT, Measurements
from calib_pin.progress import Progress
from calib_pin.setup import JointMap

POSITIONS = 0.95
"""Part of the time after which joint positions are read."""


def read_parts(
    table: Table,
    chain: Chain,
    sources: Sequence[JointSource],
    joints: Mapping[str, JointMap],
    model: str | None,
    notice: Callable[[str], None] | None,
    progress: Progress | None,
) -> list[Measurements]:
    """Measurements of one file, one of each model."""
    q = read_positions(table, chain, sources)
    if progress is not None:
        progress(POSITIONS)
    spare = spare_columns(table, chain, joints)
    parts = []
    used = {"model", "payload", "set", "target"}
    for name, (rows, own) in split_by_model(table, model).items():
        part, columns = _read_part(own, chain, name, q[rows], spare)
        parts.append(part)
        used |= columns
    ignored = [table.columns[name].header for name in spare if name not in used]
    ignored += ["(unnamed)"] * table.unnamed
    if ignored and notice is not None:
        notice(f"{table.file}: columns ignored: {', '.join(ignored)}")
    return parts


def _read_part(
    table: Table, chain: Chain, model: str, q: Floats, spare: Sequence[str]
) -> tuple[Measurements, set[str]]:
    """Measurements of one model, and the columns that hold them."""
    value_columns, values = read_values(table, model, spare)
    check_targets(table, model)
    if "x" in value_columns:
        check_spread(table, chain, values[:, :3])
    start = np.zeros((0, 0))
    if declared(model).relative:
        row_of = find_starts(table, values[:, 0], q)
        rows = np.flatnonzero(row_of != np.arange(len(row_of)))
        table, start = table.rows(rows, table.columns), q[row_of[rows]]
        q, values = q[rows], values[rows]
    sigma_columns, sigma = read_sigma(table, model)
    part = Measurements(
        joints=chain.joints,
        q=q,
        model=model,
        values=values,
        sigma=sigma,
        target=table.texts("target") if "target" in table else (),
        payload=table.texts("payload") if "payload" in table else (),
        start=start,
        validate=_read_set(table),
        lines=table.lines,
        files=(table.file,) * len(q),
    )
    return part, {*value_columns, *sigma_columns.values()}


def check_places(rows: Measurements, sockets: Collection[str]) -> None:
    """Refuse places that some rows leave open, and sockets of one configuration."""
    names = [name.rpartition(AT)[2] for name in rows.target]
    row, reason, allowed = None, "", None
    naming = declared(rows.model).naming
    if naming.required == "all or none" and any(names) and not all(names):
        row = names.index("")
        reason = f"the row names no {naming.noun}, others do"
    elif naming.configurations > 1:
        label = rows.groups().tolist()
        seen = {name: k for name, k in zip(names, label, strict=True)}
        several = {
            name for name, k in zip(names, label, strict=True) if seen[name] != k
        }
        lonely = [name for name in seen if name not in several | set(sockets)]
        if lonely:
            row = names.index(lonely[0])
            reason = f"the {naming.noun} '{lonely[0]}' has one configuration only"
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


def _read_set(table: Table) -> NDArray[np.bool_]:
    """True for the rows of the validation set, shape (N,)."""
    if "set" not in table:
        return np.zeros(len(table.lines), bool)
    names = table.texts("set")
    for row, name in enumerate(names):
        if name not in ("train", "validate"):
            raise table.cell_error("unknown set", "set", row, "train, validate")
    return np.array([name == "validate" for name in names])
