"""An executive that comes last, while the nodes below it have met already."""

from pathlib import Path

import can
import pytest
from processes import Running, own_bus, pcpc

from pcpc.drivers.can import bus as buses

RIG = "telerobot-u0"
EXECUTIVE, LOCAL = 0x701, 0x703  # heartbeats
WAITS = bytes([127])


@pytest.mark.parametrize("pacing", ["real", "lockstep"])
def test_who_asks_more_often_than_the_node_below_waits_is_answered(
    pacing: str, tmp_path: Path
) -> None:
    bus = own_bus()
    group, port = buses.udp_address(str(buses.parse(bus)[1]))
    words = [RIG, "--bus", bus, "--pacing", pacing, "--no-figure", "--quiet"]
    with can.Bus(group, interface="udp_multicast", port=port) as above:

        def answered() -> bool:
            message = above.recv(timeout=0.002)
            return message is not None and message.arbitration_id == LOCAL

        with (
            Running("run", "--only=plant", *words) as plant,
            Running("run", "--only=local", *words) as local,
        ):
            while not answered():  # it has met the plant
                assert not plant.over() and not local.over()
            for _ in range(5000):
                above.send(can.Message(arbitration_id=EXECUTIVE, data=WAITS, is_extended_id=False))
                if answered():
                    break
            else:
                raise AssertionError("not answered 5000 heartbeats in 10 s")


def test_a_run_whose_executive_is_started_last_is_whole(tmp_path: Path) -> None:
    words = [RIG, "--bus", own_bus(), "--set", "duration_s=0.2", "--no-figure", "--quiet"]
    words += ["--pacing", "lockstep"]
    with (
        Running("run", "--only=plant", *words) as plant,
        Running("run", "--only=local", *words) as local,
    ):
        done = pcpc("run", "--only=executive", *words, "-o", str(tmp_path / "executive"))
        assert (done.ran, plant.done().code, local.done().code) == (True, 0, 0), f"{done}\n{local}"
