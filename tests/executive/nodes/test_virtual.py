"""Virtual time: the same run again gives the same bits, one sample of delay, and known results."""

import math
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from engine import ATB1000, SLEW10, puppet_rig
from replays import replayed

from pcpc.executive.log import reader as logs
from pcpc.executive.loop.states import State
from pcpc.executive.nodes.virtual import VirtualRun, simulate
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.after.verdict.judge import Judge

# engage needs a neural law: test_neural_controllers.py
RIGS = sorted(p for p in (ATB1000 / "rigs").glob("*.yaml") if p.stem != "engage")
TOPICS = ("/state", "/plant/state")
ENCODER_LSB_RAD = 2.3968449810713143e-05  # 2 pi / 2^18
COMMAND_LSB_NM = 1e-4
COMMAND_ID = 0xA0

Simulate = Callable[..., Path]

# Muzzle error, rms over the rig's window, mrad: reference values of an independent implementation,
# printed with three digits.
MUZZLE_RMS_MRAD = {
    #            pd     pd_star  pid
    "slew10": (3.45, 2.32, 2.07),
    "slew25": (3.20, 2.14, 2.00),
    "bang10": (2.73, 2.07, 2.40),
    "step10": (21.9, 21.8, 21.9),
    "step25": (66.0, 66.1, 66.0),
    "sin0.2": (2.41, 1.67, 0.786),
    "sin0.5": (2.82, 1.95, 1.63),
    "sin1.0": (4.17, 3.00, 3.47),
    "hull": (2.35, 1.63, 1.40),
    "hullrand": (2.53, 1.73, 1.41),
    "lowspeed": (2.21, 1.54, 0.512),
    "fire": (0.981, 0.927, 0.632),
    "firetrack": (3.37, 2.30, 0.680),
}
CONTROLLERS = ("pd", "pd_star", "pid")
ONLY_HERE = {"rough"}  # whose world nobody else has implemented; test_rough.py derives its parts
CASES = [
    (rig, law, rms)
    for rig, row in MUZZLE_RMS_MRAD.items()
    for law, rms in zip(CONTROLLERS, row, strict=True)
]


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Simulate:
    """Return a function that simulates a rig once per set of options and returns its log."""
    folder = tmp_path_factory.mktemp("logs")

    @cache
    def run(rig: Path, controller: str | None, *options: str, again: int = 0) -> Path:
        log = folder / f"{len(list(folder.iterdir()))}.mcap"
        simulate(load_rig(rig, controller, options), log)
        return log

    return run


def metrics(path: Path, rig_file: Path) -> dict[str, float]:
    """Return what the rig's evaluation finds in a log."""
    return Judge.of(load_rig(rig_file, resolve=False)).metrics(logs.read(path))


def quantised(values: np.ndarray, lsb: float) -> np.ndarray:
    """Return what arrives of `values` sent with this resolution."""
    return np.rint(values / lsb) * lsb


# ------------------------------------------------------------------------------------ the same bits


@pytest.mark.parametrize("rig", RIGS, ids=lambda rig: rig.stem)
def test_a_shorter_run_has_the_bits_of_the_longer_ones_begin(
    simulated: Simulate, rig: Path
) -> None:
    whole, short = simulated(rig, "pid"), simulated(rig, "pid", "duration_s=0.25")
    for topic in TOPICS:
        one, other = logs.payloads(whole, topic), logs.payloads(short, topic)
        differing = [k for k, (a, b) in enumerate(zip(one, other, strict=False)) if a != b]
        assert len(other) >= 250, f"{topic}: {len(other)} records"
        assert not differing, f"{topic}: {len(differing)} records differ, first {differing[0]}"


def test_another_seed_gives_other_noise(simulated: Simulate) -> None:
    first = logs.read(simulated(SLEW10, None, "duration_s=0.25"))
    other = logs.read(simulated(SLEW10, None, "duration_s=0.25", "seed=2"))
    for name in ("barrel.hub_rate_rad_s", "barrel.shaft_torque_Nm"):
        same = first.node["plant"].columns[name] == other.node["plant"].columns[name]
        assert not same.any(), f"{name}: {same.sum()} of {len(same)} samples are equal"


# ------------------------------------------------------------------------------- records and delay


@pytest.mark.parametrize("rig", RIGS, ids=lambda rig: rig.stem)
def test_the_log_has_every_cycle_once(simulated: Simulate, rig: Path) -> None:
    log = logs.read(simulated(rig, "pid"))
    assert not log.missing, log.missing
    cycles = round(load_rig(rig, resolve=False).config.duration_s * 1000)
    for role, count in (("executive", cycles), ("plant", cycles + 1)):
        node = log.node[role]
        assert node.cycle.tolist() == list(range(count)), f"{role}: {len(node.cycle)} records"
        late = node.columns["time.t_s"] - node.cycle * 1e-3
        assert np.abs(late).max() < 1e-12, f"{role}: t differs from k T by {np.abs(late).max():.1e}"
        for what, rows in (("records", node), ("frames", node.frames.view(np.recarray))):
            early = np.flatnonzero(rows.stamp_ns != rows.cycle * 1_000_000)
            assert not len(early), f"{role}: stamps of {len(early)} {what} are not k T"


def test_a_run_without_loss_counts_nothing_but_frames(simulated: Simulate) -> None:
    log = logs.read(simulated(SLEW10, None, "duration_s=0.8"))
    for role, node in log.node.items():
        counts = {name: node.timing[name][-1] for name in node.timing if name.startswith("health.")}
        moving = ("health.passes", "health.frames_sent", "health.frames_received")
        assert all(counts.pop(name) > 790 for name in moving), f"{role}: {counts}"
        assert not any(counts.values()), f"{role}: {counts}"


def test_cycle_k_computes_from_the_plants_sample_k(simulated: Simulate) -> None:
    log = logs.read(simulated(SLEW10, None, "duration_s=0.8"))
    received = log.node["executive"].columns["rx.FB_A.encoder"]
    sent = quantised(log.node["plant"].columns["barrel.encoder_rad"], ENCODER_LSB_RAD)
    assert len(np.unique(received)) > 100, "the encoder hardly moved: this would prove nothing"
    wrong = np.flatnonzero(received != sent[: len(received)])
    assert not len(wrong), f"{len(wrong)} cycles differ, first {wrong[0]}"


def test_the_command_of_cycle_k_acts_from_sample_k_plus_1_on(simulated: Simulate) -> None:
    log = logs.read(simulated(SLEW10, None, "duration_s=0.8"))
    sent = quantised(log.node["executive"].columns["tx.CMD.motor_torque"], COMMAND_LSB_NM)
    held = log.node["plant"].columns["barrel.x_held_Nm"]
    assert len(np.unique(sent)) > 100, "the command hardly moved: this would prove nothing"
    wrong = np.flatnonzero(held[1:] != sent)
    assert not len(wrong), f"{len(wrong)} cycles differ, first {wrong[0]}"


def test_both_nodes_go_through_READY_to_RUN_and_end_in_STOP(simulated: Simulate) -> None:
    log = logs.read(simulated(SLEW10, None, "duration_s=0.25"))
    for role, shift in (("executive", 0), ("plant", 1)):
        seen = [(e["cycle"], e["name"]) for e in log.node[role].events if e["event"] == "state"]
        expected = [(shift, "READY"), (1 + shift, "RUN"), (250 + shift, "STOP")]
        assert seen == expected, f"{role}: {seen}"


def test_a_run_that_is_asked_to_stop_ends_with_a_whole_log(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    run = VirtualRun(load_rig(SLEW10), path)
    pieces = run.advance()
    done = next(pieces)
    run.stop()
    assert list(pieces) == [done], "it went on"
    run.close()
    log = logs.read(path)
    assert not log.missing and len(log.node["executive"].cycle) == done, log.missing
    assert all(block.control.state == State.STOP for block in run.blocks)


def test_a_fault_ends_with_STOP_and_no_torque_on_the_bus_and_all_of_it_in_the_log(
    tmp_path: Path,
) -> None:
    run = VirtualRun(load_rig(puppet_rig(tmp_path, "duration_s: 5.0")), tmp_path / "log.mcap")
    pieces, names = run.advance(), [v[0] for v in run.blocks[0].description["variables"]]
    block = run.blocks[0]
    block["mail_index"][0] = names.index("controller.torque_Nm")
    block["mail_value"][0] = 1.5
    block.mail.count = 1
    block.mail.request += 1
    next(pieces)
    block["v"][names.index("controller.torque_Nm")] = math.nan  # no request could do that
    next(pieces)
    assert list(pieces) == [], "it went on after the fault"
    run.close()
    node = logs.read(tmp_path / "log.mcap").node["executive"]
    tuned = [(t["cycle"], t["name"]) for t in node.tunings]
    assert tuned == [(0, "controller.torque_Nm")], tuned
    states = [(e["cycle"], e["name"]) for e in node.events if e["event"] == "state"]
    assert states[2:] == [(1001, "FAULT"), (1052, "STOP")], states
    torque = node.columns["tx.CMD.motor_torque"]
    assert (torque[:1002] == 1.5).all() and (np.diff(torque[1001:]) < 0.0).all(), torque[1000:]
    assert torque[-1] == 0.0 and node.cycle[-1] == 1051, (torque[-1], node.cycle[-1])
    data = node.frames[(node.frames["id"] == COMMAND_ID) & (node.frames["direction"] == 0)]["data"]
    raw, mode = int(data[-1, 0]) | int(data[-1, 1]) << 8, int(data[-1, 5]) >> 4
    assert (raw, mode) == (0, State.STOP), f"last command {raw}, mode {mode}"
    assert run.blocks[1].control.state == State.STOP, "the plant was not told"


# ------------------------------------------------------------------------------------------ results


def test_the_reference_table_covers_every_shipped_rig_and_controller() -> None:
    assert set(MUZZLE_RMS_MRAD) | ONLY_HERE == {rig.stem for rig in RIGS}
    assert set(CONTROLLERS) <= set(load_rig(SLEW10, resolve=False).config.controllers)


@pytest.mark.parametrize(("rig", "controller", "expected_mrad"), CASES)
def test_pointing_error_is_that_of_the_independent_implementation(
    simulated: Simulate, rig: str, controller: str, expected_mrad: float
) -> None:
    path = ATB1000 / "rigs" / f"{rig}.yaml"
    rms = metrics(simulated(path, controller), path)["muzzle_error_rms_mrad"]
    ratio = rms / expected_mrad
    assert 0.98 < ratio < 1.02, f"muzzle error {rms:.4g} mrad rms, {ratio:.3f} of {expected_mrad}"


def test_a_dead_controller_fails(simulated: Simulate) -> None:
    alive = metrics(simulated(SLEW10, "pd"), SLEW10)["muzzle_error_rms_mrad"]
    gains = ("controller.kv_Nms_rad=0.0", "controller.km_Nms_rad=0.0")
    dead = metrics(simulated(SLEW10, "pd", *gains), SLEW10)["muzzle_error_rms_mrad"]
    assert dead > 10.0 * alive, f"dead {dead:.3g} mrad, alive {alive:.3g} mrad"


def test_the_shot_moves_the_muzzle_by_what_no_controller_can_prevent(simulated: Simulate) -> None:
    path = ATB1000 / "rigs" / "fire.yaml"
    peaks = {
        law: metrics(simulated(path, law), path)["muzzle_error_max_mrad"] for law in CONTROLLERS
    }
    assert all(math.isclose(peak, 5.33, rel_tol=0.08) for peak in peaks.values()), peaks


@pytest.mark.parametrize("stopped", [False, True])
def test_a_run_that_ends_on_a_ramp_is_recomputed_bit_for_bit(tmp_path: Path, stopped: bool) -> None:
    limits = "{CMD.motor_torque: {low: -2.0, high: 2.0, rate_per_s: 50.0, safe: 1.5}}"
    path = tmp_path / "slow.yaml"
    path.write_text(f"base: {SLEW10}\nduration_s: 2.0\nexecutive: {{limits: {limits}}}\n")
    run = VirtualRun(load_rig(path), tmp_path / "log.mcap")
    for _ in run.advance():
        if stopped:
            run.stop()
    run.close()
    sent = logs.read(tmp_path / "log.mcap").node["executive"].columns["tx.CMD.motor_torque"]
    cycles = 1000 if stopped else 2000
    assert cycles + 10 < len(sent) < cycles + 100 and abs(sent[-1] - 1.5) <= 0.05, len(sent)
    for verdict in replayed(tmp_path / "log.mcap"):
        assert verdict.identical, f"{verdict.first()} {verdict.incomplete}"
