"""A rig of three nodes on two buses: who hears what, delays, losses on purpose."""

from pathlib import Path

import numpy as np
import pytest
from replays import replayed

from pcpc.drivers.can import dbc
from pcpc.executive.errors import RigError
from pcpc.executive.log import reader as logs
from pcpc.executive.nodes.plan import plan
from pcpc.executive.nodes.virtual import in_memory, simulate
from pcpc.executive.rig.bus_load import bus_load
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.after.verdict.outcome import Outcome
from pcpc.tools.after.verdict.summary import summarise

RELAY = Path(__file__).parents[1] / "relay" / "rig.yaml"


def run(*settings: str) -> logs.Log:
    return in_memory(load_rig(RELAY, settings=settings))


def test_the_loop_is_closed_through_the_local_node() -> None:
    """The lag under gain 4 settles at 4/5; each bus adds a sample of delay."""
    log = run()
    assert list(log.node) == ["executive", "local", "plant"]
    position = log.node["plant"].columns["lag.position"]
    assert position[-1] == pytest.approx(0.8, abs=1e-5), position[-1]
    seen = log.node["executive"].columns["rx.TELL.position"]
    measured = log.node["local"].columns["rx.FB.position"]
    assert np.array_equal(seen[:500], measured[:500]), "the executive sees the cycle's own sample"
    assert np.flatnonzero(position > 0)[0] == 2, "ask in cycle 0, command in 1, motion from 2"


def test_the_local_nodes_command_goes_to_its_safe_value_at_its_rate(tmp_path: Path) -> None:
    """The executive ends; the local node's command of 0.8 still has 100 cycles to go."""
    path = tmp_path / "slow.yaml"
    limits = "{CMD.command: {low: -5.0, high: 5.0, rate_per_s: 4.0, safe: 0.4}}"
    path.write_text(f"base: {RELAY}\nlocal: {{limits: {limits}}}\n")
    rig = load_rig(path)
    simulate(rig, tmp_path / "log.mcap")
    log = logs.read(tmp_path / "log.mcap")
    local, plant = log.node["local"], log.node["plant"]
    sent = local.columns["tx.CMD.command"]
    assert np.abs(np.diff(sent)).max() <= 0.004 * (1 + 1e-12), np.abs(np.diff(sent)).max()
    assert sent[999] > 0.79 and abs(sent[-1] - 0.4) <= 0.004, (sent[999], sent[-1])
    assert 1095 <= len(sent) <= 1110, f"{len(sent)} cycles for 1000 and the ramp"
    assert set(local.columns["supervisor.state"][10:]) == {2.0}, "RUN to the end"
    assert np.abs(plant.columns["rx.CMD.command"][-1] - 0.4) <= 0.005, "the plant took it"
    outcome = Outcome("virtual", "memory", nodes=list(log.node))
    assert summarise(rig, log, outcome).verdict == "ok"


def test_each_node_has_only_the_frames_of_its_buses() -> None:
    rig = load_rig(RELAY)
    plans = {role: plan(rig, role, "sync") for role in rig.roles}
    local = plans["local"]
    assert local.below == {"SYNC_LOCAL", "CMD", "FB", "HB_PLANT"}
    assert not plans["executive"].below and not plans["plant"].below
    assert {f.name for f in plans["executive"].rx_frames} == {"TELL", "HB_LOCAL"}
    assert {f.name for f in plans["plant"].rx_frames} == {"SYNC_LOCAL", "CMD"}
    assert sorted(local.receive_ids) == [128, 160, 1793]
    assert sorted(local.receive_ids_below) == [288, 1794]


def test_the_load_is_that_of_the_fuller_bus_not_of_both_together() -> None:
    rig = load_rig(RELAY)
    database = dbc.load(rig.dbc)
    both = dbc.bus_load(database, 1000.0, 1e6)
    fuller = bus_load(rig, database, 1000.0, 1e6)
    assert 0.5 * both <= fuller < 0.52 * both, f"{fuller:.3f} of {both:.3f}"


@pytest.mark.parametrize("frame", ["ASK", "FB", "TELL"])
@pytest.mark.parametrize(("share", "burst"), [(0.01, 1.0), (0.1, 1.0), (0.3, 5.0)])
def test_losses_have_their_share_and_their_bursts(
    frame: str, share: float, burst: float, tmp_path: Path
) -> None:
    settings = [f"losses.{frame}.share={share}", f"losses.{frame}.burst={burst}"]
    rig = load_rig(RELAY, settings=[*settings, "duration_s=20.0"])
    simulate(rig, tmp_path / "log.mcap")
    log = logs.read(tmp_path / "log.mcap")
    role = {"ASK": "local", "FB": "local", "TELL": "executive"}[frame]
    names = logs.frame_names(log)
    received = log.node[role].frames[log.node[role].frames["direction"] == 1]
    own = received[[names[int(i)] == frame for i in received["id"]]]
    lost = own["e2e"] == 6
    sigma = np.sqrt(share * (1 - share) * (2 * burst - 1) / len(own))
    assert abs(lost.mean() - share) < 5 * sigma, f"{lost.mean():.4f} of {len(own)} frames"
    runs = np.diff(np.flatnonzero(np.diff(np.concatenate(([0], lost, [0])))))[::2]
    assert runs.mean() == pytest.approx(burst, rel=0.15), f"runs of {runs.mean():.2f}"
    counted = log.node[role].timing["health.frames_lost"][-1]
    assert 0 < counted <= lost.sum(), f"{counted} counted of {lost.sum()}"


def test_losses_are_the_same_in_every_run_and_others_with_another_seed() -> None:
    lossy = ("losses.ASK.share=0.2", "losses.FB.share=0.2")
    first, again, other = run(*lossy), run(*lossy), run(*lossy, "seed=2")
    missed = [
        log.node["local"].columns["supervisor.missing_cycles"] for log in (first, again, other)
    ]
    assert np.array_equal(missed[0], missed[1])
    assert not np.array_equal(missed[0], missed[2])


def test_losses_on_purpose_are_replayed_and_no_fault_of_the_run(tmp_path: Path) -> None:
    lossy = ["losses.ASK.share=0.2", "losses.FB.share=0.3", "losses.FB.burst=5", "duration_s=2.0"]
    rig, path = load_rig(RELAY, settings=lossy), tmp_path / "log.mcap"
    simulate(rig, path)
    for verdict in replayed(path):
        assert verdict.identical, f"{verdict.first()} {verdict.incomplete}"
    log = logs.read(path)
    summary = summarise(rig, log, Outcome("virtual", "memory"))
    frames = summary.frames
    assert 700 < frames["lost_on_purpose"] < 1300, frames
    assert 0 < frames["lost"] <= frames["lost_on_purpose"], frames
    assert summary.verdict == ("loss" if frames["stale"] else "ok"), summary.verdict


@pytest.mark.parametrize(
    ("frame", "said"),
    [
        ("TEL", r"losses\.TEL: no frame TEL; did you mean TELL\?"),
        (
            "HB_PLANT",
            r"HB_PLANT is a heartbeat, for which the start waits; losses work on ASK, .*FB",
        ),
    ],
)
def test_a_loss_of_a_frame_that_cannot_have_it_is_refused(
    frame: str, said: str, tmp_path: Path
) -> None:
    file = tmp_path / "rig.yaml"
    file.write_text(f"base: {RELAY}\nrig: wrong\nlosses: {{{frame}: {{share: 0.1}}}}\n")
    with pytest.raises(RigError, match=said):
        plan(load_rig(file), "executive", "sync")


def test_a_frame_on_both_buses_is_refused(tmp_path: Path) -> None:
    text = (RELAY.parent / "relay.dbc").read_text()
    (tmp_path / "both.dbc").write_text(
        text.replace('2147.483647] "" EXEC', '2147.483647] "" EXEC,PLANT')
    )
    (tmp_path / "rig.yaml").write_text(f"base: {RELAY}\nrig: both\ndbc: both.dbc\n")
    with pytest.raises(RigError, match="frame TELL is on both buses"):
        plan(load_rig(tmp_path / "rig.yaml"), "local", "sync")
