"""The sections of an EDS or DCF file, and the variables that they describe. Source: CiA 306-1.

Numbers are decimal, 0x hexadecimal, 0 octal, or with $NODEID+; # begins a comment. A line that is
no key=value, a key or a section that comes twice (the first counts), is listed. The values of an
array without sections of its own stand in [....Value].
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

from pcpc.drivers.errors import printable

_SECTION = re.compile(r"([0-9A-F]{4})(?:SUB([0-9A-F]{1,2}))?")
_VALUES = re.compile(r"([0-9A-F]{4})VALUE")
_RECORDS = (0x08, 0x09)
_MOST_SUBINDICES = 254
_NUMBER = re.compile(r"([-+]?)(0X[0-9A-F]+|0[0-7]+|[1-9][0-9]*|0)")
_MOST_DIGITS = 40


@dataclass(frozen=True)
class EdsVariable:
    """A variable: its place, and the lower-case keys of its section; `value`: at the start."""

    index: int
    subindex: int
    keys: dict[str, str]

    @property
    def key(self) -> str:
        """Its index and subindex, as a rig writes them: 6040, 1018.2."""
        return f"{self.index:04X}" + (f".{self.subindex}" if self.subindex else "")

    @property
    def value(self) -> str:
        """What it is at the start: of a DCF, else the default; empty if nothing is said."""
        return self.keys.get("parametervalue") or self.keys.get("defaultvalue") or ""


@dataclass
class Sections:
    """The sections of a file by their upper-case names, and what is odd."""

    of: dict[str, dict[str, str]] = field(default_factory=dict)
    odd: list[str] = field(default_factory=list)


def sections(data: bytes) -> Sections:
    """Return the sections of the bytes of a file."""
    file, current = Sections(), None
    for i, line in enumerate(_text(data).splitlines()):
        bare = line.strip()
        if not bare or bare[0] in ";#":
            continue
        if bare[0] == "[" and "]" in bare:
            name = bare[1 : bare.index("]")].strip().upper()
            current = dict[str, str]()
            if name in file.of:
                file.odd.append(f"line {i + 1} ([{printable(name[:40])}] again)")
            else:
                file.of[name] = current
            continue
        key, sign, value = (part.strip() for part in bare.partition("="))
        if current is None or not sign:
            problem = "no [section] before it" if current is None else "no key=value"
            file.odd.append(f"line {i + 1} ({problem})")
        elif key.lower() in current:
            file.odd.append(f"line {i + 1} ({printable(key[:40])} again)")
        else:
            current[key.lower()] = value.split(";")[0].strip()
    return file


def _text(data: bytes) -> str:
    """Return UTF-16 by its mark, UTF-8, else Latin-1."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data.decode("utf-16", "replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.removeprefix(b"\xef\xbb\xbf").decode("latin-1")


def variables(file: Sections) -> Iterator[EdsVariable]:
    """Yield each variable, and what is odd into `found.odd`.

    Of a compact array those that have no section of their own.
    """
    given, compact = set[str](), list[EdsVariable]()
    for name, keys in file.of.items():
        if match := _VALUES.fullmatch(name):
            array = file.of.get(match[1], {})
            if not array.get("compactsubobj"):
                file.odd.append(f"[{name}] (no compact [{match[1]}])")
        elif match := _SECTION.fullmatch(name):
            index, subindex = int(match[1], 16), int(match[2] or "0", 16)
            try:
                count = number(keys.get("compactsubobj") or "0", 0)
                is_record = number(keys.get("objecttype") or "7", 0) in _RECORDS
            except ValueError as error:
                file.odd.append(f"{match[1]} ({error})")
                continue
            if match[2] is None and count > 0:
                compact += _compact(file, index, keys, count)
            elif match[2] or not is_record:
                one = EdsVariable(index, subindex, keys)
                given.add(one.key)
                yield one
        elif "datatype" in keys:
            file.odd.append(
                f"[{printable(name[:40])}] (no index of an object, as 2001 or 2001sub1)"
            )
    yield from (one for one in compact if one.key not in given)


def _compact(file: Sections, index: int, keys: dict[str, str], count: int) -> Iterator[EdsVariable]:
    """Yield the variables of an array whose subindices have no sections of their own."""
    values = dict[int, str]()
    for key, value in file.of.get(f"{index:04X}VALUE", {}).items():
        if key == "nrofentries":
            continue
        subindex = int(key) if key.isdecimal() and len(key) < 4 else 0
        if 1 <= subindex <= count:
            values[subindex] = value
        else:
            file.odd.append(f"[{index:04X}Value] {printable(key[:40])}")
    if count > _MOST_SUBINDICES:
        file.odd.append(f"{index:04X}.{_MOST_SUBINDICES + 1} to {count}")
    count = min(count, _MOST_SUBINDICES)
    size = {"datatype": "5", "accesstype": "ro", "defaultvalue": str(count)}
    yield EdsVariable(index, 0, size)
    for i in range(1, count + 1):
        own = {"parametervalue": values[i]} if i in values else {}
        yield EdsVariable(index, i, keys | own)


def number(text: str, node: int) -> int:
    """Return a whole number of the file; ValueError says what came."""
    total, bare = 0, "".join(text.split("#")[0].split()).upper()
    if "$NODEID" in bare:
        total, bare = node, re.sub(r"\+?\$NODEID\+?", "", bare, count=1) or "0"
    match = _NUMBER.fullmatch(bare)
    if match is None or len(bare) > _MOST_DIGITS:
        what = f"'{printable(text[:40])}'" if text else "nothing"
        raise ValueError(f"expected a number, got {what}")
    digits = match[2]
    base = 16 if digits.startswith("0X") else 8 if digits.startswith("0") and digits != "0" else 10
    return total + int(match[1] + digits.removeprefix("0X"), base)
