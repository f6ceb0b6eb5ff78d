"""The quarter car by itself: energy, closed forms, a second implementation, the invariant point."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import quarter_car_reference as reference
from quarter_car_reference import CAR, FOLDER, Loop, T, do_step, views

from pcpc.executive.rig.reading import load_rig
from pcpc.plants.quarter_car import equations, model
from pcpc.plants.quarter_car.book import bode, study
from pcpc.plants.quarter_car.laws import strut_outer

SCALE = np.array([0.1, 0.3, 0.1, 1.0, 1e7, 1e7, 1e-3])


class Run:
    """A car after its first sample: its ports by name, `s` its seven states."""

    def __init__(self, **settings: float) -> None:
        self.ports = views(model.BLOCK, CAR | settings)
        self.p, self.x, self.u, self.y = self.ports
        self.s = self.x.car.values()
        self.step(0)

    def step(self, k: float, dt: float = T) -> None:
        """Do the call at t = k dt."""
        do_step(model.BLOCK, k * dt, dt, self.ports)


def energy(car: Any) -> float:
    """Return the energy of the undamped passive car."""
    zs, zu = car.x1_m, car.x1_m - car.x3_m
    moving = 0.5 * (290.0 * car.x2_m_s**2 + 59.0 * car.x4_m_s**2)
    springs = 0.5 * (16812.0 * car.x3_m**2 + 190000.0 * zu**2)
    return float(moving + springs + 9.81 * (290 * zs + 59 * zu))


def test_the_undamped_car_keeps_its_energy_to_the_fourth_order() -> None:
    free = {"strut": 0.0, "limits_on": 0.0, "road_m": 0.0, "bs_Ns_m": 0.0, "fc_N": 0.0}
    drift = []
    for step_s in (1e-3, 5e-4, 2.5e-4):
        run = Run(**free, kick_m_s=0.5, step_s=step_s)
        before = energy(run.x.car)
        for k in range(1, 2000):
            run.step(k)
        drift.append(abs(energy(run.x.car) - before))
    assert drift[0] < 1e-2, f"drifts {drift} J of 36 J"
    for coarse, fine in pairwise(drift):
        assert 20.0 < coarse / fine < 45.0, f"drifts {drift} J: dissipation of fifth order"


def test_a_linear_car_moves_as_its_frequency_response_says() -> None:
    settings = {"strut": 0.0, "limits_on": 0.0, "fc_N": 0.0}
    for road in (8.0, 58.0):
        run = Run(**settings, road_rad_s=road)
        speed = []
        for k in range(1, 9000):
            run.step(k)
            speed.append(run.y.body_rate_m_s)
        late = np.arange(1, 9000) * T >= 9.0 - 4.0 * 2.0 * np.pi / road
        phase = road * np.arange(1, 9000)[late] * T
        columns = np.column_stack((np.sin(phase), np.cos(phase), np.ones(late.sum())))
        fit = np.linalg.lstsq(columns, np.array(speed)[late], rcond=None)[0]
        found = np.hypot(fit[0], fit[1])
        gains = reference.GAINS["outer"]
        response = 10 ** (bode.response_db("passive", np.array([road]), CAR, gains)[0] / 20.0)
        assert found == pytest.approx(response * 0.04 / road, rel=1e-4), f"{road} rad/s: {found}"


def test_no_strut_moves_the_invariant_point() -> None:
    rng = np.random.default_rng(3)
    w0 = np.sqrt(CAR["kt_N_m"] / CAR["mu_kg"])
    exact = 20.0 * np.log10(CAR["kt_N_m"] / CAR["ms_kg"])
    assert exact == pytest.approx(56.33, abs=0.005)
    for _ in range(20):
        gains = {k: v * rng.uniform(0.2, 5.0) for k, v in reference.GAINS["outer"].items()}
        for law in bode.LAWS:
            found = bode.response_db(law, np.array([w0]), CAR, gains)[0]
            assert found == pytest.approx(exact, abs=1e-9), f"{law}: {found} dB"


def test_the_frequency_responses_are_the_known_ones() -> None:
    gains = reference.GAINS["outer"]
    for law in bode.LAWS:
        expected = np.array(study.known("bode", law), float)
        peak_db, peak_rad_s = map(float, study.known("peak", law))
        found = bode.response_db(law, np.array(study.BODE_RAD_S), CAR, gains)
        assert np.abs(found - expected).max() < 0.05, f"{law}: {found} dB"
        at, height = bode.peak(law, 40.0, 90.0, CAR, gains)
        assert at == pytest.approx(peak_rad_s, abs=0.1), f"{law}: {at} rad/s"
        assert height == pytest.approx(peak_db, abs=0.05), f"{law}: {height} dB"


@pytest.mark.parametrize("strut", [0, 1, 2])
def test_a_tick_is_that_of_a_second_implementation(strut: int) -> None:
    rng = np.random.default_rng(strut)
    for limits in (False, True):
        run = Run(strut=strut, limits_on=float(limits), road_rad_s=58.0)
        for _ in range(10):
            run.s[:] = rng.normal(size=7) * 0.8 * SCALE + (0, 0, 0, 0, 1.9e7, 1.9e7, 0)
            run.u.spool_command_m, run.u.force_command_N = (
                rng.uniform(-6e-3, 6e-3),
                rng.uniform(0.0, 6e3),
            )
            t, command = (
                rng.uniform(0.1, 6.0),
                run.u.force_command_N if strut == 2 else run.u.spool_command_m,
            )
            expected = reference.plant_tick(t - T, run.s.copy(), command, 58.0, strut, limits)
            run.step(t / T)
            assert np.abs((run.s - expected) / SCALE).max() < 1e-10, f"{run.s}, not {expected}"


@pytest.mark.parametrize("law", ["fl", "no_fl", "pid"])
def test_the_closed_loop_is_that_of_a_second_implementation(law: str) -> None:
    loop, other = Loop(law, road_rad_s=58.0), reference.ReferenceLaw(law)
    x = loop.start()
    worst, u = 0.0, 0.0
    for k, (t, ours, command) in enumerate(loop.run(250)):
        if k > 0:
            x = reference.plant_tick(t - T, x, u, 58.0, 1, True)
        worst = max(worst, float(np.abs((ours - x) / SCALE).max()))
        u = other.tick(x)
        worst = max(worst, abs(command - u) / 1e-3)
    assert worst < 1e-9, f"apart by {worst:.1e} of the scales in 0.25 s"


def test_the_force_changes_by_drift_and_gain() -> None:
    rng = np.random.default_rng(4)
    for _ in range(10):
        run = Run(step_s=1e-7)
        spool = rng.choice([-1.0, 1.0]) * rng.uniform(1e-4, 1e-3)
        run.s[:] = rng.normal(size=7) * 0.5 * SCALE + (0, 0, 0, 0, 1.9e7, 1.9e7, 0)
        run.x.car.x7_m = run.u.spool_command_m = spool
        _, x2, x3, x4, x5, x6, x7 = run.s.copy()
        before = reference.AC * x6 - reference.AA * x5
        run.p.substeps = 1.0
        run.step(1, 1e-8)
        found = (run.y.strut_N - before) / 1e-8
        g = reference.gain(x3, x6, x7)
        expected = reference.drift(x3, x2 - x4, x5, x6) + g * x7
        assert found == pytest.approx(expected, rel=1e-3, abs=100.0), f"F' {found} N/s"


def test_bump_stops_push_and_never_pull() -> None:
    run = Run()
    for side in (1.0, -1.0):
        for depth, speed, force in (
            (0.01, 0.0, -6000.0),
            (0.01, 1.0, -9000.0),
            (0.01, -1.0, -3000.0),
            (0.01, -3.0, 0.0),
            (-0.01, 5.0, 0.0),
        ):
            car = run.x.car
            car.x1_m, car.x2_m_s = 0.0, side * speed
            car.x3_m, car.x4_m_s = side * (0.1 + depth), 0.0
            run.step(0)
            found = run.y.bump_N
            assert found == pytest.approx(side * force, abs=1e-6), (
                f"{side} {depth} {speed}: {found}"
            )


def test_pressure_and_spool_stay_within_their_limits() -> None:
    run = Run()
    car = run.x.car
    car.x5_Pa = car.x6_Pa = 2e5
    car.x4_m_s = 20.0
    run.u.spool_command_m = -1.0
    for k in range(1, 20):
        run.step(k)
        assert car.x5_Pa >= 1e5 and car.x6_Pa >= 1e5 and abs(car.x7_m) <= 2e-3, f"{run.s}"
    assert car.x7_m == -2e-3, f"spool {car.x7_m} m"


@pytest.mark.parametrize("law", ["fl", "no_fl", "pid"])
def test_a_car_at_rest_stays_at_rest(law: str) -> None:
    loop = Loop(law, road_m=0.0)
    first = loop.start()
    moved = max(float(np.abs((x - first) / SCALE).max()) for _, x, _ in loop.run(500))
    assert moved < 1e-9, f"moved by {moved:.1e} of the scales"


def test_the_passive_car_starts_in_its_rest() -> None:
    for limits, extension in ((0.0, -0.16922), (1.0, -0.10189)):
        run = Run(strut=0.0, limits_on=limits, road_m=0.0)
        x3 = run.y.extension_m
        assert x3 == pytest.approx(extension, abs=2e-5), f"x3 {x3} m"
        for k in range(1, 500):
            run.step(k)
        speeds = run.y.body_rate_m_s, run.y.wheel_rate_m_s
        assert np.abs(speeds).max() < 1e-9, f"moves with {speeds} m/s"


def test_a_command_acts_as_many_samples_late_as_set() -> None:
    for delay in (0, 3):
        run = Run(delay_samples=float(delay))
        acting = []
        for k in range(1, 8):
            run.u.spool_command_m = 1e-4 * k
            run.step(k)
            acting.append(run.y.acting)
        expected = [1e-4 * max(0, k - delay) for k in range(1, 8)]
        assert acting == pytest.approx(expected, abs=1e-15), f"delay {delay}: {acting}"


def test_samples_are_rounded_and_truths_are_not() -> None:
    run = Run(
        rate_lsb_m_s=1e-3,
        extension_lsb_m=1e-5,
        pressure_lsb_Pa=2e3,
        spool_lsb_m=1e-7,
        kick_m_s=0.05039,
    )
    car, y = run.x.car, run.y
    car.x3_m, car.x4_m_s, car.x7_m = 0.0123456, -0.3333, 1.23456e-4
    car.x5_Pa, car.x6_Pa = 1.2345678e7, 2.3456789e7
    run.step(0)
    speeds = y.sample_body_rate_m_s, y.sample_wheel_rate_m_s
    assert speeds == pytest.approx((0.05, -0.333), rel=1e-12), f"{speeds}"
    hydraulic = y.sample_extension_m, y.sample_p1_Pa, y.sample_p2_Pa, y.sample_spool_m
    assert hydraulic == pytest.approx((0.01235, 2.3456e7, 1.2346e7, 1.235e-4), rel=1e-12)
    truths = y.body_rate_m_s, y.extension_m, y.wheel_rate_m_s, y.p2_Pa, y.p1_Pa, y.spool_m
    assert np.array_equal(truths, run.s[1:]), "truths are rounded"


def test_the_laws_know_the_strut_as_it_is_built() -> None:
    known_to_law = {one.name: one.default for one in equations.Dimensions.ports}
    for name, value in known_to_law.items():
        assert CAR[name] == value, f"{name}: built {CAR[name]}, known {value}"
    settings = reference.defaults(strut_outer.Settings.ports)
    assert (settings["mass_kg"], settings["gravity_m_s2"]) == (CAR["ms_kg"], CAR["gravity_m_s2"])
    w0 = np.sqrt(CAR["kt_N_m"] / CAR["mu_kg"])
    for name, gains in reference.GAINS.items():
        assert gains["wb_rad_s"] == gains["wk_rad_s"] == pytest.approx(w0, abs=1e-3), name
    for name in ("fl", "no_fl", "pid"):
        assert reference.GAINS[name]["spool_max_m"] == CAR["spool_max_m"], name
    assert reference.GAINS["fl"]["valve_lag_s"] == CAR["valve_lag_s"]


def test_the_strut_is_sized_by_its_derived_figures() -> None:
    rig = load_rig(FOLDER / "rigs/suspension-8.yaml", "fl")
    (law,) = (b for b in rig.nodes()["executive"].blocks if b.name == "controller")
    weight = 290.0 * 9.81
    h = equations.hydraulics(CAR, weight)
    assert h["h_supply_Pa"] == pytest.approx(37.93e6, rel=2e-4), f"Pa {h['h_supply_Pa']}"
    assert h["h_volume_m3"] == pytest.approx(6.6225e-4, rel=2e-5), f"V0 {h['h_volume_m3']}"
    assert strut_outer.known_gain(law.settings) == pytest.approx(1.8408e9, rel=3e-5)
