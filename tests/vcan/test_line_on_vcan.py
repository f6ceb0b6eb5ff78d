"""The bits of frames as canbusload counts them, and a gateway between vcan0 and vcan1."""

import os
import random
import subprocess
import threading

import can
import numpy as np
import pytest

from pcpc.drivers.can import bus
from pcpc.drivers.line.stuffing import INTERMISSION_BITS, RAW_BITS, WIRE_BITS, encode
from pcpc.executive.nodes.gateway import Gateway

pytestmark = pytest.mark.vcan
WAIT_S = 20.0  # only waited for when a frame is lost


def drawn(draw: random.Random) -> can.Message:
    extended = draw.random() < 0.5
    return can.Message(
        arbitration_id=draw.getrandbits(29 if extended else 11),
        is_extended_id=extended,
        data=bytes(draw.choices([0x00, 0xFF, 0x0F, draw.getrandbits(8)], k=draw.randrange(9))),
    )


def bits_of(message: can.Message) -> int:
    word = message.arbitration_id | message.is_extended_id << 31
    packed = word.to_bytes(4, "little") + bytes([message.dlc, 0, 0, 0])
    frame = np.frombuffer(packed + bytes(message.data).ljust(8, b"\0"), np.uint8)
    wire = np.zeros(WIRE_BITS, np.uint8)
    return int(encode(frame, np.zeros(RAW_BITS, np.uint8), wire)) + INTERMISSION_BITS


def test_canbusload_counts_the_same_bits() -> None:
    draw = random.Random(1)
    messages = [drawn(draw) for _ in range(300)]
    command = ["stdbuf", "-oL", "canbusload", "-e", "vcan0@1000000"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as load:
        assert load.stdout is not None
        frames = bits = sent = 0
        for line in load.stdout:  # a second each: interface, frames, bits, bits of data, load
            if not line.startswith(" vcan0"):
                continue
            if not sent:  # it listens
                with can.Bus(interface="socketcan", channel="vcan0") as out:
                    for message in messages:
                        out.send(message)
                        sent += 1
            frames += int(line.split()[1])
            bits += int(line.split()[2])
            if frames >= sent:
                break
        load.terminate()
    assert (frames, bits) == (300, sum(map(bits_of, messages)))


def test_a_gateway_carries_between_vcan0_and_vcan1_both_ways() -> None:
    sides = [
        bus.BusAddress("socketcan", "vcan0"),
        bus.neighbour_of(bus.BusAddress("socketcan", "vcan0")),
    ]
    gateway = Gateway(256, bitrate=1_000_000)
    gateway.open(sides)
    thread = threading.Thread(target=gateway.carry, daemon=True)
    thread.start()
    draw = random.Random(2)
    messages = [drawn(draw) for _ in range(60)]
    with (
        can.Bus(interface="socketcan", channel="vcan0") as a,
        can.Bus(interface="socketcan", channel="vcan1") as b,
    ):
        for out, into in ((a, b), (b, a)):
            for message in messages:
                out.send(message)
            heard = [into.recv(WAIT_S) for _ in messages]
            found = sorted((m.arbitration_id, bytes(m.data)) for m in heard if m is not None)
            assert found == sorted((m.arbitration_id, bytes(m.data)) for m in messages)
    gateway.stop()
    thread.join()
    for end in (gateway.n.side[0], gateway.n.side[1]):
        os.close(end.fd_rx)  # other tests wait for the first who hears all of vcan0
    assert gateway.n.line.sent.tolist()[:2] == [60, 60]
    assert gateway.n.line.busy == 2 * sum(map(bits_of, messages))


def test_a_sender_that_goes_bus_off_on_the_line_hears_so_from_its_own_channel() -> None:
    sides = [
        bus.BusAddress("socketcan", "vcan0"),
        bus.neighbour_of(bus.BusAddress("socketcan", "vcan0")),
    ]
    gateway = Gateway(8, bitrate=1_000_000, p=1.0)
    gateway.open(sides)
    thread = threading.Thread(target=gateway.carry)
    with can.Bus(interface="socketcan", channel="vcan0") as ours:
        thread.start()
        try:
            ours.send(can.Message(arbitration_id=0x10, is_extended_id=False))
            told = []
            while not told or told[-1] != 0x040:
                message = ours.recv(WAIT_S)
                assert message is not None and message.is_error_frame, (told, message)
                told.append(message.arbitration_id)
        finally:
            gateway.stop()
            thread.join()
            for end in (gateway.n.side[0], gateway.n.side[1]):
                os.close(end.fd_rx)
    assert told == [0x004, 0x004, 0x040], "warning, error passive, bus off"
