"""Laws that a rig names by a word, and a file beside it: each is a row, and a module of its own."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pcpc.executive.rig import fmu, tables
from pcpc.executive.rig.node_keys import BlockEntry
from pcpc.executive.rig.yamlfile import Document, Keys

if TYPE_CHECKING:
    from pcpc.executive.laws.block import Block


@dataclass(frozen=True)
class FileLaw:
    """How such a law is read, and what becomes of it in a log.

    read       block, text of the file for a log, and the entry by the names of the ports; RigError
    kept_as    ending of that text; `endings`: of the files themselves, beside logs
    expand     carries out a shorthand of the rig file for such a block; RigError
    resolve    lets the entry of a rig be that of the text
    """

    read: "Callable[[Document, Keys, BlockEntry], tuple[Block, str, BlockEntry]]"
    kept_as: str
    endings: tuple[str, ...]
    expand: Callable[[Document], None] = lambda document: None
    resolve: Callable[[dict[str, Any]], None] = lambda entry: None


FILE_LAWS: Mapping[str | None, FileLaw] = {  # by `law`
    tables.LAW: FileLaw(tables.read_table, "csv", (".csv",), resolve=tables.resolve),
    fmu.LAW: FileLaw(fmu.read_fmu, "json", (".fmu",), expand=fmu.expand_shorthand),
}


def expand_shorthands(document: Document) -> None:
    """Carry out what stands for blocks of such laws; RigError."""
    for law in FILE_LAWS.values():
        law.expand(document)
