"""The keys of a rig file and of a plant's parameters file, with types and ranges."""

# ruff: noqa: RUF012  msgspec gives each mapping its own copy of a mutable default

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, ClassVar, Literal

from msgspec import Meta

from pcpc.executive.durations import duration_ns
from pcpc.executive.rig.bus_keys import Bus, Drive, Watchdog, Xcp
from pcpc.executive.rig.judged_keys import Duration, Name, Word
from pcpc.executive.rig.judged_keys import Expected as Expected
from pcpc.executive.rig.judged_keys import Requirement as Requirement
from pcpc.executive.rig.keyed import Keyed
from pcpc.executive.rig.node_keys import (
    BlockName,
    Executive,
    Local,
    Plant,
    Section,
)
from pcpc.executive.rig.node_keys import Limit as Limit
from pcpc.executive.rig.roles import MORE_PLANTS, Role
from pcpc.executive.rig.scheduling import Realtime

EARLIER: dict[
    tuple[str, str], tuple[str, str, str]
] = {  # keys of earlier versions and of their logs, and today's
    ("realtime", f"{prefix}{key}"): ("realtime", role, key)
    for role, prefix, keys in (
        ("executive", "", ("priority", "cpu")),
        ("local", "local_", ("priority", "phase")),
        ("plant", "plant_", ("priority", "phase", "cpu")),
    )
    for key in keys
}
FALLBACK = "fallback"  # name of the block that waits for `overrun.fallback`
PerSecond = Annotated[float, Meta(ge=0, le=1e9)]
Count = Annotated[int, Meta(ge=0, le=2**63 - 1)]
XcpPlace = Annotated[str, Meta(pattern=r"\A(can|(udp|tcp)(:[0-9]{1,5})?)\Z")]


class Supervisor(Keyed):
    """Reactions to missing frames, in cycles, and the ramp to safe values.

    `peer_timeout_s`: how long a node that is ready waits for the other one. `on_fault`: what
    follows the ramp. `arm`: by an operator, at the start and behind a fault. `estop`: a received
    signal, 0 as long as all is well; `stop_frame`: a frame that any node may send; both are a quick
    stop and a fault. `intrusion`: what two senders of a frame lead to, see `loop.intrusion`.
    """

    hold_cycles: Annotated[int, Meta(ge=2)] = 2
    fault_after_cycles: Annotated[int, Meta(ge=2)] = 3
    ramp_s: Annotated[float, Meta(gt=0, le=3600)] = 0.05
    quick_stop_s: Annotated[float, Meta(gt=0, le=3600)] | None = None
    on_fault: Literal["stop", "wait"] = "stop"
    arm: Literal["automatic", "manual"] = "automatic"
    estop: str | None = None
    stop_frame: str | None = None
    intrusion: Literal["count", "hold", "fault"] = "count"
    peer_timeout_s: Annotated[float, Meta(gt=0, le=1e6)] = 300.0


class Overrun(Keyed):
    """What follows when cycles run past their end, besides skipped periods: nothing, by default.

    After `fault_after` of them in a row the node faults; or after `fallback_after` the controller
    `fallback` takes over for good. Those in the first `grace_s` do not count.
    """

    fault_after: Annotated[int, Meta(ge=1)] | None = None
    fallback: Name | None = None
    fallback_after: Annotated[int, Meta(ge=1)] = 1
    grace_s: Annotated[float, Meta(ge=0, le=3600)] = 0.1


class Timing(Keyed):
    """Judges lateness plus work at p99.9, as fractions of a period; null: not judged.

    WARN is told, ERROR is an expectation that is not met.
    """

    warn: Annotated[float, Meta(gt=0)] | None = 0.5
    error: Annotated[float, Meta(gt=0)] | None = None


class Errors(Keyed):
    """How many frames may go wrong, all nodes together, before a run counts as one with loss.

    A healthy bus has none of these, also on a loaded machine, where frames come late but whole.
    Frames from another sender have no limit to set: one is too many.
    """

    crc: Count = 0
    repeated: Count = 0
    wrong_sequence: Count = 0
    implausible: Count = 0
    send: Count = 0
    bus: Count = 0


class Alarms(Keyed):
    """What is told at once during a run: more than so many in a second; null: never.

    `late_us`: a cycle that wakes later; null: than a period.
    """

    late_us: Annotated[float, Meta(gt=0)] | None = None
    lost_per_s: PerSecond | None = 0.0
    crc_per_s: PerSecond | None = 0.0
    held_per_s: PerSecond | None = 10.0  # single ones are what holding is for


class Law(Keyed):
    """A controller: a law with its settings, and wiring beyond that of all controllers.

    `lockstep_only`: why a clock would break it (one sample more of delay); "" where it would not.
    `like` stands for what another controller gives; it is carried out before: `rig.inheritance`.
    """

    carried_out: ClassVar[tuple[str, ...]] = ("like",)  # keys that are known, and gone by now

    law: str
    lockstep_only: str = ""
    parameters: dict[str, float] = {}
    inputs: dict[str, str] = {}
    transmit: dict[str, str] = {}


class Loss(Keyed):
    """Loss of a frame on purpose, at its receivers: `share` of all, in runs of `burst` on average.

    The log holds what was lost; the receiver counts it by the counter that is missing.
    """

    share: Annotated[float, Meta(ge=0, lt=1)]
    burst: Annotated[float, Meta(ge=1, le=1e9)] = 1.0


class Fault(Keyed, rename={"from_": "from", "for_": "for"}):
    """A fault on purpose: of a value `at` a variable, of a `frame`, or a stall of a `node`.

    On `from` a time on, `for` a while (null: to the end), again `every` so often, or `times` times
    at moments drawn from the rig's seed; without any of them only when a client asks for it. How
    large (`value`) and how often it acts meanwhile (`share`, in runs of `burst`): see
    `loop.injection`, `loop.injected_values`, `loop.injected_frames`.
    """

    kind: Word
    at: Word | None = None
    frame: Word | None = None
    node: Role | None = None
    data_of: Word | None = None
    how: Literal["value", "freeze", "random", "offset"] | None = None
    goes_on: bool = False
    value: float | None = None
    share: Annotated[float, Meta(gt=0, le=1)] = 1.0
    burst: Annotated[float, Meta(ge=1, le=1e9)] = 1.0
    from_: Duration | None = None
    for_: Duration | None = None
    every: Duration | None = None
    times: Annotated[int, Meta(ge=1, le=1000)] | None = None


class Tuning(Keyed):
    """Parameters that change at a time of the run, all in the same cycle; who takes over in it."""

    at_s: Annotated[float, Meta(ge=0, le=1e6)]
    set: dict[str, float] = {}
    handover: Name | None = None


class Handover(Keyed):
    """How controllers on `standby` take over: the step fades in `over_s`.

    `to`: who begins, 0 the controller, 1 the first of `standby`, and so on.
    """

    over_s: Annotated[float, Meta(ge=0, le=3600)] = 0.2
    to: Annotated[float, Meta(ge=0, le=8)] = 0.0


_LONGEST_RUN_NS = 10**15
Happening = Literal["fault", "change", "skip", "tuning"]


class Record(Keyed):
    """What the log keeps: all, or with `keep` what lies around an event; see `log.snapshot`.

    `keyframe`: time between two states of whole nodes, see `log.keyframes`; 0s for none.
    """

    keep: Duration | None = None
    on: Happening | list[Happening] = "fault"
    keyframe: Duration = "1s"

    @property
    def keyframe_ns(self) -> int:
        """`keyframe` in ns."""
        return round(duration_ns(self.keyframe, zero=True))

    @property
    def keep_ns(self) -> int:
        """`keep` in ns; 0 for all."""
        return 0 if self.keep is None else round(duration_ns(self.keep, zero=True))

    @property
    def events(self) -> list[str]:
        """`on` as a list."""
        return [self.on] if isinstance(self.on, str) else list(self.on)

    def problems(self) -> Iterator[tuple[str, str]]:
        """Yield each key whose value is out of range, and what is wrong with it."""
        if self.keep is not None and not 0 < self.keep_ns <= _LONGEST_RUN_NS:
            yield "keep", f"{self.keep}: expected more than 0 and no more than 12 days"
        if self.keyframe_ns and not 10**8 <= self.keyframe_ns <= _LONGEST_RUN_NS:
            yield "keyframe", f"{self.keyframe}: expected 100ms to 12 days, or 0s for none"


class Config(Keyed):
    """A rig file as it stands, with defaults filled in and options applied."""

    spread: ClassVar[Mapping[str, tuple[str, ...]]] = {"more_plants": MORE_PLANTS}

    rig: Name
    title: str = ""
    dbc: str
    rate_hz: Annotated[float, Meta(ge=1, le=20000)]
    duration_s: Annotated[float, Meta(gt=0, le=1e6)]  # 12 days: still exact in ns as a float
    seed: Count = 1
    pacing: Literal["real", "sync", "lockstep"] = "real"
    bus: Bus = Bus()
    xcp: XcpPlace | Xcp | None = None
    controller: str
    controllers: dict[Name, Law]
    standby: list[Name] = []
    handover: Handover = Handover()
    supervisor: Supervisor = Supervisor()
    watchdog: Watchdog | None = None
    realtime: Realtime = Realtime()
    errors: Errors = Errors()
    alarms: Alarms = Alarms()
    overrun: Overrun = Overrun()
    timing: Timing = Timing()
    executive: Executive
    plant: Plant
    local: Local | None = None
    more_plants: dict[Role, Plant] = {}  # each with an entry of its own or `like: plant`
    losses: dict[str, Loss] = {}
    faults: dict[BlockName, Fault] = {}
    evaluation: dict[str, Any] | None = None
    watch: str | None = None
    record: Record = Record()
    schedule: list[Tuning] = []
    note: list[str] = []
    require: list[Requirement] = []
    expect: dict[str, dict[str, tuple[float, float] | Expected]] = {}

    @property
    def sections(self) -> dict[Role, Section]:
        """The nodes that this rig has, by role."""
        local: dict[Role, Section] = {} if self.local is None else {"local": self.local}
        return {"executive": self.executive, **local, **self.plants}

    @property
    def plants(self) -> dict[Role, Plant]:
        """The nodes of the plant side, by role."""
        return {"plant": self.plant, **self.more_plants}

    @property
    def below(self) -> tuple[Role, ...]:
        """The nodes right below the executive: a local node, or all plants."""
        return tuple(self.plants) if self.local is None else ("local",)

    @property
    def second_bus(self) -> Bus | None:
        """The bus of a local node's plant or of some plants, where its keys are given."""
        if self.local is not None:
            return self.local.bus
        return next((one.bus for one in self.plants.values() if one.bus is not None), None)

    @property
    def drives(self) -> dict[Role, Drive]:
        """The drives among them."""
        return {role: one.drive for role, one in self.plants.items() if one.drive is not None}

    @property
    def xcp_on_can(self) -> Xcp | None:
        """XCP on CAN, where it is asked for."""
        return Xcp() if self.xcp == "can" else self.xcp if isinstance(self.xcp, Xcp) else None

    def key_of(self, drive: Drive) -> str:
        """Return the path of a drive's entry."""
        return next(f"{role}.drive" for role, one in self.drives.items() if one is drive)

    @property
    def period_ns(self) -> int:
        """How long a cycle takes."""
        return round(1e9 / self.rate_hz)

    @property
    def expected(self) -> dict[str, tuple[float, float] | Expected]:
        """The limits of the controller that runs, by their metrics."""
        return self.expect.get(self.controller, {})

    def limit_ids(self) -> dict[str, str]:
        """Return the ids of the limits of the controller that runs, by their metrics."""
        limits = self.expected.items()
        return {key: one.id for key, one in limits if isinstance(one, Expected) and one.id}


class Evaluation(Keyed):
    """What judges a run: a Python file, the part of the run it looks at, and numbers for it."""

    file: str
    window_s: tuple[float, float]
    numbers: dict[str, float] = {}


class Parameter(Keyed):
    """One entry of a parameters file."""

    value: float
    unit: str
    reason: str
