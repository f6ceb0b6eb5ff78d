"""`pcpc run`: from a rig file to a run folder with a verdict.

The host has loaded what the real-time processes need before it forks them, so that they need not;
what judges the run it loads while they set themselves up. It starts the recorder, shows progress
from the shared blocks, ends all of them in order, and then reads the log back: what the summary
says is what the log holds.
"""

import contextlib
import json
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pcpc.drivers.compiled import compile_cache
from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.log import long_logs, recorder
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop import sharing
from pcpc.executive.loop.alarms import Alarms
from pcpc.executive.nodes import process
from pcpc.executive.nodes.live import Live
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.executive.rig.roles import Role
from pcpc.tools.after.verdict.outcome import Outcome, changed_settings, follows
from pcpc.tools.run.child_words import check_only, child_arguments, chosen_nodes, was_told_to_end
from pcpc.tools.run.commands import RunRequest
from pcpc.tools.run.drive_folder import folder_of_drive, of_the_master
from pcpc.tools.start import pace
from pcpc.tools.start.bus import run_line
from pcpc.tools.start.bus.traffic import warning
from pcpc.tools.start.children import Child, complain, on_request
from pcpc.tools.start.folder import LOG, run_folder
from pcpc.tools.start.interface import choose_bus
from pcpc.tools.start.page import Pages
from pcpc.tools.start.peer_wait import PeerWait
from pcpc.tools.terminal.progress import Compiling, Progress, node_line
from pcpc.tools.terminal.rooms import need_room, part_of

REFUSALS = Exit.WRONG_INPUT, Exit.ENVIRONMENT
_POLL_S = 0.02
_END_S, _SHORT_END_S = 3.0, 0.5  # the other node notices the end of the run, and its death
_ASKED_S, _UNBORN_S = 15.0, 0.5  # from asking a node to end to its death; without a cycle
_DRAIN_S, _DRIVE_END_S = 60.0, 0.05  # of the rings; the drive takes the executive's last word


class Host:
    """One run on a bus: its processes, from start to summary."""

    def __init__(
        self, request: RunRequest, rig: Rig, roles: tuple[Role, ...], folder: Path
    ) -> None:
        self.request, self.rig, self.roles, self.folder = request, rig, roles, folder
        for room in ("watchdog", "xcp"):
            if getattr(rig.config, room) is not None:
                need_room(f"live/{room}")
        self.choice = choose_bus(request.bus, rig, roles)
        self.bus = self.choice.bus
        self.pacing = request.pacing or rig.config.pacing
        self.progress, self.compiling = Progress(request.kept.quiet), Compiling()
        self.outcome = Outcome(
            self.pacing,
            str(self.bus),
            changed=changed_settings(request.set),
            strict=request.kept.judge,
            begin_ns=request.begin_ns,
        )
        self.children: dict[str, Child] = {}
        self.nodes: dict[str, Live] = {}
        self.alarms: dict[str, Alarms] = {}
        self.begin_ns, self.heard = request.begin_ns, 0  # lines of the watchdog
        self.waiting, self.wrong_rates = PeerWait(rig, roles), list[str]()
        self.leader = "executive" if "executive" in roles else roles[0]
        self.keeps_log = self.leader == "executive"
        names = {role: self._block_name(role) for role in (self.leader, *roles)}
        self.page = Pages(request.beside, names, rig, self.bus)

    @property
    def blocks(self) -> dict[str, sh.NodeMemory]:
        """The memory of each of our own nodes that has appeared."""
        return {role: node.block for role, node in self.nodes.items()}

    def run(self) -> int:
        """Start, watch and end the processes; return an exit code if one was refused, else -1."""
        self._greet()
        self.page.start()
        on_request(self._interrupt)
        try:
            if self.leader == "executive":
                if self.rig.config.bus.emulate is not None:
                    self.children["line"] = run_line.start(self.rig, self.bus, self.folder)
                if self.rig.config.watchdog is not None:
                    self.children["watchdog"] = Child.serving("watchdog", self._watchdog)
            for role in self.roles:
                self.children[role] = self._node(role)
            self._load_judge()
            self._watch()
        finally:
            self._end()
            self.choice.release()
            self.progress.close()
        if self.waiting.given_up_s:
            complain(list(self.children.values()))
            said = self.waiting.message(self.leader, str(self.bus), self.request.rig)
            print(*self.wrong_rates or [said], sep="\n", file=sys.stderr)
            return Exit.ENVIRONMENT
        refused = [c for _, c in sorted(self.children.items()) if c.code in REFUSALS]
        died = [c for c in self.children.values() if c.code < 0 or c.code == Exit.NOT_MET]
        if not all(map(was_told_to_end, died)):
            refused = []  # what others refuse for want of a node that died is no reason
        spoken = refused[:1] or list(self.children.values())
        complain([child for child in spoken if child.name != "watchdog"])
        if self.outcome.interrupted and not self._under_way():
            print("interrupted before a cycle was seen; nothing is recorded", file=sys.stderr)
            return Exit.INTERRUPTED
        return refused[0].code if refused else -1

    def _words(self, role: Role) -> list[str]:
        alone = ["--alone"] * (len(self.roles) < len(self.rig.roles))
        return [role, *child_arguments(self.request, str(self.bus)), *alone]

    def _node(self, role: Role) -> Child:
        """Start a node: as a copy of this process, where the loop is compiled."""
        arguments = self._words(role)
        if not self.bus.compiled:
            return Child.started(role, process.MODULE, arguments, interpreted=True)

        def main(words: Sequence[str]) -> int:
            compile_cache.watch.listener = None
            return process.main(words)

        process.load_code()
        return Child.fork(role, main, arguments)

    def _watchdog(self, ready: int) -> int:
        serve = part_of("live/watchdog", "serve").serve  # here, because it compiles
        compile_cache.watch.listener = None
        try:
            return int(serve(self.rig, self.bus, self.pacing, None, ready))
        except UserError as error:
            print(f"watchdog: {error}", file=sys.stderr)
            return error.code

    def _load_judge(self) -> None:
        """Load the rig's evaluation, while the nodes set themselves up; RigError ends them.

        Also tells what the rig's bus would not take in time.
        """
        try:
            from pcpc.tools.after.verdict.judge import Judge, columns_to_keep  # time

            if said := warning(self.rig, self.pacing):
                print(said, file=sys.stderr)
            self.judge = Judge.of(self.rig)
            self.judged = columns_to_keep(self.judge, self.pacing, not self.request.kept.no_figure)
        except BaseException:
            for child in self.children.values():
                child.end(0.0, 0.0)
            self.children.clear()
            raise

    def _greet(self) -> None:
        self.progress.say(f"{self.rig.config.rig} on {self.bus}, pacing {self.pacing}")
        if self.choice.note:
            self.progress.say(f"{self.bus}: {self.choice.note}")
        if self.rig.config.supervisor.arm == "manual":
            self.progress.say(
                "arm: manual: commands stay at their safe values until `pcpc operate arm`"
            )
        if not self.bus.compiled:
            self.progress.say(
                f"{self.bus.interface}: through python-can in the interpreted loop, 10 to 50 times "
                "slower a frame; expect late cycles above 200 Hz"
            )

    def _interrupt(self, number: int, frame: Any) -> None:
        self.outcome.interrupted = True
        first = [role for role in (self.leader, *self.roles) if role in self.children]
        for role in first[:1]:
            self.children[role].ask()

    def _watch(self) -> None:
        """Attach to what appears, start the recorder, show progress, until a node ends."""
        while not any(child.ended or self._done(name) for name, child in self.children.items()):
            if self.outcome.interrupted and not self._under_way():
                break
            self._attach()
            self._start_recorder()
            self._hear_watchdog()
            if said := self.page.ended():
                self.progress.close()
                print(said, file=sys.stderr, flush=True)
            for alarm in [one for alarms in self.alarms.values() for one in alarms.look()]:
                self.progress.say(str(alarm))
            if self.waiting.too_long(self.blocks, self._under_way()):
                break
            if self.progress.due():
                self.progress.show(self._state())
            time.sleep(_POLL_S)

    def _hear_watchdog(self) -> None:
        """Tell at once what the watchdog has done; it belongs to what ended the run."""
        if "watchdog" in self.children:
            complaints = self.children["watchdog"].complaint()
            for line in complaints[self.heard :]:
                self.progress.close()
                print(line, file=sys.stderr, flush=True)
                self.outcome.faults.append(line)
            self.heard = len(complaints)

    def _has_ended(self, name: str) -> bool:
        return name in self.children and self.children[name].ended

    def _done(self, role: str) -> bool:
        """Return whether the loop of a node has ended; its process stays until we let it go."""
        return role in self.nodes and self.nodes[role].ended

    def _attach(self) -> None:
        """Map the blocks of our own nodes that have appeared since."""
        for role in self.roles:
            if role not in self.nodes:
                with contextlib.suppress(sh.SharedError):
                    node = Live(sharing.attach(self._block_name(role), sharing.HOST))
                    if node.pid == self.children[role].process.pid:
                        self.nodes[role], self.alarms[role] = node, Alarms(node.block)

    def _block_name(self, role: str) -> str:
        return sh.block_name(self.rig.config.rig, str(self.bus), role)

    def _start_recorder(self) -> None:
        if "recorder" in self.children or not self.keeps_log or self.leader not in self.nodes:
            return
        roles = self.rig.roles if self.leader == "executive" else self.roles
        judged = self.judged if self.leader == "executive" else {}
        names = [self._block_name(role) for role in roles]
        words = [str(self.folder / LOG), *names, "--judged", json.dumps(judged)]
        self.children["recorder"] = Child.fork("recorder", recorder.main, words, survives=True)

    def _under_way(self) -> bool:
        node = self.nodes.get(self.leader)
        return node is not None and node.under_way

    def _state(self) -> str:
        """Return the progress line from the leading node's block."""
        waited = 1e-9 * (time.monotonic_ns() - self.begin_ns)
        node = self.nodes.get(self.leader)
        if node is None or not node.ready:
            return self.compiling.text() or f"starting, {waited:.0f} s"
        if not self._under_way():
            return f"waiting for the other node on {self.bus}, {waited:.0f} s"
        total = f"/{node.block.description['cycles']}"  # the plant runs until it is told to stop
        return node_line(node.block, total if self.leader == "executive" else "")

    def _end(self) -> None:
        """Let the nodes end by themselves, then ask; then the recorder, which drains the rings."""
        nodes = [self.children[role] for role in self.rig.roles if role in self.children]
        self._attach()
        first = [name for name, child in self.children.items() if child.ended or self._done(name)]
        over = all(node.ended for node in self.nodes.values())
        recorder_first = self._has_ended("recorder") and not over
        codes = [child.code for child in nodes if child.ended]
        patience = _END_S
        wrong = any(code not in (Exit.OK, Exit.SAFETY_STOP) for code in codes)
        if recorder_first or wrong or self._has_ended("line"):
            patience = _SHORT_END_S
        unborn = self.waiting.given_up_s > 0.0
        unborn = unborn or (self.outcome.interrupted and not self._under_way())
        if unborn or any(code in REFUSALS for code in codes):
            patience = 0.0
        asked_s = _UNBORN_S if unborn else _ASKED_S
        drives = [child for child in nodes if child.name in self.rig.config.drives]
        for child in nodes:  # the executive first: the plant still takes its last command
            if drives and child is drives[0] and child is not nodes[0]:  # they end for nobody
                time.sleep(_DRIVE_END_S)
                for one in drives:
                    one.ask()
            self._await_end(child, patience, asked_s)
        if not unborn and not any(child.ended and child.code in REFUSALS for child in nodes):
            self._start_recorder()  # a run may be shorter than our look at it
        self._let_go(nodes, asked_s)
        if "line" in self.children:
            self.children["line"].end(0.0)
            said, self.wrong_rates = run_line.summary(self.folder)
            self.outcome.faults += self.wrong_rates
            if said:
                self.progress.say(said)
        if "watchdog" in self.children:
            self.children["watchdog"].end(0.0)
            self._hear_watchdog()
        if "recorder" in self.children:
            recording = self.children["recorder"]
            recording.end(_DRAIN_S)
            if recording.code == Exit.LOSS:  # the run is whole, its log is not
                self.outcome.missing += recording.complaint()
            elif recorder_first and recording.code > 0:
                self.outcome.faults.append("recorder: ended before the nodes")
        order = dict.fromkeys([*first, *self.children])
        for name in sorted(order, key=lambda name: follows(self.blocks.get(name))):
            self.outcome.judge(name, self.children[name].code, self.blocks.get(name))
        paced = self.blocks if self.pacing != "lockstep" else {}
        self.outcome.stall = pace.stall(paced, self.rig)
        if all(child.code >= 0 for child in self.children.values()):  # else their death explains it
            self.outcome.faults += filter(None, [pace.silence(paced, self.rig)])

    def _await_end(self, child: Child, patience_s: float, asked_s: float) -> None:
        """Wait for the end of a node's loop; ask for it after `patience_s`."""
        for wait_s in (patience_s, asked_s):
            until = time.monotonic() + wait_s
            while not child.ended and not self._done(child.name):
                self._attach()
                if time.monotonic() >= until:
                    child.ask()
                    break
                time.sleep(_POLL_S)

    def _let_go(self, nodes: list[Child], asked_s: float) -> None:
        """Let the processes of nodes end once a recorder has come, or none will."""
        until = time.monotonic() + _DRAIN_S
        while not all(map(self._is_recorded, self.nodes)) and time.monotonic() < until:
            if not self._recorder_may_come():
                break
            time.sleep(_POLL_S)
        for block in self.blocks.values():
            block.tell(sharing.LEAVE)
        for child in nodes:
            child.end(_SHORT_END_S, asked_s)

    def _is_recorded(self, role: str) -> bool:
        """Return whether a recorder has the memory of a node, or it is too late for that."""
        return self.nodes[role].recorded or not self.nodes[role].block.alive()

    def _recorder_may_come(self) -> bool:
        """Return whether our recorder, or that of the executive's host here, is still to come."""
        if self.keeps_log:
            return "recorder" in self.children and not self._has_ended("recorder")
        return sharing.is_locked(self._block_name("executive"))


def on_bus(request: RunRequest, rig: Rig, roles: tuple[Role, ...]) -> int:
    """Run `roles` of a rig on a bus and sum up; return the exit code."""
    pacing, note = pace.settle(request.pacing, rig, alone=len(roles) < len(rig.roles))
    request = request.changed(pacing=pacing)
    if note:
        print(note, file=sys.stderr)
    if "executive" not in roles:
        return without_executive(request, rig, roles)
    with run_folder(request.kept.output, rig) as folder:
        host = Host(request, rig, roles, folder)
        with host.page:
            return _run_and_conclude(host, folder)


def _run_and_conclude(host: Host, folder: Path) -> int:
    """Run a rig whose log is kept here, and sum up; return the exit code."""
    code = host.run()
    from pcpc.tools.after.verdict.conclude import conclude  # time

    if code < 0:
        code = conclude(host.judge, folder, host.outcome, host.request.kept, host.judged)
        host.page.farewell(folder)
        return code
    os.truncate(folder / LOG, 0)  # without a cycle of the executive
    for name in host.judged:
        long_logs.sidecar(folder / LOG, name).unlink(missing_ok=True)
    return code


def without_executive(request: RunRequest, rig: Rig, roles: tuple[Role, ...]) -> int:
    """Run nodes for an executive elsewhere, which keeps the log; return the exit code.

    A drive keeps its own: its master may be anything.
    """
    with folder_of_drive(request, rig, roles) as folder:
        host = Host(request, rig, roles, folder or Path())
        host.keeps_log = folder is not None
        with host.page:
            code = host.run()
    if folder is not None:
        host.progress.say(f"log      {folder / LOG}")
    wrong = [one for role in roles for one in of_the_master(host.nodes.get(role))]
    for line in (*host.outcome.faults, *wrong):
        print(line, file=sys.stderr)
    if host.outcome.interrupted:
        return Exit.INTERRUPTED
    if code < 0 and host.outcome.faults:
        return Exit.SAFETY_STOP
    ok = Exit.LOSS if host.outcome.missing else Exit.NOT_MET if wrong else Exit.OK
    return code if code >= 0 else ok


def command(request: RunRequest) -> int:
    """Carry out `run`, of all nodes or of one. RigError: wrong input."""
    check_only(request)
    if request.in_place.value("device") is not None:
        return int(part_of("make/device", "cli").command(request))
    rig = load_rig(request.rig, request.controller, request.set, resolve=False)
    return on_bus(request, rig, chosen_nodes(request, rig))
