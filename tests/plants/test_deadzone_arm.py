"""The arm behind its deadzones: mechanics, a second implementation, and the acceptance limits."""

from functools import lru_cache
from pathlib import Path

import deadzone_arm_reference as plain
import numpy as np
import pytest
from judged import judged
from numpy.typing import NDArray
from stepped import Stepped

from pcpc.executive.rig.reading import load_rig
from pcpc.plants.deadzone_arm import evaluation, model
from pcpc.plants.deadzone_arm.laws import deadzone_nn

Array = NDArray[np.float64]
RIGS = Path(model.__file__).resolve().parent / "rigs"
T_S = 1e-3


class Arm(Stepped):
    """The compiled plant, called as the engine calls it."""

    def __init__(self, dt: float = T_S, **changed: float) -> None:
        spec = load_rig(RIGS / "deadzone-step.yaml").nodes()["plant"].blocks[0]
        super().__init__(model.BLOCK, spec.settings | changed, dt)

    @property
    def motion(self) -> Array:
        """Return [q1, q2, v1, v2], writable."""
        return self.x.motion.values()  # type: ignore[no-any-return]


class Loop:
    """The compiled law and plant hand to hand, without frames and their rounding."""

    def __init__(self, kind: str, law: str, delay: int = 0) -> None:
        spec = load_rig(RIGS / f"deadzone-{kind}.yaml", law).nodes()["executive"].blocks[-1]
        self.law, self.kind = Stepped(spec.block, spec.settings, T_S), kind
        self.arm = Arm(delay_samples=float(delay))

    def run(self, ticks: int) -> Array:
        """Return [e1, e2, q1, q2, v1, v2, u1, u2] by tick, as the plain one does."""
        rows = np.empty((ticks, 8))
        for k in range(ticks):
            sample = self.arm.step(*self.law.y.torque_Nm).sample
            desired = plain.desired(self.kind, k * T_S)
            y = self.law.step(*np.column_stack((*desired, sample.q_rad, sample.rate_rad_s)).ravel())
            rows[k] = (*y.e_rad, *sample.values(), *y.torque_Nm)
        return rows


@lru_cache
def measured(kind: str, controller: str, *settings: str) -> dict[str, float]:
    return judged(evaluation, f"deadzone-{kind}", controller, *settings)[1]


def four(found: dict[str, float]) -> Array:
    names = ("early_error_rms_1_rad", "early_error_rms_2_rad", "error_rms_1_rad", "error_rms_2_rad")
    return np.array([found[name] for name in names])


# Mechanics


def test_without_torque_the_arm_keeps_its_energy() -> None:
    arm = Arm()
    arm.motion[:] = (0.3, 1.1, 2.0, -3.0)
    start = arm.step(0.0, 0.0).energy_J
    energy = [arm.step(20.0, -15.0).energy_J for _ in range(5000)]  # within the deadzone
    drift = np.abs(np.array(energy) / start - 1.0).max()
    assert drift < 1e-11, f"relative energy drift {drift:.1e} in 5 s"


def test_the_torque_does_the_work_that_the_energy_gains() -> None:
    arm, work = Arm(substeps=1.0), 0.0
    before = arm.step(0.0, 0.0)
    for k in range(400):
        after = arm.step(40.0 * np.sin(0.05 * k), 30.0 + 0.1 * k)
        moved = after.true.q_rad - before.true.q_rad
        work += float(after.acting_Nm @ moved)  # constant torque: exact
        before = after
    error = abs(work - before.energy_J) / before.energy_J
    assert error < 1e-8, f"work {work:.9f} J, energy {before.energy_J:.9f} J"


def test_integration_is_of_fourth_order() -> None:
    ends = []
    for substeps in (1.0, 2.0, 4.0, 64.0):
        arm = Arm(dt=0.02, substeps=substeps)
        arm.motion[:] = (0.3, 1.1, 4.0, -6.0)
        for _ in range(20):
            arm.step(40.0, -30.0)
        ends.append(arm.motion.copy())
    errors = [float(np.abs(end - ends[-1]).max()) for end in ends[:3]]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (orders > 3.5).all() and errors[0] > 1e-6, f"orders {orders}, errors {errors}"


def test_the_first_call_only_samples_and_a_delay_waits_whole_samples() -> None:
    for delay in range(4):
        arm = Arm(delay_samples=float(delay))
        assert not arm.step(100.0, 100.0).values().any(), "the call at k = 0 moved the arm"
        torques = [arm.step(35.0 if k == 0 else 0.0, 0.0).acting_Nm[0] for k in range(6)]
        expected = [15.0 if k == delay else 0.0 for k in range(6)]
        assert torques == expected, (delay, torques)


def test_a_resolution_rounds_the_sample_and_not_the_arm() -> None:
    fine, coarse = Arm(), Arm(position_lsb_rad=1e-3, rate_lsb_rad_s=1e-2)
    for _ in range(100):
        fine.step(60.0, 40.0)
        coarse.step(60.0, 40.0)
    assert (fine.motion == coarse.motion).all()
    wrong = np.abs(coarse.y.sample.values() - fine.motion) / (1e-3, 1e-3, 1e-2, 1e-2)
    assert (wrong <= 0.5 + 1e-9).all() and wrong.max() > 0.01, wrong


# A second implementation


@pytest.mark.parametrize("seed", range(4))
def test_one_period_is_that_of_plain_numpy(seed: int) -> None:
    rng, arm = np.random.default_rng(seed), Arm()
    start, u = rng.uniform(-3, 3, 4), rng.uniform(-120, 120, 2)
    arm.k, arm.motion[:] = 1, start
    arm.step(*u)
    expected = plain.move(start, plain.deadzone(u), T_S)
    wrong = np.abs(arm.motion - expected).max()
    assert wrong < 1e-14, f"{wrong:.1e}"


@pytest.mark.parametrize(
    ("kind", "law", "ticks", "allowed"),
    [
        ("step", "pd", 500, 1e-10), ("sine", "pd", 500, 1e-10),
        ("step", "nn", 40, 1e-9),  # until it is chaotic
        ("sine", "nn", 150, 1e-9), ("step", "nn_book", 20, 1e-9),
    ],
)  # fmt: skip
def test_the_closed_loop_is_that_of_plain_numpy(
    kind: str, law: str, ticks: int, allowed: float
) -> None:
    book = {"s_rate": 240.0, "positive_slope": False}
    net = plain.Networks(**(book if law == "nn_book" else {}))  # type: ignore[arg-type]
    expected = plain.run(kind, None if law == "pd" else net, ticks)
    wrong = np.abs(Loop(kind, law).run(ticks) - expected).max(axis=1)
    assert wrong.max() < allowed, f"{wrong.max():.1e}, first beyond at {np.argmax(wrong > allowed)}"


def test_without_rounding_one_more_sample_overshoots_as_it_should() -> None:
    """0.3014 is robust there; frames of 1e-5 rad/s and 1e-4 N m make it 0.16 to 0.19."""
    overshoot = -Loop("step", "nn", delay=1).run(700)[:, 0].min()
    assert 0.295 < overshoot < 0.308, overshoot


# The rigs


def test_pd_hangs_off_by_the_edge_of_the_deadzone() -> None:
    found = measured("step", "pd")
    for joint in (1, 2):
        hang = found[f"error_bias_{joint}_rad"]
        assert abs(hang + 20.0 / (15.0 * 7.0)) < 1e-4, f"joint {joint} rests at {hang:.5f} rad"
        assert found[f"settle_{joint}_s"] == np.inf, found


@pytest.mark.parametrize(
    ("kind", "controller", "expected", "allowed"),
    [
        ("step", "pd", (0.1904, 0.1904, 0.1905, 0.1905), 6e-5),
        ("sine", "pd", (0.1306, 0.1717, 0.1779, 0.1868), 6e-5),
        ("sine", "nn", (0.0007, 0.0010, 0.0006, 0.0009), 1.5e-4),  # varies there by 0.0001
    ],
)
def test_reproducible_errors_have_the_digits_of_an_independent_implementation(
    kind: str, controller: str, expected: tuple[float, ...], allowed: float
) -> None:
    found = four(measured(kind, controller))
    assert np.abs(found - expected).max() < allowed, found


@pytest.mark.parametrize("kind", ["step", "sine"])
@pytest.mark.parametrize("delay", [0, 1, 2])
def test_the_networks_leave_less_than_a_tenth_of_pds_error(kind: str, delay: int) -> None:
    found = measured(kind, "nn", f"arm.delay_samples={delay}.0")
    times = four(measured(kind, "pd")) / four(found)
    assert times.min() > 10.0, f"{times} times better"
    assert times.max() < 4000.0, f"{times}: better than the rounding of the frames allows"
    assert found["diverged"] == 0.0 and found["r_max_rad_s"] < 10.0, found


def test_the_transients_of_the_network_are_in_their_known_ranges() -> None:
    """Over roundings and masses 1e-6 apart: settled in 0.7 to 1.3 s, overshoot 0.10 to 0.32 rad."""
    step, sine = measured("step", "nn"), measured("sine", "nn")
    assert 0.6 < step["settle_1_s"] < 1.3 and 0.7 < step["settle_2_s"] < 1.4, step
    assert 0.09 < step["overshoot_1_rad"] < 0.33, step["overshoot_1_rad"]
    for name, value in (("start_error_rms_1_rad", 0.018), ("start_error_rms_2_rad", 0.061)):
        assert abs(sine[name] - value) < 6e-4, f"{name} {sine[name]:.4f}"
    assert sine["adapted_error_rms_1_rad"] < 4e-4 and sine["adapted_error_rms_2_rad"] < 4e-4, sine


def test_six_draws_of_the_networks_are_all_better_than_pd() -> None:
    times = [
        four(measured("sine", "pd"))
        / four(measured("sine", "nn", f"controller.network_seed={seed}.0"))
        for seed in range(6)
    ]
    worst = np.min(times, axis=1)
    assert (worst > 1.0).all() and np.median(times) > 100.0, f"worst of each draw {worst}"


def test_networks_with_wrong_signs_that_never_learn_are_worse_than_pd() -> None:
    wrong = ("controller.positive_slope=0.0", "controller.s_rate=0.0")
    ratio = four(measured("sine", "nn", *wrong)) / four(measured("sine", "pd"))
    assert ratio.max() > 1.0, f"{ratio} of pd's error"


def test_coarse_signals_change_no_digit_that_matters() -> None:
    coarse = ("arm.position_lsb_rad=1e-5", "arm.rate_lsb_rad_s=1e-3", "arm.torque_lsb_Nm=0.01")
    change = np.abs(four(measured("sine", "nn", *coarse)) - four(measured("sine", "nn")))
    assert change.max() < 3e-4, change


def test_the_guard_ends_a_run_and_no_good_run_comes_near_it() -> None:
    found = measured("step", "nn", "controller.r_max_rad_s=9.0")  # |r(0)| = 9.9
    assert found["diverged"] == 1.0 and found["command_rms_1_Nm"] == 0.0, found
    good = measured("step", "nn")
    limits = load_rig(RIGS / "deadzone-step.yaml").nodes()["executive"].blocks[-1].settings
    assert good["r_max_rad_s"] < 0.2 * limits["r_max_rad_s"], good["r_max_rad_s"]
    assert good["norm_max"] < 0.2 * limits["norm_max"], good["norm_max"]


def test_the_law_knows_the_arm_and_not_its_deadzones() -> None:
    settings = {port.name for port in deadzone_nn.BLOCK.settings}
    assert not {name for name in settings if name.startswith("d_")}, settings
    rig = load_rig(RIGS / "deadzone-step.yaml")
    law, plant = (
        rig.nodes()["executive"].blocks[-1].settings,
        rig.nodes()["plant"].blocks[0].settings,
    )
    for name in ("a1_m", "a2_m", "m1_kg", "m2_kg"):
        assert law[name] == plant[name], f"{name}: {law[name]} against {plant[name]}"
