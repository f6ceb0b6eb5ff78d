"""`import pcpc`: runs in virtual time and real processes, from Python."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from copies import program
from hypothesis import example, given
from hypothesis import strategies as st
from places import PATIENCE_S
from processes import alive, own_bus, until

import pcpc
from pcpc.executive.log.signals import signals
from pcpc.executive.nodes.tap import Tap
from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.rig import yamlfile
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.after.log import series
from pcpc.tools.api.live import _verdict
from pcpc.tools.start.rigs import find
from pcpc.tools.start.settings import settings

NEW_PROCESSES = True  # `pcpc.running` starts what it starts for its users
SHORT = {"duration_s": 0.3}


AN_INPUT = r"an input, not recorded; use its source rx\.FB_A\.encoder"


@pytest.fixture(scope="module")
def run() -> pcpc.Run:
    """Return a short run of the barrel, its seed set."""
    return pcpc.simulate("slew10", set=SHORT, seed=7, quiet=True)


def test_a_simulated_run_has_the_bits_of_virtual_time(run: pcpc.Run) -> None:
    log = in_memory(load_rig(find("slew10"), None, ["duration_s=0.3", "seed=7"]))
    executive, plant = log.node["executive"], log.node["plant"]
    for name, values in executive.columns.items():
        assert run[name].tobytes() == values.tobytes(), name
    for name, values in plant.columns.items():  # its sample of the executive's cycle
        assert run[f"plant:{name}"].tobytes() == values[: len(executive.cycle)].tobytes(), name
    assert np.array_equal(run.t_s, executive.cycle * 1e-3)
    assert run.rig.config.seed == 7


def test_a_variable_that_was_not_recorded_is_a_line_with_a_proposal(run: pcpc.Run) -> None:
    with pytest.raises(KeyError, match=r"^controller\.e_radd: .*did you mean controller\.e_rad\?$"):
        run["controller.e_radd"]
    with pytest.raises(pcpc.Error, match="not recorded"):
        run["plant:controller.e_rad"]
    with pytest.raises(pcpc.UnknownName, match="a parameter"):
        run["controller.kv_Nms_rad"]
    with pytest.raises(pcpc.UnknownName, match=AN_INPUT):
        run["controller.encoder_rad"]
    with pytest.raises(pcpc.UnknownName, match=r"use its source plant:rx\.CMD\.motor_torque$"):
        run["barrel.motor_command_Nm"]
    assert "controller.e_rad" in run and "controller.e_radd" not in run
    assert run.units["controller.e_rad"] == "rad"


def test_a_name_is_known_with_and_without_its_node(run: pcpc.Run) -> None:
    for name in ("barrel.theta_rad", "controller.e_rad"):
        node = "plant" if name.startswith("barrel") else "executive"
        assert run[name].tobytes() == run[f"{node}:{name}"].tobytes(), name
        assert name in run and f"{node}:{name}" in run
        entry = f"abs({name}) < 100 rad"
        assert (
            run.require(always=entry).margin
            == run.require(always=f"abs({node}:{name}) < 100").margin
        )
        known = series.all_series(run.log)
        found = [series.choose(known, [n], "", [run.log]) for n in (name, f"{node}:{name}")]
        assert found[0] == found[1] != [], found
        assert signals(run.path, [name]).columns == signals(run.path, [f"{node}:{name}"]).columns
        judged = run._judged_run.run()
        assert judged[name].tobytes() == judged[f"{node}:{name}"].tobytes()
    assert run["time.t_s"].tobytes() == run["executive:time.t_s"].tobytes(), "of both nodes"
    for refused in (
        lambda: run.require(always="controller.encoder_rad < 1"),
        lambda: series.choose([], ["controller.encoder_rad"], "", [run.log]),
        lambda: signals(run.path, ["controller.encoder_rad"]),
        lambda: run._judged_run.run()["controller.encoder_rad"],
        lambda: run.figure("controller.encoder_rad"),
    ):
        with pytest.raises(pcpc.Error, match=AN_INPUT):
            refused()


def test_frames_are_those_of_the_bus_each_once(run: pcpc.Run) -> None:
    executive = run.log.node["executive"].frames
    sent = run.frames[run.frames["sender"] == "executive"]
    assert len(sent) == (executive["direction"] == logs_sent(executive)).sum()
    assert (np.diff(run.frames["t_s"]) >= 0.0).all()
    sync = run.frames[run.frames["name"] == "SYNC"]
    assert (sync["id"] == 0x80).all() and abs(len(sync) - 300) <= 2
    assert np.allclose(np.diff(sync["t_s"])[1:], 1e-3, atol=1e-9)  # the first asks for sample 0


def logs_sent(frames: np.ndarray) -> int:
    """Return the direction of SYNC, which the executive sends."""
    return int(frames["direction"][frames["id"] == 0x80][0])


def test_a_run_recomputes_to_the_bit_and_a_change_shows(run: pcpc.Run) -> None:
    assert all(node.identical for node in run.replay())
    changed = run.replay(set={"controller.kv_Nms_rad": 90.0})
    assert not all(node.identical for node in changed)


def test_what_a_run_came_to_is_that_of_the_command_line(tmp_path: Path) -> None:
    of_api = pcpc.simulate("hull", set={"duration_s": 12.0}, folder=tmp_path / "api")
    command = [program(), "simulate", "hull", "--quiet"]
    command += ["--no-figure", "-o", str(tmp_path / "cli")]
    subprocess.run(command, check=True, capture_output=True)
    of_command = pcpc.open(tmp_path / "cli")
    assert of_api.verdict == of_command.verdict == "ok"
    assert of_api.metrics and of_api.metrics == of_command.metrics
    assert of_api.check() is of_api
    moved = tmp_path / "moved.mcap"  # a log alone is judged by what it carries
    (tmp_path / "cli" / "log.mcap").rename(moved)
    assert pcpc.open(moved).metrics == of_command.metrics


def test_a_run_that_is_not_ok_says_why(run: pcpc.Run) -> None:
    bad = pcpc.simulate("slew10", set={"expect.pd.muzzle_error_rms_mrad": [0.0, 1e-9]}, quiet=True)
    assert bad.verdict == "expectation not met"
    with pytest.raises(AssertionError, match=r"muzzle_error_rms_mrad = .*, expected 0 to 1e-09"):
        bad.check()


def test_a_rig_or_setting_that_cannot_be_is_a_line() -> None:
    with pytest.raises(pcpc.Error, match=r"slew11.*did you mean slew10"):
        pcpc.simulate("slew11")
    with pytest.raises(pcpc.Error, match=r"barrel\.gapp.*did you mean gap_rad"):
        pcpc.simulate("slew10", set={"barrel.gapp": 1})
    with pytest.raises(pcpc.Error, match=r"no\.such\.mcap"):
        pcpc.open("no.such.mcap")
    with pytest.raises(TypeError, match="duration_s: a rig holds no object"):
        pcpc.simulate("slew10", set={"duration_s": object()})
    with pytest.raises(AttributeError, match=r"no attribute simulat$"):
        pcpc.simulat  # noqa: B018  for its message


def test_pictures_are_pngs_for_notebook_and_disk(run: pcpc.Run, tmp_path: Path) -> None:
    for names in ((), ("controller.e_rad", "plant:barrel.theta_rad")):
        picture = run.figure(*names, path=tmp_path / "figure.png")
        assert picture._repr_png_() == (tmp_path / "figure.png").read_bytes()
        assert picture.png.startswith(b"\x89PNG") and len(picture.png) > 10_000
    with pytest.raises(pcpc.Error, match="did you mean"):
        run.figure("controller.e_radd")


def test_a_table_of_pandas_has_every_variable(run: pcpc.Run) -> None:
    table = run.to_pandas()
    assert list(table.columns) == run.names and table.index.name == "t_s"
    assert table["controller.e_rad"].to_numpy().tobytes() == run["controller.e_rad"].tobytes()


def test_importing_it_does_not_load_the_compiler() -> None:
    code = "import pcpc, sys; print('numba' in sys.modules, 'numpy' in sys.modules, dir(pcpc))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("False False") and "'simulate'" in done.stdout


@given(
    st.recursive(
        st.none()
        | st.booleans()
        | st.integers(-(2**63), 2**63 - 1)
        | st.text()
        | st.floats(allow_nan=False),
        lambda inner: (
            st.lists(inner, max_size=3) | st.dictionaries(st.text(min_size=1), inner, max_size=3)
        ),
    )
)
@example({"\x1f" * 110: {"a": 1.0}})  # a key of more letters than YAML looks for its colon
def test_a_value_from_python_arrives_in_the_rig(value: object) -> None:
    text = settings({"name": value})[0].removeprefix("name=")
    assert yamlfile.parse_value(text, yamlfile.Place(Path("rig.yaml"))) == value


# Real processes


@contextmanager
def left_behind() -> Iterator[list[int]]:
    """Collect pids; at the end none of them may be alive."""
    pids: list[int] = []
    yield pids
    until(lambda: not any(map(alive, pids)), f"{pids} end")


def family(live: pcpc.Live) -> list[int]:
    """Return the pids of a run: of its command and of its nodes."""
    blocks = [node.block for node in live._nodes.values()]
    return [live._command.process.pid, *(int(block.control.pid) for block in blocks)]


LONG = {
    "duration_s": 3600.0,
    "supervisor.hold_cycles": 10**6,
    "supervisor.fault_after_cycles": 10**6,
}


def test_a_gain_set_live_stands_in_the_log_at_the_cycle_that_was_told() -> None:
    with left_behind() as pids:
        with pcpc.running("slew10", pacing="real", set=LONG, bus=own_bus()) as live:
            pids += family(live)
            assert live.running and live.state == "RUN"
            assert live.wait_until("time.t_s", above=0.05, within_s=PATIENCE_S) > 0.05
            cycle = live.set({"controller.kv_Nms_rad": 111.0, "controller.lam_per_s": 11.0})
            assert live["controller.kv_Nms_rad"] == 111.0
            assert live.read("controller.kv_Nms_rad", "plant:barrel.gap_rad").keys()
            with pytest.raises(pcpc.Error, match="outside"):
                live.set({"controller.kv_Nms_rad": 1e9})
            with pytest.raises(pcpc.UnknownName, match=r"did you mean controller\.e_rad"):
                live["controller.e_radd"]
            with pytest.raises(pcpc.NotMet, match=r"controller\.e_rad above 1000: not within"):
                live.wait_until("controller.e_rad", above=1000.0, within_s=0.05)
            live.wait_until(lambda now: now["time.t_s"] > 1e-3 * cycle + 0.05, within_s=PATIENCE_S)
        assert live.run.verdict == "interrupted"
        tunings = [e for e in live.run.events if e.get("name") == "controller.kv_Nms_rad"]
        assert [(e["cycle"], e["value"]) for e in tunings] == [(cycle, 111.0)]


def test_a_block_that_raises_leaves_nothing_behind() -> None:
    bus = own_bus()
    with (
        left_behind() as pids,
        pytest.raises(ZeroDivisionError),
        pcpc.running("slew10", pacing="real", set=LONG, bus=bus) as live,
    ):
        pids += family(live)
        raise ZeroDivisionError


def test_a_python_that_is_killed_leaves_nothing_behind() -> None:
    code = (
        "import pcpc, sys, signal\n"
        f"with pcpc.running('slew10', pacing='real', set={LONG!r}, bus={own_bus()!r}) as live:\n"
        "    nodes = [int(node.block.control.pid) for node in live._nodes.values()]\n"
        "    print(live._command.process.pid, *nodes, flush=True)\n"
        "    signal.pause()\n"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    with left_behind() as pids:
        pids += [int(word) for word in process.stdout.readline().split()]
        assert len(pids) == 3
        os.kill(process.pid, signal.SIGKILL)
        process.wait()


def test_a_run_that_ends_by_itself_is_waited_for_and_one_that_cannot_begin_is_a_line() -> None:
    with pcpc.running("slew10", pacing="lockstep", set=SHORT, bus=own_bus()) as live:
        run = live.wait(within_s=240.0)
    assert run.verdict == "not judged" and len(run.t_s) == 300
    assert _verdict(run.path.parent, 0) == "it ended at once: not judged"
    assert _verdict(run.path, 5) == "it ended with exit code 5"
    virtual = pcpc.simulate("slew10", set=SHORT, quiet=True)
    assert run["controller.e_rad"].tobytes() == virtual["controller.e_rad"].tobytes()
    with (
        pytest.raises(pcpc.Error, match="canx9"),
        pcpc.running("slew10", bus="socketcan:canx9", set=SHORT),
    ):
        raise AssertionError("it cannot begin")


def test_a_tap_sees_every_cycle_that_the_log_holds() -> None:
    with pcpc.running("slew10", pacing="real", set=LONG, bus=own_bus()) as live:
        tap = Tap(live._nodes["plant"])
        pieces = []
        while sum(map(len, pieces)) < 500:
            live.wait_until(lambda now: True, within_s=PATIENCE_S)
            pieces.append(tap.rows())
    cycles = np.concatenate([rows.cycle for rows in pieces])
    seen = np.concatenate([rows["barrel.theta_rad"] for rows in pieces])
    assert tap.missed["record"] == 0
    node = live.run.log.node["plant"]
    between = (node.cycle >= cycles[0]) & (node.cycle <= cycles[-1])
    np.testing.assert_array_equal(cycles, node.cycle[between])
    np.testing.assert_array_equal(seen, node.columns["barrel.theta_rad"][between])
