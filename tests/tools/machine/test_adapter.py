"""`pcpc doctor --bus`: what it says of good and bad buses; adapters are emulated on UDP.

Bounds are those of a binomial distribution, an adapter's faults those of `bad_adapter`.
"""

import contextlib
import json
import math
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from bad_adapter import GROUP, BadEnd
from free_bus import own_port
from json_schemas import strictly_holds
from places import ROOT

from pcpc.drivers.can import bus as buses
from pcpc.drivers.can.plain_bus import Udp
from pcpc.drivers.can.wire_layout import Flag
from pcpc.drivers.errors import BusError, Exit
from pcpc.drivers.machine import claim
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.cli import main
from pcpc.tools.machine.doctor.adapter import cli, judged
from pcpc.tools.machine.doctor.adapter.channel import ChannelFacts, interface_facts
from pcpc.tools.machine.doctor.adapter.ends import End, HeardFrame, Origin, UdpEnd, open_end
from pcpc.tools.machine.doctor.adapter.exam import FEWEST, Exam, examine
from pcpc.tools.machine.doctor.adapter.facts import AdapterFacts, AdapterRow
from pcpc.tools.machine.doctor.adapter.passes import Pass, Stamped, Tally
from pcpc.tools.machine.doctor.adapter.pattern import plain_pattern, rig_pattern
from pcpc.tools.machine.doctor.adapter.stamps import hardware_fault, kernel_fault
from pcpc.tools.start.bus import traffic
from pcpc.tools.terminal.progress import Progress

Screen = pytest.CaptureFixture[str]
CARRIER = Path(__file__).with_name("bad_adapter.py")
HERE = [sys.executable, "-m", "pcpc.tools.cli", "doctor", "--bus"]
CAN = [
    ChannelFacts(name, "can", "emulated", "ERROR-ACTIVE", None, None, True, 1000, {"tx_errors": 0})
    for name in ("can0", "can1")
]


def channel() -> str:
    """Return a free group and port."""
    return f"{GROUP}:{own_port(GROUP) + 1}"


def bus() -> str:
    return f"udp_multicast:{channel()}"


@contextlib.contextmanager
def ends(fault: str = "", period: int = 1) -> Iterator[list[End]]:
    """Give two ends of one bus, of which the second is a bad adapter's."""
    where = channel()
    found: list[End] = [UdpEnd(where), BadEnd(where, fault, period)]
    try:
        yield found
    finally:
        for end in found:
            end.close()


def short_exam(found: Sequence[End], cycles: int = 600) -> Exam:
    """Return an examination of a few passes, of which none rises."""
    plain = plain_pattern()
    hello = Pass(found, plain, 500.0).run(5)
    exam = Exam(hello, plain, asked=2 * cycles)
    exam.burst = Pass(found, plain, 500.0).run(5)
    exam.steps = [Pass(found, plain, 500.0).run(20)]
    exam.long = Pass(found, plain, 1000.0).run(cycles)
    return exam


def rows(facts: AdapterFacts) -> dict[str, AdapterRow]:
    return {row.name: row for row in facts.rows}


def said(capsys: Screen, *words: str) -> tuple[int, str, str]:
    code = main(["doctor", *words])
    return code, *capsys.readouterr()


@pytest.mark.parametrize(
    ("fault", "period", "row", "field"),
    [
        ("loss", 50, "loss", "lost"), ("twice", 50, "once", "doubled"),
        ("order", 50, "in order", "misordered"), ("delay", 50, "delay", "late"),
        ("bit", 50, "whole", "changed"), ("length", 50, "whole", "changed"),
        ("id", 50, "strangers", "strange"), ("stamps jump", 200, "stamps", ""),
        ("stamps run fast", 1, "stamps", ""), ("stamps go back", 50, "stamps", ""),
        ("stamps stand still", 1, "stamps", ""), ("kernel stamps late", 50, "stamps", ""),
    ],
)  # fmt: skip
def test_each_fault_of_an_adapter_is_named_and_none_ends_good(
    fault: str, period: int, row: str, field: str
) -> None:
    with ends(fault, period) as found:
        exam = short_exam(found)
    facts = cli.facts(exam, CAN)
    assert rows(facts)[row].state == "violated", rows(facts)[row]
    assert facts.verdict == "not good" and cli.exit_code(facts) != Exit.OK
    assert facts.good_for_hz is None
    if field:
        assert sum(getattr(one, field) for one in exam.tallies) > 0


def test_a_good_adapter_has_no_such_row() -> None:
    with ends() as found:
        exam = short_exam(found)
    states = {name: row.state for name, row in rows(cli.facts(exam, CAN)).items()}
    for name in ("wiring", "once", "whole", "in order", "echo", "stamps", "error counters"):
        assert states[name] == "held", (name, states)
    assert states["loss"] == "not judged", "1200 frames show no loss of 1e-4"


def test_frames_that_were_lost_are_bounded_as_a_binomial_distribution_has_it() -> None:
    assert FEWEST == math.ceil(math.log(0.05) / math.log1p(-1e-4)) == 29956
    with ends() as found:
        facts = cli.facts(short_exam(found), CAN)
    assert facts.long is not None and facts.long.sent == 1200
    assert facts.loss_below == pytest.approx(1.0 - 0.05 ** (1 / 1200), rel=1e-9)
    assert facts.loss_below == pytest.approx(3.0 / 1200, rel=3e-3), "the rule of three"


def _tally(**about: Any) -> Tally:
    full = Tally(1000.0, sent=30000, arrived=30000, seconds=15.0, planned_s=15.0)
    full.delays_ns, full.from_end, full.given_back = [50_000] * 30000, [15000, 15000], [15000] * 2
    for name, value in about.items():
        setattr(full, name, value)
    return full


def _exam(**about: Any) -> Exam:
    hello = Tally(50.0, sent=20, arrived=20, from_end=[10, 10], given_back=[10, 10])
    exam = Exam(hello, plain_pattern(), Tally(100.0, sent=32, arrived=32), asked=30000)
    exam.steps, exam.long = [_tally()], _tally(**about)
    return exam


WRONG: list[tuple[dict[str, Any], str, str]] = [  # of 30,000 frames, the row, its state
    ({}, "loss", "held"),
    ({"arrived": 29_999}, "loss", "violated"),
    ({"doubled": 1}, "once", "violated"),
    ({"changed": 1}, "whole", "violated"),
    ({"misordered": 1}, "in order", "violated"),
    ({"late": 1}, "delay", "violated"),
    ({"late": 1, "unstamped": 30_000}, "delay", "not judged"),
    ({"held_up": 20_000, "delays_ns": [1] * 10_000}, "delay", "not judged"),
    ({"dropped": 1, "arrived": 29_999}, "loss", "not judged"),
    ({"refused": 1}, "queue", "violated"),
    ({"seconds": 20.0}, "load", "not judged"),
    ({"sent": 29_955, "arrived": 29_955}, "loss", "not judged"),
    ({"sent": 29_956, "arrived": 29_956}, "loss", "held"),
    ({"given_back": [0, 0]}, "echo", "violated"),
]


@pytest.mark.parametrize(("about", "row", "state"), WRONG)
def test_one_frame_decides(about: dict[str, Any], row: str, state: str) -> None:
    facts = cli.facts(_exam(**about), CAN)
    assert rows(facts)[row].state == state, rows(facts)[row]
    assert (facts.verdict == "good") == (state == "held"), facts.verdict
    assert (cli.exit_code(facts) == Exit.OK) == (state == "held")


def test_what_was_lost_before_the_long_pass_counts() -> None:
    exam = _exam()
    exam.hello.arrived = 19
    assert rows(cli.facts(exam, CAN))["loss"].state == "violated"


def test_drops_above_a_load_are_named_with_the_load() -> None:
    exam = _exam()
    exam.steps.append(_tally(rate_hz=2000.0, arrived=29_000))
    with_rate = [ChannelFacts(**{k: getattr(one, k) for k in one.__struct_fields__}
                              | {"bitrate": 1_000_000}) for one in CAN]  # fmt: skip
    facts = cli.facts(exam, with_rate)
    row = rows(facts)["load"]
    assert row.state == "violated" and "at 4,000 frames/s 1,000 of 30,000" in row.found, row
    assert facts.limited_by == "loss" and facts.highest_hz == 1000.0
    bits = 54 + 64 + (54 + 64 - 1) // 4 + 13
    assert facts.highest_load == pytest.approx(2000 * bits / 1e6)


@pytest.mark.parametrize("queue", [10, 31])
def test_a_queue_of_few_frames_is_named_with_the_command(queue: int) -> None:
    short = [interface_facts("can7", LINK | {"txqlen": queue}), CAN[1]]
    row = rows(cli.facts(_exam(), short))["queue"]
    assert (row.state, row.cure) == ("violated", "sudo ip link set can7 txqueuelen 1000"), row


LINK: dict[str, Any] = {  # as `ip -json -details -statistics link show` has it, iproute2 6.1
    "ifname": "can7", "flags": ["NOARP", "UP", "LOWER_UP", "ECHO"], "mtu": 72, "txqlen": 10,
    "linkinfo": {
        "info_kind": "can",
        "info_data": {
            "state": "ERROR-PASSIVE", "berr_counter": {"tx": 128, "rx": 3}, "restart_ms": 100,
            "bittiming": {"bitrate": 500000}, "data_bittiming": {"bitrate": 2000000},
        },
        "info_xstats": {"bus_error": 4, "arbitration_lost": 9, "bus_off": 1},
    },
    "stats64": {"rx": {"packets": 5, "errors": 1, "dropped": 2, "over_errors": 0},
                "tx": {"packets": 6, "errors": 7, "dropped": 0}},
}  # fmt: skip


def test_what_linux_says_of_a_controller_is_read() -> None:
    found = interface_facts("can7", LINK)
    assert (found.kind, found.state, found.queue, found.fd) == ("can", "ERROR-PASSIVE", 10, True)
    assert (found.bitrate, found.data_bitrate, found.software) == (500_000, 2_000_000, False)
    assert found.counters == {
        "tx_error_counter": 128, "rx_error_counter": 3, "bus_error": 4, "bus_off": 1,
        "rx_errors": 1, "rx_dropped": 2, "rx_over_errors": 0, "tx_errors": 7, "tx_dropped": 0,
    }  # fmt: skip
    before = json.loads(json.dumps(LINK))
    before["stats64"]["tx"]["errors"] = 5
    gained = found.since(interface_facts("can7", before)).counters
    assert gained is not None and {k: n for k, n in gained.items() if n} == {"tx_errors": 2}
    facts = cli.facts(_exam(), [found.since(interface_facts("can7", before)), CAN[1]])
    assert rows(facts)["error counters"].found == "can7 tx_errors +2"
    assert facts.verdict == "not good"


def test_without_ip_nothing_is_judged_that_only_ip_knows() -> None:
    facts = cli.facts(_exam(), [interface_facts("can8", {}), interface_facts("can9", {})])
    row = rows(facts)["error counters"]
    assert row.state == "not judged" and "no counters" in row.found, row


def test_two_bit_rates_on_one_line_are_named_with_the_command() -> None:
    fast = json.loads(json.dumps(LINK))
    fast["linkinfo"]["info_data"]["bittiming"]["bitrate"] = 1_000_000
    facts = cli.facts(_exam(), [interface_facts("can7", LINK), interface_facts("can8", fast)])
    row = rows(facts)["wiring"]
    assert row.state == "violated" and "500000/2000000, 1000000/2000000" in row.found, row
    assert row.cure.endswith("can8 up type can bitrate 500000"), row


class DeafEnd:
    """An end that hears nothing but what its controller says."""

    def __init__(self, name: str, *classes: int, gives_back: bool = False) -> None:
        self.name, self.has_fd, self.dropped = name, False, 0
        self.classes, self.gives_back = list(classes), gives_back
        self.back: list[HeardFrame] = []

    def offer(self, word: int, data: bytes, flags: int = Flag.NONE) -> bool:
        if self.gives_back:
            self.back.append(HeardFrame(word, data, flags, time.time_ns(), origin=Origin.OWN))
        return True

    def frames(self) -> Iterator[HeardFrame]:
        for one in self.classes:
            yield HeardFrame(one, bytes(8), 0, time.time_ns(), origin=Origin.ERROR)
        yield from self.back
        self.classes, self.back = [], []

    def fileno(self) -> int:
        return -1

    def close(self) -> None:
        """Nothing to leave."""


@pytest.mark.parametrize(
    ("classes", "gives_back", "told"),
    [
        ((), True, "can1 hears nothing of can0, nor the other way: not one line"),
        ((0x20,), False, "gets no acknowledgement: another bit rate"),
        ((), False, "gets no acknowledgement: another bit rate"),
        ((0x04, 0x40), False, "can0 went bus-off"),
    ],
)
def test_a_line_that_carries_nothing_is_named_in_one_line_with_the_cure(
    classes: tuple[int, ...], gives_back: bool, told: str
) -> None:
    found = [
        DeafEnd("can0", *classes, gives_back=gives_back),
        DeafEnd("can1", gives_back=gives_back),
    ]
    facts = cli.facts(examine(found, plain_pattern(), 30000, Progress(True)), CAN)
    row = rows(facts)["wiring"]
    assert row.state == "violated" and told in row.found and row.cure, row
    assert facts.verdict == "not good" and facts.long is None
    assert {rows(facts)[name].state for name in ("loss", "once", "load")} == {"not judged"}


def test_one_channel_shows_what_it_sends_and_never_ends_good() -> None:
    facts = cli.facts(_exam(), CAN[:1])
    assert rows(facts)["reception"].state == "not judged"
    assert rows(facts)["reception"].cure == "--bus can0,can1"
    assert facts.verdict == "not judged" and cli.exit_code(facts) == Exit.NOT_MET


def test_a_channel_without_echo_asks_for_a_second_one() -> None:
    end = DeafEnd("can0")
    facts = cli.facts(examine([end, end], plain_pattern(), 30000, Progress(True)), CAN[:1])
    row = rows(facts)["wiring"]
    assert (row.state, "no echo" in row.found) == ("not judged", True), row
    assert row.cure == "name a second channel: --bus can0,can1" and facts.verdict == "not judged"


@pytest.mark.deep
def test_an_interface_of_python_can_without_counters_or_stamps_of_hardware_says_so(
    capsys: Screen,
) -> None:
    code, out, _ = said(capsys, "--bus", "virtual:adapter", "--frames", "300", "--json")
    found = json.loads(out)
    states = {row["name"]: row["state"] for row in found["rows"]}
    assert code == Exit.NOT_MET and found["verdict"] == "not judged", found
    assert states["wiring"] == states["once"] == states["whole"] == "held", states
    assert states["error counters"] == states["loss"] == states["CAN FD"] == "not judged"


def test_what_is_printed_as_json_is_of_its_schema_and_says_what_was_sent(capsys: Screen) -> None:
    code, out, err = said(capsys, "--bus", bus(), "--frames", "400", "--json")
    found = strictly_holds("doctor", out)
    assert (code, found["verdict"], err) == (Exit.NOT_MET, "not judged", "")
    assert found["software"] is True and found["way"] == "one channel"
    assert found["long"]["sent"] == 400 and found["long"]["lost"] == 0
    assert found["loss_below"] == pytest.approx(3.0 / 400, rel=0.01)
    assert found["frames_needed"] == FEWEST


def test_text_fits_a_terminal_and_shows_progress(
    capsys: Screen, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    code, out, err = said(capsys, "--bus", bus(), "probe", "--frames", "400")
    assert code == Exit.NOT_MET and "frames/s" in err, err
    assert [line for line in out.splitlines() if len(line) > 80] == []
    assert "not judged  loss            0 of 40" in out, out
    assert "verdict     not judged; not judged: loss" in out
    assert "loss: --frames 29956" in out


def test_the_frames_are_those_of_the_rig() -> None:
    rig = load_rig(ROOT / "plants/atb1000/rigs/hull.yaml", resolve=False)
    pattern = rig_pattern(rig)
    sent, executive = traffic.buses(rig)[0], rig.config.sections["executive"].node
    assert {one.word for one in pattern.frames} == {one.frame.word for one in sent}
    for one in pattern.frames:
        of = next(x for x in sent if x.frame.word == one.word)
        assert (one.length, one.end) == (of.frame.dlc, int(of.sender == executive)), of
    assert pattern.per_cycle == pytest.approx(sum(1 / x.frame.every_n(1000.0) for x in sent))


@contextlib.contextmanager
def talking(where: str) -> Iterator[None]:
    program = (
        "import sys, time\nfrom pcpc.drivers.can.plain_bus import Udp\n"
        "bus = Udp(sys.argv[1])\nprint('on', flush=True)\n"
        "while True:\n bus.put(0x123, bytes(8))\n time.sleep(0.005)\n"
    )
    words = [sys.executable, "-c", program, where]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, cwd=ROOT) as other:
        assert other.stdout is not None and other.stdout.readline() == "on\n"
        try:
            yield
        finally:
            other.kill()


def test_nothing_is_sent_where_others_talk(capsys: Screen) -> None:
    where = channel()
    ear = Udp(where)
    with talking(where):
        code, out, err = said(capsys, "--bus", f"udp_multicast:{where}")
    heard = {frame.word for frame in ear.frames()}
    ear.close()
    assert (code, out, heard) == (Exit.ENVIRONMENT, "", {0x123}), err
    assert "others talk" in err and "ids 123" in err and "nothing was sent" in err, err


def test_nothing_is_sent_where_a_run_waits(capsys: Screen) -> None:
    where = channel()
    held = claim.hold(f"bus/udp_multicast:{where}")
    assert held is not None
    with held:
        code, out, err = said(capsys, "--bus", f"udp_multicast:{where}")
    assert (code, out) == (Exit.ENVIRONMENT, "") and "is on it" in err, err


def test_ctrl_c_ends_it() -> None:
    words = [*HERE, bus(), "--frames", "1000000"]
    with subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT
    ) as process:
        assert process.stderr is not None and process.stderr.readline()
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    assert (process.returncode, out) == (Exit.INTERRUPTED, ""), err
    assert "Traceback" not in err


def test_a_device_that_may_not_be_opened_is_named_with_the_group(tmp_path: Path) -> None:
    device = tmp_path / "ttyACM0"
    device.touch()
    words = (
        "import sys\nfrom pcpc.drivers.can.bus import BusAddress\n"
        "from pcpc.tools.machine.doctor.adapter.ends import open_end\nimport os\n"
        "os.access = lambda path, mode: False\n"
        "open_end(BusAddress('slcan', sys.argv[1]))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", words, device], capture_output=True, text=True, cwd=ROOT
    )
    assert "no permission to open" in done.stderr and "usermod -aG dialout" in done.stderr


def test_a_plain_doctor_loads_nothing_of_it() -> None:
    words = (
        "import sys\nimport pcpc.tools.machine.doctor.cli\nfrom pcpc.tools.cli import main\n"
        "main(['doctor', '--frames', '5'])\n"
        "print([m for m in sys.modules if 'doctor.adapter' in m or m in ('can', 'numpy')])\n"
    )
    done = subprocess.run([sys.executable, "-c", words], capture_output=True, text=True, cwd=ROOT)
    assert done.stdout == "[]\n" and "--frames: needs --bus" in done.stderr, done


def _times(count: int, rate: float = 1.0, offset: int = -5 * 10**17) -> list[Stamped]:
    draw, found, now = random.Random(3), [], 10**18
    for _ in range(count):
        now += 1_000_000
        true = now + draw.randrange(60_000, 90_000)
        own = round((true - 10**18) * rate) + offset
        found.append(Stamped(now, own, now + draw.randrange(100_000, 400_000)))
    return found


@pytest.mark.parametrize(("rate", "good"), [(1.0, True), (1.0001, True), (1.002, False),
                                            (0.998, False), (0.9999, True)])  # fmt: skip
def test_a_clock_of_hardware_may_differ_by_a_quartz_and_no_more(rate: float, good: bool) -> None:
    assert (hardware_fault(_times(2000, rate)) is None) == good


def test_stamps_of_hardware_may_not_jump_between_frames() -> None:
    stamps = _times(2000)
    moved = [*stamps[:1000], *(Stamped(s.sent_ns, s.stamp_ns + 2_000_000, s.read_ns)
                               for s in stamps[1000:])]  # fmt: skip
    assert hardware_fault(stamps) is None and hardware_fault(moved) is not None


def test_a_stamp_of_the_kernel_lies_between_sending_and_reading() -> None:
    good = [Stamped(10**18, 10**18 + 5_000, 10**18 + 9_000)]
    assert kernel_fault(good) is None
    for stamp_ns in (10**18 - 50_000, 10**18 + 50_000):
        fault = kernel_fault([Stamped(10**18, stamp_ns, 10**18 + 9_000)])
        assert fault is not None and fault.count == 1


def test_frames_of_every_length_are_told_apart() -> None:
    for length, flags in ((0, 0), (1, 0), (3, 0), (8, 0), (64, Flag.FD | Flag.BRS)):
        with ends() as found:
            tally = Pass(found, plain_pattern(length, flags), 1000.0).run(60)
        assert (tally.sent, tally.arrived, tally.wrong) == (120, 120, 0), (length, tally)


@pytest.fixture
def carried(request: pytest.FixtureRequest) -> Iterator[str]:
    """Give two channels between which a bad adapter carries, in a process of its own."""
    fault, period = request.param
    ports = own_port(GROUP) + 1, own_port(GROUP) + 1
    words = [sys.executable, str(CARRIER), fault, str(period), *map(str, ports)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, cwd=ROOT) as carrier:
        assert carrier.stdout is not None and carrier.stdout.readline() == "carries\n"
        try:
            yield ",".join(f"udp_multicast:{GROUP}:{port}" for port in ports)
        finally:
            carrier.kill()


@pytest.mark.deep
def test_one_frame_of_ten_thousand_that_is_lost_is_seen_in_a_hundred_thousand() -> None:
    with ends("loss", 10_000) as found:
        exam = cli._undisturbed(lambda: examine(found, plain_pattern(), 100_000, Progress(True)))
    facts = cli.facts(exam, CAN)
    assert facts.verdict == "not good" and cli.exit_code(facts) == Exit.LOSS, rows(facts)["loss"]
    lost, sent = (sum(getattr(one, what) for one in exam.tallies) for what in ("lost", "sent"))
    assert 0 < lost < 40 * sent / 100_000, (lost, sent)


@pytest.mark.deep
@pytest.mark.parametrize(
    ("carried", "row", "code"),
    [
        (("loss", 300), "loss", 3), (("twice", 300), "once", 3), (("bit", 300), "whole", 3),
        (("order", 300), "in order", 1), (("delay", 300), "delay", 1),
    ],
    indirect=["carried"],
)  # fmt: skip
def test_a_bad_adapter_in_another_process_is_told(carried: str, row: str, code: int) -> None:
    done = subprocess.run(
        [*HERE, carried, "--frames", "3000", "--json"],
        capture_output=True, text=True, cwd=ROOT,
    )  # fmt: skip
    found = json.loads(done.stdout)
    states = {one["name"]: one["state"] for one in found["rows"]}
    assert (states[row], found["verdict"]) == ("violated", "not good"), found["rows"]
    assert done.returncode == code, (done.returncode, found["rows"])


@pytest.mark.deep
def test_a_bus_of_this_machine_is_good_for_a_rig_and_says_that_no_adapter_took_part() -> None:
    done = subprocess.run(
        [*HERE, bus(), "hull", "--frames", "30000", "--json"],
        capture_output=True, text=True, cwd=ROOT,
    )  # fmt: skip
    found = json.loads(done.stdout)
    told = [row for row in found["rows"] if row["state"] == "violated"]
    assert found["long"]["lost"] == 0 and found["long"]["sent"] >= 30000, found["rows"]
    adapter = next(row for row in found["rows"] if row["name"] == "adapter")
    assert adapter["state"] == "not judged" and "no adapter took part" in adapter["found"]
    assert (done.returncode == 0) == (found["verdict"] == "good") == (not told), found["rows"]
    if found["verdict"] == "good":
        assert found["good_for_hz"] >= 1000.0


@pytest.mark.deep
def test_bus_addresses_open_as_they_are_named() -> None:
    end = open_end(buses.BusAddress("udp_multicast", channel()))
    assert end.has_fd and end.name.startswith("udp_multicast:")
    end.close()
    with pytest.raises(BusError, match="python-can cannot open it"):
        open_end(buses.BusAddress("kvaser", "0"))


def test_a_verdict_needs_every_row_that_is_needed() -> None:
    held, open_row = AdapterRow("a", "held", ""), AdapterRow("b", "not judged", "")
    assert judged.verdict_of([held]) == "good"
    assert judged.verdict_of([held, open_row]) == "not judged"
    assert judged.verdict_of([held, AdapterRow("b", "not judged", "", needed=False)]) == "good"
    assert judged.verdict_of([held, open_row, AdapterRow("c", "violated", "")]) == "not good"
