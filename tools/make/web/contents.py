"""What a page is told of a rig: JSON, and behind it the modules of its controllers.

    payload = base64(SHA-256 of what follows; zstd(length of the JSON, 4 bytes little-endian; JSON;
              modules))

The digest of a run is that of `tools.after.run_digest`.
"""

import base64
import hashlib
import importlib.metadata
import json
import math
import platform
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import zstandard

from pcpc.drivers.errors import UserError
from pcpc.executive.errors import RigError
from pcpc.executive.log.reader import Log
from pcpc.executive.nodes.plan import plan
from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.rig.blocks import BlockSpec
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.executive.rig.roles import Role
from pcpc.plants.drawing import DrawingError, drawing_of, settings_of
from pcpc.tools.after.run_digest import digest_of
from pcpc.tools.make.generate.translator.kinds import Untranslatable
from pcpc.tools.make.web.disturbances import disturbances
from pcpc.tools.make.web.judge_script import judge_data
from pcpc.tools.make.web.log_head import log_head
from pcpc.tools.make.web.program import Program
from pcpc.tools.make.web.scene_script import scene_data
from pcpc.tools.make.web.symbols import Unrecordable

SEEDS = 3  # beyond the rig's own
LAYOUT = "layout.json"
WALL_NS = "1700000000000000001"  # in the place of the time of day at which a page is made
SHORT = 200  # characters
WINDOW = 25  # bits; the controllers of a rig are alike
MOST_BYTES = 1 << 30  # of what a page keeps of a run


class Contents:
    """A rig, and its controllers one by one."""

    def __init__(self, rig: Rig, name: str, settings: list[str]) -> None:
        """`name`: as the user called it; `settings`: what he changed."""
        self._modules = list[bytes]()
        self._places: dict[str, int] = {}
        config = rig.config
        self.about: dict[str, Any] = {
            "version": importlib.metadata.version("pcpc"),
            "machine": platform.machine().replace("_", "-"),
            "rig": config.rig,
            "title": config.title,
            "called": name,
            "settings": settings,
            "period_s": config.period_ns * 1e-9,
            "rate_hz": config.rate_hz,
            "nodes": list(rig.roles),
            "schedule": [{"at_s": one.at_s, "set": dict(one.set)} for one in config.schedule],
            "disturbances": disturbances(rig, settings),
            "layout": _layout(rig),
            "parts": [],
            "controllers": [],
            "absent": [],
        }

    def add(self, rig: Rig) -> None:
        """Compile a controller and run it once; RigError, UserError."""
        program = Program(rig)
        kept = 8 * program.cycle_count * sum(map(len, program.rows.values()))
        if kept > MOST_BYTES:
            what = f"a page would keep {kept / 2**30:.1f} GiB of a run; make it shorter"
            raise rig.error("duration_s", what)
        module = program.module()
        log = in_memory(rig)
        ended = log.node["executive"].columns["supervisor.fault"]
        if len(ended) != program.cycle_count or ended.any():
            what = "its run ends in a fault, and a page has no supervisor; `pcpc simulate` shows it"
            raise rig.error("controller", what)
        offset = sum(map(len, self._modules))
        self._modules.append(module)
        self.about["controllers"].append(
            {
                "name": rig.config.controller,
                "module": [offset, len(module)],
                "cycles": program.cycle_count,
                "digest": digest(program, log),
                "columns": {role: _columns(program, role) for role in program.nodes},
                "values": [one for role in program.nodes for one in _values(program, role)],
                "judge": judge_data(rig, self.about["settings"]),
                "log": self._log(rig),
                "drawing": self._drawing(rig),
                "seed": rig.config.seed,
                "seeds": _seeds(rig, program, self.about["settings"]),
            }
        )

    def _drawing(self, rig: Rig) -> Any:
        """Return the plant's drawing, or why there is none."""
        try:
            made = drawing_of(rig)
            found = scene_data(made, settings_of(rig)) if made else {"why": "the rig has none"}
        except (DrawingError, Unrecordable) as error:
            found = {"why": str(error)}
            if (told := {"name": "the drawing", **found}) not in self.about["absent"]:
                self.about["absent"].append(told)
        return self._part(found)

    def _log(self, rig: Rig) -> dict[str, Any]:
        """Return what a page needs to write a log, or why it writes none."""
        try:
            return self._shared_head(log_head(rig))
        except Untranslatable as error:
            return {"why": str(error)}

    def _shared_head(self, head: dict[str, Any]) -> dict[str, Any]:
        """Return a log's head with what several controllers have as places in `parts`."""
        whole = json.dumps(head).replace(head["wall_ns"], WALL_NS)
        return {key: self._part(value) for key, value in json.loads(whole).items()}

    def _part(self, value: Any) -> Any:
        """Return a value, longer ones as {"part": place}."""
        if isinstance(value, list):
            return [self._part(one) for one in value]
        text = json.dumps(value)
        if len(text) < SHORT:
            return value
        place = self._places.setdefault(text, len(self._places))
        if place == len(self.about["parts"]):
            self.about["parts"].append(value)
        return {"part": place}

    def leave_out(self, controller: str, error: UserError) -> None:
        """Note why a controller is not there."""
        self.about["absent"].append({"name": controller, "why": str(error)})

    def payload(self) -> str:
        """Return all of it."""
        text = json.dumps(self.about, separators=(",", ":"), allow_nan=False).encode()
        whole = len(text).to_bytes(4, "little") + text + b"".join(self._modules)
        wide = zstandard.ZstdCompressionParameters.from_level(
            19, window_log=WINDOW, enable_ldm=True
        )
        packed = zstandard.ZstdCompressor(compression_params=wide).compress(whole)
        return base64.b64encode(hashlib.sha256(packed).digest() + packed).decode()


def contents(
    path: Path, name: str, only: str | None, settings: list[str], say: Callable[[str], None]
) -> Contents:
    """Return what a page of a rig holds; RigError, UserError: no controller of it can be there."""
    rig = load_rig(path, only, settings)
    made = Contents(rig, name, settings)
    first = rig.config.controller
    names = [only] if only else [first, *(one for one in rig.config.controllers if one != first)]
    begin_s = time.monotonic()
    for number, controller in enumerate(names):
        left_s = (time.monotonic() - begin_s) / max(number, 1) * (len(names) - number)
        left = f", about {left_s:.0f} s left" if number else ""
        say(f"{controller}, {number + 1} of {len(names)}{left}")
        try:
            made.add(load_rig(path, controller, settings))
        except (RigError, Untranslatable) as error:
            if controller in (only, first):
                raise
            made.leave_out(controller, error)
    return made


def digest(program: Program, log: Log) -> str:
    """Return the digest of a whole run, as `pcpc simulate --digest` prints it."""
    names: dict[str, list[str]] = {
        str(role): [one.name for one in rows if one.digested] for role, rows in program.rows.items()
    }
    return digest_of(log, names, program.cycle_count)


def _columns(program: Program, role: Role) -> list[list[Any]]:
    """Return name, unit, meaning, 1: digested + 2: must be finite, and kind of each column."""
    table = program.nodes[role].plan.table
    found = []
    for one in program.rows[role]:
        variable = table.variables[table.index[one.name]]
        flags = one.digested + 2 * one.finite
        found.append([one.name, variable.unit, variable.help, flags, variable.kind])
    return found


def _values(program: Program, role: Role) -> list[dict[str, Any]]:
    """Return the parameters of a node that can be changed in a page."""
    made = program.nodes[role].plan
    specs = {spec.name: spec for spec in made.spec.blocks}
    found = []
    for i, name in enumerate(program.places[role]):
        place = made.table.index[name]
        variable = made.table.variables[place]
        if variable.kind != "parameter" or not math.isfinite(variable.high - variable.low):
            continue
        found.append(
            {
                "node": role,
                "at": i,
                "name": name,
                "unit": variable.unit,
                "help": variable.help,
                "low": variable.low,
                "high": variable.high,
                "value": made.values.get(place, 0.0),
                "set": _is_setting(specs[variable.writer], name),
            }
        )
    return found


def _is_setting(spec: BlockSpec, name: str) -> bool:
    """Return whether `--set` gives a parameter the very value that the block takes."""
    return spec.block.prepare is None and name.partition(".")[2] in spec.settings


def _seeds(
    rig: Rig, program: Program, settings: list[str]
) -> dict[str, list[tuple[int, int, float]]]:
    """Return what begins otherwise with another seed: node, place, value."""
    found: dict[str, list[tuple[int, int, float]]] = {}
    for seed in range(rig.config.seed + 1, rig.config.seed + 1 + SEEDS):
        again = load_rig(rig.path, rig.config.controller, [*settings, f"seed={seed}"])
        differ = list[tuple[int, int, float]]()
        for number, role in enumerate(program.nodes):
            old, new = program.nodes[role].plan, plan(again, role, "lockstep")
            for i, name in enumerate(program.places[role]):
                place = old.table.index[name]
                if new.values.get(place, 0.0) != old.values.get(place, 0.0):
                    differ.append((number, i, new.values.get(place, 0.0)))
        if differ:
            found[str(seed)] = differ
    return found


def _layout(rig: Rig) -> Mapping[str, Any] | None:
    """Return the panels beside a rig's evaluation or drawing, None without."""
    beside = [Path(rig.evaluation.file)] if rig.evaluation else []
    for file in (*beside, *([rig.drawing] if rig.drawing else [])):
        try:
            found: Mapping[str, Any] = json.loads(file.with_name(LAYOUT).read_text("utf-8"))
            return found
        except (OSError, ValueError):
            continue
    return None
