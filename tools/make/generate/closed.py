"""The closed loop of a rig as one C program without I/O: all nodes, the frames between them.

It prints the digest of all recorded states and outputs of the blocks of all nodes, over the first
cycles of the run. A cycle is that of `executive.loop.exchange`: the executive works on sample k,
its frames go down, each node from the lowest up works on what has come. All nodes are in RUN but
for the first two cycles; no frame is lost.

    digest = (digest ^ bits) 1099511628211 mod 2^64, a word a value, NaN as 7FF8000000000000
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can import dbc
from pcpc.executive.log.reader import Log
from pcpc.executive.loop.states import State
from pcpc.executive.rig import messages
from pcpc.executive.rig.reading import Rig
from pcpc.tools.after.run_digest import in_order
from pcpc.tools.make.generate import frames
from pcpc.tools.make.generate.node import NodeWiring, rig_files
from pcpc.tools.make.generate.translator.kinds import Untranslatable
from pcpc.tools.make.generate.words import identifier

PORT = Path(__file__).with_name("closed.inc")
BASIS, PRIME, NAN = 14695981039346656037, 1099511628211, 0x7FF8000000000000


class ClosedLoop:
    """The nodes of a rig, wired by frames."""

    def __init__(self, rig: Rig, in_single: bool = False) -> None:
        """`in_single`: all nodes but the plant compute with floats."""
        lost = [name for name, loss in rig.config.losses.items() if loss.share > 0.0]
        if lost:
            cure = " ".join(f"--set losses.{name}.share=0" for name in lost)
            raise Untranslatable(f"{rig.path}: losses on purpose have no C; {cure}")
        if rig.config.bus.emulate is not None:
            raise rig.error("bus.emulate", "an emulated line has no C; --set bus.emulate=null")
        self.rig = rig
        self.nodes = {role: NodeWiring(rig, role, role) for role in rig.roles}
        self.texts: dict[str, str] = {}
        self.single: dict[str, bool] = {role: in_single and role != "plant" for role in rig.roles}
        for role in rig.roles:
            self.texts |= rig_files(rig, role, role, self.single[role])
        for wiring in self.nodes.values():  # finds out what of the loop is sent
            for block in (*range(len(wiring.plan.spec.blocks)), -1):
                wiring.copies(block)

    def columns(self) -> dict[str, list[tuple[str, str]]]:
        """Return of each node the digested variables: name, and expression in C."""
        found: dict[str, list[tuple[str, str]]] = {}
        for role, wiring in self.nodes.items():
            variables = wiring.plan.table.variables
            places = [p for _, views in wiring.blocks for p in (*views.states, *views.outputs)]
            texts = {variables[p].name: wiring.places[p] for p in places if variables[p].recorded}
            found[role] = [
                (name, texts[name].replace("rig->", f"{role}_node.", 1))
                for name in in_order([(one.name, one.kind, one.writer) for one in variables])
                if name in texts
            ]
        return found

    def files(self, cycles: int) -> dict[str, str]:
        """Return the files of the program that runs so many cycles."""
        return self.around("\n".join(self._main(cycles)))

    def around(self, main: str) -> dict[str, str]:
        """Return the files of a program with the nodes, its `main.c` given."""
        sent = {f.name: f for wiring in self.nodes.values() for f in wiring.plan.tx_frames}
        used = list(sent.values())
        return {
            **self.texts,
            "frames.h": frames.header(used, used),
            "frames.c": frames.source(used, used),
            "main.c": main,
        }

    def _main(self, cycles: int) -> Iterator[str]:
        yield "/* The closed loop of a rig; prints the digest of what its nodes record. */"
        yield f"#define CYCLES {cycles}U"
        yield from self.declared()
        yield PORT.read_text(encoding="utf-8")
        for node, columns in self.columns().items():
            yield f"static uint64_t {node}_digest = {BASIS}U;\n\nstatic void {node}_mix(void)\n{{"
            yield f"    uint64_t h = {node}_digest;"
            yield from (f"    h = mix(h, (double){text});" for _, text in columns)
            yield f"    {node}_digest = h;\n}}\n"
        yield from self.cycles()
        roles = list(self.nodes)
        below = [*reversed(roles[1:])]
        yield "int main(void)\n{"
        yield f"    if (({self.refused}) != 0) {{"
        yield '        say("refused");\n        finish();\n        return 1;\n    }'
        yield from (f"    {role}_cycle(0U);" for role in below)
        yield f"    for (uint32_t k = 0U; k < {cycles}U; k += 1U) {{"
        yield f"        {roles[0]}_cycle(k);"
        yield from (f"        {role}_cycle(k + 1U);" for role in below)
        yield "    }"
        yield "    uint64_t all = 0U;"
        yield from (f"    all = (all ^ {role}_digest) * {PRIME}U;" for role in roles)
        yield "    say_hex(all);\n    cost_say();\n    finish();\n    return 0;\n}\n"

    @property
    def refused(self) -> str:
        """What sets all nodes to their first values, in C; not 0: a self-test refuses."""
        return " | ".join(f"{role}_rig_init(&{role}_node)" for role in self.nodes)

    def declared(self) -> Iterator[str]:
        """Yield what is included, and the nodes with what they hear and send."""
        yield from (f'#include "{role}_rig.h"' for role in self.nodes)
        yield from ('#include "frames.h"', '#include "pcpc_math.h"', "")
        for role in self.nodes:
            yield f"static {role}_rig {role}_node;"
            yield f"static {role}_received {role}_in;"
            yield f"static {role}_sent {role}_out;"

    def cycles(self) -> Iterator[str]:
        """Yield ROLE_cycle(k) of all nodes; each calls its ROLE_mix."""
        for role, wiring in self.nodes.items():
            yield from self._send(role, wiring)
            yield from self._cycle(role, wiring)

    def _cycle(self, role: str, wiring: NodeWiring) -> Iterator[str]:
        """Yield one cycle of a node; a lower one is not mixed in its last cycle."""
        first = role == next(iter(self.nodes))
        run, before = State.RUN, State.READY if first else State.INIT
        early = f"(k < {run - before}U)"
        yield f"static void {role}_cycle(uint32_t k)\n{{"
        loop, number = set(wiring.loop), "float" if self.single[role] else "double"
        values = {
            "supervisor_state": f"{early} ? (double)(k + {before}U) : {float(run)}",
            "supervisor_nmt": f"{early} ? {float(before.heartbeat)} : {float(run.heartbeat)}",
            "supervisor_gain": "1.0",
            "supervisor_saturated": "(clamped != 0U) ? 1.0 : 0.0",
            "health_passes": "(double)k",
        }
        counted = "supervisor_saturated" in loop
        if counted:
            yield "    static uint32_t clamped;"
        for name, text in values.items():
            if name in loop:
                yield f"    {role}_node.loop.{name} = ({number})({text});"
        if first:
            yield "    cost_begin();"
        yield f"    (void){role}_rig_step(&{role}_node, k, &{role}_in, &{role}_out);"
        if first:
            yield "    cost_end();"
        given = f"&{role}_node, false, false, ({number})1.0, &{role}_out"
        first_sum, next_sum = ("clamped = ", "clamped += ") if counted else ("(void)", "(void)")
        yield f"    {first_sum}(uint32_t){role}_rig_limit({given});"
        yield f"    {next_sum}{role}_send(k);"
        yield f"    if (k < CYCLES) {{\n        {role}_mix();\n    }}\n}}\n"

    def _send(self, role: str, wiring: NodeWiring) -> Iterator[str]:
        """Yield what carries the frames of a node to all others, by their bytes."""
        rate = self.rig.config.rate_hz
        yield f"static uint32_t {role}_send(uint32_t k)\n{{"
        room = frames.data_bytes(wiring.plan.tx_frames)
        yield f"    uint32_t clamped = 0U;\n    uint8_t data[{room}];\n"
        yield "    (void)k;\n    (void)data;"
        for frame in wiring.plan.tx_frames:
            if not frame.signals or messages.is_emergency(frame):
                continue
            name, every = identifier(frame.name), frame.every_n(rate)
            yield f"    if ((k % {every}U) == 0U) {{" if every > 1 else "    {"
            yield f"        {name}_signals s;"
            for signal in frame.signals:
                its = identifier(signal.name)
                yield f"        s.{its} = (double){role}_out.{_flat(frame, signal.name)};"
            yield f"        clamped += pack_{name}(&s, data);"
            for other, theirs in self.nodes.items():
                if frame.name in [one.name for one in theirs.plan.rx_frames]:
                    if frame.selector:  # what is not in this layout stays as it was
                        for signal in frame.signals:
                            place = f"{other}_in.{_flat(frame, signal.name)}"
                            yield f"        s.{identifier(signal.name)} = (double){place};"
                    yield f"        unpack_{name}(data, &s);"
                    for signal in frame.signals:
                        its = identifier(signal.name)
                        number = "float" if self.single[other] else "double"
                        place = f"{other}_in.{_flat(frame, signal.name)}"
                        yield f"        {place} = ({number})s.{its};"
            yield "    }"
        yield "    return clamped;\n}\n"


def _flat(frame: dbc.Frame, signal: str) -> str:
    return identifier(f"{frame.name}.{signal}")


def digest_of(log: Log, columns: Mapping[str, Sequence[tuple[str, str]]], cycles: int) -> str:
    """Return the digest of a log of the same rig, as the program prints it."""
    whole = 0
    for role, names in columns.items():
        recorded = log.node[role].columns
        table: NDArray[np.float64] = np.stack([recorded[name] for name, _ in names])[:, :cycles].T
        words = np.ascontiguousarray(table).view(np.uint64)
        words = np.where(np.isnan(table), np.uint64(NAN), words)
        digest = BASIS
        for word in words.ravel().tolist():
            digest = ((digest ^ word) * PRIME) & (2**64 - 1)
        whole = ((whole ^ digest) * PRIME) & (2**64 - 1)
    return f"{whole:016x}"
