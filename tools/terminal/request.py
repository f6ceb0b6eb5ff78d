"""What a command is asked for: a class of typed fields, of which its options are made.

    class SoakRequest(Request):
        '''A rig, and for how long it runs.'''

        rig: Annotated[str, "RIG", "a rig's name (pcpc rigs) or file"]
        each_s: Annotated[float, duration, "--each", "TIME", "duration of a run"] = 600.0
        json: Json = False

A field without a default is a word of the command, one with a default an option of its name. Behind
its type stand

    "-o", "--each"        further names of an option, or a long one in place of the field's; an
                          option that is named so and has no default has to be given
    "TIME", "its help"    what its value is called, unless a bool or a Literal says it; its help
    duration              what makes its value of a text; of a list: all of it of one text
    an argparse.Action    what is done in place of setting it
    WORD                  a word, though it has a default: it can be left out
    {"nargs": "+"}        other keywords of `add_argument`

A list is an option that can be repeated, or several words. In place of a field that is a request
stand its fields, in place of `Offers` those that rooms offer. What has no `Annotated` is no option.
"""

import argparse
from collections.abc import Callable, Mapping, Sequence
from types import NoneType
from typing import (
    Any,
    ClassVar,
    Final,
    Literal,
    NamedTuple,
    Self,
    TypeVar,
    dataclass_transform,
    get_args,
    get_origin,
)

from pcpc.drivers.errors import UserError
from pcpc.tools.terminal.rooms import offers

Add = Callable[..., argparse.Action]  # add_argument of a command's parser
WORD: Final = {"word": True}
HIDDEN: Final = argparse.SUPPRESS  # as a help
_NEEDED: Final = object()  # in place of a default


@dataclass_transform(eq_default=False, kw_only_default=True)
class Request:
    """What a command is asked for; its fields are keywords of the class."""

    _fields: ClassVar[dict[str, "_Field"]] = {}
    _given: Mapping[str, tuple[str, Any]] = {}  # by field: the option, its value

    def __init_subclass__(cls) -> None:
        cls._fields = {}
        for base in reversed(cls.__bases__):
            cls._fields |= getattr(base, "_fields", {})
        for name, hint in cls.__annotations__.items():
            about = getattr(hint, "__metadata__", ())
            kind = hint.__origin__ if about else hint
            cls._fields[name] = _Field(name, kind, about, getattr(cls, name, _NEEDED))

    def __init__(self, **values: Any) -> None:
        if unknown := values.keys() - self._fields.keys():
            raise TypeError(f"{type(self).__name__} has no {', '.join(sorted(unknown))}")
        for name, field in self._fields.items():
            value = values.get(name, field.default)
            if value is _NEEDED:
                raise TypeError(f"{type(self).__name__} needs {name}")
            setattr(self, name, value)

    @classmethod
    def add_to(cls, add: Add) -> None:
        """Add its options to a parser."""
        for field in cls._fields.values():
            field.add_to(add)

    @classmethod
    def from_options(cls, options: argparse.Namespace) -> Self:
        """Return what a command line asks for, which a parser with its options has read."""
        found = cls(**{
            name: field.value(options)
            for name, field in cls._fields.items()
            if field.parts or name in options
        })  # fmt: skip
        found._given = getattr(options, "given", {})
        return found

    def changed(self, **values: Any) -> Self:
        """Return it with other values of these fields."""
        old = {name: getattr(self, name) for name in self._fields}
        found = type(self)(**{**old, **values})
        found._given = self._given
        return found

    def refuse(self, why: str, *names: str) -> None:
        """Raise UserError for the first of these fields that a command line gives."""
        for name in names:
            if name in self._given:
                raise UserError(f"{self._given[name][0]}: {why}")

    def are_given(self, *names: str) -> bool:
        """Return whether a command line gives one of these fields."""
        return not self._given.keys().isdisjoint(names)


_R = TypeVar("_R", bound=Request)


class Offers:
    """What the rooms that are here have added to a command's options: a request of each."""

    def __init__(self, *requests: Request) -> None:
        self._requests = requests

    def of(self, kind: type[_R]) -> _R:
        """Return the request of a kind, as a room offers it."""
        return next((one for one in self._requests if isinstance(one, kind)), None) or kind()

    def value(self, name: str) -> Any:
        """Return a field of one of them; None where the room that offers it was taken out."""
        return next((vars(one)[name] for one in self._requests if name in vars(one)), None)


class _Field(NamedTuple):
    """A field of a request: its type, what stands behind that, its default."""

    name: str
    kind: Any
    about: Sequence[Any]
    default: Any

    @property
    def parts(self) -> "Sequence[type[Request]]":
        """The requests whose fields stand in its place."""
        if self.kind is Offers:
            return offers(self.about[0])
        is_request = isinstance(self.kind, type) and issubclass(self.kind, Request)
        return (self.kind,) if is_request else ()

    def value(self, options: argparse.Namespace) -> Any:
        """Return its value in what a parser has read."""
        if self.kind is Offers:
            return Offers(*(one.from_options(options) for one in self.parts))
        return self.kind.from_options(options) if self.parts else getattr(options, self.name)

    def add_to(self, add: Add) -> None:
        """Add it to a parser, unless it is no option."""
        for part in self.parts:
            part.add_to(add)
        if self.about and self.kind is not Offers:
            names, more = self._names_and_more()
            add(*names, **self._of_kind(is_word=not names[0].startswith("-"), more=more), **more)

    def _names_and_more(self) -> tuple[list[str], dict[str, Any]]:
        """Return the names, and the keywords that stand behind the type, for `add_argument`."""
        texts = [one for one in self.about if isinstance(one, str)]
        names = [text for text in texts if text.startswith("-") and " " not in text]
        words = [text for text in texts if text not in names]
        more: dict[str, Any] = {"metavar": words[0]} if len(words) > 1 else {}
        for one in self.about:
            if isinstance(one, Mapping):
                more |= one
            elif isinstance(one, type) and issubclass(one, argparse.Action):
                more["action"] = one
            elif callable(one):
                more["type"] = one
        more["help"] = words[-1] if words else None
        needed = self.default is _NEEDED
        if more.pop("word", needed and not names):
            return [self.name], more
        if needed:
            more["required"] = True
        if not any(name.startswith("--") for name in names):
            names.append(f"--{self.name.replace('_', '-')}")
        elif names[-1] != f"--{self.name.replace('_', '-')}":
            more.setdefault("dest", self.name)
        return names, more

    def _of_kind(self, is_word: bool, more: Mapping[str, Any]) -> dict[str, Any]:
        """Return the keywords that follow from the type and the default, but for those `more`."""
        kinds = get_args(self.kind) if NoneType in get_args(self.kind) else (self.kind,)
        kind, needed = kinds[0], self.default is _NEEDED
        default = None if needed else self.default
        found: dict[str, Any] = {}
        if kind is bool:
            return {"action": "store_true"}
        if get_origin(kind) is Literal:
            found["choices"] = get_args(kind)
            kind = type(get_args(kind)[0])
        elif get_origin(kind) is not None and "type" not in more:
            kind = get_args(kind)[0]
            default = None if default is None or is_word else [*default]
            if is_word:
                found["nargs"] = "+" if needed else "*"
            elif "nargs" not in more:
                found["action"] = "append"
        elif is_word and not needed:
            found["nargs"] = "?"
        if kind not in (str, NoneType):
            found["type"] = kind
        if default is not None:
            found["default"] = default
        return {name: value for name, value in found.items() if name not in more}
