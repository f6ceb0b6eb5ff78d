"""The suites of the bench: C does the work of Python; ratios are there; nothing is silent."""

import ctypes
import resource
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from free_bus import own_bus
from json_schemas import strictly_holds

from pcpc.drivers.can import bus as buses
from pcpc.drivers.can.wire import get_frame, put_frame
from pcpc.drivers.can.wire_layout import Arrival
from pcpc.executive.nodes.virtual import in_memory
from pcpc.tools.dev.bench import batch, codec, cycle, frame, recorder, simulate, startup
from pcpc.tools.dev.bench.cli import ON_REQUEST
from pcpc.tools.dev.bench.compiler import address
from pcpc.tools.dev.bench.options import COMMAND, SUITES
from pcpc.tools.dev.bench.ratio import Ratio
from pcpc.tools.dev.command import main
from pcpc.tools.machine.jitter.compiler import CompilerError
from pcpc.tools.make.generate.closed import ClosedLoop, digest_of
from pcpc.tools.terminal.progress import Progress

pytestmark = pytest.mark.deep

QUIET = Progress(quiet=True)
CYCLES = 300


class Kept(ctypes.Structure):
    """A frame_t of codec.h."""

    _fields_ = (("id", ctypes.c_uint32), ("n", ctypes.c_uint8), ("data", ctypes.c_uint8 * 8))


def test_a_folder_or_none_in_place_of_a_file_is_refused_before_anything_is_measured(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for path, what in ((tmp_path, "is a folder"), (tmp_path / "no" / "such", "there is no folder")):
        assert main(COMMAND, ["codec", "--rounds", "1", "--quiet", "--json", str(path)]) == 2
        said = capsys.readouterr()
        assert said.out == "" and what in said.err and said.err.count("\n") == 1, said


def medians(ratios: list[Ratio]) -> dict[tuple[str, str], float]:
    """Return the medians by name, after a look at every number."""
    for r in ratios:
        numbers = np.array([r.own, r.base, *r.ratio])
        assert np.isfinite(numbers).all() and (numbers > 0.0).all(), f"{r}"
        assert r.ratio[0] <= r.ratio[1] <= r.ratio[2] and r.unit and r.suite in SUITES, f"{r}"
    return {(r.what, r.against): r.ratio[1] for r in ratios}


@pytest.fixture(scope="module")
def recording() -> cycle.ReceivedFrames:
    return cycle.record(cycles=CYCLES)


def test_the_device_sends_the_frames_of_the_cycles_in_python(
    recording: cycle.ReceivedFrames,
) -> None:
    made, c = recording.plan, cycle.library()
    n, kept = cycle.new_loop(made), (Kept * 64).in_dll(c, "kept")
    cycle.begin(c)
    first, total = 0, 0
    for end in recording.ends.tolist():
        frames, ends = recording.frames[first:end], np.array([end - first])
        cycle.drive_memory(n, made.steps, frames, ends, 1)
        c.drive_memory(address(frames), address(ends), ctypes.c_int64(1), ctypes.c_int64(1))
        count = int(n.wire.outbox_put)
        ours = [(bytes(raw[:4]), raw[4], bytes(raw[8:16])) for raw in n.wire.outbox[:count]]
        sent = ctypes.c_uint32.in_dll(c, "kept_frames").value
        theirs = [(f.id.to_bytes(4, "little"), f.n, bytes(f.data)) for f in kept[:sent]]
        assert theirs == ours, f"cycle {n.k}"
        first, total = end, total + sent
    assert n.control.received == len(recording.frames) and n.control.passes == CYCLES
    assert total > 2 * CYCLES and not n.control.crc_errors


def test_a_virtual_run_in_c_has_the_records_of_one_in_python() -> None:
    rig = simulate.slew10(0.3)
    nodes = ClosedLoop(rig)
    list(nodes.cycles())
    expected = digest_of(in_memory(rig), nodes.columns(), CYCLES)
    c = simulate.library(rig)
    assert [f"{c.run(CYCLES):016x}" for _ in range(2)] == [expected, expected]
    assert f"{c.run(CYCLES - 1):016x}" != expected


def test_a_restored_run_gives_the_same_bytes_again() -> None:
    n = simulate.nodes(0.1)
    simulate.in_python(n)
    before = n.loops[0].record.copy()
    n.restore()
    n.loops[0].record[:] = 0
    simulate.in_python(n)
    assert (n.loops[0].record == before).all()


def test_a_frame_of_c_is_read_by_python_and_the_reverse() -> None:
    c = frame.library()
    bus = buses.bus_named(*buses.parse(own_bus()))
    ends = frame.open_end(bus), frame.open_end(bus)
    ours, theirs = ends[0][0], ends[1][0]
    theirs.packet_tx[:] = 0
    c.prepare_packet(address(ends[1]))
    for length in (0, 3, 8):
        for extended in (0, 0x80):
            head = np.array([0x21, 0x01, 0, extended, length, 0, 0, 0], np.uint8)
            data = np.arange(8, dtype=np.uint8) * (np.arange(8) < length)
            ours.tx[:16] = np.concatenate([head, data])
            assert put_frame(ours) and get_frame(ours, True) == Arrival.FRAME
            received = ours.rx.copy()
            theirs.tx[:] = ours.tx
            assert c.drive_frames(address(ends[1]), ctypes.c_int64(1)) == 1
            assert get_frame(ours, True) == Arrival.FRAME
            ours.rx[8], theirs.rx[8] = received[8], received[8]  # the driver numbers its frames
            assert bytes(ours.rx) == bytes(received) == bytes(theirs.rx), f"{length} bytes"
            get_frame(theirs, True)
    for end in ends:
        frame.close_end(end)


def test_python_c_and_cantools_pack_the_same_bytes_and_read_the_same_values() -> None:
    ours, theirs = codec.frames_of(), codec.frames_of()
    codec.in_python(ours, 1)
    codec.in_c(theirs, 1, frame.library())
    assert ours.data.any() and (ours.data == theirs.data).all()
    assert (ours.found.view(np.int64) == theirs.found.view(np.int64)).all()
    known = dict(zip(ours.table.variables, ours.found.tolist(), strict=True))
    for data, (message, values) in zip(ours.data, ours.messages(), strict=True):
        encoded = message.encode(values, strict=False)
        assert bytes(data[: len(encoded)]) == encoded, f"{message.name}: cantools {encoded.hex()}"
        for name, value in message.decode(encoded, decode_choices=False).items():
            assert known.get(f"{message.name}.{name}", value) == value, f"{message.name}.{name}"


def test_cycle_gives_its_ratios() -> None:
    found = medians(cycle.measure(QUIET, rounds=2))
    assert {what for what, _ in found} == {"in memory", "on the bus", "publish 256"}


def test_a_compiled_frame_is_three_times_faster_than_with_python_can(
    capsys: pytest.CaptureFixture[str],
) -> None:
    found = medians(frame.measure(QUIET, rounds=2))
    ratio = found["udp_multicast", "python-can"]
    assert ratio < 1 / 3, f"{ratio:.3f} of python-can's time"
    assert ("udp_multicast", frame.AGAINST) in found
    if not buses.vcan_ready(frame.VCAN):
        assert "no vcan0 here" in capsys.readouterr().err


def test_the_codec_is_twenty_times_faster_than_cantools() -> None:
    found = medians(codec.measure(QUIET, rounds=2))
    ratio = found["all 14 frames", "cantools"]
    assert len(found) == 2 and ratio < 1 / 20, f"{ratio:.4f} of cantools' time"


def test_the_virtual_run_gives_its_ratios_at_matched_accuracy() -> None:
    s = simulate.segment()
    exact = simulate.by_scipy(s, "DOP853", simulate.REFERENCE)
    own = np.abs(simulate.own_muzzle(s) - exact).max()
    assert np.ptp(exact) > 1e-3 and own < 1e-9, f"{own:.1e} rad from the reference"
    for method, tolerance in simulate.matched_methods(s):
        error = np.abs(simulate.by_scipy(s, method, tolerance) - exact).max()
        assert error <= own, f"{method} at {tolerance:.0e}: {error:.1e}, the plant {own:.1e} rad"
    found = medians(simulate.measure(QUIET, rounds=1))
    assert len(found) == 2 and ("slew10", "C -O2, both nodes") in found


def test_the_recorder_gives_its_ratios() -> None:
    found = medians([recorder.throughput(QUIET, rounds=1)])
    assert found["throughput", "mcap.Writer.add_message"] > 1.0, f"{found}"
    late_us, work_us = recorder.one_run(recorder.UnrecordedHost, seconds=0.4)
    assert 0.0 < late_us < 1e6 and 0.0 < work_us < 1e6, f"{late_us}, {work_us} us"


def test_the_start_is_timed() -> None:
    found = medians(startup.measure(QUIET, rounds=1, cold=False))
    (what, _), *rest = found
    assert what == "warm" and not rest


@pytest.mark.parametrize("measure", [cycle.measure, frame.measure, codec.measure, simulate.measure])
def test_without_a_compiler_the_cure_is_named(
    measure: Callable[..., list[Ratio]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(CompilerError, match="no C compiler on PATH; `apt-get install gcc`"):
        measure(QUIET, 1)


def test_suites_of_minutes_run_only_when_asked_by_name() -> None:
    assert set(ON_REQUEST) == {"batch", "host", "startup"} and set(ON_REQUEST) < set(SUITES)


def test_what_is_missing_is_named_before_anything_is_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setitem(sys.modules, "scipy", None)
    assert main(COMMAND, ["codec", "batch", "simulate", "--quiet"]) == 4
    printed, told = capfd.readouterr()
    assert printed == "" and len(told.splitlines()) == 1
    assert told.startswith("not measured: codec batch simulate: cc: no C compiler on PATH; `apt")
    monkeypatch.undo()
    monkeypatch.setitem(sys.modules, "scipy", None)
    assert main(COMMAND, ["batch", "simulate", "--quiet"]) == 4
    told = capfd.readouterr().err
    assert told.startswith("not measured: batch simulate: it needs scipy: ") and "pip" in told, told


def test_each_of_several_suites_has_a_process_and_all_are_in_one_file(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    table = tmp_path / "ratios.json"
    words = ["codec", "frame", "--rounds", "1", "--quiet", "--json", str(table)]
    assert main(COMMAND, words) == 0
    suites = [row["suite"] for row in strictly_holds("bench", table.read_text())]
    assert suites[0] == "codec" and suites[-1] == "frame", f"{suites}"
    assert capfd.readouterr().out.count("ratio") == len(suites)


def test_the_lanes_of_the_suite_are_runs_of_their_own_and_fault_in_none() -> None:
    one = batch.group()
    batch.once(one)
    theta = one.plans["plant"].names.index("barrel.theta_rad")
    assert len(set(one.seats["plant"].values[theta].tolist())) == 8, "each its own play"
    assert batch.in_threads([one], 1) > 0.0


def test_the_processor_time_of_lanes_is_that_of_the_thread_that_does_them() -> None:
    one = batch.group()
    batch.once(one)
    before = resource.getrusage(resource.RUSAGE_SELF)
    measured_s = 1e-9 * 8 * batch.in_lanes(one)
    after = resource.getrusage(resource.RUSAGE_SELF)
    whole_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    assert 0.5 * whole_s < measured_s < 1.5 * whole_s, "of the process, which does nothing else"
