"""The telerobot: energy, a second implementation in plain Python, the tables, losses, its rigs."""

import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from places import ROOT

from pcpc.executive.laws.block import Block
from pcpc.executive.log.reader import Log
from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.rig.bus_load import check_rate
from pcpc.executive.rig.reading import load_rig
from pcpc.plants.telerobot import evaluation, model
from pcpc.plants.telerobot.laws import telerobot_local, telerobot_remote

FOLDER = ROOT / "plants/telerobot"
H = 1e-3
Vector = NDArray[np.float64]


def rig_file(case: str) -> Path:
    """Return a rig file."""
    return FOLDER / f"rigs/telerobot-{case}.yaml"


def run(case: str, controller: str, *settings: str) -> tuple[Log, dict[str, float]]:
    """Return log and metrics of a rig in virtual time."""
    rig = load_rig(rig_file(case), controller, [*settings])
    log, judge = in_memory(rig), rig.evaluation
    assert judge is not None
    return log, evaluation.EVALUATION.judge(log, judge.window_s, judge.numbers, H)


@cache
def metrics(case: str, controller: str, *settings: str) -> dict[str, float]:
    """Return the metrics of a rig in virtual time."""
    return run(case, controller, *settings)[1]


def pair(found: dict[str, float], part: str = "") -> tuple[float, float]:
    """Return the rms errors of both joints."""
    return found[f"{part}error_rms_1_rad"], found[f"{part}error_rms_2_rad"]


# The blocks by themselves


def prepared(block: Block, **given: float) -> Any:
    """Return the ports of a block by name, prepared: p, x, u, y."""
    defaults = {p.name: p.default for p in block.settings if p.default is not None}
    assert block.prepare is not None
    made = block.prepare({**defaults, **given}, 1.0 / H, 1)
    filled = []
    for ports, values in ((block.parameters, made.parameters), (block.states, made.states)):
        parts = [np.broadcast_to(values.get(p.name, p.default or 0.0), p.size) for p in ports]
        filled.append(np.concatenate(parts).astype(float))
    parameters, states, inputs, outputs = block.step.declared
    return (
        parameters(filled[0]),
        states(filled[1]),
        inputs(np.zeros(inputs.size)),
        outputs(np.zeros(outputs.size)),
    )


def do_step(block: Block, k: int, ports: Any) -> None:
    """Step a block at tick k on its p, x, u, y."""
    block.step(k * H, H, *(view.values() for view in ports))


class Arm:
    """The arm with unit links and masses: its ports by name, `x` its angles and rates."""

    def __init__(self, **given: float) -> None:
        base = {
            "a1_m": 1.0, "a2_m": 1.0, "m1_kg": 1.0, "m2_kg": 1.0, "gravity_m_s2": 9.8,
            "viscous_Nms_rad": 0.0, "coulomb_Nm": 0.0, "load_kg": 1.0, "substeps": 10.0,
            "start_1_rad": 0.0, "start_2_rad": 0.0,
        }  # fmt: skip
        self.ports = prepared(model.BLOCK, **{**base, **given})
        _, x, self.u, self.y = self.ports
        self.motion, self.x = x.motion, x.motion.values()

    def step(self, k: int) -> None:
        """Do the call of tick k."""
        do_step(model.BLOCK, k, self.ports)

    def energy(self) -> float:
        """Return kinetic and potential energy of the point masses, from their velocities, J."""
        (q1, q2), (v1, v2) = self.motion.q_rad, self.motion.rate_rad_s
        q12, v12 = q1 + q2, v1 + v2
        elbow = v1 * np.array((-math.sin(q1), math.cos(q1)))
        hand = elbow + v12 * np.array((-math.sin(q12), math.cos(q12)))
        height = 2.0 * math.sin(q1) + math.sin(q12)
        return float(0.5 * (elbow @ elbow + hand @ hand) + 9.8 * height)


def test_the_free_arm_keeps_its_energy() -> None:
    free = Arm()
    free.x[:] = (0.3, -0.8, 1.0, -2.0)
    before = free.energy()
    for k in range(2001):
        free.step(k)
    drift = abs(free.energy() - before)
    assert drift < 1e-9, f"{drift:.1e} J in 2 s"


def test_friction_takes_energy_and_the_hanging_arm_rests() -> None:
    arm = Arm(viscous_Nms_rad=2.0, coulomb_Nm=1.5)
    arm.x[:] = (0.3, -0.8, 1.0, -2.0)
    last = arm.energy()
    for k in range(1, 1000):
        arm.step(k)
        energy = arm.energy()
        assert energy < last, f"cycle {k}: {energy - last:.1e} J more"
        last = energy
    arm.x[:] = (-math.pi / 2, 0.0, 0.0, 0.0)
    arm.step(1000)
    truths = [*arm.y.true.q_rad, *arm.y.true.rate_rad_s]
    assert np.abs(np.subtract(truths, [-math.pi / 2, 0.0, 0.0, 0.0])).max() < 1e-15, truths


# A second implementation of the whole loop, straight from the specification


class Reference:
    """Arm, local node and remote node with plain lists as channels."""

    def __init__(self, n: int, network: bool) -> None:
        self.n, self.network = n, network
        self.x = np.array([-math.pi / 2, 0.0, 0.0, 0.0])
        self.z, self.xh = self.x.copy(), self.x.copy()
        self.w = np.zeros((20, 2))
        self.v = np.random.default_rng(3).uniform(-1.0, 1.0, (5, 20))
        self.us: list[Vector] = []
        self.xs: list[Vector] = []
        self.zs: list[Vector] = []
        e = math.exp(-5.0 * H)
        self.ad = np.array([[e * (1 + 5 * H), e * H], [-25 * e * H, e * (1 - 5 * H)]])
        self.bd = np.array([(1 - e * (1 + 5 * H)) / 25, H * e])

    def model(self, x: Vector, u: Vector) -> Vector:
        """Advance a reference model by a tick."""
        q = self.ad[0, 0] * x[:2] + self.ad[0, 1] * x[2:] + self.bd[0] * u
        return np.concatenate((q, self.ad[1, 0] * x[:2] + self.ad[1, 1] * x[2:] + self.bd[1] * u))

    @staticmethod
    def parts(x: Vector, m2: float) -> tuple[Vector, Vector]:
        """Return M and V + G."""
        c, s = math.cos(x[1]), math.sin(x[1])
        m = np.array([[1 + m2 + m2 + 2 * m2 * c, m2 + m2 * c], [m2 + m2 * c, m2]])
        outer = m2 * 9.8 * math.cos(x[0] + x[1])
        v1 = -m2 * (2 * x[2] * x[3] + x[3] ** 2) * s
        return m, np.array(
            [v1 + (1 + m2) * 9.8 * math.cos(x[0]) + outer, m2 * x[2] ** 2 * s + outer]
        )

    def local(self, k: int) -> Vector:
        """Return the torque of tick k."""
        q, v = self.x[:2], self.x[2:]
        ul = self.us[k - self.n] if k >= self.n else np.array([-25 * math.pi / 2, 0.0])
        m, rest = self.parts(self.x, 1.0)
        asked = ul - 25 * q - 10 * v
        st, ph = np.zeros(2), np.zeros(20)
        if self.network:
            st = 10 * (q - self.xh[:2]) + 2 * (v - self.xh[2:])
            ph = np.tanh(self.v.T @ np.concatenate(([1.0], q, v)))
            asked = asked - self.w.T @ ph - (20 + 0.5 * np.linalg.norm(self.w)) * st
        tau = m @ asked + (0.0 if self.network else rest)
        clamped = np.clip(tau, [-400, -200], [400, 200])
        if k == 0:
            clamped = tau = np.zeros(2)  # the node does not know its law yet
        self.xh = self.model(self.xh, ul + np.linalg.solve(m, clamped - tau))
        self.w = self.w + H * 100 * (np.outer(ph, st) - 0.01 * self.w)
        return clamped

    def remote(self, k: int) -> None:
        """Append the u of tick k."""
        t, rest = k * H, np.array([-math.pi / 2, 0.0, 0.0, 0.0])
        self.zs.append(self.z.copy())
        self.xs.append(self.x.copy())
        seen = self.xs[k - self.n] if k >= self.n else rest
        past = self.zs[k - 2 * self.n] if k >= 2 * self.n else rest
        xf = seen + self.z - past
        u = np.zeros(2)
        for j, (size, om) in enumerate(((1.0, 1.0), (0.8, 1.5))):
            s = min(t / 3.0, 1.0)
            w = np.polynomial.Polynomial([0, 0, 0, 10, -15, 6])
            w0, w1, w2 = w(s), w.deriv()(s) / 3.0, w.deriv(2)(s) / 9.0
            sn, cs = math.sin(om * t), math.cos(om * t)
            q_d = size * w0 * sn
            v_d = size * (w1 * sn + w0 * om * cs)
            a_d = size * (w2 * sn + 2 * w1 * om * cs - w0 * om * om * sn)
            e, e1 = rest[j] + q_d - xf[j], v_d - xf[2 + j]
            u[j] = a_d + 5 * e1 + 25 * xf[j] + 10 * xf[2 + j] + 10 * (e1 + 5 * e)
        self.us.append(u)
        self.z = self.model(self.z, u)

    def arm(self, tau: Vector, m2: float) -> None:
        """Integrate one period."""

        def slope(x: Vector) -> Vector:
            m, rest = self.parts(x, m2)
            friction = 2.0 * x[2:] + 1.5 * np.tanh(x[2:] / 0.05)
            return np.concatenate((x[2:], np.linalg.solve(m, tau - rest - friction)))

        h = H / 10
        for _ in range(10):
            k1 = slope(self.x)
            k2 = slope(self.x + h / 2 * k1)
            k3 = slope(self.x + h / 2 * k2)
            k4 = slope(self.x + h * k3)
            self.x = self.x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


@pytest.mark.parametrize("network", [True, False])
def test_a_second_implementation_of_the_whole_loop_agrees(network: bool) -> None:
    """Three nodes without a wire, payload from 0.25 s, T = 0.05 s."""
    n, reference, law = 50, Reference(50, network), 4.0 if network else 2.0
    arm = Arm(
        viscous_Nms_rad=2.0,
        coulomb_Nm=1.5,
        load_kg=2.5,
        load_from_s=0.25,
        load_to_s=9.0,
        start_1_rad=-math.pi / 2,
    )
    x, y, torque = arm.x, arm.y, arm.u.torque_Nm
    settings = {"kv_per_s": 10.0, "lam_per_s": 5.0, "local_law": law, "predictor": 1.0}
    far = prepared(telerobot_remote.BLOCK, **settings, delay_s=n * H, u_lsb_rad_s2=0.0)
    gains = load_rig(rig_file("u2")).nodes()["local"].blocks[0].settings
    near = prepared(telerobot_local.BLOCK, **gains)
    (_, _, told, sent), (_, _, given, answer) = far, near
    tau, worst = np.zeros(2), 0.0
    for k in range(500):
        arm.step(k)
        if k > 0:
            reference.arm(tau, 2.5 if k > 250 else 1.0)
        given.q_rad[:], given.rate_rad_s[:] = y.sample.q_rad, y.sample.rate_rad_s
        do_step(telerobot_local.BLOCK, k, near)
        tau, torque[:] = reference.local(k), answer.torque_Nm
        told.q_rad[:], told.rate_rad_s[:] = y.sample.q_rad, y.sample.rate_rad_s
        told.position_tick = told.rate_tick = told.echo_tick = answer.sample_tick
        told.echo = answer.echo
        do_step(telerobot_remote.BLOCK, k, far)
        reference.remote(k)
        given.u_rad_s2[:] = sent.u_rad_s2
        given.tick, given.law, given.delay = sent.tick, sent.law, sent.delay
        worst = max(worst, np.abs(x - reference.x).max(), 1e-3 * np.abs(torque - tau).max())
    assert np.abs(arm.motion.rate_rad_s).max() > 0.05, "it moves"
    assert worst < 1e-10, f"{worst:.1e}"


# The tables, of an independent implementation, and the shipped rigs

TABLE = {  # rms errors of 15 to 20 s
    ("u0", "smith"): (0.0002, 0.0003),
    ("u0", "rnn"): (0.0010, 0.0021),
    ("u1", "rnn"): (0.0019, 0.0039),
    ("u2", "smith"): (0.1441, 0.3486),
    ("u2", "nornn"): (0.0331, 0.0679),
    ("u2", "rnn"): (0.0015, 0.0033),
    ("u2", "pd_near"): (0.1146, 0.2666),
    ("u2", "pd_slow"): (0.490, 0.561),
}


@pytest.mark.parametrize(("case", "controller"), TABLE)
def test_the_errors_are_those_of_the_independent_implementation(case: str, controller: str) -> None:
    wanted, found = TABLE[case, controller], pair(metrics(case, controller))
    near = 6e-4 if controller == "pd_slow" else 6e-5  # half of the last digit it printed
    near += 1e-4 if controller == "pd_near" else 0.0  # no delay there, the rig's own tick here
    assert found == pytest.approx(wanted, abs=near), found


def test_pd_is_unstable_and_stops_at_the_joint_speed_limit() -> None:
    log, found = run("u1", "pd", "duration_s=10.0", "evaluation.window_s=[5.0, 10.0]")
    assert 0.5 < found["tripped_s"] < 10.0, found
    speed = np.abs(log.node["plant"].columns["arm.rate_1_rad_s"])
    assert speed.max() < 40.0, f"{speed.max()} rad/s"
    assert speed[-2000:].max() < 5.0, f"{speed[-2000:].max()} rad/s after the brake"


def test_nothing_kicks_the_arm_before_the_first_command_is_due() -> None:
    for controller in ("rnn", "smith"):
        log, _ = run("u2", controller, "duration_s=0.25", "evaluation.window_s=[0.0, 0.2]")
        q = log.node["plant"].columns["arm.q_1_rad"]
        assert np.abs(q[:200] + math.pi / 2).max() < 1e-9, f"{controller}: {q[:200]}"


def test_the_delay_goes_to_the_robot_with_the_command() -> None:
    log, _ = run("u2", "rnn", "controller.delay_s=0.05", "duration_s=0.6")
    remote, robot = log.node["executive"].columns, log.node["local"].columns
    u, ul = remote["controller.u_2_rad_s2"], robot["servo.ul_2_rad_s2"]
    assert np.array_equal(ul[50 : len(u)], u[: len(u) - 50]), "u_j-N at tick j, to the bit"
    q = log.node["plant"].columns["arm.q_2_rad"]
    seen = remote["controller.seen_2_rad"]
    assert np.abs(seen[50:] - q[: len(seen) - 50]).max() < 0.51e-5, "x_k-N at tick k"


def test_ten_percent_lost_commands_cost_a_tenth_of_a_milliradian() -> None:
    found = metrics("u2", "rnn", "losses.U.share=0.1")
    assert pair(found) == pytest.approx((0.0016, 0.0034), abs=6e-5), pair(found)
    assert 1800 < found["held_u"] < 2200 and found["held_x"] == 0.0, found


def test_bursts_of_lost_samples_are_held_without_harm() -> None:
    found = metrics("u2", "rnn", "losses.TELL_Q.share=0.1", "losses.TELL_Q.burst=5.0")
    assert pair(found) == pytest.approx((0.0015, 0.0033), abs=1e-4), pair(found)
    assert 1500 < found["held_x"] < 3000, found


def test_a_leak_of_ten_switches_the_network_off() -> None:
    found = metrics("u2", "rnn", "servo.kap=10.0")
    assert pair(found) == pytest.approx((0.0314, 0.0646), abs=6e-5), pair(found)


def test_both_buses_have_room_at_1_khz() -> None:
    load = check_rate(load_rig(rig_file("u2")), "real")
    assert 0.5 < load < 0.75, f"{load:.1%} of the fuller bus"
