"""Arm and adaptive critic in plain numpy with matrices, written from the equations, for tests."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from stepped import gains

from pcpc.plants.payload_arm import model

Vector = NDArray[np.float64]
FOLDER = Path(model.__file__).parent
_GROUPS = yaml.safe_load((FOLDER / "parameters.yaml").read_text())
ARM = {name: entry["value"] for group in _GROUPS.values() for name, entry in group.items()}
LAW = gains(FOLDER)["critic"]


def sigma(x: Any) -> Any:
    """Return the logistic function; real or complex."""
    return 1.0 / (1.0 + np.exp(-x))


def mass(q: Vector, m2: float) -> Vector:
    """Return M(q) with links of 1 m and m1 of 1 kg."""
    cross = m2 * (1.0 + np.cos(q[1]))
    return np.array([[1.0 + 2.0 * m2 + 2.0 * m2 * np.cos(q[1]), cross], [cross, m2]])


def acceleration(q: Vector, v: Vector, tau: Vector, m2: float, **other: float) -> Vector:
    """Return q'' under friction and gravity; `other` replaces numbers of parameters.yaml."""
    p = {**ARM, **other}
    outer = m2 * p["gravity_m_s2"] * np.cos(q[0] + q[1])
    gravity = np.array([(1.0 + m2) * p["gravity_m_s2"] * np.cos(q[0]) + outer, outer])
    h = m2 * np.sin(q[1])
    coriolis = np.array([-h * (2.0 * v[0] * v[1] + v[1] ** 2), h * v[0] ** 2])
    friction = p["viscous_Nms_rad"] * v + p["coulomb_Nm"] * np.tanh(v / p["smooth_rad_s"])
    rest: Vector = np.linalg.solve(mass(q, m2), tau - coriolis - gravity - friction)
    return rest


def runge_kutta(q: Vector, v: Vector, tau: Vector, m2: float, h: float) -> tuple[Vector, Vector]:
    """Return angles and rates after one classic step."""

    def slope(x: Vector) -> Vector:
        return np.concatenate((x[2:], acceleration(x[:2], x[2:], tau, m2)))

    x = np.concatenate((q, v))
    k1 = slope(x)
    k2 = slope(x + 0.5 * h * k1)
    k3 = slope(x + 0.5 * h * k2)
    k4 = slope(x + h * k3)
    x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return x[:2], x[2:]


class Critic:
    """The law with the gains of rig.yaml, or others by name."""

    def __init__(self, **gains: float) -> None:
        """Draw V1, then V2; start W1, W2 and rho at 0."""
        self.g = LAW | gains
        draw = np.random.default_rng(int(self.g["network_seed"])).uniform
        self.v1, self.v2 = draw(-1, 1, (2, 10)), draw(-1, 1, (11, 10))
        self.w1, self.w2 = np.zeros((10, 2)), np.zeros((10, 2))
        self.rho = np.zeros(2)

    def torque(self, qd: Vector, vd: Vector, ad: Vector, q: Vector, v: Vector, dt: float) -> Vector:
        """Return tau and tune over `dt`."""
        g = self.g
        e, de = qd - q, vd - v
        r = de + g["lam_per_s"] * e
        s1 = sigma(self.v1.T @ r)
        d1 = np.diag(s1 * (1.0 - s1))
        s2 = sigma(self.v2.T @ np.concatenate(([1.0], e, de, qd, vd, ad)))
        signal = self.w1.T @ s1 + self.rho
        sc = r + self.v1 @ d1 @ self.w1 @ signal
        robust = -g["kz"] * sc / (np.linalg.norm(sc) + g["delta_rad_s"])
        u = self.w2.T @ s2 + g["kv_per_s"] * r - robust
        dw1 = -np.outer(s1, signal) - g["kap1"] * self.w1
        dw2 = g["gam"] * (np.outer(s2, sc) - g["kap2"] * self.w2)
        drho = self.w1.T @ d1 @ self.v1.T @ (g["kv_per_s"] * r) + g["beta"] * r
        drho = drho + g["alpha"] * self.w1.T @ s1
        self.w1 = self.w1 + dt * dw1
        self.w2 = self.w2 + dt * dw2
        self.rho = self.rho + dt * drho
        tau: Vector = mass(q, 1.0) @ u
        return tau


def loop(cycles: int, payload_kg: float = 0.0) -> Iterator[tuple[Vector, Vector, Vector]]:
    """Yield q, q' and tau of every millisecond; the payload comes at 5 s."""
    law, q, v = Critic(), np.zeros(2), np.zeros(2)
    for k in range(cycles):
        t = 1e-3 * k
        qd, vd = np.array((np.sin(t), np.cos(t))), np.array((np.cos(t), -np.sin(t)))
        tau = law.torque(qd, vd, -qd, q, v, 1e-3)
        yield q, v, tau
        m2 = 1.0 + (payload_kg if 5000 <= k < 7000 else 0.0)
        for _ in range(10):
            q, v = runge_kutta(q, v, tau, m2, 1e-4)
