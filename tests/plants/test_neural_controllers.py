"""The neural pointing laws in closed loop: engagement, fallback, boundedness, nominal constants."""

from pathlib import Path

import numpy as np
import pytest
from places import ROOT

from pcpc.executive.log import reader as logs
from pcpc.executive.nodes.virtual import VirtualRun, in_memory
from pcpc.executive.rig.reading import load_rig
from pcpc.plants.atb1000.beam import Tube, modal_data

RIGS = ROOT / "plants" / "atb1000" / "rigs"


def run(rig: str, controller: str, *settings: str) -> logs.Log:
    return in_memory(load_rig(RIGS / f"{rig}.yaml", controller, settings))


def column(log: logs.Log, name: str) -> np.ndarray:
    return log.node["executive"].columns[name]


def muzzle_rms_mrad(log: logs.Log, begin_s: float, end_s: float) -> float:
    plant, n = log.node["plant"].columns, len(log.node["executive"].cycle)
    q_d = column(log, "reference.q_d_rad")
    theta = plant["barrel.theta_rad"][:n]
    droop = plant["barrel.droop_rad"][:n] / np.cos(theta) * np.cos(q_d)
    error = q_d - (plant["barrel.muzzle_rad"][:n] - droop)
    t = column(log, "time.t_s")
    window = (t >= begin_s) & (t < end_s)
    return float(1e3 * np.sqrt(np.mean(error[window] ** 2)))


def test_engaging_the_network_in_the_run_collapses_the_error() -> None:
    log = run("engage", "pd_nn_fast")
    before, after = muzzle_rms_mrad(log, 1.0, 4.0), muzzle_rms_mrad(log, 5.5, 9.0)
    assert before > 4 * after, f"{before:.2f} mrad before, {after:.2f} mrad after"
    norm = column(log, "controller.norm_z")
    assert norm[3999] == norm[0], "weights moved before the network was engaged"
    tau = column(log, "controller.tau_Nm")
    jump = abs(tau[4001] - tau[3999])
    assert jump < 1.0, f"engaging jumps by {jump:.2f} N m"


@pytest.mark.parametrize("name", ["pd_nn", "pd_nn_fast", "nn_backstepping"])
@pytest.mark.parametrize("poison", ["w_3", "v_5"])
def test_a_network_that_fails_hands_over_to_pd_within_one_cycle(name: str, poison: str) -> None:
    rig = load_rig(RIGS / "hull.yaml", name, ("duration_s=8.0",))
    virtual = VirtualRun(rig, None)
    place = [v[0] for v in virtual.blocks[0].description["variables"]].index(f"controller.{poison}")
    for cycles in virtual.advance():
        if cycles == 4000:
            virtual.blocks[0].loop.v[place] = np.nan
    log = virtual.memory.log()
    fallback, command = (
        column(log, "controller.fallback"),
        column(log, "controller.motor_torque_Nm"),
    )
    assert fallback[3999] == 0.0 and fallback[4000] == 1.0, f"{fallback[3998:4003]}"
    assert np.isfinite(command).all(), "a command was not finite"
    usual = np.abs(np.diff(command[3000:4000])).max()
    bump = abs(command[4000] - command[3999])
    assert bump < 1.5 * usual, f"bump {60 * bump:.2f} N m, usual step up to {60 * usual:.2f} N m"
    assert (column(log, "supervisor.state")[4000:7999] == 2.0).all(), "the supervisor stepped in"
    pd = muzzle_rms_mrad(run("hull", "pd", "duration_s=8.0"), 5.0, 8.0)
    after = muzzle_rms_mrad(log, 5.0, 8.0)
    assert 0.8 * pd < after < 1.2 * pd, f"{after:.2f} mrad after, PD alone {pd:.2f} mrad"


def test_a_diverging_network_is_latched_off_by_its_norm() -> None:
    log = run("sin0.5", "pd_nn_fast", "controller.f_rate=1e5", "controller.kappa=0.0")
    fallback = column(log, "controller.fallback")
    assert fallback[-1] == 1.0, f"largest norm {np.nanmax(column(log, 'controller.norm_z')):.3g}"
    first = int(np.argmax(fallback))
    assert (fallback[first:] == 1.0).all(), "not latched"


def test_the_network_off_is_pd_bit_for_bit() -> None:
    off = run("slew10", "pd_nn", "controller.network_on=0.0", "duration_s=2.0")
    pd = run("slew10", "pd", "duration_s=2.0")
    same = np.array_equal(
        column(off, "controller.motor_torque_Nm"), column(pd, "controller.motor_torque_Nm")
    )
    assert same, "pd_nn with the network off is not pd"


def test_e_modification_keeps_the_weights_bounded_for_ten_minutes(tmp_path: Path) -> None:
    """The first layer leaks with 1/(G kappa |r|), 40 min here: bounded by Z_B, not settled."""
    rig = load_rig(RIGS / "sin0.5.yaml", "pd_nn_fast", ("duration_s=600.0", "record.keep=1s"))
    virtual = VirtualRun(rig, tmp_path / "log.mcap")
    block = virtual.blocks[0]
    place = [v[0] for v in block.description["variables"]].index("controller.norm_z")
    norms = []
    for _ in virtual.advance():
        norms.append(float(block.loop.v[place]))
    virtual.close()
    fifth = len(norms) // 5
    peaks = [max(norms[i * fifth : (i + 1) * fifth]) for i in range(5)]
    assert max(norms) < 20.0, f"largest norms of each 2 minutes {peaks}"  # Z_B of the rig
    assert peaks[4] - peaks[3] < 0.6, f"largest norms of each 2 minutes {peaks}"


def test_the_nominal_constants_are_those_of_the_nominal_barrel() -> None:
    beam = modal_data(Tube(1.20, 0.020, 0.014, 205e9, 7850.0, 0.15))
    p = load_rig(RIGS / "hull.yaml", "pd_fast").nodes()["executive"].blocks[1].settings
    inertia = 3.580456  # hub, straight barrel and 60^2 times the rotor
    m = beam.coupling[0]
    w_f = beam.omega_rad_s[0] / np.sqrt(1 - m * m / inertia)
    expected = {
        "mode_rad_s": w_f,
        "mode_gain": -m / (inertia - m * m),
        "strain_ue_per_mode": 0.01e6 * beam.root[0],
    }
    for name, value in expected.items():
        assert abs(p[name] / value - 1) < 1e-4, f"{name}: {p[name]} against {value}"


# Muzzle error rms, mrad, of an independent implementation with a noise seed of its own.
NEURAL = ("pd_fast", "pd_nn", "pd_nn_fast", "nn_backstepping")
MUZZLE_RMS_MRAD = {
    "slew10": (3.42, 1.73, 1.68, 1.31),
    "slew25": (3.15, 1.61, 1.61, 1.25),
    "bang10": (2.71, 1.98, 1.99, 1.74),
    "step10": (21.9, 21.9, 21.8, 21.8),
    "step25": (66.0, 66.0, 66.0, 66.0),
    "sin0.2": (2.43, 0.319, 0.389, 0.383),
    "sin0.5": (2.81, 1.03, 1.04, 1.0),
    "sin1.0": (4.14, 2.96, 2.95, 2.14),
    "hull": (2.37, 0.27, 0.312, 0.293),
    "hullrand": (2.56, 0.304, 0.378, 0.452),
    "lowspeed": (2.21, 0.397, 0.39, 0.353),
    "fire": (1.06, 0.685, 0.699, 0.683),
    "firetrack": (3.37, 0.688, 0.691, 0.688),
}
# A limit cycle in the gear's play makes these depend on the noise seed: the median of ten seeds.
SEED_RANGES_MRAD = {
    ("hull", "nn_backstepping"): (0.22, 0.45),
    ("sin0.2", "nn_backstepping"): (0.38, 0.50),
    ("hullrand", "nn_backstepping"): (0.25, 0.55),
    ("sin0.2", "pd_nn"): (0.27, 0.37),
}


def window(rig: str) -> tuple[float, float]:
    evaluation = load_rig(RIGS / f"{rig}.yaml", resolve=False).evaluation
    assert evaluation is not None
    return evaluation.window_s


@pytest.mark.parametrize("rig", MUZZLE_RMS_MRAD)
@pytest.mark.parametrize("name", NEURAL)
def test_pointing_error_is_within_ten_percent_of_the_independent_implementation(
    rig: str, name: str
) -> None:
    expected = MUZZLE_RMS_MRAD[rig][NEURAL.index(name)]
    if (rig, name) in SEED_RANGES_MRAD:
        low, high = SEED_RANGES_MRAD[rig, name]
        values = [
            muzzle_rms_mrad(run(rig, name, f"seed={seed}"), *window(rig)) for seed in range(1, 11)
        ]
        middle = float(np.median(values))
        assert low < middle < high, f"median {middle:.3f} mrad of {np.round(values, 3)}"
        return
    rms = muzzle_rms_mrad(run(rig, name), *window(rig))
    assert 0.9 < rms / expected < 1.1, f"{rms:.3f} mrad against {expected}"


def test_jump_nodes_carry_the_gain_on_hull_motion() -> None:
    whole = muzzle_rms_mrad(run("hull", "pd_nn_fast"), 4.0, 12.0)
    without = muzzle_rms_mrad(run("hull", "pd_nn_fast", "controller.fj_rate=0.0"), 4.0, 12.0)
    assert without > 4 * whole, f"{without:.2f} mrad without jump nodes, {whole:.2f} with"


def test_the_composite_beats_pd_on_hull_motion_and_sine() -> None:
    for rig, factor in (("hull", 5.0), ("sin0.5", 2.3)):
        pd, own = (muzzle_rms_mrad(run(rig, c), *window(rig)) for c in ("pd", "pd_nn_fast"))
        assert pd / own >= factor, f"{rig}: {pd:.2f} / {own:.2f} = {pd / own:.2f}"
