"""Alarms of a running node: which counters, how often, and their place in the log."""

from pathlib import Path
from typing import Any

import pytest
from engine import both, puppet_rig
from rings import block_of, put_cycle

from pcpc.executive.log.reader import read
from pcpc.executive.log.recorder import Recorder
from pcpc.executive.loop import alarms as told
from pcpc.executive.loop import buckets
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.alarms import Alarms
from pcpc.executive.loop.buckets import OF_STAGES
from pcpc.executive.nodes.plan import describe
from pcpc.executive.rig.reading import load_rig


def block(folder: Path, *lines: str, pacing: str = "real") -> Any:
    """Return the memory of an executive that has done 1,000 cycles of 1 ms."""
    plan = both(load_rig(puppet_rig(folder, *lines)), pacing)[0]
    made = sh.private(describe(plan, {"pacing": pacing}))
    made.control.passes, made.control.cycle = 1000, 999
    return made


def test_a_node_without_trouble_has_no_alarm(tmp_path: Path) -> None:
    made = block(tmp_path)
    made["histogram"][0, buckets.place_of(990_000, *OF_STAGES)] += 5
    alarms = Alarms(made)
    assert not [one for second in range(10) for one in alarms.look(float(second))]


def test_what_happens_again_and_again_is_told_once_a_second_with_its_count(tmp_path: Path) -> None:
    made = block(tmp_path)
    alarms, control = Alarms(made), made.control
    lines = []
    for tick in range(250):
        control.lost += 2 if tick >= 10 else 0
        control.cycle += 10
        lines += [(tick, str(one)) for one in alarms.look(100.0 + 0.01 * tick)]
    assert [tick for tick, _ in lines] == [10, 110, 210], lines
    assert lines[0][1] == "1.109 s cycle 1109: alarm: executive: 2 x frame lost"
    assert lines[1][1].endswith("executive: 200 x frame lost")


@pytest.mark.parametrize("kind", told.KINDS)
def test_each_counter_has_an_alarm(tmp_path: Path, kind: str) -> None:
    made = block(tmp_path, "alarms: {held_per_s: 0}")
    alarms = Alarms(made)
    assert not list(alarms.look(1.0))
    word, what = told.KINDS[kind]
    made.control[word] += 3
    (alarm,) = alarms.look(1.5)
    assert (alarm.kind, alarm.count, alarm.what) == (kind, 3, what)


def test_single_held_cycles_are_no_alarm_by_default(tmp_path: Path) -> None:
    made = block(tmp_path)
    alarms, control = Alarms(made), made.control
    control.held += 10
    assert not list(alarms.look(1.0))
    control.held += 11
    assert [(one.kind, one.count) for one in alarms.look(2.5)] == [("held", 11)]


def test_a_rate_is_allowed_and_none_is_none(tmp_path: Path) -> None:
    lines = "alarms: {lost_per_s: 5, crc_per_s: null}"
    made = block(tmp_path, lines)
    alarms, control = Alarms(made), made.control
    control.crc_errors = 99
    for second in range(5):
        control.lost += 5
        assert not list(alarms.look(float(second))), second
    control.lost += 6
    (alarm,) = alarms.look(5.5)
    assert alarm.kind == "lost" and alarm.count == 6


def test_a_late_cycle_is_one_beyond_the_limit_and_a_reset_is_no_alarm(tmp_path: Path) -> None:
    made = block(tmp_path, "alarms: {late_us: 300}")
    alarms = Alarms(made)
    made["histogram"][0, buckets.place_of(300_000, *OF_STAGES)] += 1
    assert not list(alarms.look(1.0))
    made["histogram"][0, buckets.place_of(340_000, *OF_STAGES)] += 2
    (alarm,) = alarms.look(2.0)
    assert (alarm.kind, alarm.count, alarm.what) == ("late", 2, "cycle later than 300 us")
    made["histogram"][:] = 0
    assert not list(alarms.look(4.0))
    made["histogram"][0, buckets.place_of(340_000, *OF_STAGES)] += 1
    assert [one.count for one in alarms.look(6.0)] == [1]


def test_without_a_clock_nothing_is_an_alarm(tmp_path: Path) -> None:
    made = block(tmp_path, pacing="lockstep")
    made.control.lost = 9
    assert not list(Alarms(made).look(1.0))


@pytest.mark.parametrize("keeps", [0, 10**9], ids=["all", "part"])
def test_alarms_are_events_of_the_log_also_of_a_part(tmp_path: Path, name: str, keeps: int) -> None:
    made = block_of(name)
    made.description |= {"alarms": {"late_us": None}, "keep_ns": keeps, "keep_on": ["fault"]}
    recorder = Recorder(tmp_path / "log.mcap", [made])
    for cycle in range(8):
        put_cycle(made, cycle)
    made.control.passes, made.control.cycle = 8, 7
    made.control.crc_errors = 2
    recorder.drain()
    recorder.finish()
    node = read(tmp_path / "log.mcap").node["executive"]
    assert len(node.cycle) == (0 if keeps else 8)
    (event,) = node.events
    assert (event["event"], event["name"], event["value"], event["cycle"]) == (
        "alarm", "crc", 2, 7,
    ), event  # fmt: skip
