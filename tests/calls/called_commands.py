"""The commands of which calls fail, what they need, and what may be wrong with how one ended."""

import json
import re
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from pcpc.drivers.errors import Exit
from pcpc.executive.log import reader as logs
from pcpc.executive.nodes import process
from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.after.run_digest import run_digest
from pcpc.tools.cli.commands import COMMANDS as COMMANDS_OF_PCPC
from tests.calls import failing_calls as calls
from tests.free_bus import own_bus

_VOLATILE = (
    "bus", "bound", "rig_git", "timing_us", "timing_level", "timing_share", "latest_cycles",
    "start_to_first_cycle_s",
)  # fmt: skip
_NO_FAILURES = ("Traceback", "Exception ignored", "Fatal Python error", "During handling")
_SPEED = re.compile(r"[0-9,.]+ x\s+real\s+time")
_LAST_WORDS = 3  # cycles from the first fault of a run to the first that a node records of its own
_FIRST_S = 600.0  # it may compile


@dataclass(frozen=True)
class Command:
    """Words after `pcpc`, in a folder with what `prepare` makes.

    `same`: its files never vary; `says`: nor does what it prints.
    """

    words: str
    same: bool = True
    says: bool = False


BUS = "--bus {bus} --no-figure --quiet"
COMMANDS = {
    "simulate": Command("simulate {base}/motor -o out --no-figure --quiet"),
    "tree": Command("simulate {base}/tree -o out --no-figure --quiet"),
    "lockstep": Command("run {base}/motor -o out --pacing lockstep " + BUS),
    "real": Command("run {base}/motor -o out --pacing real " + BUS, same=False),
    "bare": Command("run {base}/bare -o out --pacing real " + BUS, same=False),
    "replay": Command("replay {base}/run --quiet", says=True),
    "export": Command("log export {base}/run/log.mcap -o out.csv --quiet"),
    "import": Command("log import {base}/frames.log --dbc {base}/motor/motor.dbc -o out.mcap"),
    "play": Command("play {base}/run/log.mcap --bus {bus} --quiet"),
    "sweep": Command("sweep {base}/motor --vary motor.coulomb_Nm=x0.9:1.1 --draws 4 -o out"),
    "figure": Command("simulate {base}/motor -o out --quiet"),
}


def prepare(base: Path) -> None:
    """Make in the new folder `base` what the commands need."""
    base.mkdir()
    for number, words in enumerate((
        f"new {base}/motor",
        f"simulate {base}/motor -o {base}/run --no-figure",
        f"log export {base}/run/log.mcap -o {base}/frames.log",
    )):  # fmt: skip
        done = calls.run(words.split(), base / f"made{number}", None, "", _FIRST_S)
        assert done.code == 0, done
    shutil.copytree(base / "motor", base / "tree")  # a work tree, which git is asked about
    subprocess.run(["git", "init", "--quiet", str(base / "tree")], check=True)
    shutil.copytree(base / "motor", base / "bare")  # the same without counters and CRCs
    dbc = base / "bare" / "motor.dbc"
    text = re.sub(r"SG_ (counter|crc) : (?!8\|)", r"SG_ un\1 : ", dbc.read_text())
    dbc.write_text(re.sub(r"SG_ (160|288) (counter|crc)", r"SG_ \1 un\2", text))
    for command in COMMANDS_OF_PCPC.values():
        for one in command.parts or (command,):
            import_module(f"pcpc.tools.{one.module}")
    in_memory(load_rig(str(base / "motor" / "rig.yaml"), None, ("duration_s=0.001",)))
    process.load_code()


@dataclass(frozen=True)
class Judge:
    """What a command came to when no call failed: what may be wrong with another end of it."""

    words: Sequence[str]
    folder: Path
    same: bool  # whether its files are the same each time
    counts: Mapping[tuple[str, str], int]  # of calls by process and function
    limit_s: float = 60.0
    said: str | None = None  # what it prints each time, where that never varies

    @classmethod
    def of(cls, name: str, base: Path) -> "Judge":
        """Run a command of COMMANDS as it is."""
        words = COMMANDS[name].words.format(base=base, bus=own_bus()).split()
        folder = base.parent / name
        ended = calls.run(words, folder, None, "", _FIRST_S)
        same, limit_s = COMMANDS[name].same, max(20.0, 10.0 * ended.seconds)
        said = _SPEED.sub("", ended.out) if COMMANDS[name].says else None
        judge = cls(words, folder, same, ended.counts, limit_s, said)
        assert not judge.wrong(ended, folder), ended
        assert ended.code == 0 or not judge.same, ended  # what keeps time may be late
        return judge

    @property
    def files(self) -> set[str]:
        """Names of the files that the command made."""
        return _files(self.folder)

    def run(self, folder: Path, site: calls.Site, how: str) -> calls.Ended:
        """Run it with a call that fails."""
        return calls.run(self.words, folder, site, how, self.limit_s)

    def wrong(self, ended: calls.Ended, folder: Path) -> list[str]:
        """Return what a command may not do and did."""
        found = [f"left {one} running" for one in ended.left]
        found += [f"left {one}" for one in sorted(_files(folder) - self.files)]
        found += [f"a {word}" for word in _NO_FAILURES if word in ended.err + ended.out]
        if ended.code is None:
            found.append("a hang")
        elif ended.code not in [*Exit]:
            found.append(f"exit code {ended.code}")
        elif ended.code and not (ended.err + ended.out).strip():
            found.append(f"exit code {ended.code} without a word")
        said = _SPEED.sub("", ended.out)
        if ended.code == 0 and self.said not in (None, said):
            found.append(f"false ok: {said}")
        return found + self._false(ended.code == 0, folder)

    def _false(self, ok: bool, folder: Path) -> list[str]:
        """Return what is missing or not true in the files, of which `ok` says that they are."""
        if ok and (lacking := self.files - _files(folder)):
            return [f"false ok: no {one}" for one in sorted(lacking)]
        found = []
        for name in self.files & _files(folder):
            true, file = self.folder / name, folder / name
            if name.endswith(".mcap"):
                found += self._false_log(ok, true, file)
            elif self.same and ok and _content(true) != _content(file):
                found.append(f"false ok: {name} is another one")
        return found

    def _false_log(self, ok: bool, true: Path, file: Path) -> list[str]:
        try:
            whole, log = logs.read(true), logs.read(file)
        except logs.LogError as error:
            return [f"false ok: {error}"] if ok else []
        if ok and log.missing:
            return [f"false ok: {log.missing[0]}"]
        if ok and (lost := lost_frames(log)):
            return [f"false ok: {one}" for one in lost]
        if ok and self.same and run_digest(whole) != run_digest(log):
            return ["false ok: other bits"]
        return _other_rows(whole, log) if self.same else []


def lost_frames(log: logs.Log) -> list[str]:
    """Return the frames of which a node did not get one, between two that it got."""
    found = []
    for role, node in log.node.items():
        for other in (one for name, one in log.node.items() if name != role):
            for word in np.unique(node.frames["id"]):
                sent, came = (_data_of(one, word, way) for one, way in ((node, 0), (other, 1)))
                if len(sent) and not any(
                    sent[i : i + len(came)] == came for i in range(len(sent) - len(came) + 1)
                ):
                    found.append(f"{role} sent {len(sent)} of {word:X}, {len(came)} came")
    return found


def _data_of(node: logs.NodeLog, word: int, direction: int) -> list[bytes]:
    frames = node.frames
    chosen = (frames["id"] == word) & (frames["direction"] == direction)
    return [row.tobytes() for row in frames["data"][chosen]]


def _other_rows(whole: logs.Log, log: logs.Log) -> list[str]:
    """Return the columns of a cut log that have other bits in a cycle before a fault."""
    found, nodes = [], [(role, node) for role, node in log.node.items() if len(node.cycle)]
    states = [(node, node.columns.get("supervisor.fault")) for _, node in nodes]
    faulted = [node.cycle[state != 0.0] for node, state in states if state is not None]
    end = min((int(cycles[0]) for cycles in faulted if len(cycles)), default=1 << 62)
    for role, node in nodes:
        true, rows = whole.node[role], node.cycle < end - _LAST_WORDS
        at = np.searchsorted(true.cycle, node.cycle[rows]).clip(0, len(true.cycle) - 1)
        for name, values in node.columns.items():
            if not np.array_equal(values[rows], true.columns[name][at], equal_nan=True):
                found.append(f"another {role}:{name} in a cut log")
    return found


def _files(folder: Path) -> set[str]:
    return {str(one.relative_to(folder)) for one in folder.rglob("*") if one.is_file()}


def _content(file: Path) -> Any:
    """Return what has to be equal of a file."""
    if file.suffix == ".json":
        found = json.loads(file.read_text())
        return {key: value for key, value in found.items() if key not in _VOLATILE}
    return file.read_bytes()
