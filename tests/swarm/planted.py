"""Faults planted in the product, one at a time, and what `pcpc swarm` makes of them.

`python -m tests.swarm.planted [NAME]... [--for S]`, from the root: each is tried
until a promise is broken that the same seed keeps without it, or so long (600 s of a processor). A
line of JSON each. What a promise's own test plants is another one. Exit code 1: more than two were
not found.
"""

import argparse
import gc
import importlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

from pcpc.tools.study.swarm.cli import checked
from pcpc.tools.study.swarm.draws import world_of

ROOT = Path(__file__).resolve().parents[2]
_LOOP, _AFTER = "executive/loop", "tools/after"
PLANTED: dict[str, tuple[str, str, str]] = {  # file, what stands there, what stands there instead
    "recorder: the last row of each drain": (
        "executive/log/recorder.py", "rows[start : start + count])\n                self.counts",
        "rows[start : start + max(count - 1, 1)])\n                self.counts"),
    "recorder: a keyframe a cycle late": (
        "executive/log/keyframes.py", "yield frame.stamp_ns, frame.cycle, entry",
        "yield frame.stamp_ns, frame.cycle + 1, entry"),
    "recorder: a tuning in single precision": (
        "executive/log/event_entries.py", 'return "tunings", {"name": variables[argument][0], ',
        'value = float(f"{number:.7g}")\n'
        '        return "tunings", {"name": variables[argument][0], '),
    "replay: refused requests are compared": (
        "executive/nodes/planned_keyframes.py", "and variables[i].name not in _REFUSALS", ""),
    "lanes: the first tuning": (
        "executive/batch/group.py", "seat.n.tuning.done = 0",
        "seat.n.tuning.done = min(seat.n.tuning.n, 1)"),
    "branch: what a client asked": (
        f"{_AFTER}/branch/branching.py", "if name in index and cycle > node.last:",
        "if name in index and cycle > node.last and cycle in "
        "[one[0] for one in node.replay.plan.schedule]:"),
    "judge: another sender is no loss": (
        f"{_AFTER}/verdict/frames.py", 'if counts["foreign"]:', 'if counts["foreign"] > 5:'),
    "keyframe: a robot's drive is left out": (
        "executive/nodes/planned_keyframes.py",
        'profile == planned_drive.CIA402', "profile"),
    "plan: slow frames a cycle later": (
        "drivers/can/frames.py", "max(1, round(self.cycle_ms * rate_hz / 1000))",
        "max(1, int(self.cycle_ms > 1) + round(self.cycle_ms * rate_hz / 1000))"),
    "keyframe: a record is left out": (
        "executive/nodes/planned_keyframes.py", "in KEPT.items()",
        'in [one for one in KEPT.items() if one[0] != "guard"]'),
    "reader: a damaged record is not told": (
        "executive/log/mcap_reader.py",
        'scanned.add_note(f"{what} at byte {place} is damaged ({error}); {lost}")', "pass"),
    "reader: a cut end is not told": (
        "executive/log/mcap_reader.py", "    if not summary:\n        why = _GOES_ON",
        "    if False:\n        why = _GOES_ON"),
    "long log: the last row of a part": (
        "executive/log/long_logs.py", "end = min(begin + self.part_cycles, count)",
        "end = min(begin + self.part_cycles, count - 1)"),
    "replay: tunings of a slice's last cycle": (
        "executive/nodes/slices.py",
        "tunings = [t for t in self._tunings if t[0] <= last]\n"
        "            self._tunings = [t for t in self._tunings if t[0] > last]",
        "tunings = [t for t in self._tunings if t[0] < last]\n"
        "            self._tunings = [t for t in self._tunings if t[0] >= last]"),
    "replay: frames of a slice's last cycle": (
        "executive/nodes/slices.py", '"cycle"], last, side="right"', '"cycle"], last, side="left"'),
    "replay: no ramp at the end": (
        "executive/nodes/replay.py", "(gain < before) & (state < State.FAULT)", "gain < 0.0"),
    "replay: frames lost on purpose come again": (
        "executive/nodes/replay.py", 'are_of_wire(part.frames["e2e"])',
        'part.frames["e2e"] < 255'),
    "branch: a tuning in its first cycle": (
        f"{_AFTER}/branch/branching.py", "if name in index and cycle > node.last:",
        "if name in index and cycle > node.last + 1:"),
    "branch: what the nodes below sent last": (
        f"{_AFTER}/branch/branching.py", "into.inbox_put += 1", "into.inbox_put += 0"),
    "branch: the next tuning alone": (
        f"{_AFTER}/branch/branching.py", "loop.tuning.n, loop.tuning.done = len(later), 0",
        "loop.tuning.n, loop.tuning.done = min(len(later), 1), 0"),
    "lanes: the last lane begins elsewhere": (
        "executive/batch/group.py", "seat.values[:] = self._begin[role][:, None]",
        "seat.values[:] = self._begin[role][:, None]; seat.values[:, 7] *= 1.0 + 1e-12"),
    "lanes: limits of commands": (
        "executive/batch/cycle.py", "def clamp(value: Lane, low: Lane, high: Lane) -> Lane:",
        "def clamp(value: Lane, low: Lane, high: Lane) -> Lane:\n    high = high * 0.9\n    _ = 0"),
    "judge: repeated frames are no loss": (
        f"{_AFTER}/verdict/frames.py", "if counts[name] > getattr(limits, key)",
        'if counts[name] > getattr(limits, key) and name != "repeated"'),
    "judge: a repeated frame counts as used": (
        f"{_AFTER}/verdict/frames.py", 'STATES.get(state, "unread")',
        'STATES.get(state * (state != 2), "unread")'),
    "judge: silence is no fault": (
        f"{_AFTER}/verdict/outcome.py", "if block is not None and block.control.fault:",
        "if block is not None and block.control.fault > 1:"),
    "judge: an end before its time is none": (
        f"{_AFTER}/verdict/requirements.py", "(cycles - 1 - last) * period_s > END_S * clocked",
        "False"),
    "judge: a requirement is half a unit wider": (
        f"{_AFTER}/verdict/monitors.py", "np.where(forced, holds.margin(rows), math.inf)",
        "np.where(forced, holds.margin(rows) + 0.5, math.inf)"),
    "supervisor: holds one cycle longer": (
        "executive/nodes/planned_supervisor.py", "guard.fault_after = wanted.fault_after_cycles",
        "guard.fault_after = wanted.fault_after_cycles + 1"),
    "supervisor: a ramp of twice the time": (
        "executive/nodes/planned_supervisor.py", "guard.ramp_step = period_s / wanted.ramp_s",
        "guard.ramp_step = 0.5 * period_s / wanted.ramp_s"),
    "plan: a rate limit in rad, not in turns": (
        "executive/nodes/planned_commands.py", "else limit.rate_per_s * period_s",
        "else limit.rate_per_s * period_s * 6.28"),
    "plan: plausible a tenth beyond": (
        "executive/nodes/planned_plausible.py", "these.bounds[i] = limit.low, limit.high, rate",
        "these.bounds[i] = limit.low, 1.1 * limit.high, rate"),
    "codec: the sign of a big-endian signal": (
        "drivers/can/dbc.py", "if extends else 0, signal.kind, place",
        "if extends and not signal.big_endian else 0, signal.kind, place"),
    "codec: another layout's signals": (
        "drivers/can/dbc.py", "0 if signal.layout is None else 1 + signal.layout,", "0,"),
    "loop: a tuning a cycle late": (
        f"{_LOOP}/tuning.py", "tuning.schedule[tuning.done].cycle <= n.k",
        "tuning.schedule[tuning.done].cycle < n.k"),
    "loop: a command is clamped before its ramp": (
        f"{_LOOP}/limits.py", "value = min(max(wanted, table[i].low), table[i].high)",
        "value = wanted if rising else min(max(wanted, table[i].low), table[i].high)"),
    "loop: a fault forgets its ramp": (
        f"{_LOOP}/supervisor.py", "guard.gain = max(guard.gain - guard.pace, 0.0)",
        "guard.gain = max(guard.gain - guard.pace, 0.01)"),
    "codec: rounds to zero": (
        "drivers/can/codec.py", "size = (size + _TWO_52) - _TWO_52",
        "size = (size - 0.4 + _TWO_52) - _TWO_52"),
    "protection: a repeated frame is used": (
        "drivers/can/e2e.py", "    if delta == 0:\n", "    if delta == 0 and before == 3:\n"),
    "protection: the CRC of 16 bits leaves a byte out": (
        "drivers/can/e2e.py", "if i < crc_byte or i > crc_byte + 1:",
        "if i < crc_byte or i > crc_byte + 2:"),
    "protection: five frames may be lost": (
        "drivers/can/e2e.py", "MAX_DELTA = 4 ", "MAX_DELTA = 5 "),
    "reception: the second frame of a cycle": (
        f"{_LOOP}/reception.py", "    if has_doubts(n, row):\n        take_values(n, row, new)",
        "    if not new:\n        pass\n    elif has_doubts(n, row):\n"
        "        take_values(n, row, new)"),
}  # fmt: skip
_COMPILED = (_LOOP, "drivers/can/codec", "drivers/can/e2e", "executive/batch/cycle")  # anew
_KEEPING = ("pcpc.executive.nodes", "pcpc.executive.log", "pcpc.tools")  # rooms, results of calls
_CACHED = type(cache(lambda: None))


def main() -> int:
    """Try those that are named, or all; the others of the loop, which is compiled anew, last."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="how names begin")
    parser.add_argument("--for", type=float, default=600.0, dest="for_s", metavar="S")
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    names = [one for one in PLANTED if not asked.names or one.startswith(tuple(asked.names))]
    for seed in range(asked.seed, asked.seed + 4):  # what is compiled once
        checked(world_of(seed))
    found = [_is_found(name, asked.for_s, asked.seed) for name in sorted(names, key=_is_compiled)]
    return int(found.count(False) > 2)


def _is_found(name: str, for_s: float, seed: int) -> bool:
    """Try a fault in a child; print what became; a seed that is broken without it is passed."""
    with tempfile.TemporaryDirectory(prefix="pcpc-planted-") as folder:
        told: dict[str, Any] = {"seeds": 0, "cycles": 0, "spent_s": 0.0, "found": {}}
        while not told["found"] and told["spent_s"] < for_s:
            _in_child(name, for_s - told["spent_s"], seed + told["seeds"], Path(folder))
            row = json.loads(Path(folder, "told").read_text())
            told = {key: told[key] + row[key] for key in told if key != "found"}
            last = seed + told["seeds"] - 1
            without = checked(world_of(last), row["found"]).found if row["found"] else {}
            if without:
                print(f"seed {last} without a fault: {without}", file=sys.stderr, flush=True)
            told["found"] = {k: v for k, v in row["found"].items() if k not in without}
    print(json.dumps({"name": name, **told}), flush=True)
    return bool(told["found"])


def _is_compiled(name: str) -> bool:
    return PLANTED[name][0].startswith(_COMPILED)


def _in_child(name: str, for_s: float, seed: int, folder: Path) -> None:
    """Plant a fault in a process of its own, or in a copy, where it is compiled.

    `told` in the folder says what came.
    """
    if not _is_compiled(name):
        pid = os.fork()
        if not pid:
            plant(*PLANTED[name])
            tried(for_s, seed, folder)
            os._exit(0)
        os.waitpid(pid, 0)
        return
    for part in ("pcpc", "drivers", "executive", "plants", "tools", "tests/swarm"):
        shutil.copytree(ROOT / part, folder / part, symlinks=True, dirs_exist_ok=True)
    file, was, becomes = PLANTED[name]
    text = (ROOT / file).read_text().replace(was, becomes)
    (folder / file).write_text(text)
    call = f"tried({for_s}, {seed}, Path({str(folder)!r}))"
    words = f"from pathlib import Path; from tests.swarm.planted import tried; {call}"
    env = os.environ | {"NUMBA_CACHE_DIR": str(folder / "compiled")}
    subprocess.run([sys.executable, "-c", words], cwd=folder, check=True, env=env)


def plant(file: str, was: str, becomes: str) -> None:
    """Give the functions of a module that is not compiled the code of its changed text.

    What was kept of earlier calls is forgotten.
    """
    text, path = (ROOT / file).read_text(), str(ROOT / "pcpc" / file)
    assert text.count(was) == 1, (file, was)
    importlib.import_module(f"pcpc.{file.removesuffix('.py').replace('/', '.')}")
    module = compile(text.replace(was, becomes), path, "exec")
    new = {one.co_qualname: one for one in _codes(module)}
    for one in gc.get_objects():
        if isinstance(one, FunctionType) and one.__code__.co_filename == path:
            one.__code__ = new[one.__code__.co_qualname]
        elif isinstance(one, _CACHED) and one.__module__.startswith(_KEEPING):
            one.cache_clear()


def _codes(code: CodeType) -> Iterator[CodeType]:
    for one in code.co_consts:
        if isinstance(one, CodeType):
            yield one
            yield from _codes(one)


def tried(for_s: float, seed: int, folder: Path) -> None:
    """Check seed after seed until one breaks a promise; write what became, not of compiling."""
    checked(world_of(seed))
    begin_s, count, cycles, found = time.process_time(), 0, 0, dict[str, list[str]]()
    while not found and time.process_time() - begin_s < for_s:
        row = checked(world_of(seed + count))
        count, cycles, found = count + 1, cycles + row.cycles, row.found
    lines_of = {promise: lines[0][:160] for promise, lines in found.items()}
    spent_s = round(time.process_time() - begin_s, 1)
    told = {"seeds": count, "cycles": cycles, "spent_s": spent_s, "found": lines_of}
    (folder / "told").write_text(json.dumps(told))


if __name__ == "__main__":
    sys.exit(main())
