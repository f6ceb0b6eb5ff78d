"""The neural network of the pointing laws: learns friction, gravity, inertia along the reference.

    x   = [1, e/0.02, e'/0.2, q_d/0.5, q_d'/0.5, q_d''/3, w/0.2]   entries 2.. within +-3    (1)
    v_j = q_d' - hull rate             DESIRED speed against the hull: at rest the measured
                                       one is zero and could not flip the friction term      (2)
    phi = [1, s_1..s_10, j+-(v_j; 0.004), j+-(v_j; 0.04)]   j+-(v; v_s): (5) of two_layer.py (3)
    y   = W'phi                                                                              (4)
    rob = Kz (|Z|_F + Z_B) r,  Z = blkdiag(W, V)       robust term                           (5)
    tuning of two_layer.py, driven by clip(r, +-0.3), only while |e| > 0.1 mrad or the
    reference accelerates                                                                    (6)

y and |Z| use the weights before the update. w is the measured speed of the hub against the hull.

Health: as soon as y is no finite number within y_max or |Z| exceeds z_max, the network is latched
off: the torque of (4) and (5) that was last sent fades away in 0.1 s and the PD law beneath goes on
alone. With W = 0 at the start, V uniform in +-1 from `network_seed`, tuning laws and
e-modification, without clip and dead band of (6) and with a torque below tau_max, the errors are
uniformly ultimately bounded:
L = r'M r/2 + tr(W~'F^-1 W~)/2 + tr(V~'G^-1 V~)/2.

rad, rad/s, N m. Source: augmented network and tuning after Lewis, Campos, Selmic (SIAM 2002),
chapter 3.
"""

from collections.abc import Mapping

from pcpc.executive.laws.approximators.two_layer import (
    first_layer,
    hidden,
    jump_pair,
    norm,
    output,
    scaled,
    tune,
)
from pcpc.executive.laws.block import Ports, Prepared, inline, port
from pcpc.executive.laws.emath import clip, where
from pcpc.plants.atb1000.laws import pd

INPUTS, NODES, JUMPS = 7, 10, 4
PHI = 1 + NODES + JUMPS
JUMP_SPEEDS_RAD_S = (0.004, 0.04)  # one inside, one beyond the Stribeck range
R_MAX_RAD_S = 0.3  # raw steps would wind the weights up
DEAD_BAND_RAD = 1e-4
FADE_S = 0.1
NORM_SHOWN = 1e6  # beyond any bound that a rig may set; stands for what is not finite, too


class Parameters(Ports):
    """Tuning rates, the robust term and the limits of health."""

    network_on = port("", "1 engages the network, 0 leaves the PD law alone", None, 0.0, 1.0)
    f_rate = port("", "F, tuning rate of bias and smooth nodes", None, 0.0, 1e5)
    fj_rate = port("", "FJ, tuning rate of the jump nodes", None, 0.0, 1e5)
    g_rate = port("", "G, tuning rate of the first layer", None, 0.0, 1e5)
    kappa = port("", "e-modification", None, 0.0, 10.0)
    kz = port("", "Kz, robust term", None, 0.0, 100.0)
    z_bound = port("", "Z_B, bound of the ideal weights", None, 0.0, 1e6)
    z_max = port("", "weight norm at which the network is latched off", None, 0.0, 1e6)
    y_max_Nm = port("N m", "output at which the network is latched off", None, 0.0, 1e6)


class Settings(Parameters):
    """The parameters, and what draws the first layer."""

    network_seed = port("", "draws the first layer", None, 0.0, 2.0**31)


class States(Ports):
    """Weights, health and the vectors of this period."""

    w = port("N m", "output weights W", shape=PHI, recorded=False, adapts=True)
    v = port("", "V, row by row", shape=(INPUTS, NODES), recorded=False, adapts=True)
    network_fault = port("", "1 once the network was latched off")
    faded_Nm = port("N m", "torque of (4) and (5) as sent; fading after a fault")
    x = port("", "inputs of the network", shape=INPUTS, recorded=False)
    a = port("", "inputs of the nodes", shape=NODES, recorded=False)
    phi = port("", "hidden vector", shape=PHI, recorded=False)


class Outputs(Ports):
    """What the network gives and how it is."""

    network_Nm = port("N m", "network torque (4), or what is left of it after a fault")
    norm_z = port("", "Frobenius norm of all weights; 1e6 if larger or not finite")
    fallback = port("", "1 once the network was latched off and PD is alone")


def prepare(settings: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
    """Return the parameters as given and the V (7, 10), drawn uniform in +-1."""
    return Prepared(settings, {"v": first_layer(settings["network_seed"], INPUTS, NODES)})


@inline
def learned_torque(
    dt: float,
    e: float,
    r: float,
    p: Parameters,
    x: States,
    u: pd.TrackingInputs,
    y: Outputs,
) -> float:
    """Return network and robust torque (4) (5), fading once it is latched off, and tune (6)."""
    v_j = u.q_d_rate_rad_s - u.hull_rate_rad_s  # (2)
    x.x[0] = 1.0  # (1)
    x.x[1] = scaled(e, 0.02)
    x.x[2] = scaled(u.q_d_rate_rad_s - u.hub_rate_rad_s, 0.2)
    x.x[3] = scaled(u.q_d_rad, 0.5)
    x.x[4] = scaled(u.q_d_rate_rad_s, 0.5)
    x.x[5] = scaled(u.q_d_acc_rad_s2, 3.0)
    x.x[6] = scaled(u.hub_rate_rad_s - u.hull_rate_rad_s, 0.2)
    hidden(x.x, x.v, x.a, x.phi)  # (3)
    jump_pair(v_j, JUMP_SPEEDS_RAD_S[0], x.phi, 1 + NODES)
    jump_pair(v_j, JUMP_SPEEDS_RAD_S[1], x.phi, 3 + NODES)
    norm_z = norm(x.w, x.v)
    network = output(x.phi, x.w)  # (4)
    learned = network + p.kz * (norm_z + p.z_bound) * r  # (5)

    on = p.network_on > 0.5
    healthy = (abs(network) <= p.y_max_Nm) & (norm_z <= p.z_max)  # false for NaN
    x.network_fault = where(on, where(healthy, x.network_fault, 1.0), x.network_fault)
    trusted = on & (x.network_fault < 0.5)
    x.faded_Nm = where(trusted, learned, x.faded_Nm * (1.0 - dt / FADE_S))

    moving = (abs(e) > DEAD_BAND_RAD) | (abs(u.q_d_acc_rad_s2) > 1e-6)
    rate = where(trusted & moving, dt, 0.0)
    drive = clip(r, -R_MAX_RAD_S, R_MAX_RAD_S)
    leak = p.kappa * abs(drive)
    tune(x, drive, leak, rate * p.f_rate, rate * p.fj_rate, rate * p.g_rate)  # (6)
    y.network_Nm = where(trusted, network, x.faded_Nm)
    y.norm_z = where(norm_z <= NORM_SHOWN, norm_z, NORM_SHOWN)
    y.fallback = x.network_fault
    return x.faded_Nm
