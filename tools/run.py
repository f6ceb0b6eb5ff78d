"""`pcpc run`, `exec`, `plant`, `simulate`: from a rig file to a run folder with a verdict.

The host starts the real-time processes and the recorder, shows progress from the shared blocks,
ends all of them in order, and then reads the log back: what the summary says is what the log holds.
"""

import argparse
import signal
import sys
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from drivers import bus as buses
from drivers.compile_cache import cache_folder
from drivers.errors import BusError
from executive import shared as sh
from executive.errors import RigError
from executive.rig import Rig, load_rig
from tools import summary as summaries
from tools.children import Child
from tools.progress import Progress

USAGE, NO_ENVIRONMENT = 2, 4
_POLL_S = 0.02
_END_S = 3.0  # the other node notices the end of the run by itself within this
_LOG = "log.mcap"


class Host:
    """One run on a bus: its processes, from start to summary."""

    def __init__(
        self, options: argparse.Namespace, rig: Rig, roles: tuple[str, ...], folder: Path
    ) -> None:
        self.options, self.rig, self.roles, self.folder = options, rig, roles, folder
        configured = rig.config.bus
        channel = None if configured.channel is None else str(configured.channel)
        named = (configured.interface, channel) if options.bus is None else buses.parse(options.bus)
        self.bus = buses.choose(*named)
        self.pacing = options.pacing or rig.config.pacing
        self.progress = Progress(options.quiet)
        self.outcome = summaries.Outcome(self.pacing, str(self.bus), changed=changed(options))
        self.children: dict[str, Child] = {}
        self.blocks: dict[str, sh.Shared] = {}
        self.started_s = time.monotonic()

    def run(self) -> int:
        """Start, watch and end the processes; return an exit code if nothing was run, else -1."""
        self._greet()
        for role in self.roles:
            module = "plants.emulator" if role == "plant" else "executive.process"
            role_word = [] if role == "plant" else ["executive"]
            arguments = [*role_word, *_child_arguments(self.options, str(self.bus))]
            self.children[role] = Child(role, module, arguments, not self.bus.compiled)
        signal.signal(signal.SIGINT, self._interrupt)
        signal.signal(signal.SIGTERM, self._interrupt)
        try:
            self._watch()
        finally:
            self._end()
            self.progress.close()
        for child in self.children.values():
            for line in child.complaint():
                print(line, file=sys.stderr)
        refused = [c.code for c in self.children.values() if c.code in (USAGE, NO_ENVIRONMENT)]
        return refused[0] if refused else -1

    def _greet(self) -> None:
        self.progress.say(f"{self.rig.config.rig} on {self.bus}, pacing {self.pacing}")
        if not self.bus.compiled:
            self.progress.say(
                f"{self.bus.interface}: through python-can in the interpreted loop, 10 to 50 times "
                "slower a frame; expect late cycles above 200 Hz"
            )
        if not cache_folder().exists():
            self.progress.say("first start: compiling for this machine, about half a minute")

    def _interrupt(self, number: int, frame: Any) -> None:
        self.outcome.interrupted = True
        for role in ("executive", *self.roles):
            if role in self.children:
                self.children[role].ask()
                break

    def _watch(self) -> None:
        """Attach to what appears, start the recorder, show progress, until a node ends."""
        while not any(child.ended for child in self.children.values()):
            for role in self.roles:
                if role not in self.blocks:
                    self._attach(role, sh.block_name(self.rig.config.rig, str(self.bus), role))
            self._start_recorder()
            if self.progress.due():
                self.progress.show(self._state())
            time.sleep(_POLL_S)

    def _attach(self, role: str, name: str) -> None:
        try:
            block = sh.attach(name)
        except (sh.SharedError, ValueError):
            return
        if int(block["control"][sh.PID]) == self.children[role].process.pid:
            self.blocks[role] = block

    def _start_recorder(self) -> None:
        if "recorder" in self.children or "executive" not in self.blocks:
            return
        names = [
            sh.block_name(self.rig.config.rig, str(self.bus), role)
            for role in ("executive", "plant")
        ]
        self.children["recorder"] = Child(
            "recorder", "executive.recorder", [str(self.folder / _LOG), *names]
        )

    def _state(self) -> str:
        """Return the progress line from the leading node's block."""
        role = "executive" if "executive" in self.roles else self.roles[0]
        waited = time.monotonic() - self.started_s
        block = self.blocks.get(role)
        if block is None or not block["control"][sh.READY]:
            return f"starting, {waited:.0f} s"
        control = block["control"]
        if not control[sh.PASSES]:
            return f"waiting for the other node on {self.bus}, {waited:.0f} s"
        if self.outcome.start_s is None:
            self.outcome.start_s = round(waited, 2)
        done, late = int(control[sh.CYCLE]) + 1, int(control[sh.LATE])
        total = f"/{block.description['cycles']}" if role == "executive" else ""
        rate = _rate_hz(block)
        state = block.description["state_names"][int(control[sh.STATE])]
        return f"{state:5} cycle {done}{total}  {rate:.0f} Hz{self._watched(block)}  late {late}"

    def _watched(self, block: sh.Shared) -> str:
        name = block.description["watch"]
        names = [v[0] for v in block.description["variables"]]
        if name not in names:
            return ""
        value = sh.snapshot(block)[names.index(name)]
        return f"  {name} {value:+.6f}"

    def _end(self) -> None:
        """Let the nodes end by themselves, then ask; then the recorder, which drains the rings."""
        lost = self.children.get("recorder")
        if (
            lost is not None
            and lost.ended
            and not all(b["control"][sh.DONE] for b in self.blocks.values())
        ):
            self.outcome.faults.append("the recorder ended before the nodes")
        nodes = [self.children[role] for role in self.roles]
        patience = _END_S
        if any(child.ended and child.code not in (0, 5) for child in nodes) or self.outcome.faults:
            patience = 0.2  # one never came up, or died: the others need not wait
        for child in nodes:
            child.end(patience)
        if lost is not None:
            lost.end(30.0)
        for role, block in self.blocks.items():
            self._judge(role, block)
            block.unlink()

    def _judge(self, role: str, block: sh.Shared) -> None:
        """Note a node's fault or death, and what its rings dropped."""
        control = block["control"]
        child = self.children[role]
        if control[sh.FAULT]:
            reason = block.description["fault_names"][int(control[sh.FAULT])]
            self.outcome.faults.append(f"{role}: {reason}, cycle {int(control[sh.CYCLE])}")
        elif child.code < 0:
            name = signal.Signals(-child.code).name
            self.outcome.faults.append(f"{role}: ended by {name} in cycle {int(control[sh.CYCLE])}")
        self.outcome.dropped += sum(
            int(block[f"{ring}_ends"][sh.DROPPED]) for ring in ("record", "frame", "event")
        )
        if role == "executive" or self.outcome.realtime is None:
            self.outcome.realtime = bool(control[sh.REALTIME])


def _rate_hz(block: sh.Shared) -> float:
    """Return the mean rate over the newest thousand records."""
    ends, rows = block["record_ends"], block["record"]
    put = int(ends[sh.PUT])
    count = min(put - 1, 1000)
    if count < 1:
        return 0.0
    stamps = [int(rows[(put - 1 - back) % len(rows), 1]) for back in (0, count)]
    return 1e9 * count / max(stamps[0] - stamps[1], 1)


def _child_arguments(options: argparse.Namespace, bus: str) -> list[str]:
    arguments = [options.rig, "--with-parent", "--bus", bus]
    if options.pacing:
        arguments += ["--pacing", options.pacing]
    if options.controller:
        arguments += ["--controller", options.controller]
    for setting in options.set:
        arguments += ["--set", setting]
    return arguments


def changed(options: argparse.Namespace) -> bool:
    """Return True if an option changes what the rig's expectations are about."""
    return any(setting.partition("=")[0] != "seed" for setting in options.set)


def run_folder(options: argparse.Namespace, rig: Rig) -> Path:
    """Make and return the run's folder; RigError if it holds a log already or cannot be made."""
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    folder = Path(options.output or Path("runs") / f"{stamp}-{rig.config.rig}")
    if (folder / _LOG).exists():
        raise RigError(
            f"{folder}: holds a log already; choose another folder with -o, or remove it"
        )
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RigError(f"{folder}: {error.strerror}; choose another folder with -o") from None
    return folder


def on_bus(options: argparse.Namespace, roles: tuple[str, ...]) -> int:
    """Run `roles` of a rig on a bus and sum up; return the exit code."""
    rig = load_rig(options.rig, options.controller, options.set, resolve=False)
    if "executive" not in roles:
        return plant_alone(options, rig)
    folder = run_folder(options, rig)
    host = Host(options, rig, roles, folder)
    code = host.run()
    if code >= 0:
        _remove_if_empty(folder)
        return code
    if not (folder / _LOG).exists():
        return summaries.CODES["interrupted" if host.outcome.interrupted else "safety stop"]
    return conclude(rig, folder, host.outcome, options)


def plant_alone(options: argparse.Namespace, rig: Rig) -> int:
    """Run the emulator for an executive elsewhere, which keeps the log; return the exit code."""
    host = Host(options, rig, ("plant",), Path())
    code = host.run()
    for line in host.outcome.faults:
        print(line, file=sys.stderr)
    if host.outcome.interrupted:
        return summaries.CODES["interrupted"]
    return code if code >= 0 else summaries.CODES["safety stop" if host.outcome.faults else "ok"]


def _remove_if_empty(folder: Path) -> None:
    if not any(folder.iterdir()):
        folder.rmdir()


def simulate(options: argparse.Namespace) -> int:
    """Run a rig in virtual time and sum up; return the exit code."""
    from executive.virtual import VirtualRun

    rig = load_rig(options.rig, options.controller, options.set)
    folder = run_folder(options, rig)
    progress = Progress(options.quiet)
    outcome = summaries.Outcome("virtual", "memory", changed=changed(options))
    run = VirtualRun(rig, folder / _LOG)

    def interrupt(number: int, frame: Any) -> None:
        outcome.interrupted = True
        run.stop()

    signal.signal(signal.SIGINT, interrupt)
    begin, total = time.monotonic(), run.blocks[0].description["cycles"]
    for cycles in run.advance():
        speed = cycles / rig.config.rate_hz / max(time.monotonic() - begin, 1e-9)
        progress.show(f"cycle {cycles}/{total}, {speed:.0f} x real time")
    run.close()
    progress.close()
    for role, block in zip(("executive", "plant"), run.blocks, strict=True):
        if block["control"][sh.FAULT]:
            reason = block.description["fault_names"][int(block["control"][sh.FAULT])]
            outcome.faults.append(f"{role}: {reason}, cycle {int(block['control'][sh.CYCLE])}")
    return conclude(rig, folder, outcome, options)


def conclude(
    rig: Rig, folder: Path, outcome: summaries.Outcome, options: argparse.Namespace
) -> int:
    """Read the log back, write summary and figure, print; return the exit code of the verdict."""
    from executive import logs

    log = logs.read(folder / _LOG)
    summary = summaries.summarise(rig, log, outcome)
    text = summaries.write_json(summary, folder / "summary.json")
    reason = (
        ""
        if options.no_figure
        else summaries.draw(rig, log, summary["metrics"], folder / "figure.png")
    )
    if reason:
        print(f"no figure: {reason}", file=sys.stderr)
    if options.json:
        print(text)
    else:
        summaries.show(summary, folder)
    return summaries.CODES[summary["verdict"]]


def command(options: argparse.Namespace) -> int:
    """Carry out `run`, `exec`, `plant` or `simulate`; print errors in one line."""
    roles = {"run": ("plant", "executive"), "exec": ("executive",), "plant": ("plant",)}
    try:
        if options.command == "simulate":
            return simulate(options)
        return on_bus(options, roles[options.command])
    except RigError as error:
        print(error, file=sys.stderr)
        return USAGE
    except (BusError, sh.SharedError) as error:
        print(error, file=sys.stderr)
        return NO_ENVIRONMENT
