"""A law that pcpc swarm has drawn; shape 11."""

from pcpc.executive.laws.block import Block, Ports, port, stage
from pcpc.executive.laws.emath import clip, floor, sin, tanh, where

ALL = clip, floor, sin, tanh, where


class Gains(Ports):
    first = port("", "gain", None, -100.0, 100.0)
    second = port("", "gain", None, -100.0, 100.0)


class States(Ports):
    kept = port("", "filtered input")


class Inputs(Ports):
    position = port("", "measured")
    target = port("", "wanted")


class Outputs(Ports):
    command = port("", "to the plant", low=-2000.0, high=2000.0)


@stage
def step(t: float, dt: float, p: Gains, x: States, u: Inputs, y: Outputs) -> None:
    e = u.target - u.position
    x.kept += 0.125 * (clip(u.position, -1e6, 1e6) - x.kept)
    wanted = ((tanh(clip(p.second, -2.0, abs(p.first))) * (tanh(p.first) * x.kept)) - floor((e * (sin(t) + p.first))))
    y.command = clip(p.first * e + clip(wanted, -1.0, 1.0), -40.0, 40.0)


BLOCK = Block(step)
