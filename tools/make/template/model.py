"""A DC motor behind a voltage driver, with an encoder: voltage in, angle in whole counts out.

    v   = clip(v_cmd, +-v_max)                              the driver              (1)
    L i' = v - R i - K w                                    the winding             (2)
    J w' = K i - b w - T,   T = Tc sign(w); at rest T holds against up to Tc        (3)
    q'  = w                                                                         (4)
    encoder = D floor(q/D + 1/2),   D = 2 pi / counts_per_turn                      (5)

    call k of `step` at t = k dt:  k = 0  sample the motor at rest
                                   k > 0  integrate [t - dt, t] with the voltage held so far, take
                                          the new one, sample at t

So a command computed from the sample of t_k acts from t_k+1: one sample of delay, as on real
hardware. Implicit Euler steps of h = dt/substeps:

    i+  = (i + h/L (v - K w)) / (1 + h R/L)                                         (2')
    (J + h b) w+ + h Tc Sgn(w+)  contains  J w + h K i+                             (3')

They are stable for any winding, and a motor that sticks stands exactly still. With a constant
voltage the motor ends at w = (K v/R - Tc)/(b + K K/R): test_motor.py.

V, A, N m, rad, rad/s, s; a positive voltage raises q. K is torque per current and back-EMF per
speed, which are one number in SI units.
"""

from pcpc.executive.laws.block import Block, Ports, inline, port, stage
from pcpc.executive.laws.emath import clip
from pcpc.plants.actuators.stick_slip import velocity
from pcpc.plants.sensors import rounded

TWO_PI = 6.283185307179586


class Parameters(Ports):
    """Of driver, winding, rotor and encoder; rig.yaml says the numbers and where they are from."""

    v_max_V = port("V", "largest voltage of the driver", None, 0.0, 1000.0)
    resistance_ohm = port("ohm", "R, of the winding", None, 1e-3, 1e4)
    inductance_H = port("H", "L, of the winding", None, 1e-7, 10.0)
    torque_constant_Nm_A = port("N m/A", "K, also the back-EMF in V s/rad", None, 1e-6, 100.0)
    inertia_kg_m2 = port("kg m^2", "J, of rotor and load", None, 1e-9, 1e3)
    viscous_Nms_rad = port("N m s/rad", "b, viscous friction", None, 0.0, 1e3)
    coulomb_Nm = port("N m", "Tc, Coulomb friction", None, 0.0, 1e3)
    counts_per_turn = port("", "of the encoder, all four edges", None, 4.0, 1e7)
    substeps = port("", "integration steps in a period, a whole number", 10.0, 1.0, 1000.0)


class States(Ports):
    """What is integrated, and the voltage in force."""

    current_A = port("A", "i")
    speed_rad_s = port("rad/s", "w")
    angle_rad = port("rad", "q")
    held_V = port("V", "v, until the next call")


class Inputs(Ports):
    """What came over the bus."""

    voltage_V = port("V", "newest valid command")


class Outputs(Ports):
    """Two sensors, with their ranges on the bus; the truth is the states, which are recorded."""

    encoder_rad = port("rad", "angle in whole counts (5)", low=-1000.0, high=1000.0)
    sample_current_A = port("A", "of the winding", low=-30.0, high=30.0)


@inline
def advance(v: float, h: float, p: Parameters, x: States) -> None:
    """Integrate over `h` s under the voltage `v`: (2'), (3'), (4)."""
    driven = x.current_A + h / p.inductance_H * (v - p.torque_constant_Nm_A * x.speed_rad_s)
    x.current_A = driven / (1.0 + h * p.resistance_ohm / p.inductance_H)
    momentum = p.inertia_kg_m2 * x.speed_rad_s + h * p.torque_constant_Nm_A * x.current_A
    inertia = p.inertia_kg_m2 + h * p.viscous_Nms_rad
    x.speed_rad_s = velocity(momentum, h * p.coulomb_Nm, inertia)
    x.angle_rad += h * x.speed_rad_s


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    """Advance the motor from t - dt to t, take the new command, sample; at t = 0 only sample."""
    if t > 0.0:
        n = int(p.substeps)
        for _ in range(n):
            advance(x.held_V, dt / n, p, x)
        x.held_V = clip(u.voltage_V, -p.v_max_V, p.v_max_V)  # (1)
    y.encoder_rad = rounded(x.angle_rad, TWO_PI / p.counts_per_turn)  # (5)
    y.sample_current_A = x.current_A


BLOCK = Block(step)
