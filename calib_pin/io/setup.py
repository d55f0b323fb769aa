"""Setup files: YAML in, `Setup` out, or one line about the first thing wrong.

What may stand in a file is declared in `calib_pin.setup`; here are the lines, the names
that there are, and what fits together. PyYAML imports slowly, and most commands read no
setup file.

Joint priors are JSON: that of robots of one type, a file that a setup file names, and
that of one robot, a part of the results that an older calibration began
(`calib-pin/robot-prior`, which has neither robots nor spreads).

    {"format": "calib-pin/fleet-prior", "version": 1,
     "robot": {"name", "joints": [{"name", "axis", "placement"}]},
     "robots": 200,       # that it was made from
     "parameters": [{"name", "unit", "mean", "sigma", "spread", "robots"}],
     "covariance": [],    # of the next robot's errors about the means
     "noise": {}}         # by quantity

All numbers are in SI units. What they mean stands at `setup.population`.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from calib_pin.errors import InputError, OptionError, nearest
from calib_pin.io.files import read_bytes
from calib_pin.io.json_text import decoded, format_keys, plain, reading, typed
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import MEASUREMENT_MODELS
from calib_pin.observations import AT
from calib_pin.parameterizations import NOTHING, PARAMETERIZATIONS, required_keys
from calib_pin.residual_models import RESIDUAL_MODELS
from calib_pin.setup import LOSSES, SOLVERS, WORLD, JointPrior, PopulationPrior, Setup
from calib_pin.setup.arguments import Parser, Refused, dotted, unknown
from calib_pin.setup.arguments import Path as Place
from calib_pin.setup.values import LARGEST_ERROR, LARGEST_TURN, SMALLEST, Value

if TYPE_CHECKING:
    from calib_pin.io.yaml_tree import Tree

WIDTH = 60
"""Column after which a list is continued in the next line."""

LARGEST = 1e5
"""Largest value of a parameter, whatever its unit: that of a camera's focal length."""

CAMERA_BYTES = 1 << 20
"""Most bytes of a file of a camera."""

CAMERA = ("camera_matrix", "distortion_coefficients", "image_width", "image_height")
"""Its keys."""

BROWN, COEFFICIENTS = ("", "plumb_bob"), 5
"""Models of a lens that are that of Brown and Conrady, and its coefficients."""

TrueErrors = Mapping[str, Annotated[float, Value("m, rad", -LARGEST, LARGEST)]]
"""Values of parameters by name."""

FLEET, ROBOT = "calib-pin/fleet-prior", "calib-pin/robot-prior"
"""The format of a prior by other robots, and of one by an older calibration."""

SYMMETRIC = 1e-9
"""Largest part of a correlation that may differ from its mirror image."""

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
    errors: dict[str, float] = _typed(tree, tree.data, TrueErrors)
    for name in errors:
        if known is not None and name not in known:
            raise tree.error(f"no parameter '{name}'{nearest(name, known)}", (name,))
    return errors


def read_setup(path: str | Path | Mapping[str, object]) -> Setup:
    r"""Read a setup file.

    Args:
        path: YAML file, or its keys as a mapping; an empty one states nothing.

    Returns:
        Its values, and defaults for the rest.

    Raises:
        InputError: If the file is not YAML, or a key or value cannot be used; names
            the first such line. If the prior that it names cannot be read.

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
        file = folder / prior
        document = decoded(read_bytes(file), "fleet's prior", FLEET, file)
        with reading(file, "prior"):
            joint_prior = replace(_prior_of(document), file=str(file))
        data = {**data, "prior": joint_prior}
    camera = data.get("camera") if isinstance(data, Mapping) else None
    if isinstance(camera, Mapping) and isinstance(camera.get("file"), str):
        given = {key: value for key, value in camera.items() if key != "file"}
        intrinsics = camera_of(folder / camera["file"], given.get("estimate") is True)
        data = {**data, "camera": {**intrinsics, **given}}
    setup: Setup = _typed(tree, data, Setup)
    obstacles = tuple(
        replace(obstacle, mesh=obstacle.mesh and str(folder / obstacle.mesh))
        for obstacle in setup.obstacles
    )
    return replace(setup, obstacles=obstacles, file=tree.file)


def camera_of(path: Path, estimate: bool) -> dict[str, Any]:
    """The keys of `camera` in a setup file, from a file of other software.

    `camera_info` of ROS, and `FileStorage` of OpenCV as YAML, have the matrix and the
    distortion under the same names.

    Args:
        path: The file.
        estimate: Whether the intrinsics are estimated: then a lens of another model
            than that of Brown and Conrady starts without a distortion.

    Raises:
        InputError: If the file holds no such camera, or another lens.
    """
    from calib_pin.io.yaml_tree import parse_tree

    # OpenCV writes a directive that is not YAML, and tags.
    data = read_bytes(path, CAMERA_BYTES)
    plain = re.sub(rb"^%YAML.*|^---.*|^\.\.\..*", b"", data, flags=re.MULTILINE)
    document = parse_tree(re.sub(rb"!![\w-]+", b"", plain), str(path)).data
    document = document if isinstance(document, Mapping) else {}
    K, lens, *size = (_numbers(document.get(key)) for key in CAMERA)
    if len(K) != 9 or "distortion_coefficients" not in document:
        reason = "is no camera_info of ROS, and no FileStorage of OpenCV as YAML"
        raise InputError(reason, file=path, allowed=", ".join(CAMERA[:2]))
    model, lens = str(document.get("distortion_model", "")), np.trim_zeros(lens, "b")
    if len(lens) and (len(lens) > COEFFICIENTS or model not in BROWN):
        if not estimate:
            reason = f"the lens '{model or len(lens)}' is none of Brown and Conrady"
            allowed = "such a one to start from, with 'estimate: true' beside 'file'"
            raise InputError(reason, file=path, allowed=allowed)
        lens = np.zeros(0)
    camera = {
        "focal": K[[0, 4]].tolist(),
        "center": K[[2, 5]].tolist(),
        "distortion": np.pad(lens, (0, COEFFICIENTS - len(lens))).tolist(),
    }
    numbers = np.concatenate(size).tolist()
    return {**camera, "size": numbers} if len(numbers) == 2 else camera


def _numbers(value: Any) -> Floats:
    """The numbers of a number, a list, or a mapping with `data`; empty for others."""
    if isinstance(value, Mapping):
        value = value.get("data")
    try:
        return np.array([] if value is None else value, float).ravel()
    except (TypeError, ValueError):
        return np.zeros(0)


def setup_document(setup: Setup) -> dict[str, Any]:
    """A setup as plain data with the keys of a setup file; defaults are left out.

    Examples:
        >>> setup_document(Setup(tip="tool0", fixed=("*.placement.z",)))
        {'tip': 'tool0', 'fixed': ['*.placement.z'], 'parameters': ['placement']}
    """
    document: dict[str, Any] = plain(setup, brief=True)
    for key in ("parameters", *required_keys(setup.parameters)):
        document.setdefault(key, plain(getattr(setup, key), brief=True))
    if isinstance(setup.prior, JointPrior):
        document["prior"] = prior_document(setup.prior)
    return document


def setup_of(document: Mapping[str, Any]) -> Setup:
    """The setup of what `setup_document` made, read back from a JSON file.

    Unknown keys are those of a later version and are passed over.

    Raises:
        OptionError, ValueError: If it is not such a document.

    Examples:
        >>> setup_of(setup_document(Setup(tip="tool0"))).tip
        'tool0'
    """
    prior = document.get("prior")
    if isinstance(prior, Mapping) and "format" in prior:
        document = {**document, "prior": _prior_of(prior)}
    setup: Setup = Parser(FAMILIES, document=True).parse(document, Setup, ("setup",))
    _check_evolution(setup)
    return setup


def prior_document(prior: JointPrior) -> dict[str, Any]:
    """A joint prior as plain data."""
    name = FLEET if isinstance(prior, PopulationPrior) else ROBOT
    return {**format_keys(name), **plain(prior)}


def _prior_of(document: Mapping[str, Any]) -> JointPrior:
    """The joint prior of plain data.

    Raises:
        KeyError, TypeError, ValueError, AttributeError: If it is none, see
            `json_text.reading`.
    """
    kind = JointPrior if document.get("format") == ROBOT else PopulationPrior
    prior = typed(kind, document)
    C = np.array(prior.covariance)
    usable = np.isfinite([*C.flat, *(p.mean for p in prior.parameters)]).all()
    usable &= all(0.0 < sigma < np.inf for sigma in prior.noise.values())
    if not usable or C.shape != (len(set(prior.names)), len(prior.names)):
        raise ValueError("a number is missing, or none that it can be")
    deviations = np.diag(np.linalg.cholesky(C))
    if np.abs((C - C.T) / np.outer(deviations, deviations)).max() > SYMMETRIC:
        raise ValueError("'covariance' is not symmetric")
    return prior


def yaml_text(lines: Mapping[str, Any]) -> str:
    """Lines of a setup file, given as plain data, to be put below others.

    Examples:
        >>> print(yaml_text({"tip": "tool0", "reading": {"axes": ["y", "x", "z"]}}))
        tip: tool0
        reading:
          axes: [y, x, z]
        >>> print(yaml_text({"tip": "tool0"}))
        tip: tool0
    """
    import yaml

    data = plain(lines)
    # Braces around all of it, as around what is innermost, could stand below nothing.
    nested = any(isinstance(value, dict | list) for value in data.values())
    style: dict[str, Any] = {"default_flow_style": None if nested else False}
    style |= {"sort_keys": False, "allow_unicode": True, "width": WIDTH}
    text = yaml.safe_dump(data, **style)
    return str(text).rstrip("\n")


def _typed(tree: Tree, data: object, hint: Any) -> Any:
    """Data as a type has them; refusals have their line."""
    try:
        result = Parser(FAMILIES).parse(data, hint)
        if isinstance(result, Setup):
            _check(result)
    except Refused as error:
        value = tree.written(error.path) if error.shown else None
        raise tree.error(error.reason, error.path, value, error.allowed) from None
    return result


NAMES: Mapping[str, str] = {
    **dict.fromkeys(("planes", "targets", "sockets", "spheres", "anchors"), AT),
    "payloads": NOTHING,  # As measurements without one have it.
    "chains": WORLD,
    **dict.fromkeys(("stations", "tools"), " "),
}
"""A name, or a part of it, that entries of a section cannot have.

In the target column `AT` stands between two names.
"""


NOISE: Mapping[str, Value] = {
    "m": Value("m", SMALLEST, LARGEST_ERROR),
    "rad": Value("rad", SMALLEST, LARGEST_TURN),
    "px": Value("px", SMALLEST, 1e3),
}
"""Noise that a file may state, by the unit of its quantity; what was found, of a servo
arm that lost a bolt, may be any."""


def _check(setup: Setup) -> None:
    """Refuse names that cannot be, and what does not fit together.

    Raises:
        Refused: If there is such.
    """
    _check_evolution(setup)
    models = MEASUREMENT_MODELS.values()
    known = {q.name: q for model in models for q in model.declaration.quantities}
    for name, sigma in setup.noise.items():
        if name not in known:
            raise unknown(("noise", name), known)
        try:
            NOISE[known[name].unit].parse(sigma, float)
        except ValueError as error:
            raise Refused(("noise", name), str(error)) from None
    joints = setup.joints.items()
    _check_twice((given.joint, ("joints", name, "joint")) for name, given in joints)
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
    ends = enumerate(setup.distances)
    _check_twice((frozenset(d.between), ("distances", k, "between")) for k, d in ends)


def _check_evolution(setup: Setup) -> None:
    """Refuse options that differential evolution does not have or take."""
    if not setup.solver.evolution:
        return
    from calib_pin.solvers import DifferentialEvolution

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
