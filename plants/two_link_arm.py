"""What plants that are two-link arms have in common: torques that come late, samples, truths.

A sample is rounded to a multiple of its `..._lsb_...`, half up; so is the torque that acts; 0 does
not round. rad, rad/s, N m.
"""

from typing import Any

from pcpc.executive.laws.block import Ports, inline, port
from pcpc.plants.sensors import rounded
from pcpc.plants.transport import DELAY_SIZE, delayed


class Interface(Ports):
    """The age of what acts, and quanta."""

    delay_samples = port("", "age of the torque that acts, whole", 0.0, 0.0, DELAY_SIZE - 1.0)
    torque_lsb_Nm = port("N m", "quantum of the torque that acts, 0 none", 0.0, 0.0, 1e3)
    position_lsb_rad = port("rad", "quantum of the position samples, 0 none", 0.0, 0.0, 1.0)
    rate_lsb_rad_s = port("rad/s", "quantum of the rate samples, 0 none", 0.0, 0.0, 10.0)


class Held(Ports):
    """The registers of the delay."""

    torque_Nm = port("N m", "torques on their way", shape=(2, DELAY_SIZE), recorded=False)


class Inputs(Ports):
    """The law's torques."""

    torque_Nm = port("N m", "newest valid command to joint #", shape=2, named="torque_#_Nm")


class Outputs(Ports):
    """Samples and truths."""

    sample_rad = port("rad", "sensor: q#", shape=2, named="sample_#_rad")
    rate_sample_rad_s = port("rad/s", "sensor: q#'", shape=2, named="rate_sample_#_rad_s")
    q_rad = port("rad", "true q#", shape=2, named="q_#_rad")
    rate_rad_s = port("rad/s", "true q#'", shape=2, named="rate_#_rad_s")
    acting_Nm = port("N m", "torque on joint # up to this sample", shape=2, named="acting_#_Nm")


@inline
def receive(p: Any, held: Any, u: Any, y: Any) -> None:
    """Write the torques that act in this period; `p` is an Interface."""
    for j in range(len(u.torque_Nm)):
        due = delayed(u.torque_Nm[j], p.delay_samples, held.torque_Nm[j])
        y.acting_Nm[j] = rounded(due, p.torque_lsb_Nm)


@inline
def sample(p: Any, q: Any, v: Any, y: Any) -> None:
    """Write samples and truths of angles and rates; `p` is an Interface."""
    for j in range(len(q)):
        y.sample_rad[j] = rounded(q[j], p.position_lsb_rad)
        y.rate_sample_rad_s[j] = rounded(v[j], p.rate_lsb_rad_s)
        y.q_rad[j] = q[j]
        y.rate_rad_s[j] = v[j]
