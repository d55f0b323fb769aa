"""`calib-pin robots`: the bundled robots."""

from __future__ import annotations

import typer


def robots() -> int:
    """List the bundled robots, whose names can stand for a URDF file."""
    from calib_pin.cli.printing import show
    from calib_pin.io.urdf import bundled_robots, load_robot
    from calib_pin.kinematics.chain import Chain
    from calib_pin.report.blocks import Cell, Table, columns

    rows = []
    for name, path in bundled_robots().items():
        chain = Chain(load_robot(name))
        others = sorted(
            file.name for file in path.parent.iterdir() if file.suffix != ".urdf"
        )
        ends = f"{chain.base} -> {chain.tip}"
        words = (name, ends, f"{len(chain.joints)}", ", ".join(others))
        rows.append([Cell(word) for word in words])
    titles = ("chain", "joints", "files")
    of = columns("name", titles, {"chain": "word", "files": "remark"})
    show([Table("", of, rows)])
    folder = next(iter(bundled_robots().values())).parents[1]
    typer.echo(f"in {folder}")
    return 0
