"""The executive of a rig in C: its blocks, what is wired to what, limits, scheduled tunings.

A block NAME is the variable NAME of four structs: parameters p, states x, inputs u, outputs y; one
without ports is left out, as in the C of its law (`tools.make.generate.translator.law`).
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

from pcpc.executive.nodes.plan import Plan, cycles_of
from pcpc.executive.rig import messages
from pcpc.executive.rig.schema import FALLBACK
from pcpc.tools.make.generate import frames
from pcpc.tools.make.generate.translator.law import LETTERS, ROLES, elements
from pcpc.tools.make.generate.words import comment, identifier, number

_OF_SUPERVISOR = (
    "state fault gain missing_cycles nmt fallback saturated status_word error_code error_register"
)
_OF_HEALTH = (
    "passes frames_sent frames_received frames_lost crc_errors frames_repeated wrong_sequence "
    "saturated_values held_cycles stale_cycles"
)
_SUPERVISOR, _HEALTH = frozenset(_OF_SUPERVISOR.split()), frozenset(_OF_HEALTH.split())


@dataclass(frozen=True)
class Part:
    """One of the structs of a block."""

    block: str
    short: str
    kind: str

    @property
    def name(self) -> str:
        """As C code says it."""
        return f"{identifier(self.block)}.{self.short}"


class Wiring:
    """Where each variable of an executive's plan is in C."""

    def __init__(self, made: Plan) -> None:
        self.made = made
        self.blocks = [spec for spec in made.spec.blocks if spec.name != FALLBACK]
        self.parts: dict[str, list[Part]] = {}
        self.said: dict[int, str] = {}
        for spec, views in zip(made.spec.blocks, made.views, strict=True):
            if spec.name == FALLBACK:
                continue
            own = self.parts[spec.name] = []
            for kind, ports in zip(ROLES, spec.block.step.declared, strict=True):
                places = getattr(views, kind)
                if not len(places):
                    continue
                part = Part(spec.name, LETTERS[kind], kind)
                own.append(part)
                values = (f"{part.name}.{one}" for one in elements(ports.layout))
                self.said |= dict(zip(places, values, strict=True))
        for place, variable in enumerate(made.table.variables):
            if place not in self.said:
                self.said[place] = _own(variable.name)

    def copies(self, block: int) -> Iterator[str]:
        """Yield what is carried to the inputs of a block, or, behind the last, to what is sent."""
        for source, target in self.made.copies[block]:
            yield f"{self.said[target]} = {self.said[source]};"


def _own(name: str) -> str:
    """Return one of the loop's own variables; what a device does not measure is 0."""
    group, _, rest = name.partition(".")
    if name == "time.t_s":
        return "rig.t_s"
    if (group == "supervisor" and rest in _SUPERVISOR) or (group == "health" and rest in _HEALTH):
        return f"rig.{name}"
    if group in ("rx", "tx"):
        frame, _, signal = rest.partition(".")
        return f"rig.{group}.{identifier(frame)}.{identifier(signal)}"
    return f"0.0 /* {comment(name)} */"


def header(made: Plan) -> str:
    """Return rig.h: what device.c needs of the rig."""
    rig, heard, sent = made.rig, made.rx_frames, made.tx_frames
    config, awaited = rig.config, sum(map(messages.is_awaited, made.rx_frames))
    period_s = round(1e9 / config.rate_hz) * 1e-9
    stop = config.supervisor.stop_frame
    names = [frame.name for frame in heard]
    quick_s = config.supervisor.quick_stop_s or config.supervisor.ramp_s
    waits = "true" if config.supervisor.on_fault == "wait" else "false"
    lines = [
        f"/* The rig {comment(config.rig)}: {comment(config.title)}. */",
        "#ifndef RIG_H",
        "#define RIG_H",
        "",
        '#include "frames.h"',
        '#include "rig_parts.h"',
        "",
        f"#define RIG_PERIOD_S {number(period_s)}",
        f"#define RIG_PERIOD_NS {round(1e9 / config.rate_hz)}u",
        "#ifndef RIG_CYCLES",
        f"#define RIG_CYCLES {cycles_of(rig)}u /* of a run; 0: until the plant ends */",
        "#endif",
        f"#define RIG_HOLD_CYCLES {config.supervisor.hold_cycles}u",
        f"#define RIG_FAULT_AFTER {config.supervisor.fault_after_cycles}u",
        f"#define RIG_RAMP_STEP {number(period_s / config.supervisor.ramp_s)} /* a cycle */",
        f"#define RIG_QUICK_STEP {number(period_s / quick_s)}",
        f"#define RIG_WAITS_IN_FAULT {waits}",
        f"#define RIG_SENT {len(sent)}u",
        f"#define RIG_HEARD {len(heard)}u",
        f"#define RIG_AWAITED {awaited}u",
        f"#define RIG_STOP_ROW {names.index(stop) if stop in names else len(heard)}u",
        f"#define RIG_LIMITS {len(made.limits)}u",
        "",
        *_struct("received_t", heard),
        *_struct("sent_t", sent),
        "typedef struct {",
        "    double t_s; /* time of the cycle */",
        "    supervisor_t supervisor;",
        "    health_t health;",
        "    counts_t counts;",
        "    received_t rx;",
        "    sent_t tx;",
        "} rig_t;",
        "",
        "extern rig_t rig;",
        "extern const frame_info rig_sent[RIG_SENT]; /* in the order of sending */",
        "extern const frame_info rig_heard[RIG_HEARD];",
        "extern const limit_t rig_limits[RIG_LIMITS + 1u];",
        "",
        "int32_t rig_init(void);",
        "void rig_tune(uint32_t k);",
        "void rig_step(double t_s);",
        "void rig_send(void);",
        "bool rig_finite(finite_t finite);",
        "bool rig_estop(void);",
        "void rig_publish(uint32_t passes);",
        "uint32_t rig_pack(uint32_t row, uint8_t data[8]);",
        "void rig_unpack(uint32_t row, const uint8_t data[8]);",
        "",
        "#endif",
        "",
    ]
    return "\n".join(lines)


def _struct(name: str, all_: frames.Frames) -> Iterator[str]:
    yield "typedef struct {"
    for frame in all_:
        if frame.signals:
            word = identifier(frame.name)
            yield f"    {word}_signals {word};"
    if not any(frame.signals for frame in all_):
        yield "    double none;"
    yield f"}} {name};"
    yield ""


def source(made: Plan) -> str:
    """Return rig.c."""
    wiring = Wiring(made)
    lines = ['#include "rig.h"', ""]
    lines += [f'#include "{identifier(spec.name)}.h"' for spec in wiring.blocks]
    lines += ["", "rig_t rig;", ""]
    for spec in wiring.blocks:
        lines += ["static struct {"]
        for part in wiring.parts[spec.name]:
            lines.append(f"    {identifier(spec.name)}_{part.kind} {part.short};")
        lines += [f"}} {identifier(spec.name)};", ""]
    rate_hz = made.rig.config.rate_hz
    for name, table in (("sent", made.tx_frames), ("heard", made.rx_frames)):
        lines.append(f"const frame_info rig_{name}[RIG_{name.upper()}] = {{")
        lines += [f"    {frames.info(one, rate_hz)}, /* {one.name} */" for one in table]
        lines += ["};", ""]
    lines += [*_limits(wiring), "", *_init(wiring), "", *_tune(wiring), "", *_step(wiring), ""]
    lines += [*_send(wiring), "", *_finite(wiring), "", *_estop(wiring), "", *_publish(), ""]
    lines += [*_choice(made, "pack"), "", *_choice(made, "unpack"), ""]
    return "\n".join(lines)


def _limits(wiring: Wiring) -> Iterator[str]:
    made = wiring.made
    period_s = round(1e9 / made.rig.config.rate_hz) * 1e-9
    yield "const limit_t rig_limits[RIG_LIMITS + 1u] = {"
    for name, limit in made.limits.items():
        rate = math.inf if limit.rate_per_s is None else limit.rate_per_s * period_s
        said = wiring.said[made.table.index[f"tx.{name}"]]
        values = ", ".join(map(number, (limit.low, limit.high, rate, limit.safe or 0.0)))
        yield f"    {{&{said}, {values}}},"
    yield "    {0, 0.0, 0.0, 0.0, 0.0},"
    yield "};"


def _init(wiring: Wiring) -> Iterator[str]:
    yield "/* Returns 0, or that this machine does not give the bits of every other. */"
    yield "int32_t rig_init(void)"
    yield "{"
    yield "    static const rig_t NOTHING;"
    yield "    int32_t wrong = 0;"
    yield "    rig = NOTHING;"
    for spec in wiring.blocks:
        name, parts = identifier(spec.name), wiring.parts[spec.name]
        for part in parts:
            yield f"    static const {name}_{part.kind} {name}_{part.short};"
            yield f"    {part.name} = {name}_{part.short};"
        begun = ", ".join(f"&{part.name}" for part in parts if part.short in "px")
        yield f"    {name}_init({begun});"
        yield f"    wrong |= {name}_selftest();"
    yield "    return wrong;"
    yield "}"


def _tune(wiring: Wiring) -> Iterator[str]:
    """Yield the rig's scheduled tunings."""
    made = wiring.made
    yield "/* What the rig tunes at a time of the run. */"
    yield "void rig_tune(uint32_t k)"
    yield "{"
    if not made.schedule:
        yield "    (void)k;"
    else:
        yield "    static uint32_t done;"
        yield "    if (k == 0u) {"
        yield "        done = 0u;"
        yield "    }"
    for i, (cycle, place, value) in enumerate(made.schedule):
        yield f"    if ((done == {i}u) && (k >= {cycle}u)) {{"
        yield f"        {wiring.said[place]} = {number(value)};"
        yield f"        done = {i + 1}u;"
        yield "    }"
    yield "}"


def _step(wiring: Wiring) -> Iterator[str]:
    yield "/* The blocks in their order. */"
    yield "void rig_step(double t_s)"
    yield "{"
    yield "    rig.t_s = t_s;"
    for i, spec in enumerate(wiring.made.spec.blocks):
        if spec.name == FALLBACK:
            continue
        yield from (f"    {line}" for line in wiring.copies(i))
        parts = ", ".join(f"&{part.name}" for part in wiring.parts[spec.name])
        yield f"    {identifier(spec.name)}_step(t_s, RIG_PERIOD_S{', ' * bool(parts)}{parts});"
    yield "}"


def _send(wiring: Wiring) -> Iterator[str]:
    yield "/* From the blocks to what is sent. */"
    yield "void rig_send(void)"
    yield "{"
    yield from (f"    {line}" for line in wiring.copies(-1))
    yield "}"


def _finite(wiring: Wiring) -> Iterator[str]:
    yield "/* Whether all outputs and all that is sent are finite numbers. */"
    yield "bool rig_finite(finite_t finite)"
    yield "{"
    yield "    bool all = true;"
    by_name = {s.name: v for s, v in zip(wiring.made.spec.blocks, wiring.made.views, strict=True)}
    for spec in wiring.blocks:
        views = by_name[spec.name]
        count = len(views.outputs) if views.judged is None else views.judged
        if count:
            yield (
                f"    all = finite((const double *)&{identifier(spec.name)}.y, {count}u) && all;"
            )
    if any(frame.signals for frame in wiring.made.tx_frames):
        yield (
            "    all = finite((const double *)&rig.tx, "
            "(uint32_t)(sizeof rig.tx / sizeof(double))) && all;"
        )
    yield "    return all;"
    yield "}"


def _estop(wiring: Wiring) -> Iterator[str]:
    made = wiring.made
    place = made.table.index.get(f"rx.{made.rig.config.supervisor.estop}")
    yield "bool rig_estop(void)"
    yield "{"
    yield f"    return {'false' if place is None else f'{wiring.said[place]} != 0.0'};"
    yield "}"


def _publish() -> Iterator[str]:
    yield "/* The counts, as frames of the next cycle tell them. */"
    yield "void rig_publish(uint32_t passes)"
    yield "{"
    yield "    rig.health.passes = (double)passes;"
    for name in sorted(_HEALTH - {"passes"}):
        yield f"    rig.health.{name} = (double)rig.counts.{name};"
    yield "}"


def _choice(made: Plan, what: str) -> Iterator[str]:
    """Yield the function that packs or unpacks a row of the table."""
    all_ = made.tx_frames if what == "pack" else made.rx_frames
    rows = [(row, identifier(frame.name)) for row, frame in enumerate(all_) if frame.signals]
    if what == "pack":
        yield "uint32_t rig_pack(uint32_t row, uint8_t data[8])"
    else:
        yield "void rig_unpack(uint32_t row, const uint8_t data[8])"
    yield "{"
    if what == "pack":
        yield "    uint32_t clamped = 0u;"
    if not rows:
        yield "    (void)row;"
        yield "    (void)data;"
    else:
        yield "    switch (row) {"
        for row, name in rows:
            yield f"    case {row}u:"
            if what == "pack":
                yield f"        clamped = pack_{name}(&rig.tx.{name}, data);"
            else:
                yield f"        unpack_{name}(data, &rig.rx.{name});"
            yield "        break;"
        yield "    default: /* a frame of counter and CRC alone */"
        yield "        break;"
        yield "    }"
    if what == "pack":
        yield "    return clamped;"
    yield "}"
