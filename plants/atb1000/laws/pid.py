"""PD of `pd.py` with an integral of the filtered error.

    w   = Kv r + s                                                        the rest as in pd.py  (1)
    s  += T Ki r        while |w| < tau_max and |r| < r_max   (else frozen)                     (2)

(1) uses s from before (2). Not in the book: a neural network with a bias node acts largely as an
integrator, and PD alone would be too easy to beat. rad, rad/s, N m; positive torque raises q.
"""

from pcpc.executive.laws.block import Block, Ports, port, stage
from pcpc.executive.laws.emath import where
from pcpc.plants.atb1000.laws import pd


class Gains(pd.Gains):
    """Those of PD, and the integral's."""

    ki_Nm_rad = port("N m/rad", "integral gain", None, 0.0, 1.0e5)
    r_max_rad_s = port("rad/s", "no integration beyond this filtered error", None, 0.0, 10.0)


class States(Ports):
    """The integral."""

    s_Nm = port("N m", "integral of the filtered error (2)", adapts=True)


@stage
def step(t: float, dt: float, p: Gains, x: States, u: pd.Inputs, y: pd.Outputs) -> None:
    """One control period; see the module header."""
    pd.errors(p, u, y)
    wanted = p.kv_Nms_rad * y.r_rad_s + x.s_Nm  # (1)
    pd.command(wanted, p, u, y)
    free = (abs(wanted) < p.tau_max_Nm) & (abs(y.r_rad_s) < p.r_max_rad_s)
    x.s_Nm += where(free, dt * p.ki_Nm_rad * y.r_rad_s, 0.0)  # (2)


BLOCK = Block(step)
