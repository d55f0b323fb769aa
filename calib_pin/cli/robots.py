"""`calib-pin robots`: the bundled robots."""

from __future__ import annotations

import typer

__all__ = ["robots"]


def robots() -> int:
    """List the bundled robots, whose names can stand for a URDF file."""
    from rich.table import Table

    from calib_pin.chain import Chain
    from calib_pin.cli.printing import show
    from calib_pin.io.urdf import bundled_robots, load_robot

    table = Table(box=None, pad_edge=False)
    for column in ("name", "chain", "joints", "files"):
        table.add_column(column)
    for name, path in bundled_robots().items():
        chain = Chain(load_robot(name))
        others = sorted(
            file.name for file in path.parent.iterdir() if file.suffix != ".urdf"
        )
        table.add_row(
            name,
            f"{chain.base} -> {chain.tip}",
            f"{len(chain.joints)}",
            ", ".join(others),
        )
    show(table)
    folder = next(iter(bundled_robots().values())).parents[1]
    typer.echo(f"in {folder}")
    return 0
