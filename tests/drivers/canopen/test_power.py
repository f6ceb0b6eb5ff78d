"""The power state machine: every transition of CiA 402, legal and illegal; options, faults."""

import pytest
from drives import Bench

from pcpc.drivers.canopen.layout import Od, Power
from pcpc.drivers.canopen.power import next_power

NOT, DISABLED, READY, ON, ENABLED, QUICK, REACTION, FAULT = Power
MASKS = {NOT: 0x4F, DISABLED: 0x4F, READY: 0x6F, ON: 0x6F, ENABLED: 0x6F, QUICK: 0x6F,
         REACTION: 0x4F, FAULT: 0x4F}  # fmt: skip
SHUTDOWN, SWITCH_ON, ENABLE, DISABLE, STOP = "shutdown", "switch on", "enable", "voltage", "stop"
LEGAL = {  # from IEC 61800-7-201, by number; what is not here stays where it is
    (DISABLED, SHUTDOWN): READY,  # 2
    (READY, SWITCH_ON): ON,  # 3
    (READY, ENABLE): ON,  # 3, and 4 in the next cycle
    (ON, ENABLE): ENABLED,  # 4
    (ENABLED, SWITCH_ON): ON,  # 5
    (ON, SHUTDOWN): READY,  # 6
    (READY, DISABLE): DISABLED,  # 7
    (READY, STOP): DISABLED,  # 7
    (ENABLED, SHUTDOWN): READY,  # 8
    (ENABLED, DISABLE): DISABLED,  # 9
    (ON, DISABLE): DISABLED,  # 10
    (ON, STOP): DISABLED,  # 10
    (ENABLED, STOP): QUICK,  # 11
    (QUICK, DISABLE): DISABLED,  # 12
}


def wanted(word: int) -> str:
    """Return what the standard's table reads out of bits 3 to 0, written a second time."""
    if not word & 0b10:
        return DISABLE
    if not word & 0b100:
        return STOP
    if not word & 0b1:
        return SHUTDOWN
    return ENABLE if word & 0b1000 else SWITCH_ON


@pytest.mark.parametrize("option", range(7))
@pytest.mark.parametrize("power", Power)
def test_every_controlword_in_every_state(power: Power, option: int) -> None:
    for word in range(256):
        for before in (0, 0x80):
            expected = LEGAL.get((power, wanted(word)), power)
            if power == QUICK and wanted(word) == ENABLE and option >= 5:
                expected = ENABLED  # 16
            if (power, wanted(word), option) == (ENABLED, STOP, 0):
                expected = DISABLED
            if power == NOT:
                expected = DISABLED  # 1
            if power == FAULT and word & 0x80 and not before:
                expected = DISABLED  # 15
            assert next_power(power, word, before, option) == expected, (word, before)


def test_statuswords_tell_all_states_apart() -> None:
    for state, mask in MASKS.items():
        told = [one for one, other in MASKS.items() if state.word & other == one.word]
        assert told == [state], (state, mask)


def test_the_way_up_is_seen_in_the_statusword() -> None:
    bench, seen = Bench(), []
    for word in (0, 0x06, 0x07, 0x0F, 0x07, 0x06, 0x00):
        bench[Od.CONTROLWORD] = word
        seen.append(bench.cycles(1)[Od.STATUSWORD] & 0x6F)
    assert seen == [0x40, 0x21, 0x23, 0x27, 0x23, 0x21, 0x40]


def speed_up(option: int, deceleration: int = 20_000) -> Bench:
    bench = Bench(starts={"605A": option, "6085": deceleration}).enabled(9)
    bench[Od.TARGET_VELOCITY] = 2000
    bench.cycles(1500)
    assert abs(bench.w - 2.0) < 0.02
    bench[Od.CONTROLWORD] = 0x0B & ~4
    return bench


@pytest.mark.parametrize(("option", "end"), [(0, DISABLED), (1, DISABLED), (2, DISABLED),
                                             (5, QUICK), (6, QUICK)])  # fmt: skip
def test_a_quick_stop_ends_as_its_option_says(option: int, end: Power) -> None:
    bench = speed_up(option).cycles(1)
    assert bench.d.state.power == (DISABLED if option == 0 else QUICK)
    ramp = {1: 200, 5: 200, 2: 100, 6: 100}.get(option, 0)  # 2000/10000 s, 2000/20000 s
    if ramp:
        bench.cycles(ramp - 5)
        assert bench.d.state.power == QUICK
        bench.cycles(10)
    assert bench.d.state.power == end
    if end == QUICK:
        assert abs(bench.cycles(300).w) < 0.02, "it holds still under power"
        bench[Od.CONTROLWORD] = 0x0F
        assert bench.cycles(1).d.state.power == ENABLED
    else:
        assert bench.u == 0.0


def test_a_following_error_is_a_fault_with_its_reaction_and_reset() -> None:
    bench = Bench(held=True, starts={"6065": 100, "6066": 20}).operational().enabled(8)
    bench[Od.TARGET_POSITION] = 500
    bench.cycles(20)
    assert bench.d.state.power == ENABLED and bench[Od.STATUSWORD] & 1 << 13
    bench.cycles(2)
    assert bench[Od.ERROR_CODE] == 0x8611 and bench[Od.ERROR_REGISTER] == 0x21
    assert bench.sent(0x085)[-1].data == bytes.fromhex("1186210000000000")
    assert bench.read(0x1003, 1) == 0x8611 and bench.read(0x1003) == 1
    assert bench.cycles(20).d.state.power == FAULT and bench.u == 0.0
    assert bench[Od.STATUSWORD] & 0x4F == 0x08
    bench[Od.CONTROLWORD] = 0x8F
    assert bench.cycles(1).d.state.power == DISABLED
    assert bench.sent(0x085)[-1].data == bytes(8)
    bench.cycles(5)
    assert bench.d.state.power == DISABLED, "bits 3 to 0 of a reset enable nothing"
    assert bench.write(0x1003, 0, 0, 1) == 0 and bench.read(0x1003, 1) == 0


@pytest.mark.parametrize("option", [0, 1, 2])
def test_a_fault_reacts_as_its_option_says(option: int) -> None:
    bench = Bench(starts={"605E": option, "1016.1": 0x01_0032}).enabled(9)
    bench[Od.TARGET_VELOCITY] = 2000
    bench.send(0x701, b"\x05")
    bench.cycles(50)
    assert bench.d.state.power == ENABLED
    bench.send(0x701, b"\x05")
    bench.cycles(51)
    assert bench.d.state.power == ENABLED
    bench.cycles(1)
    assert bench[Od.ERROR_CODE] == 0x8130
    assert bench.d.state.power == (REACTION if option else FAULT)
    assert bench.cycles(400).d.state.power == FAULT


@pytest.mark.parametrize(("option", "end"), [(0, ENABLED), (1, FAULT), (2, DISABLED),
                                             (3, DISABLED)])  # fmt: skip
def test_a_drive_that_is_stopped_reacts_as_its_option_says(option: int, end: Power) -> None:
    bench = Bench(starts={"6007": option}).operational().enabled(9)
    bench[Od.TARGET_VELOCITY] = 1000
    bench.cycles(500).send(0, bytes([2, 5]))
    assert bench.cycles(200).d.state.power == end
    assert bench[Od.ERROR_CODE] == (0x8100 if option == 1 else 0)
    assert not [one for one in bench.sent(0x085) if one.cycle > 500], "stopped, it says nothing"


@pytest.mark.parametrize("option", [2, 3])
def test_a_lost_connection_ends_only_what_has_power(option: int) -> None:
    bench = Bench(starts={"6007": option, "1016.1": 0x01_0032}).operational()
    for word, power in ((6, READY), (7, ON)):
        bench[Od.CONTROLWORD] = word
        assert bench.cycles(2).d.state.power == power
    bench.send(0x701, b"\x05")
    assert bench.cycles(100).d.state.power == ON


def test_cyclic_modes_follow() -> None:
    bench = Bench().operational().enabled(8).cycles(1)
    assert bench[Od.STATUSWORD] & 1 << 12
