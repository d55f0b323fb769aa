"""Further columns of measurement files that hold positions of the joints as well.

A recording has commanded and measured positions, or those of two encoders.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from calib_pin.errors import CalibPinError
from calib_pin.io.columns import Floats, Kind
from calib_pin.io.joint_columns import JointSource, joint_sources, spare_columns
from calib_pin.io.measured_columns import reserved
from calib_pin.io.table import Table, read_table
from calib_pin.kinematics.chains import Chains
from calib_pin.observations import Observations
from calib_pin.setup import JointMap, Setup
from calib_pin.validation.findings.case import JointSet
from calib_pin.validation.findings.setup_lines import lines_of, restated

NEAR = 0.05
"""Distance of a column from that of a joint, rms in standard deviations of it, below
which it is one of that joint, too."""

MOST = 3
"""Sets that are tried."""


def joint_sets(
    files: Sequence[str | Path],
    chains: Chains,
    setup: Setup,
    read: Callable[[Mapping[str, JointMap]], Observations],
) -> Iterator[JointSet]:
    """Columns that follow those of the joints closely.

    Args:
        files: The measurement files.
        chains: The chains that were measured.
        setup: The setup.
        read: Reads the files with other maps of joints.
    """
    if not Path(files[0]).is_file():
        return  # A pipe cannot be read again.
    table = read_table(files[0], columns=setup.columns)
    sources = joint_sources(chains, setup.joints)
    for exchanged in _exchanges(table, chains, setup, sources)[:MOST]:
        maps = dict(_maps(sources, exchanged))
        try:
            data = read(restated(setup.joints, maps))
        except CalibPinError:
            continue
        stated = {"joints": {column: lines_of(given) for column, given in maps.items()}}
        yield JointSet(tuple(exchanged.values()), data, stated)


def _exchanges(
    table: Table, chains: Chains, setup: Setup, sources: Sequence[JointSource]
) -> list[dict[str, str]]:
    """Other columns in place of those that are joints, one dictionary for each set."""
    kinds = {c: kind for source in sources for c, kind in source.kinds.items()}
    used = {c: _numbers(table, c, kind) for c, kind in kinds.items()}
    by_unit = {kind.si: kind for kind in kinds.values()}.values()
    near = defaultdict[str, list[str]](list)
    spare = spare_columns(table, chains, setup.joints)
    for name in (name for name in spare if name not in reserved()):
        # A column is read once, however many joints have its kind.
        read = {kind.si: _numbers(table, name, kind) for kind in by_unit}
        far = {}
        for column, here in used.items():
            there = read[kinds[column].si]
            if here is not None and there is not None:
                with np.errstate(over="ignore"):  # What means something else.
                    rms = float(np.sqrt(np.mean((there - here) ** 2)))
                far[column] = rms / max(float(here.std()), 1e-300)
        closest = min(far, key=lambda column: far[column], default="")
        if closest and 0.0 < far[closest] < NEAR:
            near[closest].append(name)
    count = max(map(len, near.values()), default=0)
    return [
        {column: names[k] for column, names in near.items() if k < len(names)}
        for k in range(count)
    ]


def _numbers(table: Table, name: str, kind: Kind) -> Floats | None:
    """The numbers of a column [SI unit of the kind]; None where it has others."""
    if name not in table:
        return None
    try:
        return table.numbers(name, kind)
    except CalibPinError:
        return None


def _maps(
    sources: Sequence[JointSource], exchanged: Mapping[str, str]
) -> Iterator[tuple[str, JointMap]]:
    """Maps of the joints that have other columns, each with its column."""
    for source in sources:
        if not exchanged.keys() & source.kinds.keys():
            continue
        given = source.map or JointMap(source.joint)
        coupled = {exchanged.get(c, c): part for c, part in given.coupled.items()}
        column = exchanged.get(source.column, source.column)
        yield column, replace(given, coupled=coupled)
