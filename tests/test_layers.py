"""Imports point down, and numerics touch neither files nor clocks nor chance."""

from __future__ import annotations

import ast
from collections import defaultdict
from functools import cache
from pathlib import Path

from tests.shared import nodes_of, parsed

PACKAGE = Path(__file__).parents[1] / "calib_pin"

ROOMS = (
    *("errors", "plugins", "units", "progress", "workers", "setup", "kinematics"),
    *("compiled", "parameters"),
    *("observations", "parameterizations", "measurement_models", "solvers"),
    *("residual_models", "estimation", "validation", "planning", "control"),
    *("simulation", "calibration", "monte_carlo", "io", "guidance"),
    *("report", "viewer", "cli"),
    "__main__",
)
"""The modules and folders of the package, each of which imports only those before."""

MODULES = 10
"""Modules that the root may hold beside the public names."""

CHAIN = 13
"""Rooms on the longest way down."""

MEMBERS = 20
"""Public members of a class; none has more."""

NUMERIC = set(ROOMS[: ROOMS.index("io")]) - {"plugins", "workers"}
"""Rooms that take files, clocks and generators from their callers.

What loads entry points is none of them: it is how other packages come in. Nor is what
starts processes: it is how work goes out.
"""

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


def module(path: Path) -> str:
    """Full name of the module in a file."""
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts).removesuffix(".__init__")


MODULE_NAMES = {module(path) for path in FILES}


def room(path: Path) -> str:
    """Module or folder a file belongs to; empty for the package's own `__init__`."""
    return path.relative_to(PACKAGE).with_suffix("").parts[0].replace("__init__", "")


@cache
def imported(tree: ast.AST) -> set[str]:
    """Full names of all modules that a file imports anywhere."""
    found = set()
    for node in nodes_of(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative imports hide where they point"
            names = {f"{node.module}.{alias.name}" for alias in node.names}
            modules = names & MODULE_NAMES
            if node.module == "calib_pin":
                found |= names
            elif names - modules:
                found.add(str(node.module))
            found |= modules
    return found


def room_of(module: str) -> str:
    """Room of a module of the package; empty for any other and for public names."""
    parts = module.split(".")
    return parts[1] if parts[0] == "calib_pin" and len(parts) > 1 else ""


def wrong_imports(name: str, tree: ast.AST) -> list[str]:
    """Imports of a room above or beside, or of a public name, by a file of a room."""
    below = {"__version__", name, *ROOMS[: ROOMS.index(name)]}
    return [
        f"{name} imports {module}"
        for module in sorted(imported(tree))
        if module.split(".")[0] == "calib_pin" and room_of(module) not in below
    ]


def side_effects(tree: ast.AST, name: str = "") -> list[str]:
    """Uses of files, terminals, clocks, and the global random generator."""
    forbidden = FORBIDDEN_MODULES - ALLOWED.get(name, set())
    found = [m for m in imported(tree) if m.split(".")[0] in forbidden]
    for node in nodes_of(tree):
        if isinstance(node, ast.Call):
            called = getattr(node.func, "id", "")
            method = getattr(node.func, "attr", "")
            if called in FORBIDDEN_CALLS or method in FORBIDDEN_METHODS:
                found.append(ast.unparse(node.func))
            bare = not (node.args or node.keywords)
            if bare and "default_rng" in (called, method):
                found.append("default_rng() without a seed")
        elif isinstance(node, ast.Attribute):
            above, place = node.value, ""
            if isinstance(above, ast.Attribute) and above.attr == "random":
                place = ast.unparse(above.value)
            if place in ("np", "numpy") and node.attr not in (
                "Generator",
                "default_rng",
            ):
                found.append(ast.unparse(node))
    return found


def test_imports_point_down() -> None:
    found = []
    for path in FILES:
        name, tree = room(path), parsed(path)
        if name == "":
            continue  # The public names come from everywhere.
        assert name in ROOMS, f"give the new room '{name}' its place"
        wrong = wrong_imports(name, tree)
        if name in NUMERIC:
            wrong += side_effects(tree, path.stem)
        found += [f"{path.relative_to(PACKAGE)}: {text}" for text in wrong]
    assert found == []


def test_the_rooms_are_what_exists() -> None:
    assert {room(path) for path in FILES} - {""} == set(ROOMS)
    assert len(list(PACKAGE.glob("[!_]*.py"))) <= MODULES


def test_no_module_imports_itself_through_others() -> None:
    modules = {module(path): parsed(path) for path in FILES}
    below = {name: imported(tree) & set(modules) for name, tree in modules.items()}
    done: set[str] = set()

    def descend(name: str, way: tuple[str, ...]) -> None:
        assert name not in way, " -> ".join((*way[way.index(name) :], name))
        if name not in done:
            for other in below[name] - {name}:
                descend(other, (*way, name))
            done.add(name)

    for name in set(modules) - {"calib_pin"}:
        descend(name, ())


def test_the_way_down_is_short() -> None:
    below = defaultdict(set)
    for path in FILES:
        found = {room_of(name) for name in imported(parsed(path))}
        below[room(path)] |= found - {"", room(path)}

    @cache
    def depth(name: str) -> int:
        return 1 + max(map(depth, below[name]), default=0)

    assert max(map(depth, ROOMS)) <= CHAIN


def test_classes_stay_readable() -> None:
    crowded = [
        f"{path.relative_to(PACKAGE)}: {node.name}"
        for path in FILES
        for node in nodes_of(parsed(path))
        if isinstance(node, ast.ClassDef) and len(public_members(node)) > MEMBERS
    ]
    assert crowded == []


def public_members(node: ast.ClassDef) -> set[str]:
    """Names of the attributes and methods of a class without an underscore."""
    found = set()
    for item in node.body:
        if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name):
            found.add(item.target.id)
        elif isinstance(item, (ast.FunctionDef, ast.AsyncFunctionDef)):
            found.add(item.name)
    return {name for name in found if not name.startswith("_")}


def test_wrong_imports_are_seen() -> None:
    for name, line in (
        ("kinematics", "from calib_pin.estimation.problem import Problem"),
        ("setup", "import calib_pin.kinematics.chain"),
        ("solvers", "from calib_pin.estimation import identifiability"),
        ("observations", "def f():\n    from calib_pin.solvers import Status"),
        ("io", "import calib_pin"),
        ("cli", "from calib_pin import calibrate"),
        ("estimation", "if TYPE_CHECKING:\n    import calib_pin.io.files"),
    ):
        assert wrong_imports(name, ast.parse(line)), line


def test_side_effects_are_seen() -> None:
    for line in (
        "open('x')",
        "from datetime import datetime",
        "import os.path",
        "Path('x').read_text()",
        "np.random.seed(0)",
        "x = np.random.normal(size=3)",
        "np.random.default_rng()",
        "def f():\n    import sys",
    ):
        assert side_effects(ast.parse(line)), line
