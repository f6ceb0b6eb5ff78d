"""The quarter car and its laws a second time: plain Python from the equations; and the blocks."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from stepped import gains

from pcpc.executive.laws.block import Block, Port
from pcpc.plants.quarter_car import model
from pcpc.plants.quarter_car.laws import strut_backstepping, strut_outer, strut_pid

Vector = NDArray[np.float64]
FOLDER = Path(model.__file__).parent
_GROUPS = yaml.safe_load((FOLDER / "parameters.yaml").read_text())
CAR = {name: entry["value"] for group in _GROUPS.values() for name, entry in group.items()}
GAINS = gains(FOLDER)
BLOCKS = {
    "fl": strut_backstepping.BLOCK, "no_fl": strut_backstepping.BLOCK, "pid": strut_pid.BLOCK,
    "outer": strut_outer.BLOCK,
}  # fmt: skip
T = 1e-3

MS, MU, KT, KS, BS, G = 290.0, 59.0, 190000.0, 16812.0, 1000.0, 9.81
AC, AR, AO, RHO, CD, W = 5.0e-4, 1.5e-4, 9.6e-6, 900.0, 0.6, 0.02
AA, B0, B1 = AC - AR, 0.80e9, 10.0
P0 = MS * G / AR
PA = 2 * P0
V0 = (B0 + B1 * P0) * AR**2 / KS / 2
TV, XVMAX, L, KB, CB = 1 / 30, 2e-3, 0.10, 6e5, 3e3
W0 = 56.748


def bulk(p: float) -> float:
    """Return B(P)."""
    return B0 + B1 * max(p, 1e5)


def volumes(x3: float) -> tuple[float, float]:
    """Return V1, V2."""
    return max(V0 + AC * x3, 0.05 * V0), max(V0 - AA * x3, 0.05 * V0)


def psi(xv: float, p1: float) -> float:
    """Return the pressure across the valve."""
    return max(PA / 2 + min(1.0, max(-1.0, xv / 1e-5)) * (PA / 2 - p1), 1e4)


def leak(x5: float, x6: float) -> float:
    """Return QL."""
    dp = x6 - x5
    return CD * AO * math.sqrt(2 / RHO) * dp / (dp**2 + 1e5**2) ** 0.25


def gain(x3: float, p1: float, xv: float) -> float:
    """Return G."""
    return AC * bulk(p1) / volumes(x3)[0] * CD * W * math.sqrt(2 / RHO * psi(xv, p1))


def drift(x3: float, v3: float, x5: float, x6: float) -> float:
    """Return f."""
    v1, v2 = volumes(x3)
    ql = leak(x5, x6)
    return AC * bulk(x6) / v1 * (-AC * v3 - ql) - AA * bulk(x5) / v2 * (AA * v3 + ql)


def rates(t: float, x: Vector, u: float, road: float, strut: int, limits: bool) -> Vector:
    """Return the seven derivatives."""
    x1, x2, x3, x4, x5, x6, x7 = x
    v3 = x2 - x4
    f = {0: -KS * x3 - BS * v3, 1: AC * x6 - AA * x5, 2: u}[strut]
    fb = 0.0
    if limits and x3 > L:
        fb = min(0.0, -KB * (x3 - L) - CB * v3)
    if limits and x3 < -L:
        fb = max(0.0, -KB * (x3 + L) - CB * v3)
    ft = f - 20.0 * math.tanh(v3 / 0.02) + fb
    zr = 0.04 * math.sin(road * t)
    d = [x2, ft / MS - G, v3, (-ft + KT * (zr - (x1 - x3))) / MU - G, 0.0, 0.0, 0.0]
    if strut == 1:
        v1, v2 = volumes(x3)
        q = CD * W * x7 * math.sqrt(2 / RHO * psi(x7, x6))
        ql = leak(x5, x6)
        d[4] = bulk(x5) / v2 * (AA * v3 + ql)
        d[5] = bulk(x6) / v1 * (-AC * v3 - ql + q)
        d[6] = (u - x7) / TV
    return np.array(d)


def plant_tick(t: float, x: Vector, u: float, *how: Any) -> Vector:
    """Return the state T later: 20 classic Runge-Kutta steps."""
    h = T / 20
    for i in range(20):
        s = t + i * h
        k1 = rates(s, x, u, *how)
        k2 = rates(s + h / 2, x + h / 2 * k1, u, *how)
        k3 = rates(s + h / 2, x + h / 2 * k2, u, *how)
        k4 = rates(s + h, x + h * k3, u, *how)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        x[4:6] = np.maximum(x[4:6], 1e5)
        x[6] = min(XVMAX, max(-XVMAX, x[6]))
    return x


def rules(x3: float, v3: float, dp: float) -> Vector:
    """Return the normalised firing strengths of the 147 rules."""
    point = np.clip((x3 / 0.1, v3 / 2.0, dp / 10e6), -1.2, 1.2)
    grids = np.meshgrid(*(np.linspace(-1, 1, n) for n in (3, 7, 7)), indexing="ij")
    exponent = sum(
        ((c - g) / s) ** 2 / 2 for c, g, s in zip(point, grids, (0.5, 0.2, 0.2), strict=True)
    )
    mu = np.exp(-np.asarray(exponent)).ravel()
    return np.asarray(mu / mu.sum())


class ReferenceLaw:
    """Outer loop with backstepping, with or without the fuzzy system, or with PID."""

    def __init__(self, kind: str) -> None:
        """`kind`: a controller of the rig."""
        self.kind, self.xb, self.xk = kind, 0.0, math.nan
        self.theta, self.last, self.d = np.zeros(147), [math.nan, math.nan], [0.0, 0.0]
        self.x7d, self.integral = 0.0, 0.0
        g_nom = AC * bulk(P0) / V0 * CD * W * math.sqrt(2 / RHO * PA / 2)
        self.gam, self.kp = (120 / g_nom) ** 2, 600 / g_nom

    def difference(self, i: int, s: float) -> float:
        """Return the filtered difference of signal `i`."""
        last = s if math.isnan(self.last[i]) else self.last[i]
        self.d[i] += (1 - math.exp(-T / 0.002)) * ((s - last) / T - self.d[i])
        self.last[i] = s
        return self.d[i]

    def tick(self, x: Vector) -> float:
        """Return u."""
        _, x2, x3, x4, x5, x6, _ = x
        v3 = x2 - x4
        if math.isnan(self.xk):
            self.xk = x3
        rh = 16812.0 * (MS * G / 16812.0 - x3)
        fd = -1000 * self.xb - 16812 * (x3 - self.xk) - 2000 * x2 + rh
        ef = fd - (AC * x6 - AA * x5)
        self.xb += (1 - math.exp(-W0 * T)) * (v3 - self.xb)
        self.xk += (1 - math.exp(-W0 * T)) * (x3 - self.xk)
        return self.pid(ef) if self.kind == "pid" else self.backstepping(fd, ef, v3, x)

    def pid(self, ef: float) -> float:
        """Return u of the PID."""
        raw = self.kp * (ef + 40 * self.integral + 0.0005 * self.difference(0, ef))
        u = min(XVMAX, max(-XVMAX, raw))
        self.integral += T * ef * (u == raw)
        return u

    def backstepping(self, fd: float, ef: float, v3: float, x: Vector) -> float:
        """Return u of the backstepping law."""
        _, _, x3, _, x5, x6, x7 = x
        g = gain(x3, x6, self.x7d)
        m = rules(x3, v3, x6 - x5)
        x7d = float(self.theta @ m) + (self.difference(0, fd) + 100 * ef) / g
        self.x7d = x7d = min(XVMAX, max(-XVMAX, x7d))
        u = x7 + TV * (self.difference(1, x7d) + 200 * (x7d - x7))
        if self.kind == "fl":
            leaked = 100 * abs(g * ef) * self.theta
            self.theta = self.theta + T * self.gam * (m * g * ef - leaked)
        return float(min(3 * XVMAX, max(-3 * XVMAX, u)))


def defaults(ports: tuple[Port, ...]) -> dict[str, float]:
    """Return the ports' own defaults."""
    return {port.name: port.default for port in ports if port.default is not None}


def views(block: Block, settings: dict[str, float]) -> Any:
    """Return the ports of a block by name, prepared: p, x, u, y."""
    prepared = block.prepare({**defaults(block.settings), **settings}, 1.0 / T, 1)  # type: ignore[misc]

    def packed(ports: tuple[Port, ...], values: Any) -> Vector:
        return np.concatenate(
            [np.broadcast_to(values.get(port.name, 0.0), (port.size,)) for port in ports]
        ).astype(np.float64)

    parameters, states, inputs, outputs = block.step.declared
    return (
        parameters(packed(block.parameters, prepared.parameters)),
        states(packed(block.states, prepared.states)),
        inputs(np.zeros(inputs.size)),
        outputs(np.zeros(outputs.size)),
    )


def do_step(block: Block, t: float, dt: float, ports: Any) -> None:
    """Step the block on its p, x, u, y."""
    block.step(t, dt, *(view.values() for view in ports))


class Loop:
    """The compiled car and a law of the rig, wired directly: no bus, rounding or limits."""

    def __init__(self, law: str, **settings: float) -> None:
        """Take `settings` of the car."""
        self.block = BLOCKS[law]
        self.car = views(model.BLOCK, CAR | settings)
        self.law = views(self.block, GAINS[law])

    def start(self) -> Vector:
        """Return a copy of the car's state."""
        _, x, _, _ = self.car
        return x.car.values().copy()  # type: ignore[no-any-return]

    def run(self, cycles: int) -> Iterator[tuple[float, Vector, float]]:
        """Step both; yield t and the car's state, of the sample, and u, after the law's step."""
        (_, x, command, sensed), (_, _, measured, y) = self.car, self.law
        for k in range(cycles):
            do_step(model.BLOCK, k * T, T, self.car)
            measured.body_rate_m_s, measured.wheel_rate_m_s = (
                sensed.sample_body_rate_m_s,
                sensed.sample_wheel_rate_m_s,
            )
            measured.extension_m = sensed.sample_extension_m
            measured.p1_Pa, measured.p2_Pa = sensed.sample_p1_Pa, sensed.sample_p2_Pa
            measured.spool_m = sensed.sample_spool_m
            do_step(self.block, k * T, T, self.law)
            command.spool_command_m, command.force_command_N = y.command_m, y.desired_N
            yield k * T, x.car.values(), y.command_m
