"""What the mappings of a rig file are made of: keys by name, none of them unknown or changed."""

from collections.abc import Mapping
from typing import Any, ClassVar, dataclass_transform

from msgspec import Struct, StructMeta


class _KeyedMeta(StructMeta):
    """Makes the options of `Keyed` those of every subclass, which msgspec does not for all."""

    def __new__(
        cls, name: str, bases: tuple[type, ...], namespace: dict[str, Any], **options: Any
    ) -> "_KeyedMeta":
        options |= {"frozen": True, "kw_only": True, "forbid_unknown_fields": True}
        return super().__new__(cls, name, bases, namespace, **options)


@dataclass_transform(frozen_default=True, kw_only_default=True)
class Keyed(Struct, frozen=True, metaclass=_KeyedMeta):
    """A mapping of a rig file.

    `spread`: fields whose entries, of these names, stand among the keys of the file.
    """

    spread: ClassVar[Mapping[str, tuple[str, ...]]] = {}
