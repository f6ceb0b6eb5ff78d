"""What a study comes to, told in one way: a text, JSON, and a folder with that and its pictures."""

import json
from collections.abc import Iterable, Mapping
from operator import methodcaller
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import msgspec

from pcpc.tools.terminal import screen

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def plain(facts: Any) -> dict[str, Any]:
    """Return facts as JSON has them; None for what is not a finite number."""
    return dict(msgspec.json.decode(msgspec.json.encode(facts, enc_hook=methodcaller("tolist"))))


class Result:
    """Of a study: a subclass gives its `lines`, its `facts` and its `pictures`."""

    name: ClassVar[str]  # of its JSON file

    def lines(self) -> Iterable[str]:
        """Return what a terminal shows, in lines of any length."""
        raise NotImplementedError

    def facts(self) -> Any:
        """Return what JSON holds: a struct, or numbers, arrays, data classes by name."""
        raise NotImplementedError

    def pictures(self) -> Mapping[str, "Figure"]:
        """Return pictures by the names of their files; ImportError without matplotlib."""
        raise NotImplementedError

    def text(self) -> str:
        """Return the lines as a terminal has them."""
        return "\n".join(screen.fitted(self.lines())).rstrip() + "\n"

    def json(self) -> dict[str, Any]:
        """Return all as plain values; None for what is not a finite number."""
        return plain(self.facts())

    def save(self, folder: str | Path) -> Path:
        """Write the JSON and the pictures into a folder; return it. ImportError."""
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        text = json.dumps(self.json(), indent=1) + "\n"
        (folder / f"{self.name}.json").write_text(text, encoding="utf-8")
        for name, picture in self.pictures().items():
            picture.savefig(folder / f"{name}.png")
        return folder
