"""Imports point down, and numerics touch neither files nor clocks nor chance."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "calib_pin"

# Modules and families by layer; a new one is added here.
LAYERS = (
    (
        *("chi_square", "errors", "evidence", "parameters", "progress", "setup"),
        *("restricted_likelihood", "spatial", "student", "units"),
    ),
    (
        *("camera_pose", "chain", "collision", "contact_registration", "blocks"),
        *(
            "kernels",
            "link_kernels",
            "measurements",
            "registration",
            "row_kernels",
            "stretches",
            "threads",
        ),
    ),
    (
        *("parameterizations", "measurement_models", "error_model", "segments"),
        *("known_distances", "many_rows"),
    ),
    (
        *("problem", "configurations", "formulation", "population"),
        *("directions", "identifiability"),
        *("residual_models", "scale", "solvers"),
    ),
    (
        *("assessment", "calibration", "calibration_record", "causes", "comparison"),
        *("compensation", "consensus", "evaluation", "expected_accuracy", "fit"),
        *("gains", "held_out", "inverse_kinematics", "joint_readings", "ladder"),
        *("moved_instrument", "parameter_changes", "planning", "plausibility"),
        *("posterior", "predicted", "remedies", "repetitions", "result", "robust"),
        *(
            "row_errors",
            "shrinkage",
            "simulation",
            "solve",
            "stages",
            "splits",
            "studentized",
        ),
        *("systematic", "tip_accuracy", "tip_drift", "training", "trajectory"),
        *("unseen", "variance_components", "verdict"),
    ),
    ("io", "report", "viewer"),
    ("cli",),
)
LAYER = {name: k for k, names in enumerate(LAYERS) for name in names}
# Families and the parts of layer 3 know nothing of each other. The error model is
# what puts the parameterizations together.
APART = {
    "measurement_models",
    "problem",
    "directions",
    "identifiability",
    "residual_models",
    "solvers",
    "io",
    "report",
    "viewer",
}
SIDEWAYS = {
    ("error_model", "parameterizations"),
    ("identifiability", "directions"),
    ("configurations", "problem"),
    ("formulation", "problem"),
    ("known_distances", "measurement_models"),
    ("many_rows", "measurement_models"),
    ("population", "problem"),
    ("scale", "problem"),
    ("viewer", "io"),
}
NUMERICS = 4
FORBIDDEN_MODULES = {
    *("builtins", "datetime", "ftplib", "getpass", "glob", "http", "io", "logging"),
    *("multiprocessing", "os", "random", "secrets", "shutil", "socket", "subprocess"),
    *("sys", "tempfile", "threading", "time", "urllib", "uuid"),
}
# What limits the threads of a process must know of its threads and its libraries.
ALLOWED = {"threads": {"sys", "threading"}}
FORBIDDEN_CALLS = {"breakpoint", "eval", "exec", "input", "open", "print"}
FORBIDDEN_METHODS = {
    *("chmod", "exists", "fromfile", "genfromtxt", "glob", "is_dir", "is_file"),
    *("iterdir", "load", "loadtxt", "memmap", "mkdir", "open", "read_bytes"),
    *("read_text", "rglob", "save", "savetxt", "savez", "stat", "tofile", "touch"),
    *("unlink", "write_bytes", "write_text"),
}
FILES = sorted(PACKAGE.rglob("*.py"))


def home(path: Path) -> str:
    """Module or family a file belongs to; empty for the package's own `__init__`."""
    return path.relative_to(PACKAGE).with_suffix("").parts[0].replace("__init__", "")


def imported(tree: ast.AST) -> set[str]:
    """Full names of all modules that a file imports anywhere."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative imports hide where they point"
            if node.module == "calib_pin":
                found |= {f"calib_pin.{alias.name}" for alias in node.names}
            else:
                found.add(str(node.module))
    return found


def wrong_imports(name: str, tree: ast.AST) -> list[str]:
    wrong = []
    for module in sorted(imported(tree)):
        parts = module.split(".")
        target = parts[1] if len(parts) > 1 else ""
        if parts[0] != "calib_pin" or target == name:
            continue
        if target not in LAYER:  # The public names hide where they come from.
            wrong.append(f"{name} imports {module}")
            continue
        apart = {name, target} & APART and (name, target) not in SIDEWAYS
        if LAYER[target] > LAYER[name] or (LAYER[target] == LAYER[name] and apart):
            wrong.append(f"{name} imports {module}")
    return wrong


def side_effects(tree: ast.AST, name: str = "") -> list[str]:
    """Uses of files, terminals, clocks, and the global random generator."""
    forbidden = FORBIDDEN_MODULES - ALLOWED.get(name, set())
    found = [m for m in imported(tree) if m.split(".")[0] in forbidden]
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            text = ast.unparse(node.func)
            method = node.func.attr if isinstance(node.func, ast.Attribute) else ""
            if text in FORBIDDEN_CALLS or method in FORBIDDEN_METHODS:
                found.append(text)
            if text.endswith("default_rng") and not (node.args or node.keywords):
                found.append("default_rng() without a seed")
        elif isinstance(node, ast.Attribute):
            of_random = ast.unparse(node.value) in ("np.random", "numpy.random")
            if of_random and node.attr not in ("Generator", "default_rng"):
                found.append(ast.unparse(node))
    return found


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_imports_point_down(path: Path) -> None:
    name, tree = home(path), ast.parse(path.read_text())
    if name == "":
        return  # The public names come from everywhere.
    assert name in LAYER, f"give the new module '{name}' a layer"
    assert wrong_imports(name, tree) == []
    if LAYER[name] <= NUMERICS:
        assert side_effects(tree, name) == []


def test_layers_hold_what_exists() -> None:
    assert {home(path) for path in FILES} - {""} == set(LAYER)


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("chain", "from calib_pin.problem import Problem"),
        ("spatial", "import calib_pin.chain"),
        ("solvers", "from calib_pin.problem import Problem"),
        ("problem", "from calib_pin.solvers import Status"),
        ("solvers", "from calib_pin import identifiability"),
        ("identifiability", "def f():\n    from calib_pin.problem import Problem"),
        ("parameterizations", "from calib_pin.measurement_models import Quantity"),
        ("report", "from calib_pin.io.results import encode"),
        ("io", "import calib_pin.report.text"),
        ("io", "import calib_pin"),
        ("cli", "from calib_pin import calibrate"),
        ("fit", "if TYPE_CHECKING:\n    from calib_pin.io.files import read_bytes"),
    ],
)
def test_wrong_imports_are_seen(name: str, line: str) -> None:
    assert wrong_imports(name, ast.parse(line))


@pytest.mark.parametrize(
    "line",
    [
        "open('x')",
        "print(1)",
        "import time",
        "from datetime import datetime",
        "import os.path",
        "Path('x').read_text()",
        "np.loadtxt('x')",
        "np.random.seed(0)",
        "x = np.random.normal(size=3)",
        "np.random.default_rng()",
        "default_rng()",
        "def f():\n    import sys",
    ],
)
def test_side_effects_are_seen(line: str) -> None:
    assert side_effects(ast.parse(line))


def test_what_is_allowed() -> None:
    for name, line in (
        ("error_model", "from calib_pin.parameterizations import Screw"),
        ("parameters", "from calib_pin.spatial import Floats"),
        ("fit", "from calib_pin.solvers import Status"),
        ("calibration", "from calib_pin.fit import fit"),
        ("solvers", "from calib_pin.solvers.gauss_newton import Status"),
        ("cli", "import time"),
    ):
        assert wrong_imports(name, ast.parse(line)) == []
    assert side_effects(ast.parse("rng = np.random.default_rng(seed)")) == []
    assert side_effects(ast.parse("def f(rng: np.random.Generator): ...")) == []
