"""`pcpc check RIG`: every check of the nodes without starting them, and what they would do.

Prints nodes and schedules, the wiring (input <- source [unit]), the frames both ways, the bus load.
A signal that is sent but wired to nothing carries 0: a warning.
"""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from msgspec import to_builtins

from pcpc.drivers.can import dbc
from pcpc.drivers.errors import Exit, UserError, printable
from pcpc.executive.batch import lane_words
from pcpc.executive.log import names
from pcpc.executive.loop import shared as sh
from pcpc.executive.nodes import without_effect
from pcpc.executive.nodes.plan import Plan, check_pacing, cycles_of, plan
from pcpc.executive.nodes.planned_drive import taken_from_eds
from pcpc.executive.own_laws import law_errors, purity, trial
from pcpc.executive.rig.blocks import law_keys
from pcpc.executive.rig.bus_load import bus_load, check_rate
from pcpc.executive.rig.buses import check_line
from pcpc.executive.rig.law_lookup import Use, users_case
from pcpc.executive.rig.messages import unsent_lines
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.executive.rig.schema import Limit
from pcpc.plants.drawing import drawing_of, settings_of
from pcpc.tools.after.verdict.imagined_logs import imagined_log
from pcpc.tools.after.verdict.judge import Judge, check
from pcpc.tools.run.checked import (
    CheckedBus,
    CheckedFrame,
    CheckedNode,
    CheckedStep,
    Load,
    Report,
    Scale,
    Wire,
)
from pcpc.tools.run.commands import CheckRequest
from pcpc.tools.run.rig_schema import rig_schema
from pcpc.tools.start.bus import traffic
from pcpc.tools.terminal import screen
from pcpc.tools.terminal.rooms import parts_called

_MOST_ODD = 20  # entries of a DBC file that are named
_RATES_HZ = (100.0, 200.0, 500.0, 1000.0, 2000.0, 5000.0)


def command(request: CheckRequest) -> int:
    """Check and describe a rig, or print the schema of its file."""
    if not request.rig:
        if not request.schema:
            raise UserError("RIG is missing: name a rig, its file or its folder")
        screen.answer(True, rig_schema(), (), 1)
        return Exit.OK
    rig = load_rig(request.rig, request.controller, request.set)
    check_line(rig, "virtual")
    plans = [plan(rig, role, rig.config.pacing) for role in rig.roles]
    impure = _try_laws(rig)
    check_pacing(rig, rig.config.pacing)
    check_rate(rig, rig.config.pacing)
    for made in plans:
        without_effect.check(made)
    judge = Judge.of(rig)
    if request.schema:
        metrics = judge.evaluation.names(rig.evaluation.numbers) if rig.evaluation else ()
        screen.answer(True, rig_schema(rig, plans, metrics), (), 1)
        return Exit.OK
    report = describe(rig, plans)
    late = traffic.warning(rig, rig.config.pacing)
    report.warnings += [*impure, *filter(None, [late]), *check(judge, request.set)]
    report.warnings += _try_drawing(rig)
    report.warnings += [*unsent_lines(rig), *_odd_entries(rig)]
    for role in rig.config.drives:
        where = rig.where(f"{role}.drive")
        if left_out := taken_from_eds(rig, role).left_out:
            what = ", ".join(left_out[:20]) + (", ..." if len(left_out) > 20 else "")
            report.warnings.append(f"{where}: of its EDS the drive does not have {what}")
        report.warnings.append(f"{where}: the bus load is without the frames of the drive")
    screen.answer(request.json, report, lines(to_builtins(report)), 2)
    return Exit.OK


def _odd_entries(rig: Rig) -> list[str]:
    """Return a line for each entry of the DBC file that is left out or read otherwise."""
    odd = dbc.load(rig.dbc).odd
    lines = [f"{rig.dbc}:{one.place}: {one.what}" for one in odd[:_MOST_ODD]]
    more = len(odd) - len(lines)
    return [*lines, *([f"{rig.dbc}: {more} more such entries"] if more else [])]


def _try_laws(rig: Rig) -> list[str]:
    """Step the laws from outside the project with these settings; RigError for what is wrong.

    Return a line for each thing in them that has other bits, or does other things, elsewhere.
    """
    config = rig.config
    warnings: list[str] = []
    blocks = [block for role in config.sections for block in rig.nodes()[role].blocks]
    for block, (keys, law) in zip(blocks, rig.laws(), strict=True):
        module = law.partition(":")[0]
        file = rig.document.file(keys, module) if module.endswith(".py") else Path()
        use = Use(block.settings, config.rate_hz, config.seed)
        case = users_case(law, file, use)
        if case is None:
            continue
        if problem := trial.trial_problem(case):
            raise rig.document.error(keys, problem)
        warnings += filter(None, [lane_words.lanes_problem(block.block)])
        text = Path(case.file).read_text("utf-8")
        warnings += [law_errors.located_message((case.file, line), what)
                  for line, what in lane_words.decisions(text)]  # fmt: skip
        for line, name in purity.warnings(text):
            where = law_errors.located_message((case.file, line), f"{name} in a step")
            warnings += [f"{where}: not the same on every machine; see docs/howto/controller.md"]
    return list(dict.fromkeys(warnings))


def _try_drawing(rig: Rig) -> list[str]:
    """Draw the plant with zeros and with nothing; DrawingError. Return what it needs in vain."""
    made = drawing_of(rig)
    if made is None:
        return []
    for value in (0.0, math.nan):
        made.scene(dict.fromkeys((*made.needs, "t"), value), settings_of(rig))
    log = imagined_log(rig, rig.config.pacing)
    absent = [source for source in made.needs.values() if names.find_variable(log, source) is None]
    return [f"{made.file}: NEEDS: {names.unknown_name(log, source)}" for source in absent]


def describe(rig: Rig, plans: list[Plan]) -> Report:
    """Return what `--json` prints, from the checked plans of executive and plant."""
    config = rig.config
    return Report(
        rig=config.rig,
        title=config.title,
        file=str(rig.path),
        dbc=str(rig.dbc),
        controller=config.controller,
        pacing=config.pacing,
        rate_hz=config.rate_hz,
        duration_s=config.duration_s,
        cycles=cycles_of(rig),
        nodes={made.role: _node(made) for made in plans},
        bus=_bus(rig),
        warnings=[line for made in plans for line in (*_unwired_lines(made), *_narrow(made))],
    )


def _node(made: Plan) -> CheckedNode:
    return CheckedNode(
        node=made.spec.name,
        schedule=[CheckedStep(spec.name, _law(made, spec.name)) for spec in made.spec.blocks],
        wiring=_wiring(made),
        sends=[_frame(frame, made.rig.config.rate_hz) for frame in made.tx_frames],
        receives=[frame.name for frame in made.rx_frames],
        variables=len(made.table.variables),
        **{part.KEY: part.report(made) for part in parts_called("checks")},
    )


def _law(made: Plan, block: str) -> str:
    config = made.rig.config
    kind, *_, name = map(str, law_keys(config, made.role, block))
    if kind == "controllers":
        return config.controllers[name].law
    entry = config.sections[made.role].blocks.get(name)  # none: a part of the loop, as handover is
    return (entry.law or "") if entry else ""


def _wiring(made: Plan) -> list[Wire]:
    """Return the copies in the loop's order: block by block, then what is sent."""
    variables = made.table.variables
    return [
        Wire(variables[target].name, variables[source].name, variables[target].unit)
        for copies in made.copies
        for source, target in copies
    ]


def _frame(frame: dbc.Frame, rate_hz: float) -> CheckedFrame:
    every_cycles = frame.every_n(rate_hz)
    return CheckedFrame(
        id=frame.can_id,
        extended=frame.extended,
        name=frame.name,
        bytes=frame.dlc,
        every_cycles=every_cycles,
        period_ms=1000.0 * every_cycles / rate_hz,
        protected=frame.protected,
        crc_bits=8 * frame.crc[0],
        signals=[signal.name for signal in frame.signals],
        scales=[Scale(one.unit, abs(one.factor), one.range) for one in frame.signals],
    )


def _bus(rig: Rig) -> CheckedBus:
    """Return the worst-case load at several rates, and the rate that fills the bus."""
    config = rig.config
    bits = config.bus.bits_per_s
    checked = CheckedBus(config.bus.interface, config.bus.channel, bits)
    if bits is None:
        return checked
    database = dbc.load(rig.dbc)
    rates = sorted({*_RATES_HZ, config.rate_hz})
    load = {rate: bus_load(rig, database, rate, bits) for rate in rates}
    slow = bus_load(rig, database, 0.0, bits)  # frames with a time of their own
    per_hz = (load[config.rate_hz] - slow) / config.rate_hz
    checked.load = [Load(rate, round(share, 6)) for rate, share in load.items()]
    checked.highest_rate_hz = int((1.0 - slow) / per_hz) if per_hz > 0.0 else None
    return checked


def _unwired_lines(made: Plan) -> Iterator[str]:
    """Yield a line for each frame with signals that are sent but wired to nothing."""
    place = made.rig.where(f"{made.role}.transmit")
    for frame in made.tx_frames:
        names = (f"{frame.name}.{signal.name}" for signal in frame.signals)
        if bare := [name for name in names if name not in made.spec.transmit]:
            yield f"{place}: {made.spec.name} sends 0 in {', '.join(bare)}: wired to nothing"


def _narrow(made: Plan) -> Iterator[str]:
    """Yield a line for each signal that cannot hold what the port that it is wired to may have."""
    variables, sent = made.table.variables, made.copies[-1]
    signals = {f"tx.{f.name}.{s.name}": (f, s) for f in made.tx_frames for s in f.signals}
    for source, target in sent:
        if variables[target].name not in signals:
            continue
        frame, signal = signals[variables[target].name]
        name, port, (low, high) = f"{frame.name}.{signal.name}", variables[source], signal.range
        limit = made.spec.limits.get(name, Limit())
        port_range = max(port.low, limit.low), min(port.high, limit.high)
        beyond = low - port_range[0], port_range[1] - high
        if port.kind == "output" and any(abs(signal.factor) < by < math.inf for by in beyond):
            place = dbc.place(made.rig.dbc, frame.name, signal.name)
            has = f"{port.name} goes from {port_range[0]:g} to {port_range[1]:g} {signal.unit}"
            yield f"{place}: {name} holds {low:g} to {high:g} {signal.unit}, {has}: it will be cut"


def lines(report: dict[str, Any]) -> Iterator[str]:
    """Yield a report as text."""
    title = f": {printable(report['title'])}" if report["title"] else ""
    yield f"{report['rig']}{title}"
    yield f"  file {report['file']}"
    yield f"  dbc  {report['dbc']}"
    yield (
        f"  {report['rate_hz']:g} Hz, {report['duration_s']:g} s, {report['cycles']} cycles, "
        f"pacing {report['pacing']}, controller {report['controller']}"
    )
    for role, node in report["nodes"].items():
        yield from _node_lines(role, node)
    yield from _bus_lines(report)
    for warning in report["warnings"]:
        yield f"warning: {warning}"


def _node_lines(role: str, node: dict[str, Any]) -> Iterator[str]:
    laws = ((entry["block"], entry["law"]) for entry in node["schedule"])
    blocks = ", then ".join(f"{block} ({law})" if law else block for block, law in laws)
    yield from ("", f"{role} {node['node']}, {node['variables']} of {sh.MAX_VARIABLES} variables")
    yield f"  schedule  {blocks}"
    yield "  wiring"
    width = max((len(wire["input"]) for wire in node["wiring"]), default=0)
    for wire in node["wiring"]:
        unit = f" [{wire['unit']}]" if wire["unit"] else ""
        yield f"    {wire['input']:{width}} <- {wire['source']}{unit}"
    for part in parts_called("checks"):
        yield from (line for about in node[part.KEY] for line in part.lines(about))
    yield f"  receives  {', '.join(node['receives'])}"
    yield "  sends"
    width = max((len(frame["name"]) for frame in node["sends"]), default=0)
    for frame in node["sends"]:
        digits = 8 if frame["extended"] else 3
        when = "every cycle" if frame["every_cycles"] == 1 else f"every {frame['period_ms']:g} ms"
        guard = {0: "", 8: "  counter, crc", 16: "  counter, crc16"}[frame["crc_bits"]]
        yield (
            f"    0x{frame['id']:0{digits}X}  {frame['name']:{width}}  {frame['bytes']} bytes  "
            f"{when:13}{guard}".rstrip()
        )
    rows = [
        (
            f"    {frame['name']}.{name}",
            f"{scale['quantum']:g} {scale['unit']}".strip(),
            f"{scale['range'][0]:g} to {scale['range'][1]:g}",
        )
        for frame in node["sends"]
        for name, scale in zip(frame["signals"], frame["scales"], strict=True)
    ]
    yield "  signals, their quantum and range"
    yield from screen.table(rows, (1,))


def _bus_lines(report: dict[str, Any]) -> Iterator[str]:
    bus = report["bus"]
    if not bus["load"]:
        yield from ("", "bus load: not checked, the rig gives no bus.bitrate")
        return
    yield from ("", f"bus load, worst case at {bus['bitrate']} bit/s")
    for entry in bus["load"]:
        this = "  <- this rig" if entry["rate_hz"] == report["rate_hz"] else ""
        yield f"  {entry['rate_hz']:5g} Hz {entry['load']:7.1%}{this}"
    if bus["highest_rate_hz"]:
        yield (f"  {bus['highest_rate_hz']} Hz would fill it; `pcpc bus` shows when frames arrive")
