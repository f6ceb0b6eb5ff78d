"""The load of a rig's bus, and whether it is too much for a run on a clock."""

from pcpc.drivers.can import dbc
from pcpc.drivers.can.frame_bits import duration_ns
from pcpc.executive.rig.bus_keys import Xcp
from pcpc.executive.rig.messages import database_of, errors_named, frames_by_bus
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.xcp import xcp_frames, xcp_ids


def bus_load(rig: Rig, database: dbc.Database, rate_hz: float, bitrate: float) -> float:
    """Return the worst-case load as a fraction of `bitrate`, of the fuller of a rig's two buses."""
    fast = rig.config.bus.data_bitrate
    buses = frames_by_bus(rig, database)
    loads = [dbc.bus_load(database, rate_hz, bitrate, names, fast) for names in buses]
    for _, frame, count in xcp_frames(rig):
        takes_s = 1e-9 * duration_ns(frame.bits(), bitrate, fast or bitrate)
        loads[0] += count * takes_s * rate_hz / Xcp.CYCLES
    return max(loads)


def check_rate(rig: Rig, pacing: str) -> float:
    """Return the worst-case load of the rig's bus; RigError if frames on a clock would not fit.

    Or if an id of XCP on CAN is another frame's.
    """
    xcp_ids(rig)
    bitrate = rig.config.bus.bits_per_s
    if bitrate is None:
        return 0.0
    database = database_of(rig)
    with errors_named(rig):
        load = bus_load(rig, database, rig.config.rate_hz, bitrate)
    if load > 1.0 and pacing in ("real", "sync"):
        raise rig.error(
            "rate_hz",
            f"{rig.config.rate_hz:g} Hz loads the bus with {load:.1%} of {bitrate} bit/s; "
            "lower rate_hz, use pacing lockstep, or --set bus.bitrate=null for no limit",
        )
    return load
