"""PD of `pd.py` with the inertia's torque and a momentum observer of all other torques.

    P    = J_h w + J_m (w - w_h)              momentum: w hub rate, w_h hull rate           (1)
    J w' = u - d                              d: friction, weight, hull, what else acts     (2)
    d^  += L T (u_k-2 - d^) - L (P - P_k-1)   d^' = L (d - d^): time constant 1/L           (3)
    w    = Kv r + (J_h + J_m) q_d'' + clip(d^, +-d_max)     r and the rest as in pd.py      (4)

(3) is L (integral of (u - d^) - P) in differences, with the command that was in force between the
last two samples: what was computed two periods ago. d^ begins at 0. Beyond L = 1/(3 T) the noise of
the gyro comes back as torque; the first mode and the play set the limit much earlier. Held by
friction, d^ follows the command itself and so grows as an integral does.

Reads what PD reads, and q_d''. Knows the nominal inertias, neither friction nor weight. rad, rad/s,
N m at the output; positive torque raises q. Source: De Luca, Mattone, Actuator failure detection
and isolation using generalized momenta, Proc. IEEE ICRA (2003), 634-639; for friction: Le Tien,
Albu-Schaeffer, De Luca, Hirzinger, Friction observer and compensation for control of robots with
joint torque measurement, Proc. IEEE/RSJ IROS (2008), 3789-3795.
"""

from pcpc.executive.laws.block import Block, Ports, group, inline, port, stage
from pcpc.executive.laws.emath import clip, where
from pcpc.plants.atb1000.laws import pd


class Observer(Ports):
    """The inertias and the observer."""

    hub_inertia_kg_m2 = port("kg m^2", "hub and straight barrel, J_h", None, 0.0, 1e6)
    rotor_inertia_kg_m2 = port("kg m^2", "rotor at the output, J_m", None, 0.0, 1e6)
    observer_per_s = port("1/s", "L, bandwidth of the observer", None, 0.0, 1e4)
    d_max_Nm = port("N m", "limit of what is compensated", None, 0.0, 1e4)


class Parameters(Ports):
    """Of PD and of the observer."""

    pd = group(pd.Gains)
    observer = group(Observer)


class States(Ports):
    """The estimate, the momentum of the last period and two commands."""

    disturbance_Nm = port("N m", "d^, estimate of what acts against the command", adapts=True)
    momentum_Nms = port("N m s", "P of the last period")
    in_force_Nm = port("N m", "command of two periods ago, at the output")
    sent_Nm = port("N m", "command of the last period, at the output")
    begun = port("", "1 after the first period")


class Outputs(pd.Outputs):
    """Those of PD, and what is compensated."""

    compensated_Nm = port("N m", "d^ within +-d_max")


@inline
def observe(dt: float, p: Observer, x: States, u: pd.TrackingInputs) -> None:
    """Step (3)."""
    rotor_rate = u.hub_rate_rad_s - u.hull_rate_rad_s
    momentum = p.hub_inertia_kg_m2 * u.hub_rate_rad_s + p.rotor_inertia_kg_m2 * rotor_rate  # (1)
    change = where(x.begun > 0.5, momentum - x.momentum_Nms, 0.0)
    x.begun = 1.0
    x.momentum_Nms = momentum
    driven = dt * (x.in_force_Nm - x.disturbance_Nm)
    x.disturbance_Nm += p.observer_per_s * (driven - change)


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: pd.TrackingInputs, y: Outputs) -> None:
    """One control period; see the module header."""
    pd.errors(p.pd, u, y)
    o = p.observer
    observe(dt, o, x, u)
    y.compensated_Nm = clip(x.disturbance_Nm, -o.d_max_Nm, o.d_max_Nm)
    inertia = (o.hub_inertia_kg_m2 + o.rotor_inertia_kg_m2) * u.q_d_acc_rad_s2
    pd.command(p.pd.kv_Nms_rad * y.r_rad_s + inertia + y.compensated_Nm, p.pd, u, y)  # (4)
    x.in_force_Nm = x.sent_Nm
    x.sent_Nm = y.motor_torque_Nm * p.pd.gear_ratio


BLOCK = Block(step)
