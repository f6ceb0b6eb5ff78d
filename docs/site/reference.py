"""Write the pages of docs/reference from what they tell of: `make reference`.

commands.md   the parser of the command line
api.md        signatures and docstrings of `import pcpc`
"""

import argparse
import ast
import importlib
import inspect
import re
import textwrap
from pathlib import Path
from typing import Any

import pcpc
from pcpc.drivers.errors import Exit
from pcpc.tools import cli
from pcpc.tools.console.command import Command
from pcpc.tools.console.commands import GROUPS

FOLDER = Path(__file__).resolve().parents[1] / "reference"
_COLUMNS = 100
_NOTE = "<!-- written by `make reference`; change its source, not this page -->"
_COMMANDS = f"""# Commands
{_NOTE}

RIG is the name of a rig that comes with pcpc (`pcpc rigs`) or a file; LOG is a file, a run folder,
or `latest`, the newest run below `runs/`. All commands have the same exit codes; a command lists
those that it can end with.
"""
_API = f"""# The package
{_NOTE}

What `import pcpc` offers, from its docstrings; [the guide](../python.md) shows it at work.
"""


def commands() -> str:
    """Return the page of the command line."""
    lines = [_COMMANDS, "| exit code | |", "|---|---|"]
    lines += [f"| {code:d} | {code.meaning} |" for code in Exit]
    parsers = _parts(cli.parser())
    for title, group in GROUPS.items():
        lines.append(f"\n## {title[0].upper()}{title[1:]}")
        for command in group:
            lines += _command(command, parsers[command.name])
    return "\n".join(lines) + "\n"


def _command(command: Command, parser: argparse.ArgumentParser) -> list[str]:
    lines = [f"\n### {parser.prog}\n", f"{command.help[0].upper()}{command.help[1:]}."]
    for part in command.parts:
        lines += _command(part, _parts(parser)[part.name])
    if command.parts:
        return lines
    shown = [action for action in parser._actions if action.dest != "help"]
    names = [_argument(action) for action in shown if not action.option_strings]
    options = [one for one in shown if one.help and one.help != argparse.SUPPRESS]
    rest = [f"-- {command.rest}"] if command.rest else []
    usage = " ".join([parser.prog, "[OPTION ...]", *names, *rest])
    notes = ["", *command.notes.strip().splitlines()] if command.notes else []
    lines += ["\n```text", usage, "", *command.example.splitlines(), *notes, "```"]
    if options:
        lines += ["", "| argument | |", "|---|---|"]
        lines += [f"| {_code(_argument(one))} | {_help(parser, one)} |" for one in options]
    codes = command.codes or dict.fromkeys(Exit, "")
    told = ", ".join(f"{code:d} {said or code.meaning}" for code, said in codes.items())
    return [*lines, "", *textwrap.wrap(f"Exit code: {told}.", _COLUMNS)]


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
    text = parser._get_formatter()._expand_help(action)
    return text.replace("|", "&#124;").replace("*", "\\*").replace("[", "\\[")


def _code(text: str) -> str:
    return f"<code>{text.replace('|', '&#124;')}</code>" if "|" in text else f"`{text}`"


def api() -> str:
    """Return the page of the package."""
    lines = [_API]
    for name in sorted(pcpc.__all__, key=lambda name: (name[0].isupper(), name)):
        module, _, other = pcpc._WHERE[name].partition(":")
        source = inspect.getsource(importlib.import_module(f"pcpc.{module}"))
        (found,) = (
            node for node in ast.parse(source).body
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name == (other or name)
        )  # fmt: skip
        lines += _definition(found, f"pcpc.{name}", "##")
    return "\n".join(lines) + "\n"


def _definition(node: Any, name: str, level: str) -> list[str]:
    """Return the chapter of a function or class, with its public members below."""
    told = _prose(ast.get_docstring(node) or "")
    if isinstance(node, ast.FunctionDef):
        return [f"\n{level} {name}\n", f"```text\n{_call(name, node)}\n```\n", told]
    members = [one for one in node.body if isinstance(one, ast.FunctionDef) and one.name[0] != "_"]
    lines, values = [f"\n{level} {name}\n", told], [one for one in members if _is_value(one)]
    lines += ["\n| value | type | |", "|---|---|---|"] if values else []
    for one in values:
        said = " ".join((ast.get_docstring(one) or "").split())
        lines.append(f"| `{one.name}` | `{_type(one)}` | {said} |")
    for one in members:
        lines += [] if one in values else _definition(one, f"{name}.{one.name}", level + "#")
    return lines


def _is_value(node: ast.FunctionDef) -> bool:
    return any("property" in ast.unparse(one) for one in node.decorator_list)


def _type(node: ast.FunctionDef) -> str:
    return ast.unparse(node.returns).strip("'") if node.returns else ""


def _call(name: str, node: ast.FunctionDef) -> str:
    """Return a function's signature, an argument a line where it would be too long."""
    node.args.args = [one for one in node.args.args if one.arg != "self"]
    text = re.sub(r"(: [^=,]+)=", r"\1 = ", ast.unparse(node.args)).replace("'", "")
    returned = f" -> {_type(node)}"
    if len(f"{name}({text}){returned}") <= _COLUMNS:
        return f"{name}({text}){returned}"
    arguments = textwrap.indent(re.sub(r", (?=\*|\w+\s*[:=])", ",\n", text), "    ")
    return f"{name}(\n{arguments},\n){returned}"


def _prose(text: str) -> str:
    """Return a docstring as Markdown: what stands in columns stays in columns."""
    paragraphs = text.split("\n\n")
    return "\n\n".join(
        f"```text\n{textwrap.dedent(one)}\n```" if re.search(r"\S {2,}\S|^ {4}", one, re.M) else one
        for one in paragraphs
    )


PAGES = {"commands.md": commands, "api.md": api}

if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for page, written in PAGES.items():
        (FOLDER / page).write_text(written(), "utf-8")
