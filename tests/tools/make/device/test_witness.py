"""When a device's frames came: counts of made-up frames, and those of a real bus."""

import socket
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from processes import ROOT, own_bus, pcpc

from pcpc.drivers.can import bus as buses
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.make.device.witness import FILE, FIRST, Arrivals, share

FOLDER = ROOT / "plants" / "probe" / "device"
RIG = str(FOLDER / "rig.yaml")
SYNC, CMD, FB = 0x080, 0x0A0, 0x120
T_NS = 1_000_000


def cycles(arrivals: Arrivals, late_us: dict[int, int], answer_us: int) -> None:
    """Feed 200 cycles: SYNC, feedback 30 us later, a command so much later still."""
    for k in range(200):
        begin = k * T_NS + 1000 * late_us.get(k, 0)
        arrivals.came(SYNC, begin)
        arrivals.came(FB, begin + 30_000)
        arrivals.came(CMD, begin + 30_000 + 1000 * answer_us)
        arrivals.came(CMD, begin + 30_000 + 5000 * answer_us)  # the first one is the answer


def test_jitter_and_reaction_are_counted_as_they_are_defined() -> None:
    heard = Arrivals(SYNC, [CMD], [FB], T_NS)
    cycles(heard, {100: 7}, 12)
    assert heard.counts["jitter"] == {0: 200 - FIRST - 2, 7: 2}  # before the late one, and behind
    assert heard.counts["reaction"] == {12: 200}
    assert share(heard.counts["jitter"], 100.0) == 7.0


def test_the_ids_are_those_of_the_rig() -> None:
    of_rig = Arrivals.of(load_rig(RIG, resolve=False))
    assert (of_rig.sync, of_rig.commands, of_rig.plant) == (SYNC, {CMD}, {FB})
    assert of_rig.period_ns == T_NS


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_share_is_that_of_the_sorted_values(seed: int) -> None:
    values = np.random.default_rng(seed).integers(0, 50, 333)
    for percent in (0.0, 50.0, 99.0, 100.0):
        exact = np.percentile(values, percent, method="lower")
        assert share(Counter(values.tolist()), percent) == exact
    with pytest.raises(ValueError, match="nothing"):
        share(Counter(), 50.0)


@contextmanager
def hearing(name: str) -> Iterator[tuple[socket.socket, buses.BusAddress]]:
    bus = buses.bus_named(*buses.parse(name))
    with buses.listener(bus) as ear:
        yield ear, bus


def test_a_listener_hears_what_is_sent_with_the_time_of_sending() -> None:
    name = own_bus()
    with hearing(name) as (ear, bus), pytest.raises(BlockingIOError):
        ear.recvmsg(512, 64)
    with hearing(name) as (ear, bus):
        group, port = buses.udp_address(bus.channel)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as mouth:
            loopback = socket.inet_aton(buses.LOOPBACK)
            mouth.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, loopback)
            mouth.sendto(b"one", (group, port))
        data, ancillary, _, _ = ear.recvmsg(512, 64)
        assert data == b"one" and len(ancillary) == 1


def test_a_run_on_the_clock_tells_jitter_and_reaction_of_its_device(tmp_path: Path) -> None:
    device = (sys.executable, str(FOLDER / "probe.py"), "{bus}", "200", "100")
    words = ("--pacing", "real", "--set", "rate_hz=100", "--set", "duration_s=2", "--no-figure")
    bus, folder = own_bus(), tmp_path / "run"
    done = pcpc(
        "plant", RIG, "--bus", bus, "-o", str(folder), "--json", *words, "--device", *device
    )
    timing = done.summary["device"]["timing"]
    assert 0.0 < timing["reaction_p50_us"] <= timing["reaction_p99_us"] <= timing["reaction_max_us"]
    assert 0.0 <= timing["jitter_p50_us"] <= timing["jitter_max_us"]
    assert not (folder / FILE).exists()
