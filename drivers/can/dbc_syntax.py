"""The entries of a DBC file one by one, whatever stands between those that are well-formed.

What is no entry reaches up to the next line that begins with a keyword. Source: Vector, DBC File
Format Documentation 1.0; the grammar of cantools, with what other programs write: numbers as .5,
no receiver, no semicolon at the end, bit rate and registers behind BS_, comments.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass

from pcpc.drivers.errors import printable

KEYWORDS = (
    "BA_", "BA_DEF_", "BA_DEF_DEF_", "BA_DEF_DEF_REL_", "BA_DEF_REL_", "BA_DEF_SGTYPE_", "BA_REL_",
    "BA_SGTYPE_", "BO_", "BO_TX_BU_", "BS_", "BU_", "BU_BO_REL_", "BU_EV_REL_", "BU_SG_REL_",
    "CAT_", "CAT_DEF_", "CM_", "ENVVAR_DATA_", "EV_", "EV_DATA_", "FILTER", "NS_", "NS_DESC_",
    "SG_", "SG_MUL_VAL_", "SGTYPE_", "SGTYPE_VAL_", "SIG_GROUP_", "SIG_TYPE_REF_", "SIG_VALTYPE_",
    "SIGTYPE_VALTYPE_", "VAL_", "VAL_TABLE_", "VERSION",
)  # fmt: skip
_NAME, _WHOLE = "[A-Za-z0-9_]++", r"\d++"
_ID = r"-?+\d++"  # some programs write 32 bits with a sign
_KEYWORD = "(?:" + "|".join(sorted(KEYWORDS, key=len, reverse=True)) + r")\b"
NUMBER = r"[-+]?+(?:\d++\.?+\d*+|\.\d++)(?:[eE][-+]?+\d++)?+"
_STRING = r'"(?>(?:\\"|[^"])*?")'
_NODE = rf"(?!{_KEYWORD}){_NAME}"
_NODES = rf"(?P<names>(?:{_NODE}[ \t]*+(?:,\s*+)?+)*+)"
_OF_SIGNAL = (rf"(?P<frame>{_ID})", rf"(?P<signal>{_NAME})")
_SIGNAL = r"\s*+".join(_OF_SIGNAL)
_FOR_FRAME = rf"BO_\s*+(?P<only_frame>{_ID})"
_FOR_SIGNAL = rf"SG_\s*+{_SIGNAL}"
_FOR_NODE = rf"(?:BU|EV)_\s*+(?P<node>{_NAME})"
_FOR = rf"(?:(?:{_FOR_FRAME}|{_FOR_SIGNAL}|{_FOR_NODE})\s*+)?+"
_VALUE, _END = rf"(?P<value>{_STRING}|{NUMBER})", ";?+"
_REST = rf"(?:{_STRING}|[^;\"\n]|\n(?!\s*+{_KEYWORD}))*+"
_SHAPES: dict[str, tuple[str, ...]] = {
    "VERSION": (_STRING,),
    "NS_": (":", rf"(?:[A-Z][A-Z_]*+(?=\s*+(?:{_KEYWORD}|\Z))\s*+)*+"),
    "BS_": (rf"(?:(?!\b{_KEYWORD})[^\n])*+",),
    "BU_": (":", rf"(?P<names>(?:{_NODE}\s*+,?+\s*+)*+)"),
    "BO_": (rf"(?P<only_frame>{_ID})", rf"(?P<name>{_NAME})", ":", r"(?P<length>[-+]?+\d++)",
            rf"(?P<sender>{_NODE})?+"),
    "SG_": (rf"(?P<name>{_NAME})", "(?P<marker>[A-Za-z][A-Za-z0-9_]*+)?+", ":",
            r"(?P<start>[-+]?+\d++)", r"\|", rf"(?P<bits>{_WHOLE})", "@", "(?P<order>[01])",
            r"(?P<sign>[-+])", r"\(", rf"(?P<factor>{NUMBER})", ",",
            rf"(?P<offset>{NUMBER})", r"\)", r"\[",
            rf"(?P<low>{NUMBER})", r"\|", rf"(?P<high>{NUMBER})", r"\]", rf"(?P<unit>{_STRING})",
            _NODES),
    "BO_TX_BU_": (rf"(?P<only_frame>{_ID})", ":", _NODES, _END),
    "CM_": (_FOR, rf"(?P<value>{_STRING})", _END),
    "BA_DEF_": (r"(?:(?:BO|SG|BU|EV)_\b)?+", rf"(?P<name>{_STRING})", "(?P<type>[A-Z]++)",
                rf"(?P<values>(?:(?:{_STRING}|{NUMBER})\s*+,?+\s*+)*+)", _END),
    "BA_DEF_DEF_": (rf"(?P<name>{_STRING})", _VALUE, _END),
    "BA_": (rf"(?P<name>{_STRING})", _FOR, _VALUE, _END),
    "VAL_": (rf"(?:{_SIGNAL}|{_NODE})",
             rf"(?P<pairs>(?:{NUMBER}\s*+{_STRING}\s*+)*+)", _END),
    "SIG_VALTYPE_": (*_OF_SIGNAL, ":?+", "(?P<value>[0-3])", _END),
    "SG_MUL_VAL_": (*_OF_SIGNAL, rf"(?P<chooser>{_NAME})",
                    rf"(?P<ranges>(?:{_WHOLE}\s*+-\s*+{_WHOLE}\s*+,?+\s*+)++)", _END),
}  # fmt: skip
_SHAPES |= {key: (_REST, _END) for key in KEYWORDS if key not in _SHAPES}  # of no use here
_PATTERNS = {key: re.compile(r"\s*+".join((rf"{key}\b", *_SHAPES[key]))) for key in _SHAPES}
_BLANK, _WORD = re.compile(r"[\s;]*+"), re.compile(rf"{_NAME}|")
_NEXT = re.compile(rf"\n\s*+(?={_KEYWORD})")
_COMMENT = re.compile(rf"(?P<kept>{_STRING})|//[^\n]*+|/\*.*?\*/", re.DOTALL)
_PARTS = re.compile(rf"{_STRING}|{NUMBER}")
_SHOWN, _KEPT = 100, 1000  # characters on each side of what is no entry, and of all of it


@dataclass(frozen=True)
class DbcEntry:
    """An entry: its `groups`; of what is none, the place where it ends to be one, and its `text`.

    `place`: line, and column of what is none.
    """

    place: str
    keyword: str
    groups: dict[str, str]
    misfit: str = ""
    text: str = ""

    @property
    def number(self) -> int | None:
        """The id, as the file writes it, of the frame that it is about."""
        text = self.groups.get("only_frame") or self.groups.get("frame")
        return id_of(text) if text else None


def id_of(text: str) -> int:
    """Return an id as a file writes it: a number of 32 bits, whose sign some programs mean."""
    number = int(text[:20])
    if number < -(1 << 31):
        return (1 << 32) - number  # which no id is
    return number & 0xFFFFFFFF if number < 0 else number


def entries(content: str) -> Iterator[DbcEntry]:
    """Yield each entry of the text of a DBC file, and what stands between them."""
    content = _COMMENT.sub(_without_comment, content)
    offset, line, counted = _end(_BLANK, content, 0), 1, 0
    while offset < len(content):
        line, counted = line + content.count("\n", counted, offset), offset
        keyword = content[offset : _end(_WORD, content, offset)]
        match = _PATTERNS[keyword].match(content, offset) if keyword in _PATTERNS else None
        if match:
            groups = {key: text for key, text in match.groupdict().items() if text is not None}
            yield DbcEntry(str(line), keyword, groups)
            after = match.end()
        else:
            following = _NEXT.search(content, offset)
            after = following.end() if following else len(content)
            bad = _first_misfit(content, offset, keyword)
            column = bad - content.rfind("\n", 0, bad)
            place = f"{line + content.count(chr(10), offset, bad)}:{column}"
            yield DbcEntry(place, keyword, {}, _marked(content, bad), content[offset:after][:_KEPT])
        offset = _end(_BLANK, content, after)


def parts(text: str) -> list[str]:
    """Return the strings, in their quotes, and numbers of a list."""
    return _PARTS.findall(text)


def names(text: str) -> list[str]:
    """Return the names of a list."""
    return text.replace(",", " ").split()


def _end(pattern: re.Pattern[str], content: str, at: int) -> int:
    found = pattern.match(content, at)
    return found.end() if found else at


def _without_comment(found: re.Match[str]) -> str:
    """Return a string as it is, a comment as blanks on as many lines."""
    return found["kept"] or " " + "\n" * found[0].count("\n")


def _first_misfit(content: str, offset: int, keyword: str) -> int:
    """Return the place of the first thing that does not belong into an entry."""
    pieces = (rf"{keyword}\b", *_SHAPES[keyword]) if keyword in _SHAPES else ()
    for n in range(len(pieces), 0, -1):
        if found := re.compile(r"\s*+".join(pieces[:n]) + r"\s*+").match(content, offset):
            return found.end()
    return offset


def _marked(content: str, bad: int) -> str:
    """Return the line of a place, which is marked."""
    begin = content.rfind("\n", 0, bad) + 1
    before, behind = content[begin:bad][-_SHOWN:], content[bad : bad + _SHOWN].split("\n")[0]
    return f"not DBC syntax at >>!<<: {printable(f'{before.lstrip()}>>!<<{behind.rstrip()}')}"
