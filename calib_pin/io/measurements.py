"""Measurement files: CSV in, `Measurements` in SI units out, and back.

Everything that may be written in several ways (units, orientations, joint columns) is
settled here, once. A file that cannot be right stops the run with its line.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib_pin.chain import Chain
from calib_pin.errors import InputError, OutputError
from calib_pin.io.columns import Floats, Table, read_table, split_header
from calib_pin.io.files import write_atomically
from calib_pin.io.joint_columns import (
    JointSource,
    column_values,
    joint_sources,
    read_positions,
    spare_columns,
)
from calib_pin.io.measured_columns import (
    COMPONENTS,
    RESERVED,
    VALUES,
    check_model,
    check_spread,
    infer_model,
    read_sigma,
    read_values,
)
from calib_pin.measurements import Measurements
from calib_pin.setup import JointMap

__all__ = [
    "check_columns",
    "column_name",
    "read_configurations",
    "read_measurements",
    "read_targets",
    "write_configurations",
    "write_measurements",
    "write_table",
]


def read_measurements(
    paths: str | Path | Sequence[str | Path],
    chain: Chain,
    *,
    model: str | None = None,
    joints: Mapping[str, JointMap] = {},
    notice: Callable[[str], None] | None = None,
) -> Measurements:
    r"""Read measurement files and join them in the given order.

    Args:
        paths: One CSV file, or several of the same measurement model.
        chain: Chain whose joints the files hold.
        model: Measurement model; None infers it from the columns.
        joints: How file columns become joints; others are taken by their own name.
        notice: Called once per file that has columns without a meaning, with one
            sentence that lists them.

    Returns:
        All rows, in SI units; `files` holds the paths as they were given.

    Raises:
        InputError: If a file does not hold measurements of this chain; names the file
            and, where it can, the line, the column and the value.
        OptionError: If there is no measurement model of that name.

    Example:
        >>> import calib_pin, tempfile
        >>> chain = calib_pin.load_chain("space6")
        >>> text = ",".join([*chain.joints, "x [mm]", "y [mm]", "z [mm]"])
        >>> text += "\n0.1,0.2,0.3,0.4,0.5,0.6,1500,0,250\n"
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     file = Path(folder) / "tracker.csv"
        ...     _ = file.write_text(text)
        ...     data = read_measurements(file, chain)
        >>> data.model, data.values.tolist()
        ('position', [[1.5, 0.0, 0.25]])
    """
    files = [paths] if isinstance(paths, str | Path) else list(paths)
    if not files:
        raise InputError("no measurement file is given")
    if model is not None:
        check_model(model)
    sources = joint_sources(chain, joints)
    parts: list[Measurements] = []
    for file in files:
        table = read_table(file)
        parts.append(_read(table, chain, sources, joints, model, notice))
        if parts[-1].model != parts[0].model:
            raise InputError(
                f"the file holds '{parts[-1].model}' measurements, {files[0]} holds "
                f"'{parts[0].model}' ones; name what to read from both with --model",
                file=file,
            )
    return Measurements.concatenate(parts)


def read_configurations(
    path: str | Path, chain: Chain, joints: Mapping[str, JointMap] = {}
) -> Floats:
    r"""Read only the joint positions of a CSV file; other columns are ignored.

    Args:
        path: CSV file.
        chain: Chain whose joints the file holds.
        joints: How file columns become joints; others are taken by their own name.

    Returns:
        Joint positions, shape (N, n) [rad, m].

    Raises:
        InputError: As `read_measurements` does.

    Example:
        >>> import calib_pin, tempfile
        >>> chain = calib_pin.load_chain("space6")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     file = Path(folder) / "configurations.csv"
        ...     _ = file.write_text(",".join(chain.joints) + "\n0,0,0,0.5,0,0\n")
        ...     read_configurations(file, chain).tolist()
        [[0.0, 0.0, 0.0, 0.5, 0.0, 0.0]]
    """
    return read_positions(read_table(path), chain, joint_sources(chain, joints))


def read_targets(path: str | Path) -> tuple[str, ...]:
    """Read only the targets of a CSV file; empty where it names none.

    Args:
        path: CSV file.

    Raises:
        InputError: If it is not such a file.
    """
    table = read_table(path)
    return table.texts("target") if "target" in table else ()


def check_columns(
    chain: Chain, joints: Mapping[str, JointMap] = {}, targets: Sequence[str] = ()
) -> None:
    r"""Refuse what `write_configurations` could not write, before there is anything.

    Args:
        chain: The chain.
        joints: How file columns become joints.
        targets: Names that targets may have.

    Raises:
        InputError: If the joint map cannot be undone.
        OutputError: If a name would not read back.

    Example:
        >>> import calib_pin
        >>> check_columns(calib_pin.load_chain("space6"), targets=["wall\n"])
        Traceback (most recent call last):
        calib_pin.errors.OutputError: target 'wall\n' would not read back
    """
    _configuration_columns(chain, np.empty((0, len(chain.joints))), targets, joints)


def write_configurations(
    path: Path,
    chain: Chain,
    q: Floats,
    target: Sequence[str] = (),
    *,
    joints: Mapping[str, JointMap] = {},
    comments: Sequence[str] = (),
    force: bool = False,
) -> None:
    r"""Write configurations to be measured as a CSV file.

    Args:
        path: File to write.
        chain: The chain.
        q: Joint positions, shape (N, n) [rad, m].
        target: Target of each; no column where none is named.
        joints: How file columns become joints; the file holds what a controller
            needs.
        comments: Lines for the head of the file.
        force: Whether an existing file is replaced.

    Raises:
        OptionError: If the file exists and `force` is false.
        InputError: If the joint map cannot be undone.
        OutputError: If a name would not read back, or the file cannot be written.

    Example:
        >>> import calib_pin, tempfile
        >>> chain = calib_pin.load_chain("space6")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     file = Path(folder) / "plan.csv"
        ...     write_configurations(file, chain, np.array([[0, 0, 0, 0.5, 0, 0.0]]))
        ...     file.read_text().splitlines()[1]
        '0.0,0.0,0.0,0.5,0.0,0.0'
    """
    columns = _configuration_columns(chain, q, target, joints)
    write_table(path, columns, comments, force)


def write_measurements(
    path: Path,
    measurements: Measurements,
    comments: Sequence[str] = (),
    force: bool = False,
) -> None:
    """Write measurements as a CSV file that reads back bit by bit.

    Args:
        path: File to write.
        measurements: What to write; quaternions of unit length with qw >= 0, as
            `read_measurements` gives them, come back unchanged.
        comments: Lines for the head of the file.
        force: Whether an existing file is replaced.

    Raises:
        OptionError: If the file exists and `force` is false, or the measurement model
            has no file format.
        OutputError: If a name would not read back, or the file cannot be written.

    Example:
        >>> import tempfile
        >>> data = Measurements(
        ...     ("lift",), np.array([[0.25]]), "plane-distance", np.array([[1.5]])
        ... )
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     file = Path(folder) / "ranger.csv"
        ...     write_measurements(file, data, ["a ranger on a lift"])
        ...     file.read_text().split()[-2:]
        ['lift,distance', '0.25,1.5']
    """
    check_model(measurements.model)
    write_table(path, dict(_columns(measurements)), comments, force)


def write_table(
    path: Path,
    columns: Mapping[str, Sequence[object]],
    comments: Sequence[str],
    force: bool,
) -> None:
    """Write a CSV file.

    Args:
        path: File to write.
        columns: Cells of every column by its header.
        comments: Lines for the head of the file.
        force: Whether an existing file is replaced.

    Raises:
        OptionError: If the file exists and `force` is false.
        OutputError: If it cannot be written.
    """
    buffer = io.StringIO(newline="")
    for comment in comments:
        for line in comment.splitlines() or [""]:
            buffer.write(f"# {line}".rstrip() + "\n")
    # The csv module writes floats by repr, which loses nothing.
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*columns.values(), strict=True))
    write_atomically(path, buffer.getvalue().encode(), force=force)


def _read(
    table: Table,
    chain: Chain,
    sources: Sequence[JointSource],
    joints: Mapping[str, JointMap],
    model: str | None,
    notice: Callable[[str], None] | None,
) -> Measurements:
    """Measurements of one file."""
    q = read_positions(table, chain, sources)
    spare = spare_columns(table, chain, joints)
    model = model or infer_model(table)
    value_columns, values = read_values(table, model, spare)
    if "x" in value_columns:
        check_spread(table, chain, values[:, :3])
    sigma_columns, sigma = read_sigma(table, model)
    used = {*value_columns, *sigma_columns.values(), "target", "set"}
    ignored = [table.columns[name].header for name in spare if name not in used]
    ignored += ["(unnamed)"] * table.unnamed
    if ignored and notice is not None:
        notice(f"{table.file}: columns ignored: {', '.join(ignored)}")
    return Measurements(
        joints=chain.joints,
        q=q,
        model=model,
        values=values,
        sigma=sigma,
        target=table.texts("target") if "target" in table else (),
        validate=_read_set(table),
        lines=table.lines,
        files=(table.file,) * len(q),
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


def _columns(
    measurements: Measurements,
) -> Iterator[tuple[str, Sequence[float] | Sequence[str]]]:
    """Names and cells of the columns that hold measurements."""
    for name, column in zip(measurements.joints, measurements.q.T, strict=True):
        yield column_name(name), column.tolist()
    names = VALUES[measurements.model]
    for name, column in zip(names, measurements.values.T, strict=True):
        yield name, column.tolist()
    if measurements.sigma is not None:
        components = COMPONENTS[measurements.model]
        for name, column in zip(components, measurements.sigma.T, strict=True):
            yield f"sigma_{name}", column.tolist()
    if any(measurements.target):
        yield "target", _writable_targets(measurements.target)
    if measurements.validate.any():
        yield "set", ["validate" if late else "train" for late in measurements.validate]


def _configuration_columns(
    chain: Chain, q: Floats, target: Sequence[str], joints: Mapping[str, JointMap]
) -> dict[str, Sequence[float] | Sequence[str]]:
    """Names and cells of the columns that hold configurations."""
    columns: dict[str, Sequence[float] | Sequence[str]] = {}
    for name, values in column_values(q, joint_sources(chain, joints)).items():
        columns[column_name(name)] = values.tolist()
    if any(target):
        columns["target"] = _writable_targets(target)
    return columns


def column_name(joint: str) -> str:
    """The name of a column of joint positions.

    Raises:
        OutputError: If it would not read back.
    """
    if split_header(joint) != (joint, None) or joint in RESERVED:
        raise OutputError(f"joint '{joint}' cannot be the name of a column")
    return joint


def _writable_targets(targets: Sequence[str]) -> Sequence[str]:
    """The cells of a column of targets."""
    for target in targets:
        if target != target.strip() or set(target) & set("\r\n\0"):
            raise OutputError(f"target {target!r} would not read back")
    return targets
