"""Super-twisting sliding mode on the filtered error of `pd.py`, with a linear term.

    s   = r                                                 the sliding variable             (1)
    w   = J (q_d'' + Lam e') + Kv s + K1 sqrt|s| sgn s + z  the rest as in pd.py             (2)
    z  += T K2 sgn s,  |z| <= z_max                         not while |w| >= tau_max         (3)

With J s' = d - tau + J (q_d'' + Lam e') and |d'| <= D, Kv = 0, any K2 > D and K1^2 > 4 J K2
(K2 + D)/(K2 - D) bring s and s' to 0 in finite time and hold them there; the linear term only
helps. With a delay they cannot stay: s then oscillates with about the square of the delay and K2,
and the command with the delay and K2. **That is the law's chatter**; noise of s goes through an
infinite slope at 0. The sliding mode needs no model of friction or weight, only a bound of the rate
at which they change, and a reversal of dry friction is a jump: each one throws s off.

Reads what PD reads, and q_d''. Knows the total inertia. rad, rad/s, N m at the output; positive
torque raises q. Source: Levant, Sliding order and sliding accuracy in sliding mode control, Int. J.
Control 58 (1993), 1247-1263; linear term and Lyapunov function: Moreno, Osorio, Strict Lyapunov
functions for the super-twisting algorithm, IEEE Trans. Automatic Control 57 (2012), 1035-1040.
"""

from pcpc.executive.laws.block import Block, Ports, group, port, stage
from pcpc.executive.laws.emath import clip, sign, sqrt, where
from pcpc.plants.atb1000.laws import pd


class Sliding(Ports):
    """Gains of the super-twisting part."""

    inertia_kg_m2 = port("kg m^2", "hub, barrel and rotor at the output, J", None, 0.0, 1e6)
    k1_Nm = port("N m", "K1, of the root of s; N m at 1 rad/s", None, 0.0, 1e4)
    k2_Nm_s = port("N m/s", "K2, slope of z", None, 0.0, 1e6)
    z_max_Nm = port("N m", "limit of z", None, 0.0, 1e4)


class Parameters(Ports):
    """Of PD and of the super-twisting part."""

    pd = group(pd.Gains)
    sliding = group(Sliding)


class States(Ports):
    """The integral."""

    z_Nm = port("N m", "integral of the sign (3)", adapts=True)


@stage
def step(
    t: float, dt: float, p: Parameters, x: States, u: pd.TrackingInputs, y: pd.Outputs
) -> None:
    """One control period; see the module header."""
    pd.errors(p.pd, u, y)
    k, s = p.sliding, y.r_rad_s  # (1)
    rate = u.q_d_rate_rad_s - u.hub_rate_rad_s
    inertia = k.inertia_kg_m2 * (u.q_d_acc_rad_s2 + p.pd.lam_per_s * rate)
    side = sign(s)
    wanted = inertia + p.pd.kv_Nms_rad * s + k.k1_Nm * sqrt(abs(s)) * side + x.z_Nm  # (2)
    pd.command(wanted, p.pd, u, y)
    free = abs(wanted) < p.pd.tau_max_Nm
    grown = clip(x.z_Nm + dt * k.k2_Nm_s * side, -k.z_max_Nm, k.z_max_Nm)
    x.z_Nm = where(free, grown, x.z_Nm)  # (3)


BLOCK = Block(step)
