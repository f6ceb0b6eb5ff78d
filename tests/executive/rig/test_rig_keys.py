"""docs/rig.md tells every key of a rig file, with the default and the values of the schema."""

import re
from collections.abc import Iterator

import msgspec
from msgspec import inspect
from places import ROOT

from pcpc.executive.rig import schema
from pcpc.executive.rig.conversion import as_data, file_keys_of
from pcpc.executive.rig.reading import load_rig
from pcpc.executive.rig.roles import MORE_PLANTS, ROLES

ROW = re.compile(r"^\| (`[^|]+`) \| ([^|]*) \| \S.* \|$", re.MULTILINE)
HEAD = "| key | values (default) | meaning |\n|---|---|---|\n"


def rows(
    kind: type, above: str = "", told: dict[type, str] | None = None
) -> Iterator[tuple[str, str, str]]:
    """Yield (key, default, values) of a struct and of all below it, in the order of the schema.

    What has been told already is referred to, and `null` is not said of a key without a default.
    """
    told = {} if told is None else told
    for field in inspect.type_info(kind).fields:
        key, found = f"{above}{field.encode_name}", field.type
        if field.name in schema.Config.spread:  # of plant_2 and all behind it
            key, found = MORE_PLANTS[0], found.value_type
        below = struct_in(found)
        if below and (brief := in_brief(found)):  # what may stand in place of the keys below
            yield key, default(field), values(brief)
        while below and isinstance(found, inspect.DictType):
            key, found = f"{key}.NAME", found.value_type
        key += "[]" if isinstance(found, inspect.ListType) and below else ""
        if below is None:
            first = default(field)
            allowed = values(found)
            yield key, first, allowed.removesuffix(" or null") if first == "none" else allowed
        elif below in told:
            yield key, "none", f"as `{told[below]}`"
        else:
            told[below] = key
            yield from rows(below, f"{key}.", told)


def in_brief(kind: inspect.Type) -> inspect.Type | None:
    """Return a mapping's type with what may stand in place of a struct; None for nothing."""
    if isinstance(kind, inspect.DictType) and (inner := in_brief(kind.value_type)):
        return inspect.DictType(kind.key_type, inner)
    if isinstance(kind, inspect.UnionType):
        return next((one for one in kind.types if isinstance(one, inspect.TupleType)), None)
    return None


def struct_in(kind: inspect.Type) -> type | None:
    """Return the struct that a type is, holds as entries, or may be."""
    if isinstance(kind, inspect.StructType):
        return kind.cls
    if isinstance(kind, inspect.DictType):
        return struct_in(kind.value_type)
    if isinstance(kind, inspect.ListType):
        return struct_in(kind.item_type)
    if isinstance(kind, inspect.UnionType):
        return next(filter(None, map(struct_in, kind.types)), None)
    return None


def default(field: inspect.Field) -> str:
    if field.required:
        return "required"
    value = field.default if field.default is not msgspec.NODEFAULT else field.default_factory()
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    shown = f"{value:g}" if isinstance(value, float) else str(value)
    return "none" if value in (None, "", {}, []) else f"`{shown}`"


def values(kind: inspect.Type) -> str:
    """Return in words which values a key takes."""
    if isinstance(kind, inspect.UnionType):
        return " or ".join(dict.fromkeys(map(values, kind.types)))
    if isinstance(kind, inspect.LiteralType):
        return ", ".join(f"`{value}`" for value in kind.values if value not in ROLES[4:-1])
    if isinstance(kind, inspect.DictType):
        return f"by name: {values(kind.value_type)}"
    if isinstance(kind, inspect.ListType):
        return f"list: {values(kind.item_type)}"
    if isinstance(kind, inspect.TupleType):
        return f"[{', '.join(map(values, kind.item_types))}]"
    if isinstance(kind, inspect.IntType | inspect.FloatType):
        return f"{'integer' if isinstance(kind, inspect.IntType) else 'number'}{span(kind)}"
    names = {
        inspect.NoneType: "null",
        inspect.AnyType: "anything",
        inspect.BoolType: "true or false",
    }
    return names.get(type(kind), "text")


def span(kind: inspect.IntType | inspect.FloatType) -> str:
    """Return the range of a number as an interval, or as its one bound."""
    low = kind.gt if kind.ge is None else kind.ge
    high = kind.lt if kind.le is None or kind.le >= 2**53 else kind.le
    if high is not None:
        return f" {'(' if kind.ge is None else '['}{low:g}, {high:g}{')' if kind.lt else ']'}"
    return "" if low is None else f" {'>' if kind.ge is None else '>='} {low:g}"


def cell(first: str, allowed: str) -> str:
    """Return the words for values and default."""
    return (
        f"{allowed}, {first}"
        if first == "required"
        else (allowed if first == "none" else f"{allowed} ({first})")
    )


def test_the_document_tells_every_key_with_its_default_and_values() -> None:
    page = (ROOT / "docs/rig.md").read_text(encoding="utf-8")
    tables = [part.partition("\n\n")[0] for part in page.split(HEAD)[1:]]
    told = [
        (key, allowed)
        for table in tables
        for keys, allowed in ROW.findall(table + "\n")
        for key in re.findall(r"`([^`]+)`", keys)
    ]
    wanted = [(key, cell(first, allowed)) for key, first, allowed in rows(schema.Config)]
    missing = [
        f"| `{key}` | {allowed} | ... |" for key, allowed in wanted if (key, allowed) not in told
    ]
    assert not missing, "\n".join(["not in docs/rig.md:", *missing])
    extra = [row for row in told if row not in wanted]
    assert not extra, f"in docs/rig.md, but no keys: {extra}"
    assert len(told) == len(wanted) > 60, len(told)


def test_plants_are_keys_of_the_file_in_the_order_of_their_roles() -> None:
    keys = list(file_keys_of(schema.Config))
    assert keys[(at := keys.index("local")) : at + 17] == ["local", *MORE_PLANTS, "losses"]
    more = "plant_3: {like: plant, node: C}\nplant_2: {like: plant, node: B}\nplant_9: null\n"
    rig = load_rig(ROOT / "plants/probe/x.yaml", text=f"base: rig.yaml\n{more}", resolve=False)
    assert rig.roles == ("executive", "plant", "plant_2", "plant_3") == tuple(rig.config.sections)
    assert [key for key in as_data(rig.config) if "plant" in key] == [*rig.config.plants]
