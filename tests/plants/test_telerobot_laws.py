"""Laws of the telerobot: play-out, the exact index rule, Lyapunov identity of the identifier."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import expm

from pcpc.executive.laws.block import Block, Nothing, Port, Ports, port, stage
from pcpc.plants.telerobot import equations as double_pole
from pcpc.plants.telerobot.laws import (
    playout,
    robot_node,
    telerobot_cancel,
    telerobot_model,
    telerobot_network,
    telerobot_robust,
)
from pcpc.plants.telerobot.laws import telerobot_local as local
from pcpc.plants.telerobot.laws import telerobot_remote as remote
from pcpc.plants.telerobot.laws.soft_sine import soft_sine

Vector = NDArray[np.float64]
H = 1e-3
AS = np.array([[0.0, 1.0], [double_pole.A21, double_pole.A22]])
P = np.array([[150.0, 10.0], [10.0, 2.0]])
ARM = {
    "kr_per_s": 20.0, "kw": 0.5, "gam": 100.0, "kap": 0.01, "a1_m": 1.0, "a2_m": 1.0, "m1_kg": 1.0,
    "m2_kg": 1.0, "gravity_m_s2": 9.8, "tau_max_1_Nm": 400.0, "tau_max_2_Nm": 200.0,
    "speed_limit_rad_s": 20.0, "brake_Nms_rad": 10.0,
}  # fmt: skip
REMOTE = {"kv_per_s": 10.0, "lam_per_s": 5.0, "local_law": 4.0, "predictor": 1.0}


class Law:
    """A law outside the engine: its ports by name."""

    def __init__(self, module: Any, **given: float) -> None:
        self.block: Block = module.BLOCK
        defaults = {p.name: p.default for p in self.block.settings if p.default is not None}
        assert self.block.prepare is not None
        made = self.block.prepare({**defaults, **given}, 1.0 / H, 1)
        parameters, states, inputs, outputs = self.block.step.declared
        self.p = parameters(_filled(self.block.parameters, made.parameters))
        self.x = states(_filled(self.block.states, made.states))
        self.u, self.y = inputs(np.zeros(inputs.size)), outputs(np.zeros(outputs.size))

    def step(self, k: int, **inputs: float) -> dict[str, float]:
        """Step at tick k; return the outputs by name."""
        names = [p.name for p in self.block.inputs]
        for name, value in inputs.items():
            self.u.values()[names.index(name)] = value
        views = (self.p, self.x, self.u, self.y)
        self.block.step(k * H, H, *(view.values() for view in views))
        values = self.y.values().tolist()
        return dict(zip((p.name for p in self.block.outputs), values, strict=True))


def _filled(ports: tuple[Port, ...], values: Any) -> Vector:
    parts = [np.broadcast_to(values.get(p.name, p.default or 0.0), p.size) for p in ports]
    return np.concatenate(parts).astype(float)


class Accelerations(Ports):
    """What drives the model."""

    u = port("rad/s2", "of each joint", shape=2)


@stage
def exactly(
    t: float, dt: float, p: double_pole.Sampled, x: double_pole.Joints, u: Accelerations, y: Nothing
) -> None:
    """Advance the model by a tick."""
    double_pole.advance(p, x, u.u)


class Exact:
    """Both laws around the exact discrete model in place of the arm; frames may be kept back."""

    def __init__(self, n: int, **settings: float) -> None:
        self.remote = Law(remote, **{**REMOTE, "delay_s": n * H, "u_lsb_rad_s2": 0.0, **settings})
        self.local = Law(local, **ARM)
        self.d = np.array(list(double_pole.sampled(H).values()))
        self.x = double_pole.Joints(np.zeros(double_pole.Joints.size))
        self.x.q[:] = -1.570796326794897, 0.0
        self.sent: dict[str, float] = {}

    def tick(self, k: int, lost_u: bool = False, lost_x: bool = False) -> tuple[Any, Any]:
        """Do tick k; return the outputs of local and remote law."""
        measured = {f"q_{j}_rad": self.x.q[j - 1] for j in (1, 2)}
        measured |= {f"rate_{j}_rad_s": self.x.v[j - 1] for j in (1, 2)}
        ours = self.local.step(k, **measured, **self.sent)
        told = {}
        if not lost_x:
            told = {f"q_{j}_rad": self.x.q[j - 1] for j in (1, 2)}
            told |= {f"rate_{j}_rad_s": self.x.v[j - 1] for j in (1, 2)}
            ticks = ("position_tick", "rate_tick", "echo_tick")
            told |= dict.fromkeys(ticks, ours["sample_tick"]) | {"echo": ours["echo"]}
        theirs = self.remote.step(k, **told)
        if not lost_u:
            names = ("u_1_rad_s2", "u_2_rad_s2", "tick", "law", "delay")
            self.sent = {name: theirs[name] for name in names}
        u = np.array([ours["ul_1_rad_s2"], ours["ul_2_rad_s2"]])
        exactly(k * H, H, self.d, self.x.values(), u, np.zeros(0))
        return ours, theirs


OFF = ("off_1_rad", "off_2_rad", "off_rate_1_rad_s", "off_rate_2_rad_s")


@pytest.mark.parametrize("n", [1, 2, 7, 200, 500])
def test_prediction_and_robot_meet_to_rounding_where_the_model_is_exact(n: int) -> None:
    """x(t-T) - z(t-2T) = 0: the index rule of the specification, for every delay."""
    rig, worst, moved = Exact(n), 0.0, 0.0
    for k in range(3 * n + 1500):
        _, theirs = rig.tick(k)
        worst = max(worst, *(abs(theirs[name]) for name in OFF))
        moved = max(moved, abs(theirs["seen_2_rad"]))
    assert moved > 0.1, f"{moved} rad"
    assert worst < 2e-14, f"{worst:.1e}"


def test_one_tick_of_index_error_is_seen() -> None:
    for offset in (-1.0, 1.0):
        rig, worst = Exact(50, history_offset_ticks=offset), 0.0
        for k in range(1500):
            worst = max(worst, abs(rig.tick(k)[1]["off_1_rad"]))
        assert 1e-4 < worst < 1e-2, f"offset {offset}: {worst:.1e}"


def test_the_identifier_is_the_prediction_of_t_ago() -> None:
    rig, z, n = Exact(60), {}, 60
    for k in range(800):
        ours, theirs = rig.tick(k)
        z[k] = theirs["z_1_rad"]
        if k >= n:
            difference = ours["model_1_rad"] - z[k - n]
            assert abs(difference) < 1e-13, f"tick {k}: {difference:.1e}"


def test_the_echo_is_the_nominal_lookup_while_nothing_is_lost_and_older_after_a_loss() -> None:
    n = 30
    by_echo, by_delay = Exact(n, use_echo=1.0), Exact(n, use_echo=0.0)
    for k in range(400):
        a, b = by_echo.tick(k)[1], by_delay.tick(k)[1]
        assert a == b, f"tick {k}"
        assert k < n or a["looked_up"] == 2 * n, f"tick {k}: {a['looked_up']}"
    lost = range(400, 405)
    for k in range(400, 500):
        a, b = by_echo.tick(k, k in lost)[1], by_delay.tick(k, k in lost)[1]
        assert b["looked_up"] == 2 * n
        held = min(max(k - 2 * n - 399, 0), 5) if k - 2 * n < 405 else 0
        assert a["looked_up"] == 2 * n + held, f"tick {k}: {a['looked_up']}, {held} held"


def test_missing_frames_are_held_and_counted() -> None:
    rig = Exact(20)
    for k in range(300):
        ours, theirs = rig.tick(k, lost_u=k in (100, 101, 150), lost_x=k in (200, 220))
    assert ours["held_u"] == 3.0, ours["held_u"]
    assert theirs["held_x"] == 2.0, theirs["held_x"]


def test_jitter_below_the_delay_disappears() -> None:
    """A frame that comes up to N - 1 ticks late, out of order, is played at its tick."""
    n, rng = 40, np.random.default_rng(1)
    ring, held = np.full(playout.SLOTS, playout.EMPTY), 0.0
    arrivals: dict[int, list[int]] = {}
    for k in range(9000):  # beyond a turn of the wire ticks
        arrivals.setdefault(k + int(rng.integers(1, n + 1)), []).append(k)
    for now in range(9000):
        for k in arrivals.get(now, []):
            number = playout.wire_tick(float(k))
            playout.put(ring, number, float(now), float(n), float(k))
        held, missing = playout.take(ring, float(now - n), held)
        assert missing == (1.0 if now < n else 0.0), f"tick {now}"
        assert now < n or held == now - n, f"tick {now}: {held}"


def test_the_ticks_of_the_robot_follow_an_operator_that_skipped_some() -> None:
    """7 ticks from 100 on: u keeps its delay of 20, and what was never sent is held and counted."""
    law, sent, told = Law(local, **ARM), {}, {}
    for k in range(200):
        operator = k + (7 if k >= 100 else 0)
        told = law.step(k, **sent)
        if k > 140:
            assert told["ul_1_rad_s2"] == operator - 1 - 20, f"{told['ul_1_rad_s2']} at {k}"
            assert told["sample_tick"] == playout.wire_tick(operator - 1.0), told["sample_tick"]
        sent = {
            "u_1_rad_s2": float(operator), "tick": playout.wire_tick(float(operator)),
            "law": robot_node.NETWORK, "delay": 20.0,
        }  # fmt: skip
    assert told["held_u"] == 7.0, told["held_u"]


def test_a_late_frame_is_refused_and_zero_is_no_tick() -> None:
    number = playout.wire_tick(100.0)
    assert playout.in_time(number, 120.0, 20.0) and not playout.in_time(number, 121.0, 20.0)
    assert not playout.in_time(0.0, 0.0, 20.0)
    for tick in (-200.0, 0.0, 4094.0, 4095.0, 1e6):
        number = playout.wire_tick(tick)
        assert 1.0 <= number <= 4095.0 and playout.tick_of(number, tick + 700.0) == tick


def test_the_sampled_model_is_the_matrix_exponential() -> None:
    whole = np.zeros((3, 3))
    whole[:2, :2], whole[1, 2] = AS, 1.0
    sampled = expm(whole * H)
    ours = np.array(list(double_pole.sampled(H).values()))
    error = np.abs(ours - [*sampled[0, :2], *sampled[1, :2], *sampled[:2, 2]]).max()
    assert error < 1e-15, f"{error:.1e}"


def test_the_filtered_error_of_the_identifier_comes_from_a_lyapunov_equation() -> None:
    assert np.abs(AS.T @ P + P @ AS + np.diag([500.0, 20.0])).max() < 1e-12
    assert (np.linalg.eigvalsh(P) > 0).all() and P[1].tolist() == [10.0, 2.0]


def test_the_soft_sine_has_the_derivatives_it_says() -> None:
    d = 1e-5
    for t in (0.4, 1.7, 2.9, 3.6, 11.0):
        before, at, after = (soft_sine(s, 0.8, 1.5, 3.0) for s in (t - d, t, t + d))
        for i in (0, 1):
            difference = (after[i] - before[i]) / (2 * d)
            assert difference == pytest.approx(at[i + 1], abs=1e-9), f"t {t}, order {i + 1}"
    assert soft_sine(-1.0, 1.0, 1.0, 3.0) == (0.0, 0.0, 0.0)


def test_the_lyapunov_function_of_the_identifier_falls_as_the_proof_says() -> None:
    """L = xt'P xt/2 + tr(W~'W~)/(2 Gam), where the unknown part is W*'ph, at random points."""
    rng = np.random.default_rng(8)
    for _ in range(50):
        law = Law(local, **ARM)
        w, xh, ul = law.x.w, law.x.xh, law.x.ul
        law.step(0, law=4.0, delay=5.0)  # begins at q = 0
        w[:] = rng.normal(size=w.shape)
        w_star, old = rng.normal(size=w.shape), w.copy()
        law.x.driving[:] = 0.0
        xh.q[:], xh.v[:] = rng.uniform(-0.05, 0.05, 2), rng.uniform(-0.05, 0.05, 2)
        law.x.played, ul[:] = 1.0, rng.uniform(-5.0, 5.0, 2)
        q, v = rng.uniform(-0.1, 0.1, 2), rng.uniform(-0.1, 0.1, 2)
        inputs = {"q_1_rad": q[0], "q_2_rad": q[1], "rate_1_rad_s": v[0], "rate_2_rad_s": v[1]}
        out = law.step(0, **inputs)  # still tick 0, so that xh stays
        ph = np.tanh(np.array([1.0, *q, *v]) @ law.p.v)
        c = np.cos(q[1])
        mass = np.array([[3.0 + 2.0 * c, 1.0 + c], [1.0 + c, 1.0]])
        tau = np.array([out["torque_1_Nm"], out["torque_2_Nm"]])
        assert (np.abs(tau) < [400.0, 200.0]).all(), f"{tau} N m: limited"
        acceleration = np.linalg.solve(mass, tau) + w_star.T @ ph
        rates, tuned, total = (w - old) / H, w_star - old, 0.0
        for j in (0, 1):
            xt = np.array([q[j] - xh.q[j], v[j] - xh.v[j]])
            model = AS @ [xh.q[j], xh.v[j]] + [0.0, ul[j]]
            total += xt @ P @ (np.array([v[j], acceleration[j]]) - model)
        total -= np.sum(tuned * rates) / ARM["gam"]
        xt = np.array([q - xh.q, v - xh.v])
        st = 10.0 * xt[0] + 2.0 * xt[1]
        wanted = -0.5 * (500.0 * xt[0] @ xt[0] + 20.0 * xt[1] @ xt[1])
        wanted -= (20.0 + 0.5 * np.linalg.norm(old)) * st @ st
        wanted += ARM["kap"] * np.sum(tuned * old)
        assert total == pytest.approx(wanted, rel=1e-9), f"{total} against {wanted}"


def test_a_joint_that_is_too_fast_is_braked_for_good() -> None:
    law = Law(local, **ARM)
    law.step(0, law=2.0, delay=5.0)
    assert law.step(1, rate_2_rad_s=20.1)["tripped"] == 1.0
    out = law.step(2, rate_2_rad_s=3.0)
    assert (out["tripped"], out["torque_1_Nm"], out["torque_2_Nm"]) == (1.0, 0.0, -30.0), out


NAMED = {1.0: telerobot_cancel, 2.0: telerobot_model, 3.0: telerobot_robust, 4.0: telerobot_network}


@pytest.mark.parametrize("number", NAMED)
def test_a_law_that_the_rig_names_has_the_bits_of_the_one_that_comes_with_u(number: float) -> None:
    by_name, by_number = Law(NAMED[number], **ARM), Law(local, **ARM)
    rng = np.random.default_rng(4)
    for k in range(60):
        seen = dict(
            zip(
                ("q_1_rad", "q_2_rad", "rate_1_rad_s", "rate_2_rad_s"),
                rng.uniform(-1.0, 1.0, 4),
                strict=True,
            )
        )
        seen |= {"u_1_rad_s2": rng.normal(), "u_2_rad_s2": rng.normal(), "delay": 5.0}
        seen |= {"tick": playout.wire_tick(float(k)), "law": number}
        ours, theirs = by_name.step(k, **seen), by_number.step(k, **seen)
        assert ours == theirs, f"tick {k}: {ours} and {theirs}"
    assert abs(ours["torque_1_Nm"]) > 1.0 and (number < 4.0 or ours["norm_w"] > 0.0), ours
