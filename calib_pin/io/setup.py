"""Setup files: YAML in, `Setup` out, or one line about the first thing wrong."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from calib_pin.errors import InputError, nearest
from calib_pin.io.json_text import plain
from calib_pin.setup import WORLD, JointPrior, Setup

WIDTH = 60
"""Column after which a list is continued in the next line."""

LARGEST_ERROR = 1e5
"""Largest value of a parameter, whatever its unit: that of a camera's focal length."""


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
    if tree.data is None:
        raise InputError("the file is empty", file=path)
    if not isinstance(tree.data, dict):
        raise tree.error("the file must map parameter names to values [m, rad]", ())
    for name, value in tree.data.items():
        if known is not None and name not in known:
            raise tree.error(f"no parameter '{name}'{nearest(name, known)}", (name,))
        if not isinstance(value, float) or not abs(value) <= LARGEST_ERROR:
            raise tree.error(
                f"'{name}' cannot have this value",
                (name,),
                tree.written((name,)),
                f"a number of at most {LARGEST_ERROR:g} [m, rad]",
            )
    return dict(tree.data)


if TYPE_CHECKING:
    from pydantic import ValidationError

    from calib_pin.io.yaml_tree import Tree

ALLOWED: Mapping[str, str] = {
    "dataclass_type": "a mapping of keys to values",
    "dict_type": "a mapping of names to values",
    "tuple_type": "a list in square brackets",
}
"""The allowed type where pydantic itself found the wrong type."""


def read_setup(path: str | Path) -> Setup:
    r"""Read a setup file.

    Args:
        path: YAML file; an empty one states nothing.

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
    # Both import slowly, and most commands read no setup file.
    from pydantic import ValidationError

    from calib_pin.io.setup_schema import adapter, context, known_keys
    from calib_pin.io.yaml_tree import read_tree

    tree = read_tree(path)
    if tree.data is None:
        return Setup()
    if not isinstance(tree.data, dict):
        raise tree.error("the file must be a mapping of keys to values", ())
    try:
        setup = adapter().validate_python(tree.data, context=context()).setup()
    except ValidationError as error:
        raise wrong_value(tree, error, known_keys) from None
    _check_joints(tree, setup)
    _check_names(tree, setup)
    _check_tools(tree, setup)
    if setup.board and setup.targets:
        raise tree.error(
            "'board' and 'targets' both say what the camera looks at",
            ("board",),
            allowed="one of them",
        )
    _check_distances(tree, setup)
    # The result may be read from another folder than the setup file.
    folder = Path(path).absolute().parent
    if isinstance(setup.prior, str):
        from calib_pin.io.population_prior import read_population_prior

        setup = replace(setup, prior=read_population_prior(folder / setup.prior))
    obstacles = tuple(
        obstacle
        if obstacle.mesh is None
        else replace(
            obstacle,
            mesh=str(folder / obstacle.mesh),
            scale=obstacle.scale or (1.0, 1.0, 1.0),
        )
        for obstacle in setup.obstacles
    )
    return replace(setup, obstacles=obstacles, file=str(path))


def setup_document(setup: Setup) -> dict[str, Any]:
    """A setup as plain data with the keys of a setup file; defaults are left out.

    Examples:
        >>> setup_document(Setup(tip="tool0", fixed=("*.placement.z",)))
        {'tip': 'tool0', 'parameters': ['placement'], 'fixed': ['*.placement.z']}
    """
    from calib_pin.io.setup_schema import SetupFile
    from calib_pin.parameterizations import required_keys

    file, empty = SetupFile.of(setup), SetupFile()
    required = {"parameters", *required_keys(setup.parameters)}
    found = {
        key: value
        for key, value in _plain(asdict(file)).items()
        if getattr(file, key) != getattr(empty, key) or key in required
    }
    if isinstance(setup.prior, JointPrior):
        from calib_pin.io.population_prior import prior_document

        found["prior"] = prior_document(setup.prior)
    return found


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


def setup_of(document: Mapping[str, Any]) -> Setup:
    """The setup of what `setup_document` made, read back from a JSON file.

    Unknown keys are those of a later version and are passed over.

    Raises:
        ValueError: If it is not such a document.

    Examples:
        >>> setup_of(setup_document(Setup(tip="tool0"))).tip
        'tool0'
    """
    from pydantic import ValidationError

    from calib_pin.io.setup_schema import adapter, context

    names = context(lenient=True)
    prior = document.get("prior")
    if isinstance(prior, Mapping) and "format" in prior:
        from calib_pin.io.population_prior import prior_of

        rest = {key: value for key, value in document.items() if key != "prior"}
        return replace(setup_of(rest), prior=prior_of(prior))
    try:
        return adapter().validate_python(document, context=names).setup()
    except ValidationError as error:
        place = _dotted(error.errors(include_url=False)[0]["loc"])
        raise ValueError(f"'setup.{place}' cannot have this value") from None


def _plain(value: Any) -> Any:
    """Mappings without their empty keys, and lists, as a file has them."""
    if isinstance(value, Mapping):
        return {k: _plain(item) for k, item in value.items() if item is not None}
    return [_plain(item) for item in value] if isinstance(value, tuple) else value


def wrong_value(
    tree: Tree,
    error: ValidationError,
    known: Callable[[Sequence[str | int]], Sequence[str]],
    place: Callable[[Sequence[str | int]], Sequence[str | int]] = lambda path: path,
) -> InputError:
    """The first thing that pydantic found wrong, in our words.

    Args:
        tree: The file.
        error: What pydantic found.
        known: The keys that may stand in the place of an unknown one, by its path.
        place: Path within the file of a path within what was checked.
    """
    problems = error.errors(include_url=False)
    problem = min(problems, key=lambda problem: tree.line(place(problem["loc"])))
    path: Sequence[str | int] = problem["loc"]
    where = place(path)
    if problem["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        names, key = known(path), str(path[-1])
        return tree.error(
            f"unknown key '{_dotted(path)}'{nearest(key, names)}",
            where,
            allowed=", ".join(names),
        )
    if problem["type"] == "missing":
        return tree.error(f"'{_dotted(path)}' is missing", where)
    if problem["type"] == "value_error":
        allowed = str(problem["ctx"]["error"])
    else:
        allowed = ALLOWED.get(problem["type"], problem["msg"])
    return tree.error(
        f"'{_dotted(path)}' cannot have this value",
        where,
        tree.written(where),
        allowed,
    )


def _check_joints(tree: Tree, setup: Setup) -> None:
    columns: dict[str, str] = {}
    for column, given in setup.joints.items():
        if given.joint in columns:
            raise tree.error(
                f"'joints.{column}.joint' and 'joints.{columns[given.joint]}.joint' "
                "are the same joint",
                ("joints", column, "joint"),
                given.joint,
            )
        columns[given.joint] = column


def _check_names(tree: Tree, setup: Setup) -> None:
    from calib_pin.observations import AT
    from calib_pin.parameterizations import NOTHING

    for key in ("planes", "targets", "sockets", "spheres", "anchors"):
        for name in getattr(setup, key):
            if AT in name or not name.strip():
                raise tree.error(
                    f"'{key}.{name}' cannot have this name",
                    (key, name),
                    allowed=f"a name without {AT}, which in the target column stands "
                    "between a point and a place",
                )
    taken = {
        "payloads": (NOTHING, "measurements without a payload have"),
        "chains": (WORLD, "stands for all that does not move"),
        "stations": ("", ""),
        "tools": ("", ""),
    }
    for key, (word, meaning) in taken.items():
        for name in getattr(setup, key):
            if name == word or not name.strip():
                raise tree.error(
                    f"'{key}.{name}' cannot have this name",
                    (key, name),
                    allowed=f"any name but {word}, which {meaning}"
                    if word
                    else "a name",
                )


def _check_tools(tree: Tree, setup: Setup) -> None:
    for name, tool in setup.tools.items():
        if tool.on is not None and (tool.on == name or tool.on not in setup.tools):
            others = [other for other in setup.tools if other != name]
            raise tree.error(
                f"'tools.{name}.on' is no other tool{nearest(tool.on, others)}",
                ("tools", name, "on"),
                tool.on,
                ", ".join(others) or None,
            )
    checked: set[str] = set()
    for name in setup.tools:
        on: str | None = name
        below: set[str] = set()
        while on is not None and on not in below and on not in checked:
            below.add(on)
            on = setup.tools[on].on
        if on is not None and on in below:
            path = ("tools", on, "on")
            raise tree.error(f"'tools.{on}' carries itself", path, setup.tools[on].on)
        checked |= below


def _check_distances(tree: Tree, setup: Setup) -> None:
    pairs: dict[frozenset[str], int] = {}
    for k, distance in enumerate(setup.distances):
        pair = frozenset(distance.between)
        if pair in pairs:
            raise tree.error(
                f"'distances[{k}]' and 'distances[{pairs[pair]}]' are between the "
                "same points",
                ("distances", k, "between"),
                list(distance.between),
            )
        pairs[pair] = k


def _dotted(path: Sequence[str | int]) -> str:
    """A key path as in `frames.tool.xyz` and `fixed[0]`."""
    first, *rest = path
    steps = (f"[{step}]" if isinstance(step, int) else f".{step}" for step in rest)
    return f"{first}{''.join(steps)}"
