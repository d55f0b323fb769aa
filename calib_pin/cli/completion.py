"""Values that a shell completes: names of robots, models, solvers and formats."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from importlib import import_module
from operator import attrgetter

import typer

KNOWN = {
    "--model": "measurement_models:MEASUREMENT_MODELS",
    "--parameters": "parameterizations:PARAMETERIZATIONS",
    "--solver": "estimation.solve:SOLVERS",
    "--loss": "estimation.robust:LOSSES",
    "--learned": "residual_models:RESIDUAL_MODELS",
    "--use": "validation.model_selection:USES",
    "--criterion": "planning.criteria:CRITERIA",
    "--method": "planning.search:METHODS",
}
"""Where the names that an option knows are; loaded when a shell asks."""

Completion = Callable[[typer.Context, str], list[str]]


def completed(option: str) -> Completion | None:
    """The completion of the value of an option; None for one with any value."""
    if option == "--format":
        return _formats
    if option not in KNOWN:
        return None
    module, _, name = KNOWN[option].partition(":")

    def names(_: typer.Context, incomplete: str) -> list[str]:
        known = attrgetter(name)(import_module(f"calib_pin.{module}"))
        more = ("prediction",) if option == "--criterion" else ()
        return _beginning((*more, *known), incomplete)

    return names


def robots(_: typer.Context, incomplete: str) -> list[str]:
    """Bundled robots and those of example-robot-data; a shell adds files itself."""
    from calib_pin.io.urdf import known_robots

    return _beginning(known_robots(), incomplete)


def _formats(context: typer.Context, incomplete: str) -> list[str]:
    """Formats of `export`, or those of `compensate`."""
    if context.info_name == "export":
        from calib_pin.io.exchange import FORMATS

        return _beginning(FORMATS, incomplete)
    return _beginning(("csv", "urscript", "joint-trajectory"), incomplete)


def _beginning(names: Iterable[str], incomplete: str) -> list[str]:
    return [name for name in names if name.startswith(incomplete)]
