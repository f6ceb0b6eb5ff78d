"""Write the pages of docs/reference from what they tell of: `make reference`.

commands.md     the parser of the command line
api.md          signatures and docstrings of `import pcpc`
rig-python.md   the same of what a rig's laws, plants and evaluation import
schemas         of the structs that commands print as JSON, where they print one

drive.md        of docs/howto, the table of dialects and their settings
docs/tool-confidence.md of tests and docs/faults.json,
and tools/run/rig_words.json, the words of docs/rig.md for an editor
"""

import argparse
import ast
import importlib
import inspect
import re
import textwrap
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import pcpc
from pcpc.drivers.errors import Exit
from pcpc.executive.laws.block import Block
from pcpc.executive.nodes import planned_drive, planned_robot
from pcpc.tools import cli
from pcpc.tools.cli.commands import GROUPS, TITLES
from pcpc.tools.dev import confidence, rig_words, schemas
from pcpc.tools.terminal.command import Command

_Leaf = tuple[Command, argparse.ArgumentParser]  # a command without parts
_Words = tuple[str, str]  # a name and what it means
_Row = tuple[str | Exit, str]  # an argument and its help, or an exit code and its words

FOLDER = Path(__file__).resolve().parents[1] / "reference"
DRIVES = "../howto/drive.md"
LISTED = ("mit", "robstride")  # the others are those of the makers' references
_COLUMNS = 100
_NAME = 30  # of them for a name with its meaning beside it
_NOTE = "<!-- written by `make reference`; change its source, not this page -->"
_COMMANDS = f"""# Commands
{_NOTE}

RIG is the name of a rig that comes with pcpc (`pcpc rigs`), a rig file, a folder with a `rig.yaml`,
or the name of a run in progress. LOG is a log file, a run folder, or `latest`, the newest run
below `runs/`.

## Exit codes

These codes mean the same in every command. A command below lists only what is special to it.
"""
_SHARED = """
## Options of many commands

The commands below only name these options. A command with `--host` also has the options whose
meaning begins with that name.
"""
_MANY = 3  # commands that take an argument with the same help: it is explained once
_CODES = {
    Exit.OK: "done; the verdict of a run is good",
    Exit.NOT_MET: "an expectation, requirement or comparison does not hold, or none was judged",
    Exit.WRONG_INPUT: "an option, a rig or a file is wrong",
    Exit.LOSS: "frames or records were lost, or a log is damaged; what is readable is written",
    Exit.ENVIRONMENT: "a node, a bus or a package is missing, or a file cannot be written",
    Exit.SAFETY_STOP: "the supervisor stopped the loop, or a node died",
    Exit.INTERRUPTED: "Ctrl-C, SIGTERM or a closed terminal",
}
_API = f"""# The package
{_NOTE}

What `import pcpc` offers, from its docstrings; [the guide](../python.md) shows it at work.
"""

_RIG_PYTHON = f"""# The Python of a rig
{_NOTE}

What a law, a plant and an `evaluation.py` beside your rig may import. Each file names its
literature. [How to write a controller](../howto/controller.md) and [the
tutorial](../tutorial.md) show it.

```text
from pcpc.executive.laws.block import Block, Ports, inline, port, stage    # in a law and in a plant
from pcpc.executive.laws.emath import clip, sqrt, where                    # what their steps call
from pcpc.plants.evaluation import *                                       # in an evaluation.py
```
"""
_REFERENCES = """
As `law:` of a block; a parameter without a default is required.

```text"""
_TYPES = """
Colours of lines: `BLACK`, `BLUE`, `VERMILION`, `GREEN`, `ORANGE`, `PURPLE`, `SKY`, `GREY`. Types
for hints: `Vector`, an array (n,); `Signal`, a function of a run that returns one; `Source`, a name
or a `Signal`; `Figures`, the figures of merit by name."""
_BLOCKS = {  # module -> what a law takes of it, by way of laws.block
    "executive.laws.block": ("Block", "Prepared"),
    "executive.laws.ports": ("port", "Port", "group", "required", "Nothing"),
    "drivers.compiled.stage": ("stage",),
    "drivers.compiled.jit": ("inline",),
}
_PARTS_OF_PLANTS = """
## Parts of plants

Each heading is a module: `from pcpc.plants.sensors import noisy`."""
_PARTS = "sensors", "noise", "integrate", "transport"
_ACTUATORS_OF_PLANTS = """
### actuators

[What each file is](../../plants/actuators/README.md); its head has equations and units.
"""
_ACTUATORS = (
    "stick_slip", "friction", "lugre_implicit", "sliding", "backlash", "deadzone", "gear", "drive",
)  # fmt: skip
_EVALUATION = {
    "plants.judging": ("Run", "Judged", "Merit"),
    "plants.pages": ("Panel", "Line", "Level"),
    "plants.evaluation": ("settling", "started", "diverged"),
}


def commands() -> str:
    """Return the page of the command line."""
    codes = [(f"{code:<5d}{code.meaning}", _CODES[code]) for code in Exit]
    lines = [_COMMANDS, "```text", *_columns(codes), "```"]
    parsers = _parts(cli.parser())
    told = [one for group in GROUPS.values() for one in group]
    found = [(one, parsers[one.name]) for one in told]
    common = _common([leaf for one in found for leaf in _leaves(*one)])
    shared = [(one, said) for (_, said), one in common.items() if one]
    lines += [_SHARED, "```text", *_columns(shared), "```"]
    for name, group in GROUPS.items():
        lines.append(f"\n## {TITLES[name][0].upper()}{TITLES[name][1:]}")
        for command in group:
            lines += _command(command, parsers[command.name], common)
    return "\n".join(lines) + "\n"


def _leaves(command: Command, parser: argparse.ArgumentParser) -> list[_Leaf]:
    """Return a command with its parser, or those of its parts."""
    return [(part, _parts(parser)[part.name]) for part in command.parts] or [(command, parser)]


def _common(leaves: Sequence[_Leaf]) -> dict[_Row, str]:
    """Return what many commands have: arguments with their help, exit codes with their words."""
    count: Counter[_Row] = Counter()
    named: dict[_Row, str] = {}
    for command, parser in leaves:
        for row, one in _rows(parser).items():
            count[row] += 1
            named[row] = max(named.get(row, ""), _argument(one), key=len)
        count.update((command.codes or {}).items())
    return {row: named.get(row, "") for row, number in count.items() if number >= _MANY}


def _rows(parser: argparse.ArgumentParser) -> dict[_Row, argparse.Action]:
    """Return the arguments that a page shows, by name and help."""
    actions = [one for one in parser._actions if one.dest != "help"]
    shown = [one for one in actions if one.help and one.help != argparse.SUPPRESS]
    return {(_argument(one).rpartition(", ")[2], _help(parser, one)): one for one in shown}


def _command(
    command: Command, parser: argparse.ArgumentParser, common: Mapping[_Row, str]
) -> list[str]:
    lines = [f"\n### {parser.prog}\n", f"{command.help[0].upper()}{command.help[1:]}."]
    for part in command.parts:
        lines += _command(part, _parts(parser)[part.name], common)
    if command.parts:
        return lines
    actions = [one for one in parser._actions if one.dest != "help"]
    names = [_argument(one) for one in actions if not one.option_strings]
    rest = [f"-- {command.rest}"] if command.rest else []
    rows = _rows(parser)
    shown = [row for row, one in rows.items() if row not in common and not one.option_strings]
    usage = [" ".join([parser.prog, *names, *rest]), ""] if len(names) > len(shown) or rest else []
    own = _columns([(_argument(one), row[1]) for row, one in rows.items() if row not in common])
    notes = ["", *command.notes.strip().splitlines()] if command.notes else []
    example = [*command.example.splitlines(), *notes]
    lines += ["\n```text", *usage, *own, *([""] if own else []), *example, "```"]
    shared = {
        one.option_strings[0]: row[1]
        for row, one in rows.items()
        if row in common and one.option_strings
    }
    also = [f"`{name}`" for name, said in shared.items() if said.partition(":")[0] not in shared]
    lines += ["", *_wrapped(f"{'Also' if own else 'Options:'} {', '.join(also)}.")] if also else []
    codes = [one for one in (command.codes or {}).items() if one[1] and one not in common]
    told = ", ".join(f"{code:d} {said}" for code, said in codes)
    return [*lines, *(["", *_wrapped(f"Exit code: {told}.")] if told else [])]


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(text, _COLUMNS, break_on_hyphens=False)


def _columns(rows: Sequence[tuple[str, str]]) -> list[str]:
    """Return lines of names and what they mean, the latter below a name that is long."""
    width = min(max((len(name) for name, _ in rows), default=0), _NAME)
    lines = []
    for name, said in rows:
        indent = " " * (width + 2)
        lines += [name] if len(name) > width else []
        begin = indent if len(name) > width else name.ljust(width + 2)
        lines += textwrap.wrap(
            said, _COLUMNS, initial_indent=begin, subsequent_indent=indent, break_on_hyphens=False
        ) or [begin.rstrip()]
    return lines


def _parts(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """Return the parsers of a parser's commands by name."""
    (choices,) = (a.choices for a in parser._actions if isinstance(a, argparse._SubParsersAction))
    return choices


def _argument(action: argparse.Action) -> str:
    """Return an argument as one types it."""
    value = str(action.metavar or _choices(action))
    many = {"0": "", "?": f"[{value}]", "*": f"[{value} ...]", "+": f"{value} ..."}
    return f"{', '.join(action.option_strings)} {many.get(str(action.nargs), value)}".strip()


def _choices(action: argparse.Action) -> str:
    return f"{{{','.join(map(str, action.choices or ()))}}}"


def _help(parser: argparse.ArgumentParser, action: argparse.Action) -> str:
    return parser._get_formatter()._expand_help(action)


def api() -> str:
    """Return the page of the package."""
    lines = [_API]
    for name in sorted(pcpc.__all__, key=lambda name: (name[0].isupper(), name)):
        module, _, other = pcpc._WHERE[name].partition(":")
        lines += _definition(_defined(module)[other or name], f"pcpc.{name}", "##")
    return "\n".join(lines) + "\n"


def rig_python() -> str:
    """Return the page of what a rig's Python files import."""
    lines = [_RIG_PYTHON, "## Laws and plants: blocks\n", _told("executive.laws.block")]
    lines += _vocabulary(_BLOCKS)
    emath = "executive.laws.emath"
    lines += ["\n## Functions with the same bits everywhere\n", _told(emath, equations=False)]
    lines += _functions(emath)
    lines.append(_PARTS_OF_PLANTS)
    for part in _PARTS:
        told = _told(f"plants.{part}", equations=part != "noise")
        lines += [f"\n### {part}\n", told, *_functions(f"plants.{part}")]
    offered = [(f"{one}.py", _names(f"plants.actuators.{one}")) for one in _ACTUATORS]
    lines += [_ACTUATORS_OF_PLANTS, "```text", *_columns(offered), "```"]
    lines += ["\n## References\n", _told("executive.laws.references"), *_references()]
    lines += ["\n## An evaluation\n", _told("plants.evaluation"), "\n### Figures of merit\n"]
    merits = f"A {_statistics()} takes the arguments of `Merit`, except the statistic."
    lines += [*textwrap.wrap(merits, _COLUMNS), _TYPES]
    lines += _vocabulary(_EVALUATION)
    return "\n".join(lines) + "\n"


def _module(name: str) -> Any:
    return importlib.import_module(f"pcpc.{name}")


def _told(module: str, equations: bool = True) -> str:
    """Return the head of a module, without its literature and, if so asked, its equations."""
    paragraphs = inspect.cleandoc(_module(module).__doc__).split("\n\n")
    shown = [one for one in paragraphs if not one.startswith("Source:")]
    return _prose("\n\n".join(one for one in shown if equations or not _EQUATION.search(one)))


def _defined(module: str) -> dict[str, Any]:
    """Return the functions and classes that a module defines."""
    body = ast.parse(inspect.getsource(_module(module))).body
    kinds = ast.FunctionDef | ast.ClassDef
    return {node.name: node for node in body if isinstance(node, kinds)}


def _vocabulary(parts: Mapping[str, Sequence[str]]) -> list[str]:
    """Return the chapters of functions and classes; of a record also how it is made."""
    lines = []
    for module, names in parts.items():
        for name, node in ((name, _defined(module)[name]) for name in names):
            head, *rest = _definition(node, name, "###")
            made = any("dataclass" in ast.unparse(one) for one in node.decorator_list)
            lines += [head, *([*_signature(_made(node)), ""] if made else []), *rest]
    return lines


def _made(node: ast.ClassDef) -> str:
    """Return how a record is made: its fields in their order, those with a default as such."""
    fields = [one for one in node.body if isinstance(one, ast.AnnAssign)]
    told = {ast.unparse(one.target): ast.unparse(one.value) if one.value else "" for one in fields}
    texts = [
        name + (f"={'...' if default.startswith('field') else default}" if default else "")
        for name, default in told.items()
        if "init=False" not in default and name[0] != "_"
    ]
    return f"{node.name}({', '.join(texts)})"


def _functions(module: str) -> list[str]:
    """Return a module's public functions, each with the first paragraph of its docstring."""
    rows = []
    for name, node in _defined(module).items():
        if name[0] != "_" and isinstance(node, ast.FunctionDef):
            said = " ".join((ast.get_docstring(node) or "").split("\n\n")[0].split())
            text = ", ".join(one.arg for one in node.args.args)
            rows.append((f"{name}({text})", re.sub("^Return (the )?", "", said).replace("`", "")))
    return ["\n```text", *_columns(rows), "```"]


def _names(module: str) -> str:
    """Return the names of a module's public functions."""
    named = _defined(module).items()
    return ", ".join(n for n, one in named if n[0] != "_" and isinstance(one, ast.FunctionDef))


_EQUATION = re.compile(r" \(\d\)$", re.MULTILINE)  # its number, at the end of a line
_FURTHER = re.compile(r"_(?:[2-9]|1\d)(?:_s)?$")  # numbered like the first one: to_2


def _references() -> list[str]:
    """Return the ready-made references with their parameters; those that most have stand once."""
    lines = []
    for module in ("references", "profiles", "sequences"):
        found = vars(_module(f"executive.laws.{module}")).items()
        tables = {name: _parameters(one) for name, one in found if isinstance(one, Block)}
        count = Counter(row for rows in tables.values() for row in rows)
        groups: dict[str, list[_Words]] = {}
        for row in (row for row, number in count.items() if 3 * number > 2 * len(tables)):
            names = ", ".join(name for name, rows in tables.items() if row in rows)
            groups.setdefault(names, []).append(row)
        shared = [row for rows in groups.values() for row in rows]
        groups |= {
            name: own
            for name, rows in tables.items()
            if (own := [row for row in rows if row not in shared])
        }
        for names, rows in groups.items():
            lines += [f"{module}:{names}", *_columns(rows)]
    return [_REFERENCES, *lines, "```"]


def _parameters(block: Block) -> list[_Words]:
    rows = []
    for one in (port for port in block.settings if not _FURTHER.search(port.name)):
        default = "" if one.default is None else f"; default: {one.default:g}"
        rows.append((f"    {one.name}", f"{one.help}, {one.low:g}..{one.high:g}{default}"))
    return rows


def _statistics() -> str:
    """Return the names of the kinds of Merit."""
    found = vars(_module("plants.evaluation")).items()
    names = [f"`{name}`" for name, one in found if isinstance(one, partial)]
    return f"{', '.join(names[:-1])} or {names[-1]}"


def _definition(node: Any, name: str, level: str = "") -> list[str]:
    """Return the chapter of a function or class, with its public members below."""
    told = _prose(ast.get_docstring(node) or "")
    head = [f"\n{level} {name}\n"] if level else [""]
    if isinstance(node, ast.FunctionDef):
        return [*head, *_signature(_call(name, node)), "", _returned(told)]
    body = node.body
    if any(ast.unparse(base) == "Result" for base in node.bases):  # it makes text and files of them
        result = _defined("tools.study.result")["Result"].body
        makes = {"lines", "facts", "pictures"}
        body = [one for one in [*body, *result] if getattr(one, "name", "") not in makes]
    members = [one for one in body if isinstance(one, ast.FunctionDef) and one.name[0] != "_"]
    lines, values = [*head, told], [one for one in members if _is_value(one)]
    if values:
        said = [" ".join((ast.get_docstring(one) or "").split()) for one in values]
        names = [f"{one.name}: {_type(one)}" for one in values]
        lines += ["\n```text", *_columns(list(zip(names, said, strict=True))), "```"]
    for one in members:
        lines += [] if one in values else _definition(one, f"{name.split('.')[-1]}.{one.name}")
    return lines


def _signature(text: str) -> list[str]:
    fits = "\n" not in text and len(text) <= _COLUMNS
    return [f"**`{text}`**"] if fits else ["```text", text, "```"]


def _returned(told: str) -> str:
    """Return the words of a function without the verb that all have."""
    rest = told.removeprefix("Return ")
    return told if rest == told else rest[0].upper() + rest[1:]


def _is_value(node: ast.FunctionDef) -> bool:
    return any("property" in ast.unparse(one) for one in node.decorator_list)


def _type(node: ast.FunctionDef) -> str:
    return ast.unparse(node.returns).strip("'") if node.returns else ""


def _call(name: str, node: ast.FunctionDef) -> str:
    """Return a function's signature, an argument a line where it would be too long.

    Of an argument that is None by default, its other type is shown.
    """
    node.args.args = [one for one in node.args.args if one.arg != "self"]
    text = re.sub(r"(: [^=,]+(?:\[[^=]*\][^=,]*)?)=", r"\1 = ", ast.unparse(node.args))
    text = text.replace("''", '""').replace("'", "").replace(" | None = None", " = None")
    text = text.replace(" | ", "|")
    returned = f" -> {_type(node)}"
    if len(f"{name}({text}){returned}") <= _COLUMNS:
        return f"{name}({text}){returned}"
    arguments = textwrap.indent(re.sub(r", (?=\*|\w+\s*[:=])", ",\n", text), "    ")
    return f"{name}(\n{arguments},\n){returned}"


def _prose(text: str) -> str:
    """Return a docstring as Markdown: what stands in columns stays in columns."""
    found: list[tuple[bool, str]] = []
    for one in text.split("\n\n"):
        code = bool(re.search(r"\S {2,}\S|^ {4}", one, re.M))
        if code and found and found[-1][0]:
            one = f"{found.pop()[1]}\n\n{textwrap.dedent(one)}"
        found.append((code, textwrap.dedent(one) if code else one))
    return "\n\n".join(f"```text\n{one}\n```" if code else one for code, one in found)


def drives() -> str:
    """Return the page of drives, with the table of their dialects."""
    page = (FOLDER / DRIVES).read_text("utf-8")
    before, _, rest = page.partition("<!--drives-->\n")
    rows = ["| `--drive` | nodes | settings by number |", "|---|---|---|"]
    for name, kind in ({planned_drive.CIA402: planned_drive.CANOPEN} | planned_robot.KINDS).items():
        settings = ", ".join(
            f"`{one.name}`={one.number:#x}" for one in kind.settings if one.number >= 0
        )
        if name not in LISTED:
            settings = f"{len(kind.settings)}, in `drive-settings.json`" if settings else "its EDS"
        rows.append(f"| {name} | {kind.nodes[0]} to {kind.nodes[-1]} | {settings} |")
    table = "\n".join(rows)
    return f"{before}<!--drives-->\n{table}\n<!--/drives-->{rest.partition('<!--/drives-->')[2]}"


PAGES = {"commands.md": commands, "api.md": api, "rig-python.md": rig_python}
PAGES |= {DRIVES: drives}
PAGES |= {"../../tools/run/rig_words.json": rig_words.written}
PAGES |= {"../tool-confidence.md": confidence.written}
PAGES |= {f"schemas/{name}": partial(str, text) for name, text in schemas.files().items()}

if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for page, written in PAGES.items():
        (FOLDER / page).write_text(written(), "utf-8")
