"""Setup files: YAML in, `Setup` out, or one line about the first thing wrong.

What may stand in a file is declared in `calib_pin.setup`; here are the lines, the names
that there are, and what fits together. PyYAML imports slowly, and most commands read no
setup file.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from calib_pin.errors import InputError, OptionError, nearest
from calib_pin.estimation.robust.weights import LOSSES
from calib_pin.estimation.solve import SOLVERS
from calib_pin.io.json_text import plain
from calib_pin.io.population_prior import (
    prior_document,
    prior_of,
    read_population_prior,
)
from calib_pin.measurement_models import MEASUREMENT_MODELS
from calib_pin.observations import AT
from calib_pin.parameterizations import NOTHING, PARAMETERIZATIONS, required_keys
from calib_pin.residual_models import RESIDUAL_MODELS
from calib_pin.setup import WORLD, JointPrior, Setup
from calib_pin.setup.arguments import Path as Place
from calib_pin.setup.arguments import Refused, Taker, dotted, stated, unknown
from calib_pin.setup.values import Value
from calib_pin.solvers.differential_evolution import DifferentialEvolution

if TYPE_CHECKING:
    from calib_pin.io.yaml_tree import Tree

WIDTH = 60
"""Column after which a list is continued in the next line."""

LARGEST_ERROR = 1e5
"""Largest value of a parameter, whatever its unit: that of a camera's focal length."""

TrueErrors = Mapping[
    str, Annotated[float, Value("m, rad", -LARGEST_ERROR, LARGEST_ERROR)]
]
"""Values of parameters by name."""

FAMILIES: Mapping[str, Collection[str]] = {
    "model": MEASUREMENT_MODELS,
    "parameters": PARAMETERIZATIONS,
    "learned": RESIDUAL_MODELS,
    "loss": LOSSES,
    "solver": SOLVERS,
}
"""The names that there are."""


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

    Examples:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     file = Path(folder) / "errors.yaml"
        ...     _ = file.write_text("elbow.placement.x: 1e-3")
        ...     read_true_errors(file, ["elbow.placement.x"])
        {'elbow.placement.x': 0.001}
    """
    from calib_pin.io.yaml_tree import read_tree

    tree = read_tree(path)
    try:
        found: dict[str, float] = Taker().taken(tree.data, TrueErrors)
    except Refused as error:
        raise _error(tree, error) from None
    for name in found:
        if known is not None and name not in known:
            raise tree.error(f"no parameter '{name}'{nearest(name, known)}", (name,))
    return found


def read_setup(path: str | Path | Mapping[str, object]) -> Setup:
    r"""Read a setup file.

    Args:
        path: YAML file, or its keys as a mapping; an empty one states nothing.

    Returns:
        Its values, and defaults for the rest.

    Raises:
        InputError: If the file is not YAML, or a key or value cannot be used; names
            the first such line.

    Examples:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     file = Path(folder) / "setup.yaml"
        ...     _ = file.write_text("tip: tool0\nfixed: ['*.placement.z']")
        ...     setup = read_setup(file)
        >>> setup.tip, setup.fixed
        ('tool0', ('*.placement.z',))
    """
    from calib_pin.io.yaml_tree import Tree, read_tree

    tree = Tree("", path) if isinstance(path, Mapping) else read_tree(path)
    if tree.data is None:
        return Setup()
    # The result may be read from another folder than the setup file.
    folder = Path(tree.file).absolute().parent
    data = tree.data
    prior = data.get("prior") if isinstance(data, Mapping) else None
    if isinstance(prior, str) and prior.strip():
        data = {**data, "prior": read_population_prior(folder / prior)}
    try:
        setup: Setup = Taker(FAMILIES).taken(data, Setup)
        _check(setup)
    except Refused as error:
        raise _error(tree, error) from None
    obstacles = tuple(
        replace(one, mesh=one.mesh and str(folder / one.mesh))
        for one in setup.obstacles
    )
    return replace(setup, obstacles=obstacles, file=tree.file)


def setup_document(setup: Setup) -> dict[str, Any]:
    """A setup as plain data with the keys of a setup file; defaults are left out.

    Examples:
        >>> setup_document(Setup(tip="tool0", fixed=("*.placement.z",)))
        {'tip': 'tool0', 'fixed': ['*.placement.z'], 'parameters': ['placement']}
    """
    found: dict[str, Any] = stated(setup)
    for key in ("parameters", *required_keys(setup.parameters)):
        found.setdefault(key, stated(getattr(setup, key)))
    if isinstance(setup.prior, JointPrior):
        found["prior"] = prior_document(setup.prior)
    return found


def setup_of(document: Mapping[str, Any]) -> Setup:
    """The setup of what `setup_document` made, read back from a JSON file.

    Unknown keys are those of a later version and are passed over.

    Raises:
        ValueError: If it is not such a document.

    Examples:
        >>> setup_of(setup_document(Setup(tip="tool0"))).tip
        'tool0'
    """
    prior = document.get("prior")
    if isinstance(prior, Mapping) and "format" in prior:
        document = {**document, "prior": prior_of(prior)}
    try:
        setup: Setup = Taker(FAMILIES, lenient=True).taken(document, Setup)
        _check_evolution(setup)
    except Refused as error:
        place = dotted(("setup", *error.path))
        raise ValueError(f"'{place}' cannot have this value") from None
    return setup


def yaml_text(lines: Mapping[str, Any]) -> str:
    """Lines of a setup file, given as plain data.

    Examples:
        >>> print(yaml_text({"tip": "tool0", "reading": {"axes": ["y", "x", "z"]}}))
        tip: tool0
        reading:
          axes: [y, x, z]
    """
    import yaml

    text = yaml.safe_dump(
        plain(lines),
        sort_keys=False,
        default_flow_style=None,
        width=WIDTH,
        allow_unicode=True,
    )
    return str(text).rstrip("\n")


def _error(tree: Tree, refused: Refused) -> InputError:
    """A refusal with its line."""
    value = tree.written(refused.path) if refused.shown else None
    return tree.error(refused.reason, refused.path, value, refused.allowed)


NAMES: Mapping[str, str] = {
    **dict.fromkeys(("planes", "targets", "sockets", "spheres", "anchors"), AT),
    "payloads": NOTHING,  # As measurements without one have it.
    "chains": WORLD,
    **dict.fromkeys(("stations", "tools"), " "),
}
"""A name, or a part of it, that entries of a section cannot have.

In the target column `AT` stands between two names.
"""


def _check(setup: Setup) -> None:
    """Refuse names that cannot be, and what does not fit together.

    Raises:
        Refused: If there is such.
    """
    _check_evolution(setup)
    models = MEASUREMENT_MODELS.values()
    known = {q.name: q for model in models for q in model.declaration.quantities}
    for name in setup.noise:
        if name not in known:
            raise unknown(("noise", name), known)
    _check_twice(
        (given.joint, ("joints", name, "joint")) for name, given in setup.joints.items()
    )
    for key, word in NAMES.items():
        for name in getattr(setup, key):
            if not name.strip() or name == word or (word == AT and AT in name):
                allowed = f"a name {'without' if word == AT else 'other than'} {word}"
                raise Refused((key, name), allowed, "{} cannot have this name")
    carried: set[str | None] = {None}
    for _ in setup.tools:
        carried |= {name for name, tool in setup.tools.items() if tool.on in carried}
    for name in [n for n in setup.tools if n not in carried]:
        others, on = [n for n in setup.tools if n != name], str(setup.tools[name].on)
        reason = f"{{}} is no other tool, or one that it carries{nearest(on, others)}"
        raise Refused(("tools", name, "on"), ", ".join(others), reason)
    if setup.board and setup.targets:
        reason = "{} and 'targets' both say what the camera looks at"
        raise Refused(("board",), "one of them", reason)
    for key in ("distances", "angles"):
        ends = enumerate(getattr(setup, key))
        _check_twice((frozenset(d.between), (key, k, "between")) for k, d in ends)


def _check_evolution(setup: Setup) -> None:
    """Refuse options that differential evolution does not have or take."""
    known = [option.name for option in fields(DifferentialEvolution)]
    for name, value in setup.solver.evolution.items():
        if name not in known:
            raise unknown(("solver", name), ["name", *known])
        try:
            DifferentialEvolution(**{name: value})  # type: ignore[arg-type]
        except OptionError as error:
            raise Refused(("solver", name), error.allowed) from None


def _check_twice(entries: Iterable[tuple[object, Place]]) -> None:
    """Refuse a value that stands in two places."""
    seen = dict[object, Place]()
    for value, path in entries:
        if value in seen:
            reason = f"{{}} and '{dotted(seen[value])}' are the same"
            raise Refused(path, None, reason)
        seen[value] = path
