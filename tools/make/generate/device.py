"""The executive of a rig as a device in C: what `pcpc generate c RIG --device` writes.

NAME.h, NAME.c        the law of each block, as `laws` gives it
rig.h, rig.c          blocks, wiring, limits, frames of this rig
frames.h, frames.c    pack and unpack, from the DBC file
supervisor.h, .c      states, table, faults, as `executive.loop` declares them
codec, device, run    the same for all rigs: CRC and counters, supervisor, the order of a run
main_linux.c, ...     for a machine: Linux with CAN; a Cortex-M with a UART
Makefile              `make linux m7 m4`
"""

import re
from importlib import resources

from pcpc.executive.errors import RigError
from pcpc.executive.nodes.plan import plan
from pcpc.executive.rig.reading import Rig
from pcpc.tools.make.generate import declared, frames, rig_source
from pcpc.tools.make.generate.rig_source import DeviceWiring
from pcpc.tools.make.generate.translator import elementary
from pcpc.tools.terminal.rooms import part_of

_FIXED = resources.files("pcpc.tools.make.generate") / "c"
_SAME = (  # for all rigs
    "codec.c", "codec.h", "device.c", "device.h", "rig_parts.h", "run.c", "run.h", "port.h",
    "main_linux.c", "main_mps2.c", "slcan.c", "slcan.h", "startup.c", "soft_double.c", "mps2.ld",
    "qemu.sh", "Makefile",
)  # fmt: skip
_PART = re.compile(r"^#if PCPC_(\w+)\n(.*?)(?:^#else\n(.*?))?^#endif\n", re.MULTILINE | re.DOTALL)
_ROOM = re.compile(r"\bROOM")


def device(rig: Rig, xcp: str | None = None) -> dict[str, str]:
    """Return the files of a rig's device by name; RigError for what a device in C cannot do.

    `xcp`: the two ids of its XCP slave, None: without one.
    """
    _check(rig)
    # faults on purpose are the executive's, not the device's
    made = plan(rig.changed(faults={}, losses={}), "executive", "lockstep")
    files = same_files(made.fd, xcp is not None) | elementary.files() | declared.files()
    files["frames.h"] = frames.header(made.tx_frames, made.rx_frames)
    files["frames.c"] = frames.source(made.tx_frames, made.rx_frames)
    wiring = DeviceWiring(made)
    _check_plan(wiring)
    files["rig.h"], files["rig.c"] = rig_source.header(made), rig_source.source(wiring)
    for spec, views in zip(made.spec.blocks, made.views, strict=True):
        law = wiring.law_files(spec, views)
        if taken := sorted(law.keys() & files):
            raise RigError(f"{spec.where()}: {spec.name}: {taken[0]} is another file; rename it")
        files |= law
    if xcp is not None:
        places = [(one, wiring.held(i)) for i, one in enumerate(made.table.variables)]
        files = part_of("live/xcp", "firmware").with_xcp(files, rig, places, xcp)
    return dict(sorted(files.items()))


def same_files(fd: bool, xcp: bool = False) -> dict[str, str]:
    """Return what is the same for all rigs, with the parts `#if PCPC_...` that are wanted.

    FD      a rig with a frame of CAN FD: each has room for ROOM = 64 bytes instead of 8, and its
            kind in `flags`, as Linux' struct canfd_frame has it. One of another kind than the DBC
            file says counts as one of a wrong length, as in `drivers.can.codec`.
    XCP     a device with an XCP slave
    """
    chosen = {"FD": fd, "XCP": xcp}
    texts = {name: (_FIXED / name).read_text() for name in _SAME}
    for name, text in texts.items():
        part = _PART.sub(lambda found: found[2] if chosen[found[1]] else found[3] or "", text)
        texts[name] = _ROOM.sub("64" if fd else "8", part)
    return texts


def _check(rig: Rig) -> None:
    """Raise RigError for what only the executive does."""
    config = rig.config
    if config.executive.plausible:
        what = "a device in C does not judge what it hears; leave it to the rig's executive"
        raise rig.error("executive.plausible", what)
    if config.supervisor.arm == "manual":
        what = "a device in C has no operator who arms it; --set supervisor.arm=automatic"
        raise rig.error("supervisor.arm", what)
    if config.standby:
        raise rig.error("standby", "a device in C has one controller, and none on standby")


def _check_plan(wiring: DeviceWiring) -> None:
    """Raise RigError for what the node of a device would have to be told, or to hear, elsewhere."""
    made = wiring.plan
    if made.below:
        other = min(made.below)
        raise RigError(f"{made.rig.path}: {other} is on a second bus; a device in C is on one")
    for _, place, _ in made.schedule:
        if not wiring.held(place):
            name = made.table.variables[place].name
            what = f"{name} is of the loop, which a device in C does not tune; tune blocks"
            raise made.rig.error("schedule", what)
