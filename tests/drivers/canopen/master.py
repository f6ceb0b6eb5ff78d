"""A law that is a CANopen master of a drive: up through CiA 402's states, then a velocity."""

from pcpc.executive.laws.block import Block, Nothing, Ports, port, stage


class Asked(Ports):
    """What the drive is to do."""

    wanted_rad_s = port("rad/s", "wanted", 2.0, -100.0, 100.0)
    until_s = port("s", "then it is switched off", 0.4, 0.0, 100.0)


class Heard(Ports):
    """What the drive says."""

    statusword = port("", "of the drive")
    velocity_rad_s = port("rad/s", "of the drive")


class Said(Ports):
    """What it is told."""

    controlword = port("", "of the drive")
    target_rad_s = port("rad/s", "of the drive")
    e_rad_s = port("rad/s", "what is missing")


@stage
def step(t: float, dt: float, p: Asked, x: Nothing, u: Heard, y: Said) -> None:
    """Answer the statusword with the next controlword."""
    power = int(u.statusword) & 0x6F
    y.controlword = 0.0
    if t < p.until_s:
        y.controlword = 0x06
        if power == 0x21:
            y.controlword = 0x07
        if power == 0x23 or power == 0x27:
            y.controlword = 0x0F
    y.target_rad_s = p.wanted_rad_s
    y.e_rad_s = p.wanted_rad_s - u.velocity_rad_s


BLOCK = Block(step)
