"""An electric drive: a first-order torque loop behind the motor's peak torque and speed limits.

    tau'  = (sat(tau_cmd) - tau)/Tcl                                                    (1)
    sat:    -stall (1 + w/w_nl) <= . <= stall (1 - w/w_nl),  then |.| <= peak           (2)

N m, rad/s, s; `stall` is the torque at standstill on the full bus voltage, w_nl the no-load speed.
Above w_nl the voltage limit turns into a brake, itself limited to the peak torque.
"""

from pcpc.drivers.compiled.jit import inline
from pcpc.executive.laws.emath import clip


@inline
def available_torque(
    command: float, speed: float, peak: float, stall: float, no_load: float
) -> float:
    """Return the command after both limits of (2)."""
    slip = speed / no_load
    on_voltage = clip(command, -stall * (1.0 + slip), stall * (1.0 - slip))
    return clip(on_voltage, -peak, peak)


@inline
def torque_rate(torque: float, wanted: float, time_constant: float) -> float:
    """Return tau' of (1), N m/s; `wanted` from `available_torque`, `time_constant` Tcl > 0."""
    return (wanted - torque) / time_constant
