"""`make size`: tokens and lines of each room, what a user installs, what a change has added.

    python tools/dev/size.py [GITREF]         beside what the version GITREF has

Tokens are those of Python without comments, docstrings and layout; `others` are lines of C,
JavaScript and prose.
"""

import ast
import io
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
_HAS_TEXT = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
_LAYOUT = {
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT,
    tokenize.ENDMARKER,
}  # fmt: skip
Sizes = Counter[tuple[str, str]]  # of (room, kind)


def tokens(source: str) -> int:
    """Return how many tokens a Python text has."""
    nodes = (node for node in ast.walk(ast.parse(source)) if isinstance(node, _HAS_TEXT))
    texts = {node.body[0].lineno for node in nodes if ast.get_docstring(node, False) is not None}
    return sum(
        one.type not in _LAYOUT and not (one.type == tokenize.STRING and one.start[0] in texts)
        for one in tokenize.generate_tokens(io.StringIO(source).readline)
    )


def sizes(root: Path) -> Sizes:
    """Return tokens and lines of the rooms below `root`, and their sums."""
    found: Sizes = Counter()
    for file in (file for area in AREAS for file in (root / area).rglob("*") if file.is_file()):
        folders = file.relative_to(root).parts[:-1]
        if file.suffix not in (".py", *OTHERS) or "node_modules" in folders:
            continue
        text = file.read_text(encoding="utf-8")
        depth = 3 if folders[0] == "tools" else 2
        sums = ["sum"] if folders[0] not in ("tests", "docs") else []
        sums += [] if set(folders) & set(NOT_INSTALLED) else ["what a user installs"]
        for room in ("/".join(folders[:depth]), *sums):
            if file.suffix == ".py":
                found[room, "tokens"] += tokens(text)
                found[room, "lines"] += text.count("\n")
            else:
                found[room, "others"] += text.count("\n")
    return found


def of_version(ref: str) -> Sizes:
    """Return the sizes of a version that git knows."""
    packed = subprocess.run(["git", "archive", ref], check=True, capture_output=True).stdout
    with TemporaryDirectory() as folder, tarfile.open(fileobj=io.BytesIO(packed)) as archive:
        archive.extractall(folder, filter="data")
        return sizes(Path(folder))


def main() -> None:
    """Print a line a room, the largest first, the sums at the end."""
    now, before = sizes(Path()), of_version(sys.argv[1]) if sys.argv[1:] else None
    rooms = {room for room, _ in (*now, *(before or ()))} - {"sum", "what a user installs"}
    order = sorted(rooms, key=lambda room: -now[room, "tokens"])
    print(f"{'room':26}{'tokens':>9}{'lines':>9}{'others':>9}" + "   tokens added" * bool(before))
    for room in (*order, "sum", "what a user installs"):
        counts = "".join(f"{now[room, kind]:9,}" for kind in ("tokens", "lines", "others"))
        added = now[room, "tokens"] - before[room, "tokens"] if before else 0
        print(f"{room:26}{counts}" + (f"{added:+15,}" if added else ""))


if __name__ == "__main__":
    main()
