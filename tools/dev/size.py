"""`make size`: tokens and lines of each room, what a user installs, what a change has added.

    python tools/dev/size.py [GITREF]         beside what the version GITREF has

Tokens are those of Python without comments, docstrings and layout, in which a string is one;
`words` are those of the strings, so that nothing becomes lighter by being hidden in one. `others`
are lines of C, JavaScript and prose. Below the rooms stands what a reader pays: untyped arguments,
files of drivers and executive whose code names a feature of a node (its page and its tests come on
top), apart from them lists of which it is a row, and the longest functions.
"""

import ast
import io
import re
import subprocess
import sys
import tarfile
import tokenize
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory

AREAS = ("drivers", "executive", "plants", "tools", "tests", "docs")
OTHERS = (".c", ".h", ".js", ".md")
NOT_INSTALLED = ("book", "dev", "tests", "docs")  # folders, see pyproject.toml
TYPED = (  # rooms of compiled code, whose records have types
    "executive/loop", "executive/batch", "drivers/can", "drivers/line", "drivers/canopen",
    "drivers/robots", "drivers/drive", "drivers/compiled",
)  # fmt: skip
FEATURES = {  # of a node: what names it in drivers and executive
    "intrusion": "intrusion",
    "plausibility": "plausib",
    "losses": "losses",
    "FMU": "fmu(?!l)",
    "keyframes": "keyframe",
    "faults on purpose": "inject|on_purpose",
}
LISTS = (  # in which a feature is a row
    "executive/nodes/parts.py", "executive/loop/layout.py", "executive/loop/control.py",
    "executive/loop/faults.py", "executive/loop/events.py", "executive/loop/doubts.py",
    "executive/rig/file_laws.py", "executive/log/description.py", "executive/log/observers.py",
    "executive/log/schemas.py",
    "drivers/can/e2e_states.py",
)  # fmt: skip
LONGEST = 8  # functions that are listed
_HAS_TEXT = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
_LAYOUT = {
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT,
    tokenize.ENDMARKER,
}  # fmt: skip
_KINDS = ("tokens", "words", "lines", "others")
_ADDED = _KINDS[:2]  # what a change has added is printed of these
Sizes = Counter[tuple[str, str]]  # of (room, kind)


def _docstrings(tree: ast.AST) -> list[ast.expr]:
    """Return the nodes of the docstrings in a tree."""
    bodies = (node.body for node in ast.walk(tree) if isinstance(node, _HAS_TEXT) and node.body)
    first = (body[0].value for body in bodies if isinstance(body[0], ast.Expr))
    return [
        text for text in first if isinstance(text, ast.Constant) and isinstance(text.value, str)
    ]


def _code(source: str) -> list[str]:
    """Return the tokens of a Python text."""
    texts = {node.lineno for node in _docstrings(ast.parse(source))}
    return [
        one.string
        for one in tokenize.generate_tokens(io.StringIO(source).readline)
        if one.type not in _LAYOUT and not (one.type == tokenize.STRING and one.start[0] in texts)
    ]


def tokens(source: str) -> int:
    """Return how many tokens a Python text has."""
    return len(_code(source))


def words(source: str) -> int:
    """Return how many words the strings of a Python text have, without its docstrings."""
    tree = ast.parse(source)
    texts = {id(node) for node in _docstrings(tree)}
    strings = (node for node in ast.walk(tree) if isinstance(node, ast.Constant))
    return sum(
        len(re.findall(r"\w+", node.value))
        for node in strings
        if isinstance(node.value, str) and id(node) not in texts
    )


def _python_files(root: Path, *areas: str) -> list[tuple[str, str]]:
    """Return name and text of the Python files below folders of `root`."""
    files = (file for area in areas for file in sorted((root / area).rglob("*.py")))
    return [(file.relative_to(root).as_posix(), file.read_text("utf-8")) for file in files]


def untyped_arguments(root: Path) -> tuple[int, int]:
    """Return how many arguments in the rooms TYPED are `Any`, and of how many."""
    kinds: list[str] = []
    for _, text in _python_files(root, *TYPED):
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.arg) and node.annotation is not None:
                kinds.append(ast.unparse(node.annotation))
    return kinds.count("Any"), len(kinds)


def files_of_features(root: Path) -> dict[str, str]:
    """Return how many files of drivers and executive name each feature in their code.

    Apart from them, how many of LISTS have its row.
    """
    texts = {
        name: " ".join([name, *_code(text)])
        for name, text in _python_files(root, "drivers", "executive")
    }
    counts = {}
    for feature, names in FEATURES.items():
        found = [name for name, text in texts.items() if re.search(names, text, re.IGNORECASE)]
        own = [name for name in found if name not in LISTS]
        counts[feature] = f"{len(own)}, and in {len(found) - len(own)} of the lists"
    return counts


def longest_functions(root: Path) -> list[tuple[int, str]]:
    """Return lines and name of the LONGEST functions of the product, docstrings included."""
    lengths = [
        (1 + (node.end_lineno or node.lineno) - node.lineno, f"{name}: {node.name}")
        for name, text in _python_files(root, *AREAS[:4])
        for node in ast.walk(ast.parse(text))
        if isinstance(node, _FUNCTIONS)
    ]
    return sorted(lengths, key=lambda one: (-one[0], one[1]))[:LONGEST]


def sizes(root: Path) -> Sizes:
    """Return tokens, words and lines of the rooms below `root`, and their sums."""
    found: Sizes = Counter()
    for file in (file for area in AREAS for file in (root / area).rglob("*") if file.is_file()):
        folders = file.relative_to(root).parts[:-1]
        if file.suffix not in (".py", *OTHERS) or "node_modules" in folders:
            continue
        text = file.read_text(encoding="utf-8")
        depth = 3 if folders[0] == "tools" else 2
        sums = ["sum"] if folders[0] not in ("tests", "docs") else []
        sums += ["sum of tests"] if folders[0] == "tests" else []
        sums += [] if set(folders) & set(NOT_INSTALLED) else ["what a user installs"]
        for room in ("/".join(folders[:depth]), *sums):
            if file.suffix == ".py":
                found[room, "tokens"] += tokens(text)
                found[room, "words"] += words(text)
                found[room, "lines"] += text.count("\n")
            else:
                found[room, "others"] += text.count("\n")
    return found


class Version:
    """All figures of one version of the project."""

    def __init__(self, root: Path) -> None:
        self.sizes = sizes(root)
        self.untyped, self.arguments = untyped_arguments(root)
        self.features = files_of_features(root)
        self.longest = longest_functions(root)


def of_version(ref: str) -> Version:
    """Return the figures of a version that git knows."""
    packed = subprocess.run(["git", "archive", ref], check=True, capture_output=True).stdout
    with TemporaryDirectory() as folder, tarfile.open(fileobj=io.BytesIO(packed)) as archive:
        archive.extractall(folder, filter="data")
        return Version(Path(folder))


def _print_rooms(now: Sizes, before: Sizes | None) -> None:
    sums = ("sum", "sum of tests", "what a user installs")
    rooms = {room for room, _ in (*now, *(before or ()))} - set(sums)
    order = sorted(rooms, key=lambda room: -now[room, "tokens"])
    added = "".join(f"{'+' + kind:>9}" for kind in _ADDED) if before else ""
    print(f"{'room':26}" + "".join(f"{kind:>9}" for kind in _KINDS) + added)
    for room in (*order, *sums):
        line = f"{room:26}" + "".join(f"{now[room, kind]:9,}" for kind in _KINDS)
        if before:
            more = (now[room, kind] - before[room, kind] for kind in _ADDED)
            line += "".join(f"{count:+9,}" if count else " " * 9 for count in more)
        print(line.rstrip())


def main() -> None:
    """Print a line a room, the largest first, the sums, and what a reader pays."""
    now, before = Version(Path()), of_version(sys.argv[1]) if sys.argv[1:] else None
    _print_rooms(now.sizes, before.sizes if before else None)
    print(f"\n{'arguments that are Any':26}{now.untyped:9,} of {now.arguments:,}", end="")
    print(f", before {before.untyped:,} of {before.arguments:,}" if before else "")
    for name, count in now.features.items():
        was = f", before {before.features[name]}" if before else ""
        print(f"{'files: ' + name:26}   {count}{was}")
    earlier = {name: lines for lines, name in before.longest} if before else {}
    for lines, name in now.longest:
        was = f", before {earlier.get(name, 'shorter')}" if before else ""
        print(f"{lines:4} lines  {name}{was}")


if __name__ == "__main__":
    main()
