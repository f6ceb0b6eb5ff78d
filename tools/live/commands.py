"""Commands: what looks at a running node, tunes and operates it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

from pcpc.tools.live import arguments as take_live
from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import NODE_CODES, Command, codes
from pcpc.tools.terminal.request import WORD, Request


class NodeRequest(Request):
    """What is asked of one node."""

    node: take_live.Node = None
    elsewhere: take_live.Elsewhere = take_live.Elsewhere()
    json: take.Json = False


class GetRequest(NodeRequest):
    """Variables, and how much about them."""

    names: Annotated[Sequence[str], WORD, {"metavar": "NAME"}] = ()
    node: take_live.NodeOfNames = None
    long: Annotated[
        bool, "-l", "a table of NAME or a pattern: value, unit, range, writer, meaning"
    ] = False


class SetRequest(NodeRequest):
    """Parameters and their values."""

    names: Annotated[Sequence[str], {"metavar": "NAME=VALUE"}]
    node: take_live.NodeOfNames = None


class WatchRequest(NodeRequest):
    """Variables, and how often."""

    names: Annotated[Sequence[str], {"metavar": "NAME"}]
    node: take_live.NodeOfNames = None
    every_s: Annotated[
        float,
        take.seconds("--every"),
        "--every",
        "TIME",
        "interval: 500us, 5ms, 10s; default: 200ms",
    ] = 0.2


class LockRequest(NodeRequest):
    """What is forbidden from now on."""

    level: Annotated[str, {"metavar": "none|tune|all"}]
    node: take_live.NodeOfNames = None


class SaveRequest(Request):
    """Where the parameters of a node go."""

    file: Annotated[Path, "FILE", "the YAML file to write"]
    all: Annotated[bool, "all parameters of the rig, not only changed ones"] = False
    force: Annotated[bool, "overwrite FILE"] = False
    node: take_live.Node = None
    elsewhere: take_live.Elsewhere = take_live.Elsewhere()


class LoadRequest(NodeRequest):
    """Where parameters of a node come from."""

    file: Annotated[str, "FILE", "lines NAME: VALUE, as `pcpc save` writes them"]


class UndoRequest(NodeRequest):
    """How many tunings."""

    count: Annotated[int, WORD, take.positive, "N", "undo the last N tunings; default: 1"] = 1


class ScopeRequest(Request):
    """Variables, a trigger and where to write."""

    names: Annotated[Sequence[str], "VAR", "variables of one node, or patterns with * ? []"]
    trigger: Annotated[str, "--trigger", "CONDITION", "trigger when this condition becomes true"]
    pre_s: Annotated[
        float,
        take.seconds("--pre", zero=True),
        "--pre",
        "TIME",
        "record before the trigger; default: 200ms",
    ] = 0.2
    post_s: Annotated[
        float,
        take.seconds("--post", zero=True),
        "--post",
        "TIME",
        "record after the trigger; default: 1s",
    ] = 1.0
    output: Annotated[Path, "-o", "FILE.mcap", "the log to write"]
    plot: Annotated[Path | None, "FILE.png", "draw the capture"] = None
    mode: Annotated[
        Literal["single", "normal", "auto"],
        "one burst, each trigger, or without a trigger; default: %(default)s",
    ] = "single"
    count: Annotated[int | None, take.positive, "N", "normal, auto: stop after N bursts"] = None
    within_s: Annotated[
        float | None, take.duration, "--within", "TIME", "give up after this time"
    ] = None
    past: Annotated[bool, "search the node's ring buffer for past triggers too"] = False
    force: Annotated[bool, "overwrite FILE.mcap"] = False
    node: take_live.Node = None
    elsewhere: take_live.Elsewhere = take_live.Elsewhere()
    json: take.Json = False
    quiet: take.Quiet = False


class ResetRequest(Request):
    """Which rig's nodes, if there are several."""

    verb = "reset"

    run: Annotated[
        str | None,
        WORD,
        "RIG|RUN",
        "if there are several runs: the rig's name or file, or RIG.BUS",
    ] = None
    elsewhere: take_live.Elsewhere = take_live.Elsewhere()
    json: take.Json = False


class StopRequest(ResetRequest):
    """Which rig's run, and how."""

    verb = "stop"

    quick: Annotated[bool, "ramp down in supervisor.quick_stop_s, not ramp_s"] = False


class ArmRequest(NodeRequest):
    """An executive that waits until its loop is closed."""

    verb = "arm"


class HoldRequest(NodeRequest):
    """An executive whose loop is closed."""

    verb = "hold"


class ResumeRequest(NodeRequest):
    """An executive that holds."""

    verb = "resume"


class HandoverRequest(NodeRequest):
    """Who is to be in charge."""

    verb = "handover"
    controller: Annotated[
        str, "CONTROLLER", "the controller that takes over: one on standby, or the rig's"
    ]


class FaultRequest(Request):
    """A fault of the rig, how long and how large."""

    name: Annotated[str | None, WORD, "NAME", "a name under faults: in the rig"] = None
    for_s: Annotated[
        float | None,
        take.seconds("--for"),
        "--for",
        "TIME",
        "duration: 200ms, 5s; default: until --end",
    ] = None
    value: Annotated[float | None, "X", "magnitude; default: the rig's value"] = None
    share: Annotated[float | None, "X", "probability that it acts, 0 to 1"] = None
    end: Annotated[bool, "end the fault"] = False
    node: Annotated[str | None, "NODE", "only in this node: executive, plant or a full name"] = None
    elsewhere: take_live.Elsewhere = take_live.Elsewhere()
    json: take.Json = False


_OPERATIONS = (
    Command(
        "lock",
        "forbid tuning (tune) or everything (all), or allow it (none)",
        "pcpc operate lock tune",
        LockRequest,
        module="live.variables",
        codes=NODE_CODES,
    ),
    Command(
        "reset",
        "clear a fault that waits for a reset (supervisor.on_fault)",
        "pcpc operate reset hull",
        ResetRequest,
        module="live.operation",
        codes=codes(NODE_CODES, NOT_MET="the cause is still there"),
    ),
    Command(
        "arm",
        "close the loop of a run that waits for it (supervisor.arm)",
        "pcpc operate arm",
        ArmRequest,
        module="live.operation",
        codes=codes(NODE_CODES, NOT_MET="not possible in this state"),
    ),
    Command(
        "hold",
        "ramp commands to their safe values, without a fault",
        "pcpc operate hold",
        HoldRequest,
        notes="time, references and laws continue; `pcpc operate resume` closes the loop again",
        module="live.operation",
        codes=NODE_CODES,
    ),
    Command(
        "resume",
        "close the loop after `pcpc operate hold`, on the same ramp",
        "pcpc operate resume",
        ResumeRequest,
        module="live.operation",
        codes=codes(NODE_CODES, NOT_MET="not possible in this state"),
    ),
    Command(
        "handover",
        "let another controller take over, without a jump",
        "pcpc run hull --controller pd --standby pd_nn\npcpc operate handover pd_nn",
        HandoverRequest,
        module="live.operation",
        codes=codes(NODE_CODES, NOT_MET="the controller is not usable; the present one stays"),
    ),
)

COMMANDS = (
    Command(
        "get",
        "print values; without a name a table of all, with units and ranges",
        "pcpc get\npcpc get controller.e_rad barrel.theta_rad\n"
        "ssh -t rig-machine pcpc get -l 'controller.*'",
        GetRequest,
        module="live.variables",
        codes=NODE_CODES,
    ),
    Command(
        "set",
        "tune parameters, all at once",
        "pcpc set controller.kv_Nms_rad=120 controller.lam_per_s=15",
        SetRequest,
        module="live.variables",
        codes=NODE_CODES,
        first=True,
    ),
    Command(
        "save",
        "write the tuned parameters to a file",
        "pcpc save tuned.yaml",
        SaveRequest,
        notes="use them with --set @FILE, or in a running node with `pcpc load`",
        module="live.tunings",
        codes=NODE_CODES,
    ),
    Command(
        "load",
        "tune parameters to the values in a file, all at once or none",
        "pcpc load tuned.yaml",
        LoadRequest,
        module="live.tunings",
        codes=NODE_CODES,
    ),
    Command(
        "undo",
        "undo the last tuning, of any client",
        "pcpc undo\npcpc undo 3",
        UndoRequest,
        module="live.tunings",
        codes=NODE_CODES,
    ),
    Command(
        "watch",
        "print values periodically",
        "pcpc watch 'controller.*' --every 500ms",
        WatchRequest,
        codes=NODE_CODES,
        module="live.variables",
    ),
    Command(
        "scope",
        "capture every cycle around a trigger into a log",
        "pcpc scope 'controller.*' --trigger 'abs(controller.e_rad) > 2 mrad' "
        "-o burst.mcap --plot burst.png",
        ScopeRequest,
        codes=codes(
            NOT_MET="no trigger",
            LOSS="cycles were lost",
            ENVIRONMENT="no such node",
            INTERRUPTED="",
        ),
        module="live.scope",
    ),
    Command(
        "stop",
        "stop a run in order, even a locked one",
        "pcpc stop --quick",
        StopRequest,
        module="live.operation",
        codes=NODE_CODES,
    ),
    Command(
        "operate",
        "reset, arm, hold, resume, lock a run, or hand it over to another law",
        "pcpc operate hold\npcpc operate reset hull",
        parts=_OPERATIONS,
    ),
    Command(
        "fault",
        "list the injectable faults of a rig, begin or end one",
        "pcpc fault encoder_stuck --for 200ms",
        FaultRequest,
        codes=NODE_CODES,
        module="live.fault",
    ),
)
