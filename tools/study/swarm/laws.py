"""The plant of a drawn rig, and a drive's master.

x' = (command - x) / tau      BLOCK: a lag, one Euler step a cycle; it says which layout is in turn
w  = 2^16 frac(43758 sin(k))  MASTER: words, drawn anew each hold_s; up to on_s those that switch on
"""

from pcpc.executive.laws.block import Block, Nothing, Ports, inline, port, stage
from pcpc.executive.laws.emath import clip, floor, sin, where


class Parameters(Ports):
    """Of the lag."""

    tau_s = port("s", "time constant", None, 1e-3, 1e3)
    layouts = port("", "layouts of a frame, in turn", 2.0, 1.0, 8.0)
    press_s = port("s", "when the emergency stop is pressed", 1e6, 0.0, 1e6)


class States(Ports):
    """Of the lag."""

    x = port("", "of the lag")


class Inputs(Ports):
    """From the law."""

    command = port("", "newest valid command")


class Outputs(Ports):
    """To the law."""

    position = port("", "the sample", low=-2000.0, high=2000.0)
    twice = port("", "the sample, doubled")
    which = port("", "layout in turn")
    pressed = port("", "1 once the emergency stop is pressed")


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    """Advance the lag from t - dt to t and sample it; at t = 0 only sample."""
    if t > 0.0:
        x.x += clip(dt / p.tau_s, 0.0, 1.0) * (u.command - x.x)
    y.position = x.x
    y.twice = 2.0 * x.x
    y.pressed = where(t >= p.press_s, 1.0, 0.0)
    y.which = where(y.which + 1.0 < p.layouts, y.which + 1.0, 0.0)


BLOCK = Block(step)


class Orders(Ports):
    """Of the master."""

    on_0 = port("", "first word that switches on", None, 0.0, 65535.0)
    on_1 = port("", "the next", None, 0.0, 65535.0)
    on_2 = port("", "the next", None, 0.0, 65535.0)
    on_3 = port("", "the last", None, 0.0, 65535.0)
    on_s = port("s", "as long", None, 0.0, 100.0)
    hold_s = port("s", "of drawn words", None, 0.0, 100.0)
    seed = port("", "of drawn words", None, 0.0, 100.0)


class Said(Ports):
    """Words of two frames."""

    a_0 = port("", "of the first")
    a_1 = port("", "of the first")
    a_2 = port("", "of the first")
    a_3 = port("", "of the first")
    b_0 = port("", "of the second")
    b_1 = port("", "of the second")
    b_2 = port("", "of the second")
    b_3 = port("", "of the second")


@inline
def word(k: float) -> float:
    """Return a word that is drawn by a number."""
    x = 43758.5453 * sin(k)
    return floor(65536.0 * (x - floor(x)))


@stage
def talk(t: float, dt: float, p: Orders, x: Nothing, u: Nothing, y: Said) -> None:
    """Say what switches on, then what is drawn."""
    k = 8.0 * floor(t / (p.hold_s + dt)) + p.seed
    y.a_0 = where(t < p.on_s, p.on_0, word(k))
    y.a_1 = where(t < p.on_s, p.on_1, word(k + 1.0))
    y.a_2 = where(t < p.on_s, p.on_2, word(k + 2.0))
    y.a_3 = where(t < p.on_s, p.on_3, word(k + 3.0))
    y.b_0, y.b_1 = word(k + 4.0), word(k + 5.0)
    y.b_2, y.b_3 = word(k + 6.0), word(k + 7.0)


MASTER = Block(talk)
