"""Which bus a run takes: its own, its partner's, or the named one; real processes and sockets."""

import os
import socket
import subprocess
import sys
from collections.abc import Iterator

import pytest
from places import ROOT

from pcpc.drivers.can import bus, choice
from pcpc.drivers.can.choice import BusRequest, Choice
from pcpc.drivers.errors import BusError
from pcpc.drivers.machine import claim

BOTH = ("executive", "plant")
TAKE = """
import sys
from pcpc.drivers.can.choice import BusRequest, take_bus
sys.stdin.read(1)
taken = take_bus(BusRequest("auto", None, *sys.argv[1:2], tuple(sys.argv[2].split(","))))
print(taken.bus, flush=True)
sys.stdin.read()
"""
GROUP = "239.74.163.13"


@pytest.fixture
def taken() -> Iterator[list[Choice]]:
    """Choices that are let go after the test."""
    choices: list[Choice] = []
    yield choices
    for one in choices:
        one.release()


def rig(name: str = "rig") -> str:
    """Return a rig's name that only this process uses."""
    return f"{name}-{os.getpid()}"


def auto(name: str, *roles: str, two: bool = False) -> Choice:
    return choice.take_bus(BusRequest("auto", None, name, roles, 1 + two))


def port(one: Choice) -> int:
    return bus.udp_address(one.bus.channel)[1]


def test_runs_take_buses_of_their_own_also_of_the_same_rig(taken: list[Choice]) -> None:
    for name in ("hull", "hull", "engage", "slew10"):
        taken.append(auto(rig(name), *BOTH))
    buses = {str(one.bus) for one in taken}
    assert len(buses) == 4, f"{buses}"


def test_a_bus_is_free_again_after_its_run(taken: list[Choice]) -> None:
    first = auto(rig(), *BOTH)
    first.release()
    taken.append(auto(rig(), *BOTH))
    assert taken[0].bus == first.bus


@pytest.mark.parametrize("order", [("plant", "executive"), ("executive", "plant")])
def test_the_two_nodes_of_a_rig_meet_in_either_order(
    taken: list[Choice], order: tuple[str, str]
) -> None:
    for role in (*order, *order):
        taken.append(auto(rig(), role))
    met = [str(one.bus) for one in taken]
    assert met[0] == met[1] != met[2] == met[3], f"{met}"
    assert taken[1].note == f"joins the {order[0]} there", taken[1].note


def test_three_nodes_meet_and_have_the_bus_beside_theirs(taken: list[Choice]) -> None:
    for role in ("local", "plant", "executive"):
        taken.append(auto(rig(), role, two=True))
    taken.append(auto(rig("other"), *BOTH))
    taken.append(auto(rig("third"), *BOTH, two=True))
    assert len({str(one.bus) for one in taken[:3]}) == 1
    used = {port(taken[0]), port(taken[0]) + 1, port(taken[3]), port(taken[4]), port(taken[4]) + 1}
    assert len(used) == 5, f"{used}"


def test_a_node_on_a_named_bus_is_found_and_other_rigs_are_not_joined(taken: list[Choice]) -> None:
    named = BusRequest("udp_multicast", f"{GROUP}:{47000 + os.getpid() % 1000}", rig(), ("plant",))
    taken.append(choice.take_bus(named))
    taken.append(auto(rig("other"), "executive"))
    taken.append(auto(rig(), "executive"))
    assert taken[1].bus != taken[0].bus == taken[2].bus


def test_a_long_name_of_a_rig_is_as_good(taken: list[Choice]) -> None:
    for name in ("r" * 210, "r" * 209 + "q"):
        taken.append(auto(name, "plant"))
        taken.append(auto(name, "executive"))
    met = [str(one.bus) for one in taken]
    assert met[0] == met[1] != met[2] == met[3], f"{met}"


def test_a_port_of_another_program_is_left_to_it_and_named(taken: list[Choice]) -> None:
    free = auto(rig(), *BOTH)
    free.release()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # as a viewer: it shares
        stranger.bind(("", port(free)))
        taken.append(auto(rig(), *BOTH))
        taken.append(auto(rig("two"), *BOTH, two=True))
    assert port(free) not in (port(taken[0]), port(taken[1])), f"{taken}"
    assert f"another program uses port {port(free)}; to share it: --bus" in taken[0].note


def test_a_named_bus_is_taken_as_named_and_shared(taken: list[Choice]) -> None:
    for name in ("one", "two"):
        default = f"{bus.UDP_GROUP}:{bus.UDP_PORT}"
        taken.append(choice.take_bus(BusRequest("udp_multicast", default, rig(name), BOTH)))
    taken.append(auto(rig(), *BOTH))
    assert [str(one.bus) for one in taken[:2]] == [f"udp_multicast:{bus.UDP_GROUP}"] * 2
    taken[0].release()  # the second is there still
    taken.append(auto(rig(), *BOTH))
    assert bus.UDP_PORT not in (port(taken[2]), port(taken[3])), f"{taken}"


def test_a_seat_with_a_strange_name_harms_nobody(taken: list[Choice]) -> None:
    seat = f"seat/{os.getuid()}/udp_multicast:1/{rig()}/plant/and/more"
    with claim.hold(seat) or socket.socket(), claim.hold("seat/") or socket.socket():
        taken.append(auto(rig(), "executive"))
    assert taken[0].note == "" and taken[0].bus.compiled, f"{taken}"


def test_a_bus_that_another_start_claims_first_is_left_to_it(taken: list[Choice]) -> None:
    free = auto(rig(), *BOTH)
    free.release()
    with claim.hold(choice._name(free.bus)) or socket.socket():
        taken.append(auto(rig(), *BOTH))
    assert port(taken[0]) > port(free) and taken[0].note == "", taken


def test_a_bus_of_python_can_is_claimed_by_nobody() -> None:
    assert choice.take_bus(BusRequest("virtual", "x", rig(), BOTH)).claims == []


def test_the_virtual_interfaces_come_first_and_in_order(monkeypatch: pytest.MonkeyPatch) -> None:
    there = {f"vcan{number}" for number in range(3)}
    monkeypatch.setattr(choice, "vcan_ready", there.__contains__)
    monkeypatch.setattr(choice, "neighbour_of", lambda one: bus.BusAddress("socketcan", "vcan1"))
    for count, expected in ((1, "vcan0 vcan1 vcan2"), (2, "vcan0 vcan1"), (4, "")):
        found = choice._vcans(BusRequest("auto", None, "rig", (), count))
        assert [(one.channel, why) for one, why in found] == [(w, "") for w in expected.split()]
    assert not [*choice._vcans(BusRequest("auto", "can0", "rig", ()))]
    monkeypatch.setattr(choice, "_VCANS", 2)
    assert len([*choice._vcans(BusRequest("auto", None, "rig", ()))]) == 2
    one = auto(rig(), "plant")
    one.release()
    assert choice._name(one.bus) == "bus/socketcan:vcan0"


def test_where_all_is_in_use_or_nothing_can_be_claimed_a_line_says_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(choice, "_PORTS", 2)
    monkeypatch.setattr(choice, "vcan_ready", lambda name: False)
    monkeypatch.setattr(choice, "used_ports", lambda: {bus.UDP_PORT, bus.UDP_PORT + 1})
    with pytest.raises(BusError, match="no free bus: 2 ports of udp_multicast from 43113 on are"):
        auto(rig(), *BOTH)

    def refused(name: str) -> None:
        raise OSError(1, "no sockets")

    monkeypatch.setattr(claim, "hold", refused)
    for interface in ("auto", "udp_multicast"):
        with pytest.raises(BusError, match="no bus can be claimed: no sockets; name one with"):
            choice.take_bus(BusRequest(interface, None, rig(), BOTH))


def test_of_a_machine_that_hides_its_sockets_none_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    def closed(path: str, **_: str) -> None:
        raise PermissionError(path)

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        assert one.getsockname()[1] in choice.used_ports()
        monkeypatch.setattr(choice, "open", closed, raising=False)
        assert choice.used_ports() == set()


@pytest.mark.parametrize(
    "roles", [("executive,plant",) * 4, ("plant", "executive") * 2], ids=["whole", "halves"]
)
def test_starts_in_the_same_instant_all_find_a_bus(roles: tuple[str, ...]) -> None:
    starts = [
        subprocess.Popen(
            [sys.executable, "-c", TAKE, rig("at-once"), role],
            cwd=ROOT,
            text=True,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        for role in roles
    ]
    for one in starts:
        assert one.stdin is not None
        one.stdin.write("!")
        one.stdin.flush()
    found = [one.stdout.readline().strip() for one in starts if one.stdout]
    for one in starts:
        one.communicate()
    both = {name: [r for r, b in zip(roles, found, strict=True) if b == name] for name in found}
    wanted = [["executive,plant"]] * 4 if roles[0] != "plant" else [["executive", "plant"]] * 2
    assert [sorted(one) for one in both.values()] == wanted, f"{both}"
