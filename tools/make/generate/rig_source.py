"""The executive of a rig in C: its blocks, what is wired to what, limits, scheduled tunings.

A block NAME is the variable NAME of four structs: parameters p, states x, inputs u, outputs y; one
without ports is left out, as in the C of its law (`tools.make.generate.translator.law`).
"""

from collections.abc import Iterator
from string import Template

from pcpc.executive.loop.table import Variable
from pcpc.executive.nodes.plan import Plan, cycles_of
from pcpc.executive.rig import messages
from pcpc.executive.rig.blocks import BlockSpec
from pcpc.tools.make.generate import frames
from pcpc.tools.make.generate.translator.law import LETTERS, signature
from pcpc.tools.make.generate.wiring import Wiring
from pcpc.tools.make.generate.words import comment, identifier, number

_OF_SUPERVISOR = (
    "state fault gain missing_cycles nmt fallback saturated status_word error_code error_register"
)
_OF_HEALTH = (
    "passes frames_sent frames_received frames_lost crc_errors frames_repeated wrong_sequence "
    "saturated_values held_cycles stale_cycles"
)
_SUPERVISOR, _HEALTH = frozenset(_OF_SUPERVISOR.split()), frozenset(_OF_HEALTH.split())


class DeviceWiring(Wiring):
    """A block is the variable of its name; the rest is in `rig`."""

    def part(self, spec: BlockSpec, role: str) -> str:
        """Return the expression of one of a block's structs."""
        return f"{identifier(spec.name)}.{LETTERS[role]}"

    def other(self, variable: Variable) -> str:
        """Return one of the loop's own variables; what a device does not measure is 0."""
        name = variable.name
        group, _, rest = name.partition(".")
        if name == "time.t_s":
            return "rig.t_s"
        if (group == "supervisor" and rest in _SUPERVISOR) or (
            group == "health" and rest in _HEALTH
        ):
            return f"rig.{name}"
        if group in ("rx", "tx"):
            frame, _, signal = rest.partition(".")
            return f"rig.{group}.{identifier(frame)}.{identifier(signal)}"
        return f"0.0 /* {comment(name)} */"

    def held(self, place: int) -> str:
        """Return the expression of a variable that a device holds, "" for another one."""
        return "" if self.at(place).startswith("0.0 ") else self.at(place)


_HEADER = Template("""\
/* The rig $rig: $title. */
#ifndef RIG_H
#define RIG_H

#include "frames.h"
#include "rig_parts.h"

#define RIG_PERIOD_S $period_s
#define RIG_PERIOD_NS ${period_ns}u
#ifndef RIG_CYCLES
#define RIG_CYCLES ${cycles}u /* of a run; 0: until the plant ends */
#endif
#define RIG_HOLD_CYCLES ${hold}u
#define RIG_FAULT_AFTER ${fault}u
#define RIG_RAMP_STEP $ramp /* a cycle */
#define RIG_QUICK_STEP $quick
#define RIG_WAITS_IN_FAULT $waits
#define RIG_SENT ${sent}u
#define RIG_HEARD ${heard}u
#define RIG_AWAITED ${awaited}u
#define RIG_STOP_ROW ${stop}u
#define RIG_LIMITS ${limits}u

$structs
typedef struct {
    double t_s; /* time of the cycle */
    supervisor_t supervisor;
    health_t health;
    counts_t counts;
    received_t rx;
    sent_t tx;
} rig_t;

extern rig_t rig;
extern const frame_info rig_sent[RIG_SENT]; /* in the order of sending */
extern const frame_info rig_heard[RIG_HEARD];
extern const limit_t rig_limits[RIG_LIMITS + 1u];

int32_t rig_init(void);
void rig_tune(uint32_t k);
void rig_step(double t_s);
void rig_send(void);
bool rig_finite(finite_t finite);
bool rig_estop(void);
void rig_publish(uint32_t passes);
uint32_t rig_pack(uint32_t row, uint8_t data[$room]);
void rig_unpack(uint32_t row, const uint8_t data[$room]);

#endif
""")


def header(made: Plan) -> str:
    """Return rig.h: what device.c needs of the rig."""
    heard, sent, config = made.rx_frames, made.tx_frames, made.rig.config
    supervisor, period_s = config.supervisor, config.period_ns * 1e-9
    names, stop = [frame.name for frame in heard], supervisor.stop_frame
    return _HEADER.substitute(
        rig=comment(config.rig),
        title=comment(config.title),
        period_s=number(period_s),
        period_ns=config.period_ns,
        cycles=cycles_of(made.rig),
        hold=supervisor.hold_cycles,
        fault=supervisor.fault_after_cycles,
        ramp=number(period_s / supervisor.ramp_s),
        quick=number(period_s / (supervisor.quick_stop_s or supervisor.ramp_s)),
        waits="true" if supervisor.on_fault == "wait" else "false",
        sent=len(sent),
        heard=len(heard),
        awaited=sum(map(messages.is_awaited, heard)),
        stop=names.index(stop) if stop in names else len(heard),
        limits=len(made.limits),
        room=made.data_bytes,
        structs="\n".join([*_struct("received_t", heard), *_struct("sent_t", sent)]),
    )


def _struct(name: str, all_: frames.Frames) -> Iterator[str]:
    yield "typedef struct {"
    for frame in all_:
        if frame.signals:
            word = identifier(frame.name)
            yield f"    {word}_signals {word};"
    if not any(frame.signals for frame in all_):
        yield "    double none;"
    yield f"}} {name};\n"


def source(wiring: Wiring) -> str:
    """Return rig.c."""
    made = wiring.plan
    lines = ['#include "rig.h"', ""]
    lines += [f'#include "{wiring.law(spec)}.h"' for spec, _ in wiring.blocks]
    lines += ["", "rig_t rig;", ""]
    for spec, _ in wiring.blocks:
        name = wiring.law(spec)
        lines += ["static struct {"]
        lines += [f"    {name}_{role} {LETTERS[role]};" for role in signature(spec.block)]
        lines += [f"}} {name};", ""]
    rate_hz = made.rig.config.rate_hz
    for name, table in (("sent", made.tx_frames), ("heard", made.rx_frames)):
        lines.append(f"const frame_info rig_{name}[RIG_{name.upper()}] = {{")
        lines += [f"    {frames.info(one, rate_hz, made.fd)}, /* {one.name} */" for one in table]
        lines += ["};", ""]
    lines += [*_limits(wiring), "", *_init(wiring), "", *_tune(wiring), "", *_step(wiring), ""]
    lines += [*_send(wiring), "", *_finite(wiring), "", *_estop(wiring), "", *_publish(), ""]
    lines += [*_choice(made, "pack"), "", *_choice(made, "unpack"), ""]
    return "\n".join(lines)


def _limits(wiring: Wiring) -> Iterator[str]:
    yield "const limit_t rig_limits[RIG_LIMITS + 1u] = {"
    for where, values in wiring.limits():
        yield f"    {{&{where}, {', '.join(map(number, values))}}},"
    yield "    {0, 0.0, 0.0, 0.0, 0.0},"
    yield "};"


def _init(wiring: Wiring) -> Iterator[str]:
    yield "/* Returns 0, or that this machine does not give the bits of every other. */"
    yield "int32_t rig_init(void)"
    yield "{"
    yield "    static const rig_t NOTHING;"
    yield "    int32_t wrong = 0;"
    yield "    rig = NOTHING;"
    for spec, _ in wiring.blocks:
        name = wiring.law(spec)
        for role in signature(spec.block):
            zero = f"{name}_{LETTERS[role]}"
            yield f"    static const {name}_{role} {zero};"
            yield f"    {wiring.part(spec, role)} = {zero};"
        yield f"    {name}_init({', '.join(wiring.pointers(spec, 'px'))});"
        yield f"    wrong |= {name}_selftest();"
    yield "    return wrong;"
    yield "}"


def _tune(wiring: Wiring) -> Iterator[str]:
    """Yield the rig's scheduled tunings."""
    schedule = wiring.plan.schedule
    yield "/* What the rig tunes at a time of the run. */"
    yield "void rig_tune(uint32_t k)"
    yield "{"
    if not schedule:
        yield "    (void)k;"
    else:
        yield "    static uint32_t done;"
        yield "    if (k == 0u) {"
        yield "        done = 0u;"
        yield "    }"
    for i, (cycle, place, value) in enumerate(schedule):
        yield f"    if ((done == {i}u) && (k >= {cycle}u)) {{"
        yield f"        {wiring.at(place)} = {number(value)};"
        yield f"        done = {i + 1}u;"
        yield "    }"
    yield "}"


def _step(wiring: Wiring) -> Iterator[str]:
    yield "/* The blocks in their order. */"
    yield "void rig_step(double t_s)"
    yield "{"
    yield "    rig.t_s = t_s;"
    for spec, _ in wiring.blocks:
        yield from wiring.step(spec, "t_s", "RIG_PERIOD_S")
    yield "}"


def _send(wiring: Wiring) -> Iterator[str]:
    yield "/* From the blocks to what is sent. */"
    yield "void rig_send(void)"
    yield "{"
    yield from wiring.copies(-1)
    yield "}"


def _finite(wiring: Wiring) -> Iterator[str]:
    yield "/* Whether all outputs and all that is sent are finite numbers. */"
    yield "bool rig_finite(finite_t finite)"
    yield "{"
    yield "    bool all = true;"
    for spec, views in wiring.blocks:
        count = len(views.outputs) if views.judged is None else views.judged
        if count:
            yield f"    all = finite((const double *)&{wiring.law(spec)}.y, {count}u) && all;"
    if any(frame.signals for frame in wiring.plan.tx_frames):
        yield (
            "    all = finite((const double *)&rig.tx, "
            "(uint32_t)(sizeof rig.tx / sizeof(double))) && all;"
        )
    yield "    return all;"
    yield "}"


def _estop(wiring: Wiring) -> Iterator[str]:
    made = wiring.plan
    place = made.table.index.get(f"rx.{made.rig.config.supervisor.estop}")
    yield "bool rig_estop(void)"
    yield "{"
    yield f"    return {'false' if place is None else f'{wiring.at(place)} != 0.0'};"
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
        yield f"uint32_t rig_pack(uint32_t row, uint8_t data[{made.data_bytes}])"
    else:
        yield f"void rig_unpack(uint32_t row, const uint8_t data[{made.data_bytes}])"
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
