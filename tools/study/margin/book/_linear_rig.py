"""Rigs with linear plants whose open loop is known in closed form, with a held command before them.

    x_k+1 = Phi x_k + Gamma h_k,  h_k+1 = u_k,  y = c x + noise-free;  u = kp e + kd (e - e_-1)/T

Commands and samples travel as 64-bit floats, so that nothing but rounding stands between theory
and what is found.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

RATE_HZ = 500.0
T = 1.0 / RATE_HZ
Response = NDArray[np.complex128]
_TABLE = """\
VERSION ""
BU_: EXEC PLANT
BO_ 128 SYNC: 2 EXEC
 SG_ sequence : 0|8@1+ (1,0) [0|255] "" PLANT
 SG_ crc : 8|8@1+ (1,0) [0|255] "" PLANT
BO_ 160 CMD: 8 EXEC
 SG_ command : 0|64@1- (1,0) [-1000000|1000000] "" PLANT
BO_ 161 MODE: 3 EXEC
 SG_ mode : 0|4@1+ (1,0) [0|15] "" PLANT
 SG_ counter : 8|4@1+ (1,0) [0|15] "" PLANT
 SG_ crc : 16|8@1+ (1,0) [0|255] "" PLANT
BO_ 162 SIDE: 8 EXEC
 SG_ command : 0|64@1- (1,0) [-1000000|1000000] "" PLANT
BO_ 288 FB: 8 PLANT
 SG_ position : 0|64@1- (1,0) [-1000000|1000000] "" EXEC
BO_ 1793 HB_EXEC: 1 EXEC
 SG_ nmt_state : 0|8@1+ (1,0) [0|255] "" PLANT
BO_ 1794 HB_PLANT: 1 PLANT
 SG_ nmt_state : 0|8@1+ (1,0) [0|255] "" EXEC
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_ BO_ "GenMsgSendType" ENUM "EveryCycle","Cyclic";
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_DEF_DEF_ "GenMsgSendType" "Cyclic";
"""
_EVERY = (128, 160, 161, 162, 288)
LAWS = """\
from pcpc.executive.laws.emath import clip, floor, sqrt, where
from pcpc.executive.laws.block import Block, Nothing, Ports, group, inline, port, stage

class Gains(Ports):
    kp = port("", "proportional", None, -1e6, 1e6)
    kd = port("s", "derivative", 0.0, -1e6, 1e6)

class Before(Ports):
    e = port("", "the error before")

class Sample(Ports):
    target = port("", "where to go")
    position = port("", "measured")

class Command(Ports):
    command = port("", "to the plant", low=-1e6, high=1e6)
    side = port("", "to its other input", low=-1e6, high=1e6)

@stage
def pd(t: float, dt: float, p: Gains, x: Before, u: Sample, y: Command) -> None:
    e = u.target - u.position
    y.command = p.kp * e + p.kd * (e - x.e) / dt
    y.side = 0.25 * e
    x.e = e

class Ring(Ports):
    past = port("", "commands by cycle", shape=16)

class Late(Gains):
    late = port("", "cycles", 0.0, 0.0, 15.0)

class Kept(Before):
    ring = group(Ring)

@stage
def late_pd(t: float, dt: float, p: Late, x: Kept, u: Sample, y: Command) -> None:
    now = int(t / dt + 0.5)
    e = u.target - u.position
    x.ring.past[now % 16] = p.kp * e + p.kd * (e - x.e) / dt
    y.command = x.ring.past[(now - int(p.late)) % 16]
    x.e = e

class Gate(Before):
    slow = port("", "what an observer would know")
    open = port("", "1 with authority")

@stage
def gated_pd(t: float, dt: float, p: Gains, x: Gate, u: Sample, y: Command) -> None:
    e = u.target - u.position
    x.slow += dt * (u.position - x.slow)
    y.command = p.kp * e + p.kd * (e - x.e) / dt + x.open * x.slow
    x.e = e

class Target(Ports):
    target = port("", "where to go")
    rate_s = port("1/s", "how fast")

@stage
def ramp(t: float, dt: float, p: Nothing, x: Nothing, u: Nothing, y: Target) -> None:
    y.target = 0.5 * t
    y.rate_s = 0.5

class Matrices(Ports):
    phi = port("", "of the state", shape=(3, 3))
    gamma = port("", "of the command", shape=3)
    c = port("", "of the sample", shape=3)
    side_gain = port("", "of the other input", 0.0, -1e3, 1e3)
    bend = port("", "how much more a command above 0 does than one below", 0.0, 0.0, 1.0)
    soft = port("", "where the command saturates, smoothly; 0 nowhere", 0.0, 0.0, 1e6)
    gap = port("", "half the play of the command, an operator", 0.0, 0.0, 1e3)
    slack = port("", "half the dead zone of the command", 0.0, 0.0, 1e3)
    relay = port("", "dry friction: its size times the sign of the command", 0.0, -1e3, 1e3)
    quantum = port("", "of the sample, 0 none", 0.0, 0.0, 1.0)

class States(Ports):
    x = port("", "of the plant", shape=3)
    new = port("", "the next one", shape=3)
    held = port("", "the command that holds")

class Commands(Ports):
    command = port("", "from the law")
    side = port("", "from the law")

class Position(Ports):
    position = port("", "the sample", low=-1e6, high=1e6)

@inline
def sign(a: float) -> float:
    return where(a > 0.0, 1.0, where(a < 0.0, -1.0, 0.0))

@stage
def plant(t: float, dt: float, p: Matrices, x: States, u: Commands, y: Position) -> None:
    if t > 0.0:
        acts = x.held + p.bend * abs(x.held)
        if p.soft > 0.0:
            acts = acts / sqrt(1.0 + (acts / p.soft) * (acts / p.soft))
        for i in range(3):
            x.new[i] = p.gamma[i] * acts
            for j in range(3):
                x.new[i] += p.phi[i, j] * x.x[j]
        for i in range(3):
            x.x[i] = x.new[i]
        moved = u.command + p.side_gain * u.side
        moved = moved + clip(-moved, -p.slack, p.slack) + p.relay * sign(moved)
        x.held = clip(x.held, moved - p.gap, moved + p.gap)
    total = 0.0
    for i in range(3):
        total += p.c[i] * x.x[i]
    if p.quantum > 0.0:
        total = p.quantum * floor(total / p.quantum + 0.5)
    y.position = total

PD, LATE, GATED = Block(pd), Block(late_pd), Block(gated_pd)
RAMP, PLANT = Block(ramp), Block(plant)
"""


@dataclass(frozen=True)
class Linear:
    """A continuous plant c (s - a)^-1 b behind a hold, the law's gains, and its L(z)."""

    a: Any
    b: Any
    c: Any
    kp: float
    kd: float
    plant: Callable[[Response], Response]  # of z, with the hold, without the delay

    def loop(self, f_hz: NDArray[np.float64]) -> Response:
        """Return L in closed form."""
        z = np.exp(2j * np.pi * f_hz * T)
        return (self.kp + self.kd * (1.0 - 1.0 / z) / T) * self.plant(z) / z

    def write(self, folder: Path, **parameters: float) -> Path:
        """Write the rig and return its file. ImportError without scipy."""
        from scipy.linalg import expm

        block = np.zeros((4, 4))
        block[: len(self.a), : len(self.a)], block[: len(self.a), 3] = self.a, self.b
        phi, gamma = expm(block * T)[:3, :3], expm(block * T)[:3, 3]
        values = {f"phi_{i}": one for i, one in enumerate(phi.ravel().tolist())}
        values |= {f"gamma_{i}": one for i, one in enumerate(gamma.tolist())}
        values |= {f"c_{i}": one for i, one in enumerate([*self.c, 0.0, 0.0][:3])} | parameters
        said = ", ".join(f"{name}: {value!r}" for name, value in values.items())
        every = "".join(f'BA_ "GenMsgCycleTime" BO_ {one} 2;\n' for one in _EVERY)
        every += "".join(f'BA_ "GenMsgSendType" BO_ {one} 0;\n' for one in _EVERY)
        beats = "".join(f'BA_ "GenMsgCycleTime" BO_ {one} 100;\n' for one in (1793, 1794))
        doubles = "".join(f"SIG_VALTYPE_ {one} command : 2;\n" for one in (160, 162))
        doubles += "SIG_VALTYPE_ 288 position : 2;\n"
        (folder / "linear.dbc").write_text(_TABLE + every + beats + doubles)
        (folder / "laws.py").write_text(LAWS)
        path = folder / "rig.yaml"
        path.write_text(_RIG.format(kp=self.kp, kd=self.kd, values=said))
        return path


_RIG = """\
rig: linear
dbc: linear.dbc
rate_hz: 500.0
duration_s: 1.0
controller: pd
controllers:
  pd: {{law: "laws.py:PD", parameters: {{kp: {kp!r}, kd: {kd!r}}}}}
  late: {{like: pd, law: "laws.py:LATE"}}
  gated: {{like: pd, law: "laws.py:GATED"}}
executive:
  node: EXEC
  blocks:
    reference: {{law: "laws.py:RAMP"}}
    controller: {{inputs: {{target: reference.target, position: rx.FB.position}}}}
  transmit:
    CMD.command: controller.command
    SIDE.command: controller.side
    MODE.mode: supervisor.state
    HB_EXEC.nmt_state: supervisor.nmt
plant:
  node: PLANT
  blocks:
    system:
      law: "laws.py:PLANT"
      parameters: {{{values}}}
      inputs: {{command: rx.CMD.command, side: rx.SIDE.command}}
  transmit: {{FB.position: system.position, HB_PLANT.nmt_state: supervisor.nmt}}
  safe: {{CMD.command: 0.0}}
"""

TAU, OMEGA, ZETA = 0.05, 60.0, 0.2


def _lag(z: Response) -> Response:
    a = np.exp(-T / TAU)
    return (1.0 - a) / (z - a)


def _double(z: Response) -> Response:
    return 0.5 * T * T * (z + 1.0) / (z - 1.0) ** 2


def _resonant(z: Response) -> Response:
    """Return (1 - 1/z) times the z-transform of the step response, by partial fractions."""
    pole = OMEGA * (-ZETA + 1j * np.sqrt(1.0 - ZETA * ZETA))
    residue = OMEGA**2 / (pole**2 * (pole - pole.conjugate()))
    total = T / z / (1.0 - 1.0 / z) ** 2 - 2.0 * ZETA / OMEGA / (1.0 - 1.0 / z)
    for p, r in ((pole, residue), (pole.conjugate(), residue.conjugate())):
        total = total + r / (1.0 - np.exp(p * T) / z)
    return (1.0 - 1.0 / z) * total


PLANTS = {
    "lag": Linear([[-1.0 / TAU]], [1.0 / TAU], [1.0], 8.0, 0.0, _lag),
    "double": Linear([[0.0, 1.0], [0.0, 0.0]], [0.0, 1.0], [1.0, 0.0], 400.0, 30.0, _double),
    "resonant": Linear(
        [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, -(OMEGA**2), -2.0 * ZETA * OMEGA]],
        [0.0, 0.0, OMEGA**2], [1.0, 0.0, 0.0], 8.0, 0.0, _resonant,
    ),
}  # fmt: skip
