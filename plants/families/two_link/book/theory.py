"""M, Vm and G of the two-link arm over all cycles of a run, for the proofs of its laws.

Equations (1) to (4) of equations.py; q, v (n, 2) rad, rad/s.
"""

from dataclasses import dataclass

import numpy as np

from pcpc.plants.lyapunov import Assumption
from pcpc.plants.theorem import MARGIN, Cycles, with_threshold
from pcpc.plants.weights import Vector

LINKS = ("a1_m", "a2_m", "m1_kg", "m2_kg")  # settings of `TwoLinks`
DRAWN = 4000  # points of the compact set


@dataclass(frozen=True)
class TwoLinks:
    """Lengths in m, masses in kg (`m2` a number or one a cycle), g in m/s2."""

    a1: float
    a2: float
    m1: float
    m2: float | Vector
    g: float = 0.0

    def inertia(self, q: Vector) -> Vector:
        """Return M (n, 2, 2) at q (n, 2), kg m2."""
        cosine = np.cos(q[:, 1])
        far = self.m2 * self.a2**2 + 0.0 * cosine
        cross = self.m2 * self.a1 * self.a2 * cosine
        made = np.empty((len(q), 2, 2))
        made[:, 0, 0] = (self.m1 + self.m2) * self.a1**2 + far + 2.0 * cross
        made[:, 0, 1] = made[:, 1, 0] = far + cross
        made[:, 1, 1] = far
        return made

    def coriolis(self, q: Vector, v: Vector) -> Vector:
        """Return Vm (n, 2, 2) for which M' - 2 Vm is skew, N m s/rad; q, v (n, 2)."""
        h = self.m2 * self.a1 * self.a2 * np.sin(q[:, 1])
        made = np.zeros((len(q), 2, 2))
        made[:, 0, 0] = -h * v[:, 1]
        made[:, 0, 1] = -h * (v[:, 0] + v[:, 1])
        made[:, 1, 0] = h * v[:, 0]
        return made

    def gravity(self, q: Vector) -> Vector:
        """Return G (n, 2) at q (n, 2), N m."""
        outer = self.m2 * self.g * self.a2 * np.cos(q[:, 0] + q[:, 1])
        inner = (self.m1 + self.m2) * self.g * self.a1 * np.cos(q[:, 0])
        return np.stack((inner + outer, outer), axis=1)

    def inertia_range(self) -> tuple[float, float]:
        """Return the smallest and the largest eigenvalue of M over all q, kg m2."""
        elbow = np.linspace(0.0, np.pi, 181)
        links = TwoLinks(self.a1, self.a2, self.m1, float(np.max(self.m2)), self.g)
        bent = np.stack((0.0 * elbow, elbow), axis=1)
        found = np.linalg.eigvalsh(links.inertia(bent))
        return float(found.min()), float(found.max())


def times(matrices: Vector, vectors: Vector) -> Vector:
    """Return the product of each cycle's matrix (n, 2, 2) and vector (n, 2), (n, 2)."""
    return np.einsum("nij,nj->ni", matrices, vectors)


@dataclass(frozen=True)
class Motion:
    """True motion and reference of an arm, and e, e', r for given Lam; (n, 2) each."""

    q: Vector
    v: Vector
    q_d: Vector
    rate_d: Vector
    acc_d: Vector
    lam: Vector

    @property
    def e(self) -> Vector:
        """q_d - q."""
        return self.q_d - self.q

    @property
    def e_rate(self) -> Vector:
        """q_d' - v."""
        return self.rate_d - self.v

    @property
    def r(self) -> Vector:
        """The filtered error, e' + Lam e."""
        return self.e_rate + self.lam * self.e

    @property
    def forward(self) -> tuple[Vector, Vector]:
        """q_d'' + Lam e', q_d' + Lam e: what M and Vm multiply in f."""
        return self.acc_d + self.lam * self.e_rate, self.rate_d + self.lam * self.e

    @property
    def inputs(self) -> Vector:
        """What the laws' networks take, x (n, 11): 1, e, e', q_d, q_d', q_d''."""
        parts = (self.e, self.e_rate, self.q_d, self.rate_d, self.acc_d)
        return with_threshold(np.concatenate(parts, axis=1))


def motion(run: Cycles, lam: Vector) -> Motion:
    """Return the motion of an arm whose blocks are `arm`, `reference_1` and `reference_2`.

    `lam`: (2,).
    """
    return Motion(
        run.columns("plant:arm.q_{}_rad"),
        run.columns("plant:arm.rate_{}_rad_s"),
        run.columns("executive:reference_{}.q_d_rad"),
        run.columns("executive:reference_{}.q_d_rate_rad_s"),
        run.columns("executive:reference_{}.q_d_acc_rad_s2"),
        lam,
    )


def forward_torque(links: TwoLinks, states: Motion) -> Vector:
    """Return M (q_d'' + Lam e') + Vm (q_d' + Lam e), (n, 2), N m."""
    ahead, along = states.forward
    return times(links.inertia(states.q), ahead) + times(links.coriolis(states.q, states.v), along)


def acting_torque(run: Cycles) -> Vector:
    """Return what acts on the arm in the cycle behind each, (n, 2), N m."""
    return run.after(run.columns("plant:arm.acting_{}_Nm"))


def inertia_known(known: Vector, true: Vector) -> Assumption:
    """Return whether a law's Mhat is M; (n, 2, 2) both."""
    wrong = float(np.abs(known - true).max())
    return Assumption("Mhat is M", wrong < 1e-9, f"they differ by up to {wrong:.3g} kg m2")


def drawn_states(states: Motion) -> Motion:
    """Return states of the compact set: references of the run, |r| up to 1.25 times its largest."""
    draw = np.random.default_rng(0)
    rows = draw.integers(0, len(states.q), DRAWN)
    reach = MARGIN * float(np.linalg.norm(states.r, axis=1).max())
    r = draw.normal(size=(DRAWN, 2))
    r *= reach * np.sqrt(draw.random((DRAWN, 1))) / np.linalg.norm(r, axis=1, keepdims=True)
    e = draw.uniform(-1.0, 1.0, (DRAWN, 2)) * reach / np.maximum(states.lam, 1e-9)
    e_rate = r - states.lam * e
    q_d, rate_d, acc_d = states.q_d[rows], states.rate_d[rows], states.acc_d[rows]
    return Motion(q_d - e, rate_d - e_rate, q_d, rate_d, acc_d, states.lam)


def acceleration(
    run: Cycles, links: TwoLinks, q: Vector, v: Vector, width: float, torque: Vector | float = 0.0
) -> Vector:
    """Return q'' (n, 2) of (1) (2) of arm.py beside it under a torque, none by default.

    `q`, `v`, `torque`: (n, 2).
    """
    viscous = run.setting("plant:arm.viscous_Nms_rad")
    coulomb = run.setting("plant:arm.coulomb_Nm")
    slowed = times(links.coriolis(q, v), v) + links.gravity(q)
    pull = torque - slowed - viscous * v - coulomb * np.tanh(v / width)
    return np.asarray(np.linalg.solve(links.inertia(q), pull[:, :, None])[:, :, 0])
