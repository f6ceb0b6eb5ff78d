"""What a master does wrong is counted, each kind by what it is and by nothing else."""

from collections.abc import Callable
from pathlib import Path

import pytest
from drives import NODE, Bench

from pcpc.drivers.canopen.layout import Mistake, Od, Power
from pcpc.drivers.canopen.power import NEXT, PowerCommand, command_of, is_ignored
from pcpc.executive.log import reader as logs
from pcpc.executive.nodes.virtual import simulate
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.after.verdict.outcome import Outcome
from pcpc.tools.after.verdict.summary import summarise

MASTERED = Path(__file__).parent / "mastered.yaml"
RPDO = 0x200 + NODE


def counted(bench: Bench) -> dict[Mistake, int]:
    """Return the mistakes that were made."""
    return {one: int(bench.d.mistakes[one]) for one in Mistake if bench.d.mistakes[one]}


def with_sync(bench: Bench, kind: int = 1) -> Bench:
    """Let the first received PDO come with SYNC."""
    bench.write(0x1400, 2, kind, 1)
    return bench.operational()


def rounds(bench: Bench, pdos: list[int], every: int = 10) -> Bench:
    """Send so many PDOs before each SYNC."""
    for count in pdos:
        for _ in range(count):
            bench.send(RPDO, b"\x06\x00")
        bench.send(0x80)
        bench.cycles(every)
    return bench


def periods(bench: Bench, gaps: list[int]) -> Bench:
    """Send a SYNC after each of these numbers of cycles; 10 ms are told."""
    bench.write(0x1006, 0, 10_000, 4)
    bench.operational().send(0x80)
    for gap in gaps:
        bench.cycles(gap).send(0x80)
    return bench


CASES: list[tuple[Callable[[Bench], object], dict[Mistake, int]]] = [
    (lambda b: b.read(0x1234), {Mistake.SDO_ABORTED: 1}),
    (lambda b: b.sdo(bytes([0xA0])), {Mistake.SDO_ABORTED: 1}),
    (lambda b: b.operational().send(RPDO, b"\x06"), {Mistake.PDO_SHORT: 1}),
    (lambda b: b.send(RPDO, b"\x06\x00"), {Mistake.PDO_EARLY: 1}),
    (lambda b: rounds(with_sync(b), [1, 1, 0, 1, 2, 1]),
     {Mistake.PDO_MISSING: 1, Mistake.PDO_TWICE: 1}),
    (lambda b: rounds(with_sync(b), [1, 0, 2, 1, 2, 0, 0, 2, 1]), {}),  # a SYNC overtook it
    (lambda b: rounds(with_sync(b), [1, 0, 0, 2, 1]), {Mistake.PDO_MISSING: 1}),
    (lambda b: rounds(with_sync(b), [1, 3, 1]), {Mistake.PDO_TWICE: 1}),
    (lambda b: rounds(with_sync(b, 255), [1, 0, 2]), {}),
    (lambda b: rounds(with_sync(b), [0, 0, 1, 1]), {}),
    (lambda b: periods(b, [10, 11, 14, 6, 10]), {}),
    (lambda b: periods(b, [10, 16, 4, 10]), {Mistake.SYNC_OFF: 2}),
    (lambda b: b.enabled(1), {}),
]  # fmt: skip


@pytest.mark.parametrize(("does", "expected"), CASES)
def test_each_kind_is_counted(
    does: Callable[[Bench], object], expected: dict[Mistake, int]
) -> None:
    bench = Bench()
    does(bench)
    assert counted(bench) == expected


def test_a_value_in_a_pdo_that_its_object_cannot_have() -> None:
    bench = Bench(starts={"1401.1": 0x305}).operational()
    bench.send(0x305, b"\x06\x00\x02")
    assert counted(bench) == {Mistake.VALUE_REFUSED: 1} and bench[Od.MODE] == 0


@pytest.mark.parametrize("mode", [1, 8])
def test_a_target_outside_the_software_limits_is_counted_once(mode: int) -> None:
    bench = Bench(starts={"607D.1": -1000, "607D.2": 1000}).enabled(mode)
    bench[Od.TARGET_POSITION] = 1500
    bench[Od.CONTROLWORD] = 0x1F
    bench.cycles(300)
    assert counted(bench) == {Mistake.TARGET_CLIPPED: 1}
    bench[Od.CONTROLWORD] = 0x0F
    bench[Od.TARGET_POSITION] = 900
    bench.cycles(5)
    bench[Od.CONTROLWORD] = 0x1F
    bench.cycles(300)
    assert counted(bench) == {Mistake.TARGET_CLIPPED: 1}


def test_a_transition_that_a_state_does_not_have_is_counted_when_it_is_asked_for() -> None:
    bench = Bench()
    bench[Od.CONTROLWORD] = 0x0F
    bench.cycles(50)
    bench[Od.CONTROLWORD] = 0x1F  # a bit of the mode is none of the command
    bench.cycles(50)
    assert counted(bench) == {Mistake.COMMAND_IGNORED: 1}


@pytest.mark.parametrize("power", [Power.SWITCH_ON_DISABLED, Power.READY_TO_SWITCH_ON,
                                   Power.SWITCHED_ON, Power.OPERATION_ENABLED])  # fmt: skip
def test_only_a_command_that_changes_nothing_and_is_no_wish_to_stay_is_ignored(
    power: Power,
) -> None:
    stays = {
        Power.SWITCH_ON_DISABLED: (PowerCommand.DISABLE_VOLTAGE, PowerCommand.QUICK_STOP),
        Power.READY_TO_SWITCH_ON: (PowerCommand.SHUTDOWN,),
        Power.SWITCHED_ON: (PowerCommand.SWITCH_ON,),
        Power.OPERATION_ENABLED: (PowerCommand.ENABLE_OPERATION,),
    }[power]  # fmt: skip
    for word in range(128):
        wanted = command_of(word)
        expected = NEXT[power, wanted] == power and wanted not in stays
        assert is_ignored(power, word, 2) == expected, word
        wants_power = wanted >= PowerCommand.SHUTDOWN
        assert is_ignored(Power.FAULT, word, 2) == wants_power, word
        assert not is_ignored(Power.FAULT, word | 0x80, 2), word


@pytest.mark.parametrize(
    ("option", "word", "end"),
    [
        ("605B", 0x06, Power.READY_TO_SWITCH_ON),
        ("605C", 0x07, Power.SWITCHED_ON),
    ],
)
def test_a_drive_slows_down_before_it_leaves_operation(option: str, word: int, end: Power) -> None:
    bench = Bench(starts={option: 1}).enabled(9)
    bench[Od.TARGET_VELOCITY] = 2000
    bench.cycles(1500)
    bench[Od.CONTROLWORD] = word
    bench.cycles(195)  # 2000 / 10000 s
    assert bench.d.state.power == Power.OPERATION_ENABLED and abs(bench.w) < 0.3
    bench.cycles(10)
    assert bench.d.state.power == end and bench.u == 0.0
    assert counted(bench) == {}


def test_it_goes_on_if_it_is_wanted_again_on_the_ramp() -> None:
    bench = Bench(starts={"605B": 1}).enabled(9)
    bench[Od.TARGET_VELOCITY] = 2000
    bench.cycles(1500)
    bench[Od.CONTROLWORD] = 0x06
    bench.cycles(100)
    bench[Od.CONTROLWORD] = 0x0F
    bench.cycles(1500)
    assert bench.d.state.power == Power.OPERATION_ENABLED and abs(bench.w - 2.0) < 0.02


@pytest.mark.parametrize(
    ("period_us", "told"),
    [
        (1000, []),
        (
            5000,
            [
                "master: SYNC was off by half of the period 0x1006, and more than a cycle: 100 x "
                "(drive.master.sync_off)"
            ],
        ),
    ],
)
def test_the_verdict_of_a_master_in_our_executive(
    period_us: int, told: list[str], tmp_path: Path
) -> None:
    text = MASTERED.read_text().replace('"6060": 9', f'"6060": 9, "1006": {period_us}')
    rig = load_rig(MASTERED, settings=["duration_s=0.1"], text=text)
    path = tmp_path / "log.mcap"
    simulate(rig, path)
    summary = summarise(rig, logs.read(path), Outcome("virtual", ""))
    assert summary.expectations_failed == told
    assert summary.verdict == ("expectation not met" if told else "ok")
