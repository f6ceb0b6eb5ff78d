"""A campaign: which rig, controllers, values and seeds; each process makes the same draws of it."""

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from pcpc.drivers.errors import printable
from pcpc.executive.errors import RigError, did_you_mean
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.executive.rig.requirements import text_of
from pcpc.tools.sweep.engine import Draw
from pcpc.tools.sweep.vary import Variation, all_parsed, grid_size, points, run_seed
from pcpc.tools.verdict.judge import Judge

DRAWS = 1000
MOST = 10_000_000  # draws of a campaign that ends by its statement
SEARCHES = ("worst", "rare")  # samplings that depend on the rows: see `search`
_BLOCK = 4096  # draws made at once


@dataclass(frozen=True)
class Shard:
    """Part `number` of `of`: the draws i with i mod of = number - 1."""

    number: int = 1
    of: int = 1

    @classmethod
    def parsed(cls, text: str) -> "Shard":
        """Return what `--shard i/N` says; RigError."""
        number, slash, of = text.partition("/")
        if not (slash and number.isdecimal() and of.isdecimal() and 0 < int(number) <= int(of)):
            raise RigError(f"--shard {text}: expected i/N, with i from 1 to N, as 2/8")
        return cls(int(number), int(of))

    def __str__(self) -> str:
        return f"shard-{self.number}-of-{self.of}"


@dataclass(frozen=True)
class Campaign:
    """What a table of runs follows from. `vary` and `settings` are texts of options."""

    rig: str
    controllers: tuple[str, ...]
    vary: tuple[str, ...]
    draws: int
    sampling: str = "sobol"
    seed: int = 1
    settings: tuple[str, ...] = ()

    def spec(self) -> dict[str, Any]:
        """Return it as JSON has it, with the title, and a digest of the rigs that it runs."""
        about = asdict(self) | {"variations": list(self.vary), "title": self.of[0].config.title}
        texts = [rig.resolved() for rig in self.of]
        return about | {"rigs": hashlib.sha256("\0".join(texts).encode()).hexdigest()}

    @cached_property
    def of(self) -> list[Rig]:
        """The rig with each of the controllers; RigError."""
        return [load_rig(self.rig, name, self.settings) for name in self.controllers]

    @cached_property
    def variations(self) -> tuple[Variation, ...]:
        """What is varied; RigError."""
        return all_parsed(self.vary)

    def check(self) -> None:
        """Raise RigError for a name that no run of a controller has, or values it cannot take."""
        if not self.variations and self.sampling == "grid":
            raise RigError("--sampling grid: nothing is varied; give --vary NAME=lo:hi:n")
        middle = 0, np.full(len(self.variations), 0.5)
        first = middle if self.sampling in SEARCHES else next(self.numbered(Shard()))
        for name in self.controllers:
            self.draw(name, *first)

    def check_requirement(self, name: str) -> None:
        """Raise RigError where a controller has no requirement of this name."""
        for controller, known in self.requirements().items():
            if name not in known:
                what = f"{controller} has no requirement {name}"
                raise RigError(f"{self.rig}: {what}{did_you_mean(name, known)}")

    def requirements(self) -> dict[str, list[str]]:
        """Return the names of the requirements of each controller."""
        return {
            rig.config.controller: [text_of(one) for one in Judge(rig, None).required().values()]
            for rig in self.of
        }

    def _own(self, rig: Rig) -> list[float]:
        known = {
            f"{spec.name}.{name}": value
            for node in rig.nodes().values()
            for spec in node.blocks
            for name, value in spec.settings.items()
        }
        found = []
        for one in self.variations:
            if one.name not in known:
                if one.name == "seed":
                    raise one.error("each run has a seed of its own; --seed gives the campaign's")
                what = f"{rig.config.controller} has no setting {one.name}"
                raise one.error(what + did_you_mean(one.name, known))
            found.append(known[one.name])
        return found

    def numbered(self, shard: Shard) -> Iterator[tuple[int, np.ndarray[Any, Any]]]:
        """Yield number and point of the draws of a shard."""
        whole = self.sampling in ("lhs", "grid") or self.draws <= _BLOCK
        size = self.draws if whole else _BLOCK
        made = 0
        while made < self.draws:
            size = min(max(size, 2 * made), self.draws)
            made_points = points(self.variations, size, self.sampling, self.seed)
            for number in range(made, size):
                if number % shard.of == shard.number - 1:
                    yield number, made_points[number]
            made = size

    def draw(self, controller: str, number: int, point: Any) -> Draw:
        """Return a draw for a controller; RigError for a factor on a value that is 0."""
        pairs = zip(self.variations, point, self.own[controller], strict=True)
        values = {one.name: one.value(float(u), value) for one, u, value in pairs}
        noise = run_seed(self.seed, 0 if self.sampling in SEARCHES else number)
        return Draw(number, noise, values)

    @cached_property
    def own(self) -> dict[str, list[float]]:
        """The rig's own values of what is varied, by controller; RigError."""
        return {rig.config.controller: self._own(rig) for rig in self.of}


def asked(
    rig: str | Path, controllers: Sequence[str], vary: Sequence[str], draws: int | None,
    sampling: str | None, seed: int, settings: Sequence[str], until: bool,
) -> Campaign:  # fmt: skip
    """Return what is asked for, completed; `until`: it ends by a statement. RigError."""
    names = tuple(dict.fromkeys(controllers))
    names = names or (load_rig(rig, None, settings).config.controller,)
    sampling = sampling or ("random" if until or not vary else "sobol")
    if until and sampling != "random":
        what = f"--until counts independent draws, and --sampling {sampling} makes others"
        raise RigError(f"{what}; leave --sampling out")
    if sampling == "grid" and draws is None:
        draws = grid_size(all_parsed(vary))
    if draws is None:
        draws = MOST if until else DRAWS
    if draws < 1:
        raise RigError(f"--draws {draws}: expected 1 or more")
    return Campaign(str(rig), names, tuple(vary), draws, sampling, seed, tuple(settings))


def read(path: Path) -> dict[str, Any]:
    """Return the spec in a file `sweep.json`; RigError for what is none."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        if not {"rig", "controllers", "vary", "draws"} <= set(found):
            raise ValueError("keys are missing")
    except FileNotFoundError:
        raise RigError(
            f"{path.parent}: no campaign; expected the folder of a `pcpc sweep`"
        ) from None
    except (OSError, ValueError, TypeError) as error:
        raise RigError(f"{path}: no campaign: {printable(str(error))}") from None
    return dict(found)
