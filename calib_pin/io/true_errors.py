"""True errors of a simulated robot: a YAML mapping of parameter names to values."""

from __future__ import annotations

import math
from collections.abc import Collection
from pathlib import Path

from calib_pin.errors import InputError, nearest


def read_true_errors(
    path: str | Path, known: Collection[str] | None = None
) -> dict[str, float]:
    r"""Read parameter values.

    Args:
        path: YAML file, `<parameter name>: <value>` per line [m, rad].
        known: Names of the parameters that there are; None accepts every name.

    Raises:
        InputError: If the file is not such a mapping, or names a parameter that does
            not exist; names the line.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     file = Path(folder) / "errors.yaml"
        ...     _ = file.write_text("elbow.placement.x: 1e-3")
        ...     read_true_errors(file, ["elbow.placement.x"])
        {'elbow.placement.x': 0.001}
    """
    from calib_pin.io.yaml_tree import read_tree

    tree = read_tree(path)
    if tree.data is None:
        raise InputError("the file is empty", file=path)
    if not isinstance(tree.data, dict):
        raise tree.error("the file must map parameter names to values [m, rad]", ())
    for name, value in tree.data.items():
        if known is not None and name not in known:
            raise tree.error(f"no parameter '{name}'{nearest(name, known)}", (name,))
        if not isinstance(value, float) or not math.isfinite(value):
            raise tree.error(
                f"'{name}' cannot have this value",
                (name,),
                tree.written((name,)),
                "a finite number [m, rad]",
            )
    return dict(tree.data)
