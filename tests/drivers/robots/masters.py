"""Laws that are masters of a robot's drive: switched on, then a velocity or a place."""

from pcpc.executive.laws.block import Block, Nothing, Ports, port, stage


class Asked(Ports):
    """What the drive is to do."""

    wanted = port("", "velocity in rad/s, or place in rad", 2.0, -100.0, 100.0)
    until_s = port("s", "then it is switched off", 0.4, 0.0, 100.0)


class Heard(Ports):
    """What the drive says."""

    position_rad = port("rad", "of the drive")
    velocity_rad_s = port("rad/s", "of the drive")


class OfODrive(Ports):
    """What an ODrive is told."""

    state = port("", "of the axis")
    control = port("", "control mode")
    input = port("", "input mode")
    target_rad_s = port("rad/s", "its target")
    e = port("", "what is missing")


class OfMit(Ports):
    """What a motor in MIT mode is told."""

    target_rad = port("rad", "its target")
    target_rad_s = port("rad/s", "its target")
    stiffness = port("", "of (1)")
    damping = port("", "of (1)")
    torque = port("", "of (1)")
    e = port("", "what is missing")


class OfMoteus(Ports):
    """What a moteus is told: heads of subframes, and the values of the registers."""

    write_mode = port("", "write an int8 into 0x000")
    mode = port("", "of the controller")
    write = port("", "write three float32 from 0x020 on")
    target_rad = port("rad", "its target")
    target_rad_s = port("rad/s", "its target")
    torque = port("", "fed forward")
    read = port("", "read three float32 from 0x001 on")
    pad = port("", "nothing")
    e = port("", "what is missing")


class OfRobStride(Ports):
    """What a RobStride is told, which each of its frames switches on."""

    on = port("", "no matter")
    target_rad = port("rad", "its target")
    target_rad_s = port("rad/s", "its target")
    stiffness = port("", "of (1)")
    damping = port("", "of (1)")
    e = port("", "what is missing")


@stage
def odrive(t: float, dt: float, p: Asked, x: Nothing, u: Heard, y: OfODrive) -> None:
    """Ask for closed loop and a velocity."""
    y.state = 8.0 if t < p.until_s else 1.0
    y.control, y.input = 2.0, 1.0
    y.target_rad_s = p.wanted
    y.e = p.wanted - u.velocity_rad_s


@stage
def moteus(t: float, dt: float, p: Asked, x: Nothing, u: Heard, y: OfMoteus) -> None:
    """Ask for a velocity, with the position that belongs to it."""
    y.write_mode, y.write, y.read, y.pad = 0x0001, 0x200F, 0x011F, 0x50
    y.mode = 10.0 if t < p.until_s else 0.0
    y.target_rad, y.target_rad_s, y.torque = p.wanted * t, p.wanted, 0.0
    y.e = p.wanted - u.velocity_rad_s


@stage
def mit(t: float, dt: float, p: Asked, x: Nothing, u: Heard, y: OfMit) -> None:
    """Send the orders on and off, which are largest values, and between them a spring's place."""
    on, off = t < 0.01, t >= p.until_s
    y.target_rad, y.target_rad_s, y.torque = p.wanted, 0.0, 0.0
    y.stiffness, y.damping = 0.3, 0.006
    if on or off:
        y.target_rad, y.target_rad_s, y.stiffness, y.damping = 12.5, 30.0, 500.0, 5.0
        y.torque = (0xFFC if on else 0xFFD) * 20.0 / 4095.0 - 10.0
    y.e = p.wanted - u.position_rad


@stage
def robstride(t: float, dt: float, p: Asked, x: Nothing, u: Heard, y: OfRobStride) -> None:
    """Hold a place with a spring, until it is let go."""
    y.on, y.target_rad, y.target_rad_s = 1.0, p.wanted, 0.0
    y.stiffness = 0.3 if t < p.until_s else 0.0
    y.damping = 0.006 if t < p.until_s else 0.0
    y.e = p.wanted - u.position_rad


ODRIVE, MIT, MOTEUS, ROBSTRIDE = Block(odrive), Block(mit), Block(moteus), Block(robstride)
