"""Faults on purpose in real processes: the bits of virtual time, replay, begun and ended live."""

from pathlib import Path

import numpy as np
import pytest
from processes import DEADLINE_S, ROOT, Running, own_bus, pcpc

import pcpc as package
from pcpc.executive.log import reader

FAULTS = """\
  bias: {kind: bias, at: "plant:tx.FB.encoder", value: 0.02, from: 120ms, for: 20ms}
  noise: {kind: noise, at: controller.voltage_V, value: 0.5, share: 0.3, every: 60ms, for: 9ms}
  heavy: {kind: gain, at: "plant:motor.inertia_kg_m2", value: 2.0, from: 150ms, for: 40ms}
  bits: {kind: corruption, frame: CMD, value: 3, share: 0.3, times: 4, for: 10ms}
  delay: {kind: delay, frame: FB, value: 2, from: 200ms, for: 10ms}
  turn: {kind: sequence, frame: FB, from: 130ms, for: 6ms}
  late: {kind: stall, node: executive, from: 215ms, for: 3ms}
  low: {kind: stall, node: plant, from: 240ms, for: 3ms}
  forged: {kind: masquerade, frame: FB, from: 260ms, for: 1ms}
"""
BY_HAND = """\
  spare: {kind: stuck, at: "plant:tx.FB.encoder"}
  break: {kind: stall, node: plant}
"""
PLAUSIBLE = "{FB.encoder: {low: -9, high: 9, rate_per_s: 60, fault_after: 90}}"


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the motor with faults of all groups; what it has to hold is left out."""
    folder = tmp_path_factory.mktemp("faults") / "motor"
    done = pcpc("new", str(folder))
    assert done.code == 0, str(done)
    path = folder / "rig.yaml"
    text = path.read_text().partition("evaluation:")[0]
    before, limits, after = text.partition("  limits:\n")
    text = f"{before}  plausible: {PLAUSIBLE}\n{limits}{after}"
    path.write_text(f"{text}errors: {{implausible: 99}}\nfaults:\n{FAULTS}{BY_HAND}")
    return path


@pytest.fixture(scope="module")
def calm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the motor with faults that only a hand begins: no stall of the machine can end it."""
    path = tmp_path_factory.mktemp("by_hand") / "motor" / "rig.yaml"
    done = pcpc("new", str(path.parent))
    assert done.code == 0, str(done)
    path.write_text(f"{path.read_text().partition('evaluation:')[0]}faults:\n{BY_HAND}")
    return path


def test_virtual_time_and_a_bus_without_a_clock_give_the_same_bits(
    rig: Path, tmp_path: Path
) -> None:
    short = "--set", "duration_s=0.3", "--quiet", "-o"
    done = pcpc("simulate", str(rig), *short, str(tmp_path / "virtual"), "--json")
    assert done.code == 0, str(done)
    log = reader.read(tmp_path / "virtual" / "log.mcap")
    assert [sum(np.diff(node.cycle) - 1) for node in log.node.values()] == [3, 3], (
        "both stood still"
    )
    assert done.summary["frames"]["implausible"] > 0, "the forged frame at least"
    told = {line.split(" at ")[0] for line in done.summary["injected"]}
    assert told == {
        "noise", "late", "turn", "bias", "heavy", "bits", "delay", "low", "forged"
    }  # fmt: skip
    bus = own_bus()
    done = pcpc(
        "run", str(rig), "--pacing", "lockstep", "--bus", bus, *short, str(tmp_path / "bus")
    )
    assert done.code == 0, str(done)
    done = pcpc("compare", "--bits", str(tmp_path / "virtual"), str(tmp_path / "bus"))
    assert done.code == 0, str(done)
    for run in ("virtual", "bus"):
        done = pcpc("replay", str(tmp_path / run))
        assert done.code == 0 and done.out.count("bit-identical") == 2, str(done)


def test_a_paced_run_with_faults_is_replayed_bit_by_bit(rig: Path, tmp_path: Path) -> None:
    for pacing in ("real", "sync"):
        folder = tmp_path / pacing
        pcpc(
            "run",
            str(rig),
            "--pacing",
            pacing,
            "--bus",
            own_bus(),
            "--set",
            "duration_s=0.3",
            "--quiet",
            "-o",
            str(folder),
        )
        done = pcpc("replay", str(folder))
        assert done.code == 0 and done.out.count("bit-identical") == 2, str(done)


def test_a_fault_is_begun_and_ended_while_the_rig_runs(calm: Path) -> None:
    with package.running(
        calm, pacing="real", set={"duration_s": 60.0, "supervisor.fault_after_cycles": 10000}
    ) as live:
        before = live.inject("spare")
        live.wait_until("plant:fault.spare.left", above=0.5, within_s=DEADLINE_S)
        after = live.clear("spare")
        live.wait_until("plant:fault.spare.left", below=0.5, within_s=DEADLINE_S)
        assert after > before
        live.inject("spare", for_s=0.05)
        live.wait_until("plant:fault.spare.left", below=0.5, within_s=DEADLINE_S)
        with pytest.raises(package.Error, match="spar: no such fault; did you mean spare"):
            live.inject("spar")
        with pytest.raises(package.Error, match="outside"):
            live.inject("spare", share=2.0)
        skipped = live["plant:health.skipped_cycles"]
        live.inject("break", for_s=0.01)
        live.wait_until("plant:health.skipped_cycles", above=skipped + 9.5, within_s=DEADLINE_S)
    run = live.run
    assert all(node.identical for node in run.replay())


def test_the_command_lists_begins_and_ends_them(calm: Path, tmp_path: Path) -> None:
    bus = own_bus()
    lasts = "--set", "duration_s=120", "--set", "supervisor.fault_after_cycles=10000"
    with Running(
        "run",
        str(calm),
        "--pacing",
        "real",
        "--bus",
        bus,
        *lasts,
        "--set",
        "rig=faulty",
        "--quiet",
        "-o",
        str(tmp_path / "run"),
    ) as run:
        run.in_the_middle("faulty", bus)
        name = run.block("faulty", bus, "plant").name
        done = pcpc("fault", "--node", name)
        assert done.code == 0 and "spare" in done.out and "stuck of plant:tx.FB.encoder" in done.out
        assert max(map(len, done.out.splitlines())) <= 80, done.out
        for part in ("faulty.plant", "faulty"):  # RIG: the executive's, too
            assert "spare" in pcpc("fault", "--node", part).out, part
        done = pcpc("fault", "sparse", "--node", name)
        assert (done.code, done.err) == (2, "sparse: no such fault; did you mean spare?\n")
        done = pcpc("fault", "spare", "--for", "300s", "--node", name)
        assert done.code == 0 and done.out.startswith("spare on for 300s: plant from cycle ")
        done = pcpc("fault", "spare", "--end", "--node", name)
        assert done.code == 0 and done.out.startswith("spare ended: plant from cycle ")


def test_without_a_rig_it_says_so() -> None:
    done = pcpc("fault", "--node", "nowhere.executive")
    assert done.code == 4 and "no such node is running" in done.err, str(done)


EXCUSES = [
    ('{kind: bias, at: "plant:tx.FB.encoder", value: 0.0, from: 120ms, for: 5ms}', True, "loss"),
    ("{kind: corruption, frame: CMD, from: 120ms, for: 1ms}", True, "loss"),
    ("{kind: corruption, frame: CMD, from: 900ms, share: 0.01}", True, "loss"),
    ("{kind: corruption, frame: CMD, from: 0ms, share: 0.01}", True, "loss"),
    ("{kind: flood, node: plant, value: 9, from: 0ms}", True, "loss"),
    ("{kind: loss, frame: FB, from: 500ms, for: 30ms}", False, "ok"),
    ("{kind: stall, node: plant, from: 960ms, for: 50ms}", False, "ok"),
]


@pytest.mark.parametrize(("fault", "losses", "verdict"), EXCUSES)
def test_a_fault_of_frames_excuses_what_is_missing_while_it_is_on(
    fault: str, losses: bool, verdict: str, rig: Path, tmp_path: Path
) -> None:
    own = rig.with_name("excused.yaml")
    own.write_text(
        f"base: {ROOT / 'tools/make/template/rig.yaml'}\nrig: excused\nevaluation: null\n"
        f"expect: null\nrequire: null\nfaults: {{it: {fault}}}\n"
        + "losses: {FB: {share: 0.3, burst: 30}}\n"
        * losses
    )
    done = pcpc("simulate", str(own), "--quiet", "--json", "-o", str(tmp_path / "run"))
    assert done.summary["verdict"] == verdict and done.summary["injected"], str(done)
    assert done.summary["frames"]["stale"] > 0
