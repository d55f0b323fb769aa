"""Setup files: YAML in, `Setup` out, or one line about the first thing wrong.

Their schema follows from the declarations of `calib_pin.setup`, and from the names that
there are. pydantic and PyYAML import slowly, and most commands read no setup file.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

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
from calib_pin.setup import (
    WORLD,
    ConditionSetup,
    FitSetup,
    Frames,
    FrameSetup,
    JointPrior,
    MeasurementSetup,
    PlanSetup,
    RobotSetup,
    Section,
    Setup,
    SolverSetup,
    StudySetup,
)
from calib_pin.setup.constraints import LENIENT, Constraint, Keys, Names, meanings
from calib_pin.setup.values import Number, Positive
from calib_pin.solvers.differential_evolution import (
    INITS,
    STRATEGIES,
    DifferentialEvolution,
)
from calib_pin.units import as_number

if TYPE_CHECKING:
    from pydantic import TypeAdapter, ValidationError

    from calib_pin.io.yaml_tree import Tree

WIDTH = 60
"""Column after which a list is continued in the next line."""

LARGEST_ERROR = 1e5
"""Largest value of a parameter, whatever its unit: that of a camera's focal length."""

SIZE = f"a number of at most {LARGEST_ERROR:g} [m, rad]"
TrueErrors = dict[
    str, Annotated[float, Number(least=-LARGEST_ERROR, most=LARGEST_ERROR, words=SIZE)]
]
"""Values of parameters by name."""

BLURRED = 1e3
"""Largest standard deviation of a pixel [px]."""

ALLOWED: Mapping[str, str] = {
    "dataclass_type": "a mapping of keys to values",
    "dict_type": "a mapping of names to values",
    "tuple_type": "a list in square brackets",
}
"""The allowed type where pydantic itself found the wrong type."""


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
    from pydantic import TypeAdapter, ValidationError

    from calib_pin.io.yaml_tree import read_tree

    tree = read_tree(path)
    try:
        found = TypeAdapter(TrueErrors).validate_python(tree.data)
    except ValidationError as error:
        raise wrong_value(tree, error, lambda path: ()) from None
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
    from pydantic import ValidationError

    from calib_pin.io.yaml_tree import read_tree, tree_of

    file = "" if isinstance(path, Mapping) else str(path)
    if isinstance(path, Mapping):
        tree = tree_of(yaml_text(path).encode(), "setup")
    else:
        tree = read_tree(path)
    if tree.data is None:
        return Setup()
    try:
        stated = adapter().validate_python(tree.data, context=context())
    except ValidationError as error:
        raise wrong_value(tree, error, known_keys) from None
    # The result may be read from another folder than the setup file.
    folder = Path(file).absolute().parent
    if isinstance(stated.prior, str):
        stated = replace(stated, prior=read_population_prior(folder / stated.prior))
    setup = stated.setup()
    _check(tree, setup)
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
    return replace(setup, obstacles=obstacles, file=file)


def setup_document(setup: Setup) -> dict[str, Any]:
    """A setup as plain data with the keys of a setup file; defaults are left out.

    Examples:
        >>> setup_document(Setup(tip="tool0", fixed=("*.placement.z",)))
        {'tip': 'tool0', 'parameters': ['placement'], 'fixed': ['*.placement.z']}
    """
    file, empty = SetupFile.of(setup), SetupFile()
    required = {"parameters", *required_keys(setup.parameters)}
    found = {
        key: value
        for key, value in _plain(asdict(file)).items()
        if getattr(file, key) != getattr(empty, key) or key in required
    }
    if isinstance(setup.prior, JointPrior):
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

    names = context(lenient=True)
    prior = document.get("prior")
    if isinstance(prior, Mapping) and "format" in prior:
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
    key = f"'{_dotted(path)}'" if path else "the file"
    if problem["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        names = known(path)
        reason = f"unknown key {key}{nearest(str(path[-1]), names)}"
        return tree.error(reason, where, allowed=", ".join(names))
    if problem["type"] == "missing":
        return tree.error(f"{key} is missing", where)
    reason, written = f"{key} cannot have this value", tree.written(where)
    return tree.error(reason, where, written, allowed_instead(problem))


def allowed_instead(problem: Mapping[str, Any]) -> str:
    """The values that are allowed instead of one that pydantic found wrong."""
    stated = problem.get("ctx", {}).get("error", problem["msg"])
    return ALLOWED.get(problem["type"], str(stated))


POINT = f"a name without {AT}, which in the target column stands between two names"

NAMES: Mapping[str, tuple[str, str]] = {
    **dict.fromkeys(("planes", "targets", "sockets"), (AT, POINT)),
    **dict.fromkeys(("spheres", "anchors"), (AT, POINT)),
    "payloads": (
        NOTHING,
        f"any name but {NOTHING}, which measurements without a payload have",
    ),
    "chains": (WORLD, f"any name but {WORLD}, which stands for all that does not move"),
    **dict.fromkeys(("stations", "tools"), ("", "a name")),
}
"""The name, or a part of it, that a section has not, and those that it may have."""


def _check(tree: Tree, setup: Setup) -> None:
    """Refuse names that cannot be, and what does not fit together.

    Raises:
        InputError: Names the line.
    """
    _check_twice(
        tree,
        ((given.joint, ("joints", k, "joint")) for k, given in setup.joints.items()),
    )
    for key, (word, allowed) in NAMES.items():
        for name in getattr(setup, key):
            if not name.strip() or name == word or (word == AT and AT in name):
                reason = f"'{key}.{name}' cannot have this name"
                raise tree.error(reason, (key, name), allowed=allowed)
    for name, tool in setup.tools.items():
        others = [other for other in setup.tools if other != name]
        if tool.on is not None and tool.on not in others:
            raise tree.error(
                f"'tools.{name}.on' is no other tool{nearest(tool.on, others)}",
                ("tools", name, "on"),
                tool.on,
                ", ".join(others) or None,
            )
        below, on = [name], tool.on
        while on is not None and on in setup.tools and on not in below:
            below.append(on)
            on = setup.tools[on].on
        if on in below:
            raise tree.error(f"'tools.{on}' carries itself", ("tools", on, "on"))
    if setup.board and setup.targets:
        raise tree.error(
            "'board' and 'targets' both say what the camera looks at",
            ("board",),
            allowed="one of them",
        )
    for key in ("distances", "angles"):
        ends = ((frozenset(d.between), k) for k, d in enumerate(getattr(setup, key)))
        _check_twice(tree, ((pair, (key, k, "between")) for pair, k in ends))


def _check_twice(
    tree: Tree, entries: Iterable[tuple[object, tuple[str | int, ...]]]
) -> None:
    """Refuse a value that stands in two places."""
    seen = dict[object, tuple[str | int, ...]]()
    for value, path in entries:
        if value in seen:
            reason = f"'{_dotted(seen[value])}' and '{_dotted(path)}' are the same"
            raise tree.error(reason, path, tree.written(path))
        seen[value] = path


def _dotted(path: Sequence[str | int]) -> str:
    """A key path as in `frames.tool.xyz` and `fixed[0]`."""
    first, *rest = path
    steps = (f"[{step}]" if isinstance(step, int) else f".{step}" for step in rest)
    return f"{first}{''.join(steps)}"


# --- the schema -------------------------------------------------------------------


@dataclass(frozen=True)
class EvolutionOption(Constraint):
    """An option of differential evolution, which knows its limits.

    Attributes:
        name: Field of `DifferentialEvolution`.
        kind: Its type.
    """

    name: str
    kind: str

    def check(self, value: object) -> Any:
        """The option."""
        # Numbers in quotes are numbers too, so that no one has to know YAML's rules.
        written = as_number(value) if isinstance(value, str) else None
        plain: Any = value if written is None else written
        if isinstance(plain, float) and plain.is_integer() and self.kind == "int":
            plain = int(plain)
        if isinstance(plain, float) and not math.isfinite(plain):
            raise ValueError("a finite number")
        try:
            DifferentialEvolution(**{self.name: plain})
        except OptionError as error:
            raise ValueError(error.allowed) from None
        return plain

    def schema(self) -> dict[str, Any]:
        """The names or the type of the option, and its default."""
        kinds = {"int": "integer", "float": "number", "str": "string"}
        known = {"strategy": STRATEGIES, "init": INITS}.get(self.name)
        found = {"enum": list(known)} if known else {"type": kinds[self.kind]}
        default = getattr(DifferentialEvolution, self.name)
        # JSON has no infinity, which here stands for no target.
        return found if default == -math.inf else {**found, "default": default}


def solver_keys() -> dict[str, Constraint]:
    """Keys of `solver`: its name and the options of the evolution."""
    options = fields(DifferentialEvolution)
    evolution = {o.name: EvolutionOption(o.name, str(o.type)) for o in options}
    return {"name": Names(SOLVERS), **evolution}


def noise_keys() -> dict[str, Constraint]:
    """Keys of `noise`: the quantities of all measurement models."""
    words = f"a standard deviation in px, at most {BLURRED:g}"
    return {
        q.name: Positive("px", BLURRED, words) if q.unit == "px" else Positive(q.unit)
        for model in MEASUREMENT_MODELS.values()
        for q in model.declaration.quantities
    }


@dataclass(frozen=True)
class FrameKeys(Section):
    """The frames of a setup file.

    Attributes:
        frames: Frames at both ends of the chain: known, or estimated.
    """

    frames: Frames = field(default_factory=Frames)


@dataclass(frozen=True)
class SetupFile(
    StudySetup,
    PlanSetup,
    ConditionSetup,
    FitSetup,
    MeasurementSetup,
    FrameKeys,
    RobotSetup,
):
    """A setup file of calib-pin.

    The keys of a `Setup`, but for two that a file groups otherwise: it has both frames
    under `frames`, and the options of the evolution beside the name of the solver. The
    quantities of `noise` are known here alone.
    """

    noise: Annotated[Mapping[str, float], Keys(noise_keys)] = field(
        default_factory=dict
    )

    solver: Annotated[
        Mapping[str, Any],
        Keys(solver_keys, meanings(SolverSetup) | meanings(DifferentialEvolution)),
    ] = field(default_factory=dict)  # type: ignore[assignment]

    @classmethod
    def of(cls, setup: Setup) -> Self:
        """The file of a setup."""
        ends = (setup.base_frame, setup.tool_frame)
        frames = Frames(*(None if end == FrameSetup() else end for end in ends))
        solver = {"name": setup.solver.name, **setup.solver.evolution}
        return cls(
            **_shared(setup),
            frames=frames,
            solver={} if setup.solver == SolverSetup() else solver,
        )

    def setup(self) -> Setup:
        """The setup of the file."""
        options = dict(self.solver)
        name = options.pop("name", SolverSetup.name)
        return Setup(
            **_shared(self),
            base_frame=self.frames.base or FrameSetup(),
            tool_frame=self.frames.tool or FrameSetup(),
            solver=SolverSetup(name, options),
        )


def _shared(setup: Setup | SetupFile) -> dict[str, Any]:
    """The keys that a setup and its file have alike."""
    names = {f.name for f in fields(Setup)} & {f.name for f in fields(SetupFile)}
    return {name: getattr(setup, name) for name in names - {"solver"}}


@cache
def adapter() -> TypeAdapter[SetupFile]:
    """The reader of setup files that are plain data."""
    from pydantic import TypeAdapter

    return TypeAdapter(SetupFile)


def context(*, lenient: bool = False) -> dict[str, Any]:
    """The validation context: the names that there are.

    Args:
        lenient: Whether unknown keys are passed over.
    """
    return {
        "model": Names(MEASUREMENT_MODELS, joined="+"),
        "parameters": Names(PARAMETERIZATIONS),
        "learned": Names(RESIDUAL_MODELS),
        "loss": Names(LOSSES),
        LENIENT: lenient,
    }


def json_schema() -> dict[str, Any]:
    """The JSON schema of setup files, with the names that there are.

    A number has its `unit` beside its limits.
    """
    names = context()

    def filled(part: Any) -> Any:
        if isinstance(part, list):
            return [filled(item) for item in part]
        if not isinstance(part, dict):
            return part
        part = {key: filled(value) for key, value in part.items() if key != "title"}
        if part.get("default", ...) is None:  # A key that may be left out.
            del part["default"]
        choices = [c for c in part.pop("anyOf", ()) if c != {"type": "null"}]
        if len(choices) == 1:
            part = {**choices[0], **part}
        elif choices:
            part["anyOf"] = choices
        family = part.pop("registered", None)
        return part if family is None else {**names[family].schema(), **part}

    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Setup file of calib-pin",
        **filled(adapter().json_schema()),
    }


def known_keys(path: Sequence[str | int]) -> list[str]:
    """The keys that may stand where an unknown one does.

    Args:
        path: Path of the unknown key.
    """
    schema = json_schema()
    part = schema
    for step in path[:-1]:
        if isinstance(step, int):
            part = part["items"]
        else:
            part = part.get("properties", {}).get(step) or part["additionalProperties"]
        part = resolved(schema, part)
    return list(part["properties"])


def resolved(schema: dict[str, Any], part: dict[str, Any]) -> dict[str, Any]:
    """The definition that a part of the schema refers to, or the part itself."""
    name = str(part.get("$ref", "")).rpartition("/")[2]
    return dict(schema["$defs"][name]) if name else part
