"""Who may import whom, and what the sources never do, checked on their syntax trees.

`drivers` imports nothing of ours; `executive` imports drivers, and of its rooms each only what
stands below it; laws import blocks, elementary functions, approximators and each other; a plant
imports drivers and the engine, never a law, nor a law a plant. What both know of one system, or of
a family, is its `equations.py`, which imports neither. Of another system a system imports nothing:
what two share is of a family, or an actuator. Of `tools` each group imports only those below it.
No module imports itself by way of others.
"""

import ast
import re
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path

import pytest
from places import ROOT

from pcpc.executive.own_laws.purity import has_decorator, impure_uses

AREAS = ("drivers", "executive", "plants", "tools")
FILES = sorted(path for area in AREAS for path in (ROOT / area).rglob("*.py"))
NAMES = {path: path.relative_to(ROOT).as_posix() for path in FILES}


class _Trees(Mapping[str, ast.Module]):
    """The files by name, each parsed when it is first asked for: every worker imports this."""

    def __getitem__(self, name: str) -> ast.Module:
        return _tree(name)

    def __iter__(self) -> Iterator[str]:
        return iter(NAMES.values())

    def __len__(self) -> int:
        return len(NAMES)


@cache
def _tree(name: str) -> ast.Module:
    return ast.parse((ROOT / name).read_text(encoding="utf-8"))


TREES = _Trees()
MODULES = {name.removesuffix(".py").removesuffix("/__init__").replace("/", ".") for name in TREES}

ENGINE = [name for name in TREES if not name.startswith("tools/")]

ROOMS = ("laws", "loop", "own_laws", "rig", "log", "nodes", "batch")  # of `executive`, from below


GROUPS = (  # of `tools`, from below
    "terminal", "start", "after", "live", "run", "study", "make", "machine", "api", "cli", "dev",
)  # fmt: skip


def _rooms(top: str) -> tuple[str, ...]:
    """Return the rooms that `top` may import, and what stands beside them all."""
    rooms = ROOMS[: ROOMS.index(top) + 1]
    return ("executive.durations", "executive.errors", *(f"executive.{room}" for room in rooms))


LAWS = [
    f"plants.{name[7:].split('/laws/')[0].replace('/', '.')}.laws"
    for name in TREES
    if name.startswith("plants/") and "/laws/" in name
]
EQUATIONS = [
    name.removesuffix(".py").replace("/", ".")
    for name in TREES
    if re.fullmatch(r"plants/.+/equations\.py", name)
]
SYSTEMS = sorted(path.parent.name for path in (ROOT / "plants").glob("*/rig.yaml"))
_STEPS = ("drivers.compiled.jit", "drivers.compiled.stage", "drivers.compiled.views")
_BARE = (_STEPS[0], _STEPS[2], "executive.laws.emath")
MAY_IMPORT = {
    "drivers": ("drivers",),
    "drivers/compiled": ("drivers.compiled", "drivers.errors"),
    "drivers/fmi": ("drivers.compiled", "drivers.fmi"),
    "drivers/machine": ("drivers.machine", "drivers.errors"),
    "executive": ("drivers", "executive"),
    "executive/laws": (*_STEPS, "executive.laws"),
    "executive/laws/emath.py": ("drivers.compiled.deferred", "drivers.compiled.jit"),
    "executive/laws/emath_types.py": ("drivers.compiled", "executive.laws.emath"),
    "executive/laws/ports.py": ("drivers.compiled.views", "executive.errors"),
    "executive/laws/approximators": (*_BARE, "executive.laws.approximators"),
    "executive/loop": ("drivers", *_rooms("loop")),
    "executive/own_laws": ("drivers", *_rooms("own_laws")),
    "executive/rig": ("drivers", *_rooms("rig")),
    "executive/log": ("drivers", *_rooms("log")),
    "plants": ("drivers", "executive", "plants"),
    "tools": AREAS,
    **{f"tools/{group}": (*AREAS[:3], *(f"tools.{one}" for one in GROUPS[: level + 1]))
       for level, group in enumerate(GROUPS)},
    **{law.replace(".", "/"): (*_STEPS, "executive.laws", *LAWS, *EQUATIONS)
       for law in LAWS},
    **{f"{one.replace('.', '/')}.py": (*_BARE, "executive.laws.ports", *EQUATIONS)
       for one in EQUATIONS},
}  # fmt: skip
INSTALLED = {  # what pyproject.toml declares, by the names that are imported
    "argcomplete", "can", "cantools", "llvmlite", "mcap", "msgpack", "msgspec", "numba", "numpy",
    "rich", "yaml", "zstandard",
}  # fmt: skip
LINES, COLUMNS = 400, 120
LONGER: dict[str, int] = {}  # with the reason: one thing that would be harder to read in two files


def imports(tree: ast.AST) -> Iterator[tuple[str, int]]:
    """Yield (module, line) of all imports, ours without `pcpc.` before them.

    `from a import b` gives a.b if that is our module.
    """
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name.removeprefix("pcpc."), node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"line {node.lineno}: a relative import"
            parent = str(node.module).removeprefix("pcpc.")
            for alias in node.names:
                whole = alias.name if parent == "pcpc" else f"{parent}.{alias.name}"
                yield (whole if whole in MODULES else parent), node.lineno


def within(module: str, parents: tuple[str, ...]) -> bool:
    """Return whether `module` is one of `parents` or lies below one."""
    return any(f"{module}.".startswith(f"{parent}.") for parent in parents)


def area_of(name: str) -> str:
    """Return the most specific area of a file."""
    return max((area for area in MAY_IMPORT if f"{name}/".startswith(f"{area}/")), key=len)


def wrong_imports(name: str, tree: ast.AST) -> list[str]:
    """Return the imports of our own modules that the file's area does not allow."""
    allowed = MAY_IMPORT[area_of(name)]
    never = list(LAWS) if area_of(name) == "plants" else []
    own = name.split("/")[1]
    never += [f"plants.{one}" for one in SYSTEMS if name.startswith("plants/") and one != own]
    ours = [(module, line) for module, line in imports(tree) if within(module, (*AREAS, "tests"))]
    return [
        f"{name}:{line}: {module}"
        for module, line in ours
        if not within(module, allowed) or within(module, tuple(never))
    ]


def test_every_module_imports_only_in_the_allowed_direction() -> None:
    wrong = [line for name, tree in TREES.items() for line in wrong_imports(name, tree)]
    assert not wrong, wrong


@pytest.mark.parametrize(
    ("name", "line", "allowed"),
    [
        ("drivers/a.py", "from pcpc.drivers.compiled import libc", True),
        ("drivers/a.py", "from pcpc.executive.loop import shared", False),
        ("executive/loop/a.py", "import pcpc.drivers.can.wire", True),
        ("executive/a.py", "def f():\n    from pcpc.plants.atb1000 import model", False),
        ("executive/a.py", "import pcpc.tools.run.run", False),
        ("executive/loop/a.py", "from pcpc.executive.rig import schema", False),
        ("executive/own_laws/a.py", "from pcpc.executive.rig import schema", False),
        ("executive/rig/a.py", "from pcpc.executive.own_laws import trial", True),
        ("executive/log/a.py", "from pcpc.executive.rig import schema", True),
        ("plants/a.py", "from pcpc.executive.loop import cycle", True),
        ("plants/a.py", "from pcpc.plants.atb1000.laws.pd import BLOCK", False),
        ("executive/laws/a.py", "from pcpc.executive.laws.block import Block", True),
        ("executive/laws/a.py", "from pcpc.executive.loop import shared", False),
        ("executive/laws/a.py", "from pcpc.drivers.can import bus", False),
        ("plants/atb1000/laws/a.py", "from pcpc.plants.atb1000.laws import pid", True),
        ("plants/atb1000/laws/a.py", "from pcpc.plants.atb1000 import model", False),
        (
            "plants/friction_arm/laws/a.py",
            "from pcpc.plants.families.two_link.laws import arm_pd",
            True,
        ),
        ("plants/atb1000/model.py", "from pcpc.plants.atb1000.laws import pid", False),
        ("plants/quarter_car/laws/a.py", "from pcpc.plants.quarter_car import equations", True),
        ("plants/quarter_car/model.py", "from pcpc.plants.quarter_car import equations", True),
        ("plants/quarter_car/equations.py", "from pcpc.plants.quarter_car import model", False),
        ("plants/map_chains/laws/a.py", "from pcpc.plants.deadzone_map.laws import a", False),
        ("plants/map_chains/book/a.py", "from pcpc.plants.deadzone_map import model", False),
        ("plants/map_chains/model.py", "from pcpc.plants.actuators import gear", True),
        ("plants/families/a.py", "from pcpc.plants.payload_arm import model", False),
        ("tools/a.py", "from tests import engine", False),
        ("tools/after/a.py", "from pcpc.tools.start import rigs", True),
        ("tools/after/a.py", "def f():\n    from pcpc.tools.run import run", False),
        ("tools/terminal/a.py", "from pcpc.tools.cli import commands", False),
    ],
)
def test_the_direction_check_itself_works(name: str, line: str, allowed: bool) -> None:
    assert (not wrong_imports(name, ast.parse(line))) is allowed


OPENERS = {  # others ask `after.opened`; these three ask what a log carries
    "tools/after/opened.py", "tools/after/verify/one.py", "tools/after/report/details.py",
    "tools/run/mcp/report.py",
}  # fmt: skip


def bits_compared(tree: ast.AST) -> list[int]:
    """Return the lines that hold the bytes of numbers against others."""
    sides = [
        (n.lineno, [n.left, *n.comparators]) for n in ast.walk(tree) if isinstance(n, ast.Compare)
    ]
    raw = {"view", "tobytes"}
    return [
        line
        for line, several in sides
        if any(getattr(getattr(one, "func", None), "attr", "") in raw for one in several)
    ]


def logs_read(tree: ast.AST) -> bool:
    """Return whether a log is read as a whole, or its head."""
    calls = (node.func for node in ast.walk(tree) if isinstance(node, ast.Call))
    named = (ast.unparse(one) for one in calls)
    return bool({"logs.read", "logs.head", "long_logs.read"} & {*named})


def test_a_run_is_opened_by_one_module_and_compared_by_one() -> None:
    """A room brings data: what is new in a run is no opener and no comparison of its own."""
    tools = {name: tree for name, tree in TREES.items() if name.startswith("tools/")}
    by_rig = {n for n, t in tools.items() if "tools.after.log.rig" in {m for m, _ in imports(t)}}
    assert by_rig == OPENERS
    read = {n for n, t in tools.items() if "/dev/" not in n and logs_read(t)}
    assert read == {"tools/after/opened.py"}
    after = {name: bits_compared(tree) for name, tree in tools.items() if "/after/" in name}
    assert [name for name, lines in after.items() if lines] == ["tools/after/differences.py"]
    assert bits_compared(ast.parse("a.view(int) == b\nb != a.tobytes()\na == b.sum()")) == [1, 2]


def circles(edges: dict[str, set[str]]) -> list[str]:
    """Return the modules that import themselves by way of others."""
    found = []
    for start in edges:
        seen: set[str] = set()
        ahead = list(edges[start])
        while ahead:
            if (name := ahead.pop()) not in seen:
                seen.add(name)
                ahead += edges.get(name, ())
        found += [start] if start in seen else []
    return sorted(found)


def test_no_module_imports_itself_by_way_of_others() -> None:
    names = {name.removesuffix(".py").replace("/", "."): tree for name, tree in TREES.items()}
    edges = {name: {module for module, _ in imports(tree)} for name, tree in names.items()}
    assert circles(edges) == []
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == ["b", "c"]


def test_no_module_is_imported_by_its_name_against_the_direction() -> None:
    wrong = []
    for name in ENGINE:
        others = "tools" if name.startswith("plants/") else "plants|tools"
        for node in ast.walk(TREES[name]):
            text = node.value if isinstance(node, ast.Constant) else None
            if isinstance(text, str) and re.fullmatch(rf"pcpc\.({others})(\.\w+)+", text):
                wrong.append(f"{name}: {text!r}")
    assert not wrong, wrong


FOR_PYTEST = (
    "tools/pytest_pcpc.py",
    "tools/make/template/test_motor.py",
    "tools/make/template/cart/test_cart.py",
    "tools/make/template/bare/test_bare.py",
)
FOR_WEB = {
    f"tools/live/host/{name}.py": {"starlette", "uvicorn"}
    for name in ("batched_socket", "clients", "requests", "server")
}
FOR_FOXGLOVE = {
    f"tools/live/host/foxglove/{name}.py": {"foxglove"}
    for name in ("parameters", "server", "topics")
}
FOR_MCP = {"tools/run/mcp/server.py": {"anyio", "jsonschema", "mcp", "mcp_types"}}
FOR_BUILD = "tools/fresh_build.py", "tools/dev/bill.py"
LATER = FOR_WEB | FOR_FOXGLOVE | FOR_MCP  # loaded by a function, with packages that not all have


def test_only_declared_packages_are_imported_at_the_start() -> None:
    known = {"pcpc", *AREAS, *INSTALLED, *sys.stdlib_module_names}
    wrong = []
    for name, tree in TREES.items():
        start = ast.Module([n for n in tree.body if isinstance(n, ast.Import | ast.ImportFrom)], [])
        more = {"pytest", "_pytest"} if name in FOR_PYTEST else set()  # pytest itself loads it
        more |= LATER.get(name, set())
        more |= {"setuptools"} if name in FOR_BUILD else set()  # setuptools itself loads it
        found = [(m, n) for m, n in imports(start) if m.split(".")[0] not in known | more]
        wrong += [f"{name}:{n}: {m}" for m, n in found]
    assert not wrong, wrong


def test_modules_of_the_servers_are_loaded_by_functions_only() -> None:
    modules = {name.removesuffix(".py").replace("/", ".") for name in LATER}
    for name, tree in TREES.items():
        start = ast.Module([n for n in tree.body if isinstance(n, ast.Import | ast.ImportFrom)], [])
        found = modules & {module for module, _ in imports(start)}
        assert not found or name in LATER, (name, found)


def test_what_can_be_installed_is_used() -> None:
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    names = {
        "python-can": "can",
        "pyyaml": "yaml",
        "mkdocs-material": "mkdocs",
        "foxglove-sdk": "foxglove",
    }  # its modules
    extras = {n: e for n, e in declared["optional-dependencies"].items() if n != "test"}
    wanted = [*declared["dependencies"], *(package for e in extras.values() for package in e)]
    packages = [re.split("[^a-z0-9-]", package.lower())[0] for package in wanted]
    hooks = ast.parse((ROOT / "docs/site/hooks.py").read_text(encoding="utf-8"))
    trees = [hooks, *TREES.values()]
    used = {module.split(".")[0] for tree in trees for module, _ in imports(tree)}
    needless = [name for name in packages if names.get(name, name) not in used]
    assert not needless, needless


SHAPE = {"README.md", "rig.yaml", "model.py", "laws", "evaluation.py", "drawing.py", "layout.json"}
MORE = {  # not in each
    "parameters.yaml", "rigs", "identification.py", "device", "book", "figures",
    "drive.yaml", "drive_cia402.yaml", "drive_mit.yaml", "drive_moteus.yaml", "drive_odrive.yaml",
    "drive_robstride.yaml",
    "foxglove.json", "rig.schema.json",
}  # fmt: skip


def test_what_pcpc_new_writes_and_the_shipped_systems_have_one_shape() -> None:
    """A system's further modules are parts of its model; a rig of its own has tests beside it."""
    for folder, rig in (("template", "motor"), ("template/cart", "cart")):
        written = {path.name for path in (ROOT / "tools/make" / folder).iterdir()}
        others = {"__pycache__", "cart", "bare"}
        assert written - MORE - others == SHAPE | {f"{rig}.dbc", f"test_{rig}.py"}, folder
    shipped = [ROOT / "plants" / name for name in SYSTEMS if name != "probe"]  # no system: measures
    assert shipped
    for folder in shipped:
        names = {path.name for path in folder.iterdir()} - {"__pycache__", "__init__.py"}
        assert SHAPE | {f"{folder.name}.dbc"} <= names, folder.name
        others = names - SHAPE - MORE - {f"{folder.name}.dbc"}
        assert all(one.endswith((".py", ".md")) or one == "linear.yaml" for one in others), others


def test_a_law_imports_nothing_but_numpy_beside_its_block() -> None:
    allowed = {"drivers", "executive", "plants", "numpy", "typing", "collections"}
    laws = {name: tree for name, tree in TREES.items() if area_of(name).endswith("/laws")}
    laws = {name: tree for name, tree in laws.items() if name.startswith("plants/")}
    found = {name: {module.split(".")[0] for module, _ in imports(laws[name])} for name in laws}
    wrong = {name: modules - allowed for name, modules in found.items() if modules - allowed}
    assert len(laws) > 2 and not wrong, wrong


def impurities(tree: ast.Module) -> list[str]:
    """Return what would make the bits or the time of a step depend on the machine."""
    found = [f"{line}: {name}" for line, name in impure_uses(tree)]
    for node in (n for f in tree.body if has_decorator(f, "stage", "inline") for n in ast.walk(f)):
        if isinstance(node, ast.Global | ast.Try | ast.With | ast.ListComp | ast.Dict):
            found.append(f"{node.lineno}: {type(node).__name__}")
    return found


def test_a_step_uses_no_libm_no_power_no_clock_and_no_file() -> None:
    pure = [n for n in ENGINE if not n.startswith("drivers/")]
    with_steps = [
        n for n in pure if any(has_decorator(f, "stage", "inline") for f in TREES[n].body)
    ]
    assert len(with_steps) >= 8, f"only {with_steps} have steps"
    wrong = [f"{name}:{line}" for name in with_steps for line in impurities(TREES[name])]
    assert not wrong, wrong


def test_the_purity_check_itself_works() -> None:
    source = "@stage\ndef step(t, dt, p, x, u, y):\n    y.a = math.sin(t) + x.b ** 2"
    assert impurities(ast.parse(source)) == ["3: **", "3: math"]


def counted(tree: ast.Module) -> list[str]:
    """Return where ports are addressed by numbers: `u[2]` in a stage, `p[KV]`, `x[_ST + j]`.

    A helper may index a vector by what it counts; it may be called x.
    """
    found = []
    for function in (f for f in tree.body if has_decorator(f, "stage", "inline")):
        for node in ast.walk(function):
            if not isinstance(node, ast.Subscript) or not isinstance(node.value, ast.Name):
                continue
            names = {n.id for n in ast.walk(node.slice) if isinstance(n, ast.Name)}
            numbered = bool(names) and any(re.fullmatch(r"_?[A-Z][A-Z0-9_]*", n) for n in names)
            literal = not names and node.value.id in ("p", "u", "y")
            if node.value.id in ("p", "x", "u", "y") and (
                has_decorator(function, "stage") or numbered or literal
            ):
                found.append(f"{node.lineno}: {ast.unparse(node)}")
    return found


def test_a_step_says_its_ports_by_name() -> None:
    with_steps = [
        n for n in ENGINE if any(has_decorator(f, "stage", "inline") for f in TREES[n].body)
    ]
    wrong = [f"{name}:{line}" for name in with_steps for line in counted(TREES[name])]
    assert len(with_steps) > 40 and not wrong, wrong
    source = "@stage\ndef step(t, dt, p, x, u, y):\n    y.a = u[i]\n"
    source += "@inline\ndef f(p, x, i):\n    return x[i] + x[0] + x[_ST + i] + p[0]\n"
    assert counted(ast.parse(source)) == ["3: u[i]", "6: p[0]", "6: x[_ST + i]"]


def test_every_module_begins_by_saying_what_it_is() -> None:
    first = {name: (ast.get_docstring(tree) or "").split("\n")[0] for name, tree in TREES.items()}
    wrong = {name: line for name, line in first.items() if not line.endswith((".", ":"))}
    assert not wrong, wrong


def test_every_file_is_short_enough_to_be_read() -> None:
    lines = {name: len((ROOT / name).read_text("utf-8").splitlines()) for name in TREES}
    wrong = {name: n for name, n in lines.items() if n > LONGER.get(name, LINES)}
    assert not wrong, wrong
    needless = [name for name in LONGER if lines.get(name, 0) <= LINES]
    assert not needless, f"these need no exception any more: {needless}"


def catches_all(kind: ast.expr | None) -> bool:
    """Return whether an except clause of this kind, or a suppress of it, takes every error."""
    everything = ("Exception", "BaseException")
    return kind is None or (isinstance(kind, ast.Name) and kind.id in everything)


def swallowed(tree: ast.AST) -> list[int]:
    """Return the lines where errors of every kind disappear without a word."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.ExceptHandler) and catches_all(node.type):
            speaks = any(isinstance(n, ast.Raise | ast.Return | ast.Call) for n in ast.walk(node))
            found += [] if speaks else [node.lineno]
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "suppress":
            found += [node.lineno for kind in node.args if catches_all(kind)]
    return found


def test_no_error_of_every_kind_is_swallowed() -> None:
    wrong = [f"{name}:{line}" for name, tree in TREES.items() for line in swallowed(tree)]
    assert not wrong, wrong
    assert swallowed(ast.parse("try:\n    f()\nexcept Exception:\n    pass")) == [3]


def test_nothing_sleeps_but_the_recorders_poll() -> None:
    found = [
        name
        for name in ENGINE
        for node in ast.walk(TREES[name])
        if getattr(node, "attr", getattr(node, "id", "")) == "sleep"
    ]
    assert found == ["executive/log/recorder.py"], found


def test_there_is_no_swamp() -> None:
    swamp = r"(^|/)(utils?|common|helpers?|misc)(/|\.py$)"
    assert not [name for name in TREES if re.search(swamp, name)]


def too_long(text: str) -> list[int]:
    """Return the lines of prose, in Markdown, that are too long; not those of tables and code."""
    found, fenced = [], False
    for number, line in enumerate(text.splitlines(), 1):
        fenced ^= line.lstrip().startswith("```")
        if not (fenced or line.startswith("    ") or line.lstrip().startswith("|")):
            found += [number] if len(line) > COLUMNS else []
    return found


def test_prose_fits_its_columns() -> None:
    texts = [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("plants/**/*.md")]
    wrong = [f"{path}:{n}" for path in texts for n in too_long(path.read_text(encoding="utf-8"))]
    assert len(texts) > 12 and not wrong, wrong
    long = "x" * (COLUMNS + 1)
    assert too_long(f"{long}\n| {long}\n    {long}\n```\n{long}\n```\n{long}") == [1, 7]


def test_no_two_test_files_have_one_name() -> None:
    """Else pytest refuses the second, but only where both are collected."""
    names = Counter(path.name for path in (ROOT / "tests").rglob("test_*.py"))
    assert [name for name, count in names.items() if count > 1] == []


def test_no_two_laws_have_one_bare_name() -> None:
    """Else a rig that names it gets either."""
    files = [Path(name) for name in TREES if name.startswith("plants/") and "/laws/" in name]
    names = Counter(file.stem for file in files if file.stem != "__init__")
    assert [name for name, count in names.items() if count > 1] == []
