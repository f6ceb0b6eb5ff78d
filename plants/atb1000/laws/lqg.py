"""Linear-quadratic regulator with a Kalman filter on the linear barrel: hub, first mode, drive.

    J w' + c m'' = tau - d,  m'' + c w' + 2 z w_c m' + w_c^2 m = 0       hub and mode 1      (1)
    tau' = (v - tau)/T_a,  d' = 0         current loop; d: friction, weight, what else acts  (2)
    x_f = [theta, w, m, m', tau, d],  x_c = [theta, w, m, m', tau, v]                        (3)
        v: command in force, one sample after it was computed: v(k+1) = u(k)                 (4)
    y   = [encoder + hull pitch, hub rate, strain/S + c_g cos q_d]                           (5)
    x_f += L (y - y^)                     Kalman filter; then the step of (1) (2) with v     (6)
    u_e = J q_d'' + d                     torque along the reference                         (7)
    w = u_e - K (x_c - x_d),  x_d = [q_d, q_d', -c q_d''/w_c^2, 0, u_e, u_e]                 (8)
        the rest as in pd.py (4) to (6): the shaft damping stays

K minimises the sum of (theta/1 mrad)^2 + (w/W)^2 + (u/U)^2, L the error with sensor noise and with
white noise on the torque (D, N m) and on d (E, N m in a second). The rotor is geared rigidly to the
hub in (1): play and shaft are left out, friction and weight are no more than the constant d.
`prepare` computes both gains for the rate, in portable arithmetic (executive/laws/riccati.py). e
and r of pd.py are outputs for the page, and not used.

Reads what PD reads, q_d'' and the strain. Knows the linear barrel and the noise of its sensors.
rad, rad/s, N m at the output, m in sqrt(kg) m; positive torque raises q. Source: Anderson, Moore,
Optimal Control: Linear Quadratic Methods (1990), chapters 8 and 9; disturbance state: Franklin,
Powell, Workman, Digital Control of Dynamic Systems (1998), section 8.5.
"""

from collections.abc import Mapping

from pcpc.executive.laws.block import Array, Block, Ports, Prepared, group, inline, port, stage
from pcpc.executive.laws.emath import cos, where
from pcpc.executive.laws.riccati import (
    Matrix,
    diagonal,
    eye,
    filter_gain,
    regulator,
    sampled_system,
    solution,
)
from pcpc.plants.atb1000.laws import pd

N, MEASURED = 6, 3
ANGLE_RAD = 1e-3  # unit of the error in the cost
MODE_NOISE_PER_S2 = 0.05  # white noise on m'', what the other modes and the rounding do


class Sensor(Ports):
    """How the measured strain tells the mode."""

    strain_ue_per_mode = port("ue", "S, strain of a unit of mode 1", None, 1.0, 1e9)
    gravity_mode = port("", "c_g, static deflection of mode 1 at 0 deg", None, -1.0, 1.0)
    inertia_kg_m2 = port("kg m^2", "J, hub, straight barrel and rotor", None, 1e-3, 1e6)
    deflection_s2_rad = port("s2/rad", "c/w_c^2, deflection per acceleration", None, -1.0, 1.0)


class Gains(Ports):
    """What `prepare` computes."""

    k = port("", "K (8)", shape=N)
    l = port("", "L (6), row by row", shape=(N, MEASURED))  # noqa: E741  the symbol of (6)
    a = port("", "transition of x_f in a period, row by row", shape=(N, N))
    b = port("", "what v adds to x_f in a period", shape=N)


class Parameters(Ports):
    """Of the errors, the sensor and the gains."""

    pd = group(pd.Gains)
    sensor = group(Sensor)
    gains = group(Gains)


class Design(Ports):
    """The linear barrel and the weights."""

    coupling = port("", "c, coupling of mode 1 to the hub", None, -1e3, 1e3)
    clamped_rad_s = port("rad/s", "w_c, clamped frequency of mode 1", None, 1.0, 1e4)
    clamped_damping = port("", "z, its damping", None, 0.0, 1.0)
    motor_lag_s = port("s", "T_a, current loop", None, 1e-4, 1.0)
    angle_noise_rad = port("rad", "of encoder and hull pitch", None, 1e-9, 1.0)
    rate_noise_rad_s = port("rad/s", "of the hub's gyro", None, 1e-9, 1.0)
    strain_noise_ue = port("ue", "of the strain", None, 1e-6, 1e6)
    rate_weight_rad_s = port("rad/s", "W, rate that costs as much as 1 mrad", None, 1e-6, 1e6)
    torque_weight_Nm = port("N m", "U, torque that costs as much as 1 mrad", None, 1e-6, 1e6)
    torque_noise_Nm = port("N m", "D, white noise on the torque, one sample", None, 1e-9, 1e6)
    drift_Nm = port("N m", "E, random walk of d in a second", None, 1e-9, 1e6)


class Settings(Ports):
    """What a rig gives."""

    pd = group(pd.Gains)
    sensor = group(Sensor)
    design = group(Design)


class States(Ports):
    """The filter's state and the command on its way."""

    x = port("", "theta, w, m, m', tau estimated", shape=N - 1, recorded=False)
    disturbance_Nm = port("N m", "estimate of d", adapts=True)
    in_force_Nm = port("N m", "v, command in force from this sample on, at the output")
    innovation = port("", "y - y^", shape=MEASURED, recorded=False)
    now = port("", "x_f before its step", shape=N, recorded=False)
    x_c = port("", "x_c of (3)", shape=N, recorded=False)
    x_d = port("", "x_d of (8)", shape=N, recorded=False)
    begun = port("", "1 after the first period")


class Outputs(pd.Outputs):
    """Those of PD, and what the filter says."""

    mode = port("", "estimated deflection of mode 1, sqrt(kg) m")
    compensated_Nm = port("N m", "estimated disturbance d")


@inline
def correct(p: Parameters, x: States, u: pd.FlexibleInputs) -> None:
    """Write x_f after its correction by the measurement (6) to x.now."""
    theta = u.encoder_rad + u.hull_pitch_rad
    mode = u.strain_ue / p.sensor.strain_ue_per_mode + p.sensor.gravity_mode * cos(u.q_d_rad)
    x.x[0] = where(x.begun > 0.5, x.x[0], theta)
    x.begun = 1.0
    x.innovation[0] = theta - x.x[0]  # (5)
    x.innovation[1] = u.hub_rate_rad_s - x.x[1]
    x.innovation[2] = mode - x.x[2]
    for i in range(N):
        total = x.disturbance_Nm
        if i < N - 1:
            total = x.x[i]
        for j in range(MEASURED):
            total += p.gains.l[i, j] * x.innovation[j]
        x.now[i] = total


@inline
def predict(p: Parameters, x: States) -> None:
    """Step x_f over a period, with the command in force (1) (2)."""
    for i in range(N - 1):
        total = p.gains.b[i] * x.in_force_Nm
        for j in range(N):
            total += p.gains.a[i, j] * x.now[j]
        x.x[i] = total
    x.disturbance_Nm = x.now[N - 1]


@inline
def compare(u_e: float, s: Sensor, x: States, u: pd.FlexibleInputs) -> None:
    """Write x_c (3), and x_d of (8)."""
    for i in range(N - 1):
        x.x_c[i] = x.now[i]
    x.x_c[5] = x.in_force_Nm
    x.x_d[0], x.x_d[1] = u.q_d_rad, u.q_d_rate_rad_s
    x.x_d[2], x.x_d[3] = -s.deflection_s2_rad * u.q_d_acc_rad_s2, 0.0
    x.x_d[4], x.x_d[5] = u_e, u_e


@inline
def feedback(k: Array, x_c: Array, x_d: Array) -> float:
    """Return K (x_c - x_d) of (8), summed by pairs; all (6,)."""
    total = 0.0
    for i in range(0, N, 2):
        total += k[i] * (x_c[i] - x_d[i]) + k[i + 1] * (x_c[i + 1] - x_d[i + 1])
    return total


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: pd.FlexibleInputs, y: Outputs) -> None:
    """One control period; see the module header."""
    pd.errors(p.pd, u, y)
    correct(p, x, u)  # (5) (6)
    y.mode, y.compensated_Nm = x.now[2], x.now[N - 1]
    u_e = p.sensor.inertia_kg_m2 * u.q_d_acc_rad_s2 + y.compensated_Nm  # (7)
    compare(u_e, p.sensor, x, u)
    pd.command(u_e - feedback(p.gains.k, x.x_c, x.x_d), p.pd, u, y)  # (8)
    predict(p, x)
    x.in_force_Nm = y.motor_torque_Nm * p.pd.gear_ratio  # (4)


def continuous(s: Mapping[str, float]) -> tuple[Matrix, Matrix]:
    """Return F (6, 6) and G (6, 1) of (1) (2), for x_f and the command in force."""
    c, w, z = s["coupling"], s["clamped_rad_s"], s["clamped_damping"]
    mass = [[s["inertia_kg_m2"], c], [c, 1.0]]
    forces = [[0.0, 0.0, 0.0, 0.0, 1.0, -1.0], [0.0, 0.0, -w * w, -2.0 * z * w, 0.0, 0.0]]
    hub, mode = solution(mass, forces)
    lag = [0.0] * 4 + [-1.0 / s["motor_lag_s"], 0.0]
    f = [[0.0, 1.0] + [0.0] * 4, hub, [0.0] * 3 + [1.0, 0.0, 0.0], mode, lag, [0.0] * N]
    return f, [[0.0]] * 4 + [[1.0 / s["motor_lag_s"]], [0.0]]


def lqg_matrices(s: Mapping[str, float], rate_hz: float) -> tuple[Matrix, Matrix, Matrix, Matrix]:
    """Return A (6, 6), B (6, 1) of x_f, K (1, 6) and L (6, 3). ValueError: no solution."""
    f, g = continuous(s)
    a, b = sampled_system(f, g, 1.0 / rate_hz)
    ac = [[*a[i][:5], b[i][0]] for i in range(5)] + [[0.0] * N]  # x_c: v for d
    bc = [[0.0]] * 5 + [[1.0]]
    weights = (ANGLE_RAD**-2, s["rate_weight_rad_s"] ** -2)
    k = regulator(ac, bc, diagonal([*weights, *[0.0] * 4]), [[s["torque_weight_Nm"] ** -2]])
    c = eye(N)[:MEASURED]
    push = [a[i][5] * s["torque_noise_Nm"] for i in range(5)] + [0.0]  # as d acts
    q = [[x * y for y in push] for x in push]
    q[3][3] += (MODE_NOISE_PER_S2 / rate_hz) ** 2
    q[5][5] += s["drift_Nm"] ** 2 / rate_hz
    strain = s["strain_noise_ue"] / s["strain_ue_per_mode"]
    noise = diagonal([one * one for one in (s["angle_noise_rad"], s["rate_noise_rad_s"], strain)])
    return a, b, k, filter_gain(a, c, q, noise)


def prepare(settings: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
    """Return the parameters and the gains for a rate in Hz. ValueError: there are none."""
    a, b, k, gain = lqg_matrices(settings, rate_hz)
    flat = {"a": a, "b": b, "k": k, "l": gain}
    direct = {one.name: settings[one.name] for one in (*pd.Gains.ports, *Sensor.ports)}
    return Prepared(direct | {name: [v for row in m for v in row] for name, m in flat.items()})


BLOCK = Block(step, settings=Settings, prepare=prepare)
