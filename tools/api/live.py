"""`pcpc.running`: a rig on a bus, in processes of its own, read and tuned while it runs."""

import json
import math
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.errors import did_you_mean
from pcpc.executive.nodes import injecting, operating
from pcpc.executive.nodes import live as nodes
from pcpc.executive.nodes.mailbox import LiveError
from pcpc.executive.rig.reading import load_rig
from pcpc.executive.rig.roles import ROLES
from pcpc.tools.after.record import Figure, Run, UnknownName
from pcpc.tools.start.children import Child
from pcpc.tools.start.folder import LOG
from pcpc.tools.start.page import SAID
from pcpc.tools.start.rigs import find
from pcpc.tools.start.settings import settings

_POLL_S = 0.02
_END_S = 60.0  # in which a run that was asked to end has its summary


class NotMet(UserError, AssertionError):
    """A condition was not met in time."""


class Live:
    """A rig that runs.

        live["controller.e_rad"], live["plant:barrel.theta_rad"]    newest values
        live.set({"controller.kv_Nms_rad": 120.0})                  returns the first cycle with it
        live.wait_until("controller.e_rad", below=1e-3, within_s=2)
        live.inject("encoder_stuck", for_s=0.2)                     a fault of the rig file
        live.plot("controller.e_rad", window_s=5)                   updates while the cell runs
        live.run                                                    the record, after the end

    UnknownName, with a proposal, for an unknown variable; pcpc.Error for a refused request. With a
    device, which has no executive here, "executive" below means the plant.
    """

    def __init__(self, command: Child, folder: Path, keep: Any, leader: str = "executive") -> None:
        self._command, self._folder, self._keep = command, folder, keep
        self._leader = leader  # the plant, where a device is the executive
        self._nodes: dict[str, nodes.Live] = {}
        self._run: Run | None = None

    def __repr__(self) -> str:
        return f"<pcpc.Live {self._folder} {'runs' if self.running else 'has ended'}>"

    # Reading

    @property
    def running(self) -> bool:
        """Whether the executive is running; pcpc.Error: no such node."""
        return not self._command.ended and self._node(self._leader).running

    @property
    def cycle(self) -> int:
        """The executive's newest cycle; pcpc.Error: no such node."""
        return self._node(self._leader).read().cycle

    @property
    def state(self) -> str:
        """The executive's state: INIT, READY, RUN, HOLD, FAULT, STOP; pcpc.Error: no such node."""
        block = self._node(self._leader).block
        return str(block.description["state_names"][int(block.control.state)])

    def __getitem__(self, name: str) -> float:
        node, variable = self._split(name)
        return node.read()[variable]

    def read(self, *names: str) -> dict[str, float]:
        """Return values by name; those of one node are of the same cycle.

        Without names: all of the executive. UnknownName, with a proposal, for an unknown variable.
        """
        if not names:
            return dict(self._node(self._leader).read())
        asked = {name: self._split(name) for name in names}
        values = {id(node): node.read() for node, _ in asked.values()}
        return {name: values[id(node)][variable] for name, (node, variable) in asked.items()}

    @property
    def page(self) -> str:
        """The address of the page of the run, with its token; "" without one."""
        said = [line for line in self._command.complaint() if line.startswith(SAID)]
        return said[0].removeprefix(SAID) if said else ""

    # Acting

    def set(self, changes: Mapping[str, float]) -> int:
        """Set parameters of one node, all between the same two cycles or none.

        Returns the first cycle with them. pcpc.Error: no such parameter, out of range, locked.
        """
        split = {name: self._split(name) for name in changes}
        if len({id(node) for node, _ in split.values()}) > 1:
            raise UserError(f"{', '.join(changes)}: of two nodes; set one node's at a time")
        if not split:
            return self.cycle
        node = next(iter(split.values()))[0]
        return node.tune({split[name][1]: value for name, value in changes.items()})

    def inject(
        self,
        fault: str,
        *,
        for_s: float | None = None,
        value: float | None = None,
        share: float | None = None,
    ) -> int:
        """Begin a fault of the rig (`faults:`) in every node that has it; return the first cycle.

        It ends after `for_s` seconds of the run, or by `clear`. `value`, `share`: instead of the
        rig's. pcpc.Error: no such fault, a value out of range, a stall without a clock.
        """
        nodes = list(self._nodes.values())
        return min(injecting.inject(nodes, fault, for_s, value, share).values())

    def arm(self) -> int:
        """Close the loop of a disarmed run (`arm: manual`, or after `hold`).

        Returns the cycle that executes it. pcpc.Error: the loop is already closed, or in INIT
        or FAULT.
        """
        return operating.arm(self._node("executive"))

    def hold(self) -> int:
        """Ramp the commands to their safe values, until `arm`; return the cycle that executes it.

        This is not a fault. Time, references and laws continue. pcpc.Error: the loop is already
        open.
        """
        return operating.hold(self._node("executive"))

    def handover(self, controller: str) -> int:
        """Let a controller on standby, or the rig's own, take over; return the first cycle with it.

        The command does not jump: `handover.over_s`. pcpc.Error: no such controller, already in
        charge, or an output of it is not finite.
        """
        return operating.hand_over(self._node("executive"), controller)

    def clear(self, fault: str) -> int:
        """End a fault of the rig; return the first cycle without it. pcpc.Error: no such fault."""
        return min(injecting.inject(list(self._nodes.values()), fault, end=True).values())

    def wait_until(
        self,
        what: "str | Callable[[Mapping[str, float]], bool]",
        *,
        below: float | None = None,
        above: float | None = None,
        magnitude: bool = False,
        within_s: float,
    ) -> float:
        """Wait until a variable is `below` and `above` limits; return its value then.

        `what` may also be a function of the executive's values: the call waits until it is true and
        returns the time, s. `magnitude`: the limits apply to the absolute value. NotMet after
        `within_s` seconds of this machine, or when the run ends first. TypeError: no limit.
        """
        if callable(what):
            found = self._wait(self._node(self._leader), what, within_s, "the condition")
            return found.cycle * 1e-9 * self._node(self._leader).period_ns
        if below is None and above is None:
            raise TypeError("wait_until: give a limit, below= or above=")
        node, variable = self._split(what)
        low = -math.inf if above is None else above
        high = math.inf if below is None else below

        def inside(now: Mapping[str, float]) -> bool:
            value = abs(now[variable]) if magnitude else now[variable]
            return low < value < high

        bounds = {"above": above, "below": below}
        limits = " and ".join(f"{k} {value:g}" for k, value in bounds.items() if value is not None)
        return self._wait(node, inside, within_s, f"{what} {limits}")[variable]

    def plot(
        self,
        name: str,
        *names: str,
        window_s: float = 5.0,
        every_s: float = 0.2,
        for_s: float | None = None,
    ) -> Figure:
        """Draw recorded variables over the last seconds, repeatedly, until the run ends.

        Or for `for_s` seconds of the run, or until the cell is interrupted; the run then goes on.
        A notebook updates the plot every `every_s` seconds; elsewhere nothing is shown. Returns the
        last picture. UnknownName: unknown, or not recorded.
        """
        from pcpc.tools.api.live_plot import LivePlot, follow, notebook_display  # time

        asked = [(one, *self._split(one)) for one in (name, *names)]
        live_plot = LivePlot(asked, window_s)
        first, period_s = self.cycle, 1e-9 * self._node(self._leader).period_ns

        def goes_on() -> bool:
            over = for_s is not None and (self.cycle - first) * period_s >= for_s
            return self.running and not over

        return follow(live_plot, goes_on, every_s, notebook_display())

    def wait(self, within_s: float | None = None) -> Run:
        """Wait for the run's own end; NotMet if it takes longer than `within_s` seconds."""
        try:
            self._command.process.wait(math.inf if within_s is None else within_s)
        except subprocess.TimeoutExpired:
            raise NotMet(f"the run did not end within {within_s:g} s") from None
        return self.run

    def stop(self) -> Run:
        """Stop the run in order and return its record."""
        self._command.end(0.0, _END_S)
        return self.run

    @property
    def run(self) -> Run:
        """The record of the run after its end; pcpc.Error before, or without a log."""
        if self._run is None:
            if not self._command.ended:
                raise UserError("the run goes on; its record is there after its end")
            if not (self._folder / LOG).is_file():
                raise UserError(self._complaint() or "the run left no log")
            self._run = Run(self._folder / LOG, keep=self._keep)
        return self._run

    @property
    def asked(self) -> bool:
        """Whether somebody asked for the verdict of the run."""
        return self._run is not None and self._run.asked

    # Inside

    def _split(self, name: str) -> tuple[nodes.Live, str]:
        """Return node and name of a variable; UnknownName."""
        role, colon, variable = name.partition(":")
        if not colon:
            having = [one for one, node in self._nodes.items() if name in node.variables]
            own = self._leader in having or not having
            role, variable = self._leader if own else having[0], name
        if role not in self._nodes and role not in ROLES:
            raise UnknownName(f"{name}: no node {role}; known: {', '.join(self._nodes)}")
        node = self._node(role)
        if variable not in node.variables:
            known = [
                n if r == "executive" else f"{r}:{n}"
                for r, one in self._nodes.items()
                for n in one.variables
            ]
            raise UnknownName(f"{name}: no such variable{did_you_mean(name, known)}")
        return node, variable

    def _node(self, role: str) -> nodes.Live:
        if role not in self._nodes:
            raise UserError(f"{role}: this rig has no such node; known: {', '.join(self._nodes)}")
        return self._nodes[role]

    def _wait(self, node: nodes.Live, holds: Any, within_s: float, what: str) -> nodes.CycleValues:
        try:
            return node.wait_until(holds, within_s, what)
        except LiveError as error:
            raise NotMet(str(error)) from None

    def _begin(self, roles: tuple[str, ...]) -> None:
        """Wait until all nodes are there and the executive runs; pcpc.Error if it does not."""
        while len(self._nodes) < len(roles) or not self._node(self._leader).under_way:
            if self._command.ended:
                if len(self._nodes) == len(roles):  # a run may last a millisecond
                    return
                if (self._folder / LOG).is_file() and self._command.code in (0, 1):
                    return
                code = self._command.code
                said = self._complaint() or _verdict(self._folder, code)
                raise UserError(said, Exit(code) if code in set(Exit) else None)
            for name, one in nodes.running().items():
                if _parent(one.pid) == self._command.process.pid:
                    self._nodes.setdefault(name.rpartition(".")[2], one)
            time.sleep(_POLL_S)

    def _complaint(self) -> str:
        """Return what the command said against itself."""
        lines = self._command.complaint()
        return "; ".join(line for line in lines if not line.startswith(SAID))


@contextmanager
def running(
    rig: str | Path,
    controller: str | None = None,
    *,
    set: Mapping[str, Any] | None = None,
    seed: int | None = None,
    pacing: str | None = None,
    bus: str | None = None,
    folder: str | Path | None = None,
    host: bool = False,
    standby: Sequence[str] = (),
    device: Sequence[str | Path] | None = None,
) -> Iterator[Live]:
    """Run a rig on a bus, in real processes, for as long as the `with` block lasts.

        with pcpc.running("atb1000/hull", pacing="real") as live:
            live.wait_until("controller.e_rad", below=1e-3, magnitude=True, within_s=5)
        live.run.verdict

    pacing   real, sync or lockstep; None: the rig's
    bus      as --bus; auto takes a free one, so that any number of rigs run side by side
    host     True: with a page that may tune; `live.page` is its address
    standby  other controllers of the rig, for `live.handover`
    device   words of a command that replaces the executive, started and ended with the run; {bus}
             in them is the bus. []: a device that is started elsewhere. See docs/device.md

    The others are those of `pcpc.simulate`. The end of the block stops a run that still goes on
    (verdict `interrupted`). Processes, memory and sockets are released, also if this process is
    killed. Raises pcpc.Error: the run does not begin.
    """
    place, words = find(str(rig)), settings(set, seed, standby)
    roles: tuple[str, ...] = load_rig(place, controller, words, resolve=False).roles
    roles = roles if device is None else tuple(role for role in roles if role != "executive")
    keep = tempfile.TemporaryDirectory(prefix="pcpc-") if folder is None else None
    target = Path(keep.name) / "run" if keep is not None else Path(str(folder))
    name = "run" if device is None else "plant"
    command = [name, str(place), "--quiet", "--no-figure", "--json", "-o", str(target)]
    command += ["--host", "--write"] if host else []
    options = {"--controller": controller, "--pacing": pacing, "--bus": bus}
    command += [word for name, value in options.items() if value for word in (name, value)]
    command += [word for setting in words for word in ("--set", setting)]
    command += [] if device is None else ["--device", *map(str, device)]
    live = Live(Child.started("pcpc run", "pcpc.tools.cli", command), target, keep, roles[0])
    try:
        live._begin(roles)
        yield live
    finally:
        live._command.end(0.0, _END_S)  # in order, or at least for sure


def _verdict(folder: Path, code: int) -> str:
    """Return what a run came to that had ended before it was looked at."""
    try:
        found = json.loads((folder / "summary.json").read_text("utf-8"))
        return "; ".join((f"it ended at once: {found['verdict']}", *found["faults"]))
    except (OSError, ValueError, KeyError, TypeError):
        return f"it ended with exit code {code}"


def _parent(pid: int) -> int:
    """Return the parent of a process; 0 if it is gone."""
    try:
        return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
    except OSError:
        return 0
