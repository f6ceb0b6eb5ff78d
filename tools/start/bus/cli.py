"""`pcpc bus RIG`: load and worst-case response time of every frame, and what rate would still fit.

The bit rate is --bitrate, else the rig's `bus.bitrate`, else 1 Mbit/s, classic CAN's highest: what
is late there is late on any. With --data-bitrate the same frames travel as CAN FD frames that
switch to it. What the numbers mean stands in `tools.start.bus.traffic`, the equations in
`tools.start.bus.response` and `tools.start.bus.arranged`.
"""

from collections.abc import Iterator

from pcpc.drivers.errors import Exit
from pcpc.executive.errors import RigError
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.tools.start.bus import figure, report, traffic
from pcpc.tools.start.bus.commands import BusLoadRequest
from pcpc.tools.start.bus.drive_frames import LEFT_OUT
from pcpc.tools.start.bus.report import BusReport, rate_of
from pcpc.tools.start.bus.traffic import MOST_CLASSIC, Setup
from pcpc.tools.terminal import screen
from pcpc.tools.terminal.picture import check_picture


def command(request: BusLoadRequest) -> int:
    """Print the times of all frames; NOT_MET if a frame is late. RigError: wrong input."""
    check_picture("--plot", request.plot)
    given = [*request.set]
    if request.rate_hz is not None:
        given.append(f"rate_hz={request.rate_hz!r}")
    rig = load_rig(request.rig, None, given, resolve=False)
    found = list(_buses(rig, request))
    lines = [line for bus in found for line in ("", *report.lines(rig, bus))][1:]
    lines += [f"drives  {LEFT_OUT}"] * bool(rig.config.drives)
    screen.answer(request.json, report.times(rig, found), lines, 2)
    if request.plot is not None:
        figure.draw(rig, found, request.plot)
    return Exit.OK if all(traffic.fits(bus.rows) for bus in found) else Exit.NOT_MET


def _buses(rig: Rig, request: BusLoadRequest) -> Iterator[BusReport]:
    config = rig.config
    below, name_below = config.second_bus, "local bus" if config.local else "second bus"
    of_rig = (config.bus.bits_per_s, (below and below.bits_per_s) or config.bus.bits_per_s)
    data_of_rig = (config.bus.data_bitrate, below.data_bitrate if below else None)
    jitter_ns, error_every_ns = round(1e9 * request.jitter_s), round(1e9 * request.error_every_s)
    if jitter_ns > 1e9 / config.rate_hz:
        what = f"longer than a cycle, {1e3 / config.rate_hz:g} ms: frames would meet the next"
        raise RigError(f"--jitter {1e3 * request.jitter_s:g}ms: {what}; give less")
    found = traffic.buses(rig, request.any_phase)
    for name, own, data, frames in zip(
        ("bus", name_below), of_rig, data_of_rig, found, strict=False
    ):
        bitrate, origin = _bitrate(request, own)
        fast = request.data_bitrate or data or config.bus.data_bitrate
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
            request.in_order,
            request.data_bitrate is not None and not is_fd,
        )
        yield BusReport(name, origin, setup, frames, traffic.response_rows(frames, setup))


def _bitrate(request: BusLoadRequest, of_rig: int | None) -> tuple[int, str]:
    """Return a bus's bit rate and where it comes from; RigError if the data phase is slower."""
    known = zip(report.ORIGINS, (request.bitrate, of_rig, MOST_CLASSIC), strict=True)
    origin, bitrate = next((name, rate) for name, rate in known if rate is not None)
    if request.data_bitrate is not None and request.data_bitrate < bitrate:
        asked, than = rate_of(request.data_bitrate), rate_of(bitrate)
        raise RigError(f"--data-bitrate {asked}: slower than the nominal {than}; give more")
    return bitrate, origin
