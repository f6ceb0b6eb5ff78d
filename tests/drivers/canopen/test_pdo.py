"""PDOs, NMT, SYNC and heartbeats: when what is sent, what is taken, how it is changed."""

import pytest
from drives import NODE, Bench

from pcpc.drivers.canopen import dictionary as why
from pcpc.drivers.canopen.layout import Heartbeat, Od

TPDO, RPDO = 0x180 + NODE, 0x200 + NODE
OFF = 1 << 31
FULL = 0x6064_0020  # position actual, 32 bits


def mapped(bench: Bench, index: int, cob_id: int, kind: int, *entries: int) -> Bench:
    """Map a PDO anew by SDO, as CiA 301 wants it."""
    assert bench.write(index, 1, cob_id | OFF, 4) == 0
    assert bench.write(index, 2, kind, 1) == 0
    assert bench.write(index + 0x200, 0, 0, 1) == 0
    for i, entry in enumerate(entries):
        assert bench.write(index + 0x200, i + 1, entry, 4) == 0
    assert bench.write(index + 0x200, 0, len(entries), 1) == 0
    assert bench.write(index, 1, cob_id, 4) == 0
    return bench


def test_it_boots_and_beats() -> None:
    bench = Bench()
    assert [(one.id, one.data) for one in bench.said] == [(0x705, b"\0")]
    assert bench.write(0x1017, 0, 10, 2) == 0
    beats = bench.cycles(50).sent(0x705)[1:]
    assert [one.cycle for one in beats] == list(range(10, 51, 10))
    assert {one.data for one in beats} == {b"\x7f"}


@pytest.mark.parametrize(("code", "state"), [(1, 5), (2, 4), (128, 127), (129, 127), (130, 127)])
@pytest.mark.parametrize("node", [0, NODE, NODE + 1])
def test_the_master_commands_all_or_one(code: int, state: int, node: int) -> None:
    bench = Bench()
    bench.send(0, bytes([code, node]))
    bench[Od.HEARTBEAT_MS] = 1
    assert bench.cycles(2).sent(0x705)[-1].data[0] == (state if node in (0, NODE) else 127)


def test_a_drive_that_starts_itself_is_operational() -> None:
    assert Bench(starts={"1F80": 8}).d.state.nmt == Heartbeat.OPERATIONAL


def test_resets_give_the_objects_their_first_values() -> None:
    bench = Bench().operational().enabled(9)
    for row in (Od.HEARTBEAT_MS, Od.ACCELERATION):
        bench[row] = 77
    bench.send(0, bytes([130, NODE]))
    assert (bench[Od.HEARTBEAT_MS], bench[Od.ACCELERATION]) == (0, 77)
    bench.send(0, bytes([129, NODE]))
    assert bench[Od.ACCELERATION] == 10_000 and bench[Od.CONTROLWORD] == 0
    bench.cycles(1)
    assert bench[Od.STATUSWORD] & 0x6F == 0x40 and bench.u == 0.0


def test_the_statusword_is_sent_when_it_changes_and_every_20_ms() -> None:
    bench = Bench().operational().cycles(50)
    assert [one.cycle for one in bench.sent(TPDO)] == [1, 21, 41]
    bench.send(RPDO, bytes([6, 0]))
    bench.cycles(1)
    assert bench.sent(TPDO)[-1].data == (0x0221 | 0x10).to_bytes(2, "little")


def test_no_pdo_is_sent_or_taken_before_the_start() -> None:
    bench = Bench()
    bench.send(RPDO, bytes([6, 0]))
    assert not bench.cycles(5).sent(TPDO) and bench[Od.CONTROLWORD] == 0


def test_the_inhibit_time_holds_back() -> None:
    bench = Bench()
    assert bench.write(0x1800, 3, 50, 2) == why.NOT_NOW, "while it is valid"
    mapped(bench, 0x1800, TPDO, 255, FULL)
    bench.write(0x1800, 1, TPDO | OFF, 4)
    assert bench.write(0x1800, 3, 50, 2) == 0  # 5 ms
    bench.write(0x1800, 1, TPDO, 4)
    bench.write(0x1800, 5, 0, 2)
    bench.operational().w = 5.0
    cycles = [one.cycle for one in bench.cycles(21).sent(TPDO)]
    assert cycles == [1, 6, 11, 16, 21]


@pytest.mark.parametrize("every", [1, 3, 240])
def test_synchronous_ones_go_out_with_every_nth_sync(every: int) -> None:
    bench = mapped(Bench(), 0x1801, 0x285, every, FULL).operational()
    for _ in range(3 * every):
        bench.cycles(1)
        assert bench.send(0x080) == []
        bench.cycles(1)
    assert len(bench.sent(0x285)) == 3


def test_kind_0_goes_out_with_a_sync_if_it_has_changed() -> None:
    bench = mapped(Bench(), 0x1801, 0x285, 0, FULL).operational()
    counts = []
    for q in (0.0, 0.0, 0.5, 0.5, 0.7):
        bench.q = q
        bench.cycles(1).send(0x080)
        counts.append(len(bench.cycles(1).sent(0x285)))
    assert counts == [1, 1, 2, 2, 3]


def test_a_received_one_waits_for_sync() -> None:
    bench = mapped(Bench(), 0x1401, 0x305, 1, 0x6040_0010, 0x60FF_0020).operational()
    bench.send(0x305, bytes.fromhex("060018fcffff"))
    assert bench[Od.CONTROLWORD] == 0
    bench.send(0x080)
    assert bench[Od.CONTROLWORD] == 6 and bench[Od.TARGET_VELOCITY] == -1000


def test_eight_bytes_in_eight_entries() -> None:
    entry = 0x6060_0008
    bench = mapped(Bench(), 0x1401, 0x305, 255, *[entry] * 8).operational()
    bench.send(0x305, bytes([0, 0, 0, 0, 0, 0, 0, 9]))
    assert bench[Od.MODE] == 9
    assert Bench().write(0x1601, 0, 9, 1) == why.TOO_HIGH


def test_a_short_frame_is_an_emergency_and_not_taken() -> None:
    bench = Bench().operational()
    bench.send(RPDO, b"\x06")
    assert bench.sent(0x085)[-1].data[:2] == (0x8210).to_bytes(2, "little")
    assert bench[Od.CONTROLWORD] == 0


def test_values_beyond_their_bounds_are_not_taken() -> None:
    bench = mapped(Bench(), 0x1401, 0x305, 255, 0x6072_0010, 0x6060_0008).operational()
    bench.send(0x305, bytes.fromhex("e9037f"))  # 1001 of 1000, mode 127
    assert bench[Od.MAX_TORQUE] == 1000 and bench[Od.MODE] == 0


@pytest.mark.parametrize(("write", "code"), [
    ((0x1600, 0, 0, 1), why.NOT_NOW),  # valid
    ((0x1601, 1, 0x6041_0010, 4), why.NOT_NOW),  # has entries
    ((0x1400, 1, 0x206, 4), why.WRONG_VALUE),  # another id while valid
    ((0x1401, 1, 0x605, 4), why.WRONG_VALUE),  # of an SDO
    ((0x1401, 1, 0x2000_0305, 4), why.WRONG_VALUE),  # 29 bits
    ((0x1401, 2, 241, 1), why.WRONG_VALUE),  # reserved
    ((0x1801, 2, 252, 1), why.WRONG_VALUE),  # with remote frames
])  # fmt: skip
def test_a_change_that_cannot_be_is_refused(write: tuple[int, int, int, int], code: int) -> None:
    assert Bench().write(*write) == code


@pytest.mark.parametrize(("index", "entry", "code"), [
    (0x1601, 0x6041_0010, why.NOT_MAPPABLE),  # the drive says it
    (0x1A01, 0x6065_0020, why.NOT_MAPPABLE),  # no process data
    (0x1601, 0x6040_0020, why.NOT_MAPPABLE),  # has 16 bits
    (0x1601, 0x2000_0020, why.NO_OBJECT),
    (0x1601, 0x6040_0110, why.NO_SUBINDEX),
])  # fmt: skip
def test_what_cannot_be_mapped_is_refused(index: int, entry: int, code: int) -> None:
    bench = Bench()
    assert bench.write(index, 0, 0, 1) == 0
    assert bench.write(index, 1, entry, 4) == code


def test_more_than_eight_bytes_are_refused() -> None:
    bench = Bench()
    assert bench.write(0x1A01, 0, 0, 1) == 0
    for i in range(3):
        assert bench.write(0x1A01, i + 1, FULL, 4) == 0
    assert bench.write(0x1A01, 0, 3, 1) == why.TOO_LONG_PDO


def test_a_second_drive_of_its_number_is_noticed() -> None:
    bench = Bench()
    for twin in (0x085, 0x185, 0x585, 0x705):
        bench.send(twin, bytes(8))
        assert bench.whose == 3, hex(twin)
    bench.send(0x286, bytes(8))
    assert bench.whose == 0


def test_a_master_that_guards_its_nodes_gets_the_state_and_a_bit_that_toggles() -> None:
    bench = Bench()
    guard = 0x700 + NODE | 1 << 30  # a remote frame
    assert [bench.send(guard)[0].data for _ in range(3)] == [b"\x7f", b"\xff", b"\x7f"]
    bench.operational()
    assert [one.data for one in bench.send(guard)] == [b"\x85"]
    bench.send(0, bytes([130, NODE]))
    assert bench.send(guard)[-1].data == b"\x7f", "it begins anew"
    assert bench.send(0x701 | 1 << 30) == [] and bench.send(0x600 + NODE | 1 << 30) == []
