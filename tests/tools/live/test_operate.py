"""What an operator asks of a real run: who is in charge, from Python and from a terminal."""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from live_run import Screen
from processes import DEADLINE_S, own_bus, until

import pcpc
from pcpc.executive.nodes.live import Live
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.cli import main
from pcpc.tools.start import rigs

PATIENT = {"duration_s": 600.0, "rate_hz": 200.0, "supervisor.fault_after_cycles": 400}
SHORT = {
    "duration_s": 0.4,
    "supervisor.arm": "manual",
    "schedule": [
        {"at_s": 0.05, "set": {"supervisor.disarmed": 0}},
        {"at_s": 0.15, "handover": "pid"},
        {"at_s": 0.2, "set": {"supervisor.disarmed": 1}},
        {"at_s": 0.3, "handover": "pd", "set": {"supervisor.disarmed": 0}},
    ],
    "handover.over_s": 0.05,
}


@pytest.fixture(scope="module")
def going_on() -> Iterator[pcpc.Live]:
    with pcpc.running(
        "hull", "pd", standby=["pid", "pd_nn"], set=PATIENT, pacing="real", bus=own_bus()
    ) as live:
        yield live
    executive = live.run.log.node["executive"]
    changed = 1 + np.flatnonzero(np.diff(live.run["handover.in_charge"]))
    told = {int(one["cycle"]) for one in executive.events if one["event"] == "change"}
    assert told >= {*executive.cycle[changed]}, "cycles, of which a stalled machine skips some"
    assert all(verdict.identical for verdict in live.run.replay()), "replayed"


def node_of(live: pcpc.Live) -> Live:
    return live._node("executive")


@pytest.fixture
def run(going_on: pcpc.Live) -> pcpc.Live:
    """Return the run with its own controller in charge."""
    if going_on["handover.in_charge"] != 0.0:
        going_on.handover("pd")
    return going_on


def said(screen: Screen, run: pcpc.Live, *words: str) -> tuple[int, str, str]:
    code = main([*words, "--node", node_of(run).name])
    return code, *screen.readouterr()


def test_a_hand_over_holds_from_the_cycle_that_is_told(run: pcpc.Live) -> None:
    assert run["handover.in_charge"] == 0.0
    cycle = run.handover("pd_nn")
    assert run["handover.in_charge"] == 2.0 and run.cycle >= cycle
    assert run.handover("pd") > cycle


def test_a_terminal_hands_over_and_undo_hands_back(run: pcpc.Live, capsys: Screen) -> None:
    code, out, err = said(capsys, run, "operate", "handover", "pid", "--json")
    assert code == 0 and json.loads(out)["in_charge"] == "pid", err
    code, out, err = said(capsys, run, "operate", "handover", "pid")
    assert code == 2 and err.endswith("pid is already in charge\n"), err
    code, out, err = said(capsys, run, "undo")
    assert code == 0 and out.startswith("handover.to = 0 (was 1) from cycle "), out + err
    until(lambda: run["handover.in_charge"] == 0.0, "handed back")


def test_the_screen_names_who_is_in_charge_and_who_is_on_standby(
    run: pcpc.Live, capsys: Screen, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    for law, others in (("pid", "pd, pd_nn"), ("pd", "pid, pd_nn")):
        run.handover(law)
        code, out, err = said(capsys, run, "top", "--once")
        first, second = out.splitlines()[:2]
        assert code == 0 and first.startswith(f"hull  {law} in charge  real  "), out + err
        assert second.endswith(f"  on standby: {others}"), second


def test_a_hold_and_what_follows_are_no_fault(run: pcpc.Live, capsys: Screen) -> None:
    until(lambda: run.state in ("RUN", "HOLD"), "closed")
    run.hold()
    run.wait_until("supervisor.gain", below=1e-12, within_s=DEADLINE_S)
    assert run.state == "READY" and abs(run["tx.CMD.motor_torque"]) < 1e-12
    for word, why in (("hold", "already open"), ("resume", ""), ("arm", "already closed")):
        code, out, err = said(capsys, run, "operate", word)
        assert (code == 0) == (why == "") and why in err, out + err
        assert why or out.startswith("the loop is closed from cycle "), out
    run.wait_until("supervisor.gain", above=1.0 - 1e-12, within_s=DEADLINE_S)
    assert run.state in ("RUN", "HOLD") and run["supervisor.fault"] == 0.0


def test_who_is_not_there_is_refused_with_who_is(run: pcpc.Live, capsys: Screen) -> None:
    code, _, err = said(capsys, run, "operate", "handover", "pd_nm")
    assert code == 2 and err.endswith("pd_nm is not on standby; did you mean pd_nn?\n"), err
    code, _, err = said(capsys, run, "operate", "handover", "nobody")
    assert code == 2 and err.endswith("nobody is not on standby; known: pd, pid, pd_nn\n"), err
    assert run["handover.in_charge"] == 0.0 and run["handover.refused"] == 0.0


@pytest.mark.parametrize("words", [["handover", "pid"], ["arm"], ["hold"], ["resume"]])
def test_a_plant_is_asked_for_nothing(run: pcpc.Live, capsys: Screen, words: list[str]) -> None:
    name = run._node("plant").name
    assert main(["operate", *words, "--node", name]) == 2
    told = f"{name}: this is a plant node; `pcpc operate {words[0]}` needs an executive\n"
    assert capsys.readouterr().err == told


def test_who_is_in_charge_is_saved_for_a_rig(
    run: pcpc.Live, capsys: Screen, tmp_path: Path
) -> None:
    run.set({"pid.ki_Nm_rad": 480.0, "handover.over_s": 0.3})
    run.handover("pid")
    file = tmp_path / "tuned.yaml"
    code, _, err = said(capsys, run, "save", str(file))
    assert code == 0, err
    rig = load_rig(rigs.find("hull"), "pd", ["standby=[pid, pd_nn]", f"@{file}"])
    assert rig.config.handover.to == 1.0 and rig.config.handover.over_s == 0.3
    assert rig.config.controllers["pid"].parameters["ki_Nm_rad"] == 480.0


def test_virtual_time_and_a_bus_without_a_clock_give_the_same_bits() -> None:
    virtual = pcpc.simulate("hull", "pd", standby=["pid"], set=SHORT, quiet=True)
    with pcpc.running(
        "hull", "pd", standby=["pid"], set=SHORT, pacing="lockstep", bus=own_bus()
    ) as live:
        run = live.wait(within_s=240.0)
    assert [*np.flatnonzero(np.diff(run["handover.in_charge"]))] == [149, 299]
    for name in run.log.node["executive"].columns:
        assert run[name].tobytes() == virtual[name].tobytes(), name


def test_a_run_without_standby_says_how_to_have_one(capsys: Screen) -> None:
    with (
        pcpc.running("slew10", set=PATIENT, bus=own_bus()) as live,
        pytest.raises(
            pcpc.Error, match="no controller is on standby; start the run with --standby NAME"
        ),
    ):
        live.handover("pid")
