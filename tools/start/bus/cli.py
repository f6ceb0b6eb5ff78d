"""`pcpc bus RIG`: load and worst-case response time of every frame, and what rate would still fit.

`pcpc bus emulate A B` makes a line with a bit rate of two buses, see `tools.start.bus.emulate`.

The bit rate is --bitrate, else the rig's `bus.bitrate`, else 1 Mbit/s, classic CAN's highest: what
is late there is late on any. With --data-bitrate the same frames travel as CAN FD frames that
switch to it. What the numbers mean stands in `tools.start.bus.traffic`, the equations in
`tools.start.bus.response` and `tools.start.bus.arranged`.
"""

import argparse
import json
from collections.abc import Iterator

from pcpc.drivers.errors import Exit
from pcpc.executive.errors import RigError
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.tools.start.bus import figure, report, traffic
from pcpc.tools.start.bus.drive_frames import LEFT_OUT
from pcpc.tools.start.bus.report import Bus, rate_of
from pcpc.tools.start.bus.traffic import MOST_CLASSIC, Setup
from pcpc.tools.start.rigs import find
from pcpc.tools.terminal import screen
from pcpc.tools.terminal.option_notes import refuse
from pcpc.tools.terminal.picture import check_picture

_OF_A_RIG = ("set", "rate", "jitter", "any_phase", "error_every", "plot")


def command(options: argparse.Namespace) -> int:
    """Print the times of all frames; NOT_MET if a frame is late. RigError: wrong input."""
    if options.words[0] == "emulate":
        refuse(options, "about a rig; emulate has none", *_OF_A_RIG)
        from pcpc.tools.start.bus import emulate  # here, because it imports numba

        return emulate.command(options)
    refuse(options, "only with emulate", "queue", "errors", "for_s")
    if options.words[1:]:
        raise RigError(f"{' '.join(options.words[1:])}: one rig at a time")
    check_picture("--plot", options.plot)
    given = [*options.set]
    if options.rate is not None:
        given.append(f"rate_hz={options.rate!r}")
    rig = load_rig(find(options.words[0]), None, given, resolve=False)
    found = list(_buses(rig, options))
    if options.json:
        print(json.dumps(report.as_json(rig, found), indent=2))
    else:
        print("\n\n".join("\n".join(report.text_of(rig, bus)) for bus in found))
        if rig.config.drives:
            print("\n".join(screen.rows([("drives", LEFT_OUT)])))
    if options.plot is not None:
        figure.draw(rig, found, options.plot)
    return Exit.OK if all(traffic.fits(bus.rows) for bus in found) else Exit.NOT_MET


def _buses(rig: Rig, options: argparse.Namespace) -> Iterator[Bus]:
    config = rig.config
    below, name_below = config.second_bus, "local bus" if config.local else "second bus"
    of_rig = (config.bus.bits_per_s, (below and below.bits_per_s) or config.bus.bits_per_s)
    data_of_rig = (config.bus.data_bitrate, below.data_bitrate if below else None)
    jitter_ns, error_every_ns = round(1e9 * options.jitter), round(1e9 * options.error_every)
    if jitter_ns > 1e9 / config.rate_hz:
        what = f"longer than a cycle, {1e3 / config.rate_hz:g} ms: frames would meet the next"
        raise RigError(f"--jitter {1e3 * options.jitter:g}ms: {what}; give less")
    found = traffic.buses(rig, options.any_phase)
    for name, own, data, frames in zip(
        ("bus", name_below), of_rig, data_of_rig, found, strict=False
    ):
        bitrate, origin = _bitrate(options, own)
        fast = options.data_bitrate or data or config.bus.data_bitrate
        is_fd = any(sent.frame.fd for sent in frames)
        switches = any(sent.frame.bits()[1] for sent in frames)
        if switches and fast is not None and fast < bitrate:
            what = f"data at {rate_of(fast)} is slower than the nominal {rate_of(bitrate)}"
            raise rig.error("bus.data_bitrate", what)
        if switches and fast is None:
            what = (
                "its CAN FD frames switch their bit rate; give bus.data_bitrate, or --data-bitrate"
            )
            raise rig.error("bus", what)
        setup = Setup(
            config.rate_hz,
            bitrate,
            fast,
            jitter_ns,
            error_every_ns,
            options.in_order,
            options.data_bitrate is not None and not is_fd,
        )
        yield Bus(name, origin, setup, frames, traffic.response_rows(frames, setup))


def _bitrate(options: argparse.Namespace, of_rig: int | None) -> tuple[int, str]:
    """Return a bus's bit rate and where it comes from; RigError if the data phase is slower."""
    known = {
        "--bitrate": options.bitrate,
        "of the rig": of_rig,
        "assumed, the rig names none": MOST_CLASSIC,
    }
    origin, bitrate = next((name, rate) for name, rate in known.items() if rate is not None)
    if options.data_bitrate is not None and options.data_bitrate < bitrate:
        asked, than = rate_of(options.data_bitrate), rate_of(bitrate)
        raise RigError(f"--data-bitrate {asked}: slower than the nominal {than}; give more")
    return bitrate, origin
