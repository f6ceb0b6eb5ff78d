"""The two files of a law in C: `NAME.h` with its structures, `NAME.c` with its step.

    typedef struct { double kv_Nms_rad; ... } NAME_parameters;      also _states, _inputs, _outputs
    void NAME_step(double t, double dt, const NAME_parameters *p, NAME_states *x,
                   const NAME_inputs *u, NAME_outputs *y);
    void NAME_init(NAME_parameters *p, NAME_states *x);

A structure holds doubles in the order of memory; one without ports is left out, everywhere.
"""

import inspect
import sys
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pcpc.drivers.compiled.views import Layout
from pcpc.executive.laws.block import Block, Port
from pcpc.executive.own_laws.preparation import Values, prepared_values
from pcpc.tools.make.generate.translator.functions import Function
from pcpc.tools.make.generate.translator.kinds import (
    FLOAT,
    Untranslatable,
    View,
    c_name,
    field_size,
    number_text,
    size,
)
from pcpc.tools.make.generate.translator.source import comment, comment_text, read, source_of
from pcpc.tools.make.generate.translator.unit import ROLES, Unit, wrapped_lines

GIVEN = ("parameters", "inputs")  # a step reads them only
LETTERS = dict(zip(ROLES, "pxuy", strict=True))


def law_files(
    block: Block, name: str, values: tuple[Values, Values] | None = None
) -> dict[str, str]:
    """Return the texts of `NAME.h` and `NAME.c`, by file name.

    `values`: parameters and states of `executive.own_laws.preparation`, for NAME_init; else the
    law's defaults. Raises Untranslatable with the line of the source.
    """
    if not name.isidentifier() or not name.isascii() or c_name(name) != name:
        raise Untranslatable(f"{name}: no name for C; letters, digits and _ only")
    if hasattr(block.step, "model"):
        raise Untranslatable(f"{name}: an FMU has no C; generate that of its law, if there is one")
    unit = Unit(name)
    roles = {role: ports.layout for role, ports in zip(ROLES, block.step.declared, strict=True)}
    unit.reserve(f"{name}_step", f"{name}_init", f"{name}_selftest")
    for role, layout in roles.items():
        if layout.fields:
            unit.name_role(layout, role)
    aliases = _aliases(unit, name, roles)
    function = block.step.py_func
    made = Function(unit, function, (FLOAT, FLOAT, *(View(layout) for layout in roles.values())))
    step = made.translation(f"{name}_step", _step_head(name, made.given, roles))
    for role, letter, changed in zip(ROLES, made.given[2:], step.changes[2:], strict=True):
        if changed and role in GIVEN:
            raise made.error(made.node, f"the step sets {letter}: write states and outputs only")
    origin = read(source_of(function)[0].path)
    values = _defaults(block) if values is None else values
    return {
        f"{name}.h": _header(name, unit, block, roles, aliases, origin.shown),
        f"{name}.c": _body(name, unit, step.lines, roles, values, function),
    }


def elements(layout: Layout) -> Iterator[str]:
    """Yield the expression of each double of a structure, in the order of memory."""
    for field in layout.fields:
        name = c_name(field.name)
        if field.group is not None:
            yield from (f"{name}.{rest}" for rest in elements(field.group))
            continue
        indices = [""]
        for extent in field.shape:
            indices = [f"{index}[{i}]" for index in indices for i in range(extent)]
        yield from (f"{name}{index}" for index in indices)


def signature(block: Block) -> tuple[str, ...]:
    """Return which of `parameters`, `states`, `inputs`, `outputs` the C of a block has."""
    return tuple(
        role for role, ports in zip(ROLES, block.step.declared, strict=True) if ports.layout.fields
    )


def _aliases(unit: Unit, name: str, roles: Mapping[str, Layout]) -> list[str]:
    """Return the typedefs of roles whose structure is that of another one."""
    return [
        f"typedef {unit.structs[layout]} {name}_{role};"
        for role, layout in roles.items()
        if layout.fields and unit.structs[layout] != f"{name}_{role}"
    ]


def _step_head(name: str, given: Sequence[str], roles: Mapping[str, Layout]) -> str:
    parts = [f"double {c_name(given[0])}", f"double {c_name(given[1])}"]
    for role, letter in zip(ROLES, given[2:], strict=True):
        if roles[role].fields:
            const = "const " if role in GIVEN else ""
            parts.append(f"{const}{name}_{role} *{c_name(letter)}")
    return f"void {name}_step({', '.join(parts)})"


def _init_head(name: str, roles: Mapping[str, Layout]) -> str:
    parts = [
        f"{name}_{role} *{LETTERS[role]}" for role in ("parameters", "states") if roles[role].fields
    ]
    return f"void {name}_init({', '.join(parts) or 'void'})"


def _header(
    name: str,
    unit: Unit,
    block: Block,
    roles: Mapping[str, Layout],
    aliases: Sequence[str],
    origin: str,
) -> str:
    guard = f"PCPC_{name.upper()}_H"
    given = list(inspect.signature(block.step.py_func).parameters)
    ports: dict[Layout, Sequence[Port]] = {}
    for role in ROLES:
        _note_ports(roles[role], getattr(block, role), ports)
    lines = [
        f"/* {name}: interface of the law in {origin}, from which `pcpc generate c` made it. */",
        f"#ifndef {guard}",
        f"#define {guard}",
        "",
        "#include <stdint.h>",
        "",
    ]
    for layout, struct in unit.structs.items():
        lines += [*_struct(unit, layout, struct, ports[layout]), ""]
    lines += [*aliases, ""] if aliases else []
    lines += [
        "/* Set the values that the law starts with. */",
        f"{_init_head(name, roles)};",
        "",
        "/* One period: t the time and dt the period in s, from inputs to outputs. */",
        f"{_step_head(name, given, roles)};",
        "",
        "/* Return 0 if this file was compiled to give the bits of every other machine. */",
        f"int32_t {name}_selftest(void);",
        "",
        f"#endif /* {guard} */",
        "",
    ]
    return "\n".join(part for line in lines for part in wrapped_lines(line))


def _note_ports(layout: Layout, ports: Sequence[Port], found: dict[Layout, Sequence[Port]]) -> None:
    """Note which ports the fields of a layout and of its groups are."""
    found.setdefault(layout, ports)
    at = 0
    for field in layout.fields:
        begin, left = at, field_size(field)
        while left > 0:
            left -= ports[at].size
            at += 1
        if field.group is not None:
            _note_ports(field.group, ports[begin:at], found)


def _struct(unit: Unit, layout: Layout, struct: str, ports: Sequence[Port]) -> Iterator[str]:
    """Yield the definition of a structure, with unit and meaning of its ports."""
    yield "typedef struct {"
    at = 0
    for field in layout.fields:
        words, left = _words(ports[at]), field_size(field)
        while left > 0:
            left -= ports[at].size
            at += 1
        if field.group is not None:
            yield f"    {unit.structs[field.group]} {c_name(field.name)};"
            continue
        shape = "".join(f"[{extent}]" for extent in field.shape)
        yield f"    double {c_name(field.name)}{shape};{words}"
    yield f"}} {struct};"


def _words(port: Port) -> str:
    text = f"[{port.unit}] {port.help}" if port.unit else port.help
    return f" /* {comment_text(text)} */" if text else ""


def _body(
    name: str,
    unit: Unit,
    step: Sequence[str],
    roles: Mapping[str, Layout],
    values: tuple[Values, Values],
    function: Any,
) -> str:
    doc = inspect.cleandoc(getattr(sys.modules.get(function.__module__), "__doc__", None) or name)
    lines = comment(f"{doc}\n\nMade by `pcpc generate c` from {source_of(function)[0].shown}.")
    lines += ["", f'#include "{name}.h"', "", "#include <stdbool.h>", '#include "pcpc_math.h"', ""]
    constants = unit.constant_lines()
    lines += [*constants, ""] if constants else []
    lines += unit.function_lines([function.__module__])
    lines += [*(part for line in step for part in wrapped_lines(line)), ""]
    lines += [*_init(name, unit, roles, values), ""]
    lines += [
        f"int32_t {name}_selftest(void)",
        "{",
        "    return pcpc_contracts() ? 1 : pcpc_selftest();",
        "}",
        "",
    ]
    return "\n".join(lines)


def _init(
    name: str, unit: Unit, roles: Mapping[str, Layout], values: tuple[Values, Values]
) -> Iterator[str]:
    tables: list[str] = []
    body: list[str] = []
    for role, given in zip(("parameters", "states"), values, strict=True):
        numbers = iter([value for _, value in given])
        body += _port_statements(f"{LETTERS[role]}->", roles[role], numbers, tables, f"{role}_")
    yield from (part for line in tables for part in wrapped_lines(line))
    if tables:
        yield ""
    yield _init_head(name, roles)
    yield "{"
    yield from (part for line in body for part in wrapped_lines(f"    {line}"))
    yield "}"


def _port_statements(
    at: str, layout: Layout, numbers: Iterator[float], tables: list[str], stem: str
) -> list[str]:
    """Return the statements that set the ports of a layout; arrays that are not 0 go to tables."""
    found: list[str] = []
    for field in layout.fields:
        place = f"{at}{c_name(field.name)}"
        if field.group is not None:
            found += _port_statements(
                f"{place}.", field.group, numbers, tables, f"{stem}{field.name}_"
            )
            continue
        values = [next(numbers) for _ in range(field_size(field))]
        if not field.shape:
            found.append(f"{place} = {number_text(values[0])};")
            continue
        same = all(value == values[0] for value in values)
        source = number_text(values[0])
        if not same:
            text = ", ".join(map(number_text, values))
            tables.append(f"static const double {stem}{field.name}[{len(values)}] = {{{text}}};")
            source = f"{stem}{field.name}[{_flat_index(field.shape)}]"
        found += _loops(place, field.shape, source)
    return found


def _flat_index(shape: Sequence[int]) -> str:
    text = "i"
    for letter, extent in zip("jklm", shape[1:], strict=False):
        text = f"{text} * {extent} + {letter}" if text == "i" else f"({text}) * {extent} + {letter}"
    return text


def _loops(place: str, shape: Sequence[int], source: str) -> list[str]:
    letters = "ijklm"[: len(shape)]
    heads = [
        f"{'    ' * n}for (int32_t {letter} = 0; {letter} < {extent}; {letter} += 1) {{"
        for n, (letter, extent) in enumerate(zip(letters, shape, strict=True))
    ]
    index = "".join(f"[{letter}]" for letter in letters)
    inner = f"{'    ' * len(shape)}{place}{index} = {source};"
    return [*heads, inner, *(f"{'    ' * n}}}" for n in reversed(range(len(shape))))]


def _defaults(block: Block) -> tuple[Values, Values]:
    """Return what the law starts with where no rig says more; 0 for what only a rig knows."""
    settings = {
        name: port.default
        for port in block.settings
        for name in port.names()
        if port.default is not None
    }
    wanted = {name for port in block.settings for name in port.names()}
    if wanted == set(settings):
        return prepared_values(block, settings, 1000.0, 1)
    plain = [
        [(name, port.default or 0.0) for port in ports for name in port.names()]
        for ports in (block.parameters, block.states)
    ]
    return plain[0], plain[1]


__all__ = ["ROLES", "law_files", "signature", "size"]
