"""A campaign: which rig, controllers, values and seeds; each process makes the same draws of it."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, TypedDict

import msgspec
import numpy as np

from pcpc.drivers.errors import printable
from pcpc.executive.errors import RigError, did_you_mean
from pcpc.executive.own_laws.carried_files import is_ordinary
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.executive.rig.requirements import text_of
from pcpc.tools.after.verdict.judge import Judge
from pcpc.tools.study.engine import Draw
from pcpc.tools.study.sweep.origin import difference, origin
from pcpc.tools.study.sweep.vary import Variation, parse_variations, points, run_seed

SEARCHES = ("worst", "rare")  # samplings that depend on the rows: see `search`
_BLOCK = 4096  # draws made at once


@dataclass(frozen=True)
class Shard:
    """Part `number` of `of`: the draws i with i mod of = number - 1."""

    number: int = 1
    of: int = 1

    @classmethod
    def parse(cls, text: str) -> "Shard":
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
        """Return it as JSON has it, with the title, and its `origin`; RigError."""
        about = asdict(self) | {"variations": list(self.vary), "title": self.rigs[0].config.title}
        return about | {"origin": origin(self.rigs)}

    def changed(self, spec: Mapping[str, Any]) -> str:
        """Return what of rig and code is not as `spec` has it, by the disk; "" of nothing."""
        return difference(spec["origin"], origin(replace(self).rigs))

    @cached_property
    def rigs(self) -> list[Rig]:
        """The rig with each of the controllers; RigError."""
        return [load_rig(self.rig, name, self.settings) for name in self.controllers]

    @cached_property
    def variations(self) -> tuple[Variation, ...]:
        """What is varied; RigError."""
        return parse_variations(self.vary)

    def check(self) -> None:
        """Raise RigError for a name that no run of a controller has, or values it cannot take."""
        if not self.variations and self.sampling == "grid":
            raise RigError("--sampling grid: nothing is varied; give --vary NAME=lo:hi:n")
        self._check_set()
        middle = 0, np.full(len(self.variations), 0.5)
        first = middle if self.sampling in SEARCHES else next(self.numbered(Shard()))
        for name in self.controllers:
            self.draw(name, *first)

    def _check_set(self) -> None:
        """Raise RigError for a setting that no run would have, for each draw replaces it."""
        drawn = {one.name: one.text for one in self.variations if not one.relative}
        for text in self.settings:
            name = text.partition("=")[0].strip()
            if name in drawn:
                what = f"--vary {name}={drawn[name]} replaces it in every run; leave one out"
                raise RigError(f"--set {text}: {what}")
            if name == "seed":
                what = "each run has a seed of its own; --seed gives the campaign's"
                raise RigError(f"--set {text}: {what}")

    def check_requirement(self, name: str) -> None:
        """Raise RigError where a controller has no requirement of this name."""
        for controller, known in self.requirements().items():
            if name not in known:
                what = f"{controller} has no requirement {name}"
                raise RigError(f"{self.rig}: {what}{did_you_mean(name, known)}")

    def requirements(self) -> dict[str, list[str]]:
        """Return the names of the requirements of each controller."""
        return {
            rig.config.controller: [text_of(one) for one in Judge(rig).required().values()]
            for rig in self.rigs
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
        """Yield number and point of the draws of a shard. Each point: (d,)."""
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
        return {rig.config.controller: self._own(rig) for rig in self.rigs}


def differences(one: Mapping[str, Any], other: Mapping[str, Any]) -> str:
    """Return what differs between the specs of two campaigns, in words; "" of equal ones."""
    keys = [key for key in {**one, **other} if one.get(key) != other.get(key)]
    origins = [spec.get("origin", {}) for spec in (one, other)]
    words = [key for key in keys if key != "origin"]
    words += difference(*origins).split(", ") if "origin" in keys else []
    return ", ".join(dict.fromkeys(words))


class _Spec(TypedDict):
    """What a file `sweep.json` holds at least."""

    rig: str
    controllers: Annotated[list[str], msgspec.Meta(min_length=1)]
    vary: list[str]
    variations: list[str]
    draws: Annotated[int, msgspec.Meta(ge=1)]
    sampling: Literal["random", "lhs", "sobol", "grid", "worst", "rare"]
    seed: Annotated[int, msgspec.Meta(ge=0)]
    settings: list[str]
    title: str
    origin: dict[str, str]


def read(path: Path) -> dict[str, Any]:
    """Return the spec in a file `sweep.json`; RigError for what is none."""
    try:
        if path.exists() and not is_ordinary(path):
            raise ValueError("it is not a readable file")
        found = json.loads(path.read_text(encoding="utf-8"))
        msgspec.convert(found, _Spec)
    except (FileNotFoundError, NotADirectoryError):
        raise RigError(
            f"{path.parent}: no campaign; expected the folder of a `pcpc sweep`"
        ) from None
    except (OSError, ValueError, TypeError, RecursionError) as error:
        raise RigError(f"{path}: no campaign: {printable(str(error))}") from None
    return dict(found)
