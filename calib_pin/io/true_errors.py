"""True errors of a simulated robot: a YAML mapping of parameter names to values."""

from __future__ import annotations

from pathlib import Path

__all__ = ["read_true_errors"]


def read_true_errors(path: str | Path) -> dict[str, float]:
    r"""Read parameter values.

    Args:
        path: YAML file, `<parameter name>: <value>` per line [m, rad].

    Raises:
        InputError: If the file is not such a mapping; names the line.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     file = Path(folder) / "errors.yaml"
        ...     _ = file.write_text("elbow.placement.x: 1e-3")
        ...     read_true_errors(file)
        {'elbow.placement.x': 0.001}
    """
    from calib_pin.io.yaml_tree import read_tree

    tree = read_tree(path)
    if not isinstance(tree.data, dict):
        raise tree.error("the file must map parameter names to values [m, rad]", ())
    for name, value in tree.data.items():
        if isinstance(value, bool) or not isinstance(value, float):
            raise tree.error(f"'{name}' needs a number [m, rad]", (name,), value=value)
    return {str(name): float(value) for name, value in tree.data.items()}
