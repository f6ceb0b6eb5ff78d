"""The robot's node of a telerobot: what its laws share, from the play-out of u to the limits.

ul is u of N ticks ago, by `playout.py`: held, and counted, where its frame is missing. Before the
first it is what holds the robot where it stands: -A21 q(0), or 0 for a bare double integrator. The
frames of a sample tell its tick and, as echo, that of the ul in use.

    xh+ = Ad xh + Bd (ul + Mhat^-1 (tau - tau before the limits)),  xh(0) = x(0)             (5)
    tau = Mhat a + Vm q' + G      for the wanted acceleration a: computed torque            (10)
    tau = 0, until the first frame tells; no start-up kick, as the arm hangs                 (9)

Numbers as in telerobot_network.py. xh, the recurrent identifier, is a reference model there.

Ticks are cycles, and where the operator skipped some that this node did not, as it may where SYNC
starts its cycles, its ticks jump after those that come with u. Time, and so (5), goes on as it was.

A joint faster than `speed_limit_rad_s` trips for good: tau = -brake q'.

rad, rad/s, N m. Source: Lewis, Campos, Selmic (SIAM 2002), chapter 8; numbers are this project's.
"""

from collections.abc import Mapping

from pcpc.executive.laws.approximators.two_layer import first_layer
from pcpc.executive.laws.block import Ports, Prepared, group, inline, port
from pcpc.executive.laws.emath import clip, floor, where
from pcpc.plants.families.two_link.equations import gravity_torque, inertia_times, motion, solved
from pcpc.plants.telerobot.equations import A21, JOINTS, Joints, Sampled, advance, sampled
from pcpc.plants.telerobot.laws.playout import EMPTY, SLOTS, put, take, tick_of, wire_tick

NODES, NET_INPUTS = 20, 1 + 2 * JOINTS
UNKNOWN, CANCEL, MODEL, ROBUST, NETWORK = 0.0, 1.0, 2.0, 3.0, 4.0  # what comes as `law`


class Gains(Ports):
    """The robust term, the network, the nominal arm and the limits."""

    kr_per_s = port("1/s", "Kr, robust term", None, 0.0, 1e4)
    kw = port("", "Kw, robust term per norm of W", None, 0.0, 1e3)
    gam = port("", "Gam, tuning rate", None, 0.0, 1e5)
    kap = port("", "kap, leak", None, 0.0, 1e3)
    a1_m = port("m", "nominal length of link 1", None, 1e-3, 100.0)
    a2_m = port("m", "nominal length of link 2", None, 1e-3, 100.0)
    m1_kg = port("kg", "nominal mass at link 1", None, 1e-3, 1e4)
    m2_kg = port("kg", "nominal mass at link 2", None, 1e-3, 1e4)
    gravity_m_s2 = port("m/s2", "nominal g", None, -100.0, 100.0)
    tau_max_Nm = port("N m", "limit of joint #", None, 0.0, 1e4, shape=2, named="tau_max_#_Nm")
    speed_limit_rad_s = port("rad/s", "at which a joint trips", None, 0.0, 1e4)
    brake_Nms_rad = port("N m s/rad", "damping once tripped", None, 0.0, 1e4)


class Settings(Gains):
    """The gains, and what draws the first layer."""

    network_seed = port("", "draws V", 3.0, 0.0, 2.0**31)


class Parameters(Gains):
    """The gains, the model for this rate, and the first layer."""

    model = group(Sampled)
    v = port("", "V (5, 20), row by row", shape=(NET_INPUTS, NODES))


class Inputs(Ports):
    """What the operator sent, and the measured motion."""

    u_rad_s2 = port("rad/s2", "newest u of joint #", 0.0, shape=JOINTS, named="u_#_rad_s2")
    tick = port("", "wire tick of u", 0.0)
    law = port("", "1 cancel, 2 As, 3 robust, 4 network; 0 unknown", 0.0)
    delay = port("", "N", 0.0)
    q_rad = port("rad", "measured q#", shape=JOINTS, named="q_#_rad")
    rate_rad_s = port("rad/s", "measured q#'", shape=JOINTS, named="rate_#_rad_s")


class Outputs(Ports):
    """The torques, what is told to the operator, and what led to it."""

    torque_Nm = port("N m", "to joint #", shape=JOINTS, named="torque_#_Nm")
    sample_tick = port("", "wire tick of this sample")
    echo = port("", "wire tick of the ul in use; 0: N is not known yet")
    ul_rad_s2 = port("rad/s2", "ul of joint #", shape=JOINTS, named="ul_#_rad_s2")
    model_rad = port("rad", "xh, position of joint #", shape=JOINTS, named="model_#_rad")
    model_rate_rad_s = port("rad/s", "xh, rate of joint #", shape=2, named="model_rate_#_rad_s")
    network_rad_s2 = port("rad/s2", "W'ph of joint #", shape=JOINTS, named="network_#_rad_s2")
    norm_w = port("", "Frobenius norm of W")
    held_u = port("", "ticks without a new u, of the whole run")
    tripped = port("", "1 once a joint was too fast")


class Arm(Ports):
    """The nominal arm at this tick."""

    m11 = port("kg m^2", "Mhat, its first entry")
    m12 = port("kg m^2", "the one beside it")
    m22 = port("kg m^2", "its last")
    vm = port("N m", "Vm q'", shape=JOINTS)


class States(Ports):
    """The identifier, the ticks, the play-out, the arm and the network."""

    xh = group(Joints, "xh_")
    driving = port("rad/s2", "what drives xh until the next tick", shape=JOINTS, recorded=False)
    ul = port("rad/s2", "u in use", shape=JOINTS, recorded=False)
    start = port("rad", "q(0)", shape=JOINTS, recorded=False)
    begun = port("", "1 after the first tick", recorded=False)
    xh_tick = port("", "tick of xh", recorded=False)
    ul_tick = port("", "tick of ul", recorded=False)
    ahead = port("", "ticks by which the operator's are ahead of this node's", recorded=False)
    played = port("", "1 after the first u", recorded=False)
    missed = port("", "ticks without a new u", recorded=False)
    trip = port("", "1 once a joint was too fast", recorded=False)
    st = port("", "st (1)", shape=JOINTS, recorded=False)
    learned = port("rad/s2", "W'ph", shape=JOINTS, recorded=False)
    seen = port("", "[1; q; q'] of (2)", shape=NET_INPUTS, recorded=False)
    ph = port("", "ph (2)", shape=NODES, recorded=False)
    w = port("rad/s2", "W (20, 2)", shape=(NODES, JOINTS), recorded=False, adapts=True)
    buffer = port("rad/s2", "play-out of u", EMPTY, shape=(JOINTS, SLOTS), recorded=False)
    arm = group(Arm, "arm_", recorded=False)


@inline
def begin(now: float, x: States, u: Inputs) -> None:
    """At the first tick, start identifier and reference where the robot is."""
    first = x.begun < 0.5
    for j in range(JOINTS):
        x.start[j] = where(first, u.q_rad[j], x.start[j])
        x.xh.q[j] = where(first, u.q_rad[j], x.xh.q[j])
        x.xh.v[j] = where(first, u.rate_rad_s[j], x.xh.v[j])
    x.xh_tick = where(first, now, x.xh_tick)
    x.begun = 1.0


@inline
def identify(now: float, p: Parameters, x: States) -> None:
    """Bring xh to this tick (5)."""
    for _ in range(int(now - x.xh_tick)):
        advance(p.model, x.xh, x.driving)
    x.xh_tick = now


@inline
def operator_tick(now: float, x: States, u: Inputs) -> float:
    """Return the tick of this cycle, not behind that of the newest u."""
    own = now + x.ahead
    behind = where(u.tick > 0.5, tick_of(u.tick, own) - own, 0.0)
    x.ahead += where(behind > 0.0, behind, 0.0)
    return now + x.ahead


@inline
def use_newest(due: float, x: States, u: Inputs) -> None:
    """Without a delay, use what came last, whatever its tick."""
    came = u.tick > 0.5
    for j in range(JOINTS):
        x.ul[j] = where(came, u.u_rad_s2[j], x.ul[j])
    x.played = where(came, 1.0, x.played)
    x.ul_tick = due


@inline
def use_due(now: float, due: float, x: States, u: Inputs) -> None:
    """Put what came into the buffer, take the u that is due into ul."""
    missing = 0.0
    for j in range(JOINTS):
        put(x.buffer[j], u.tick, now, u.delay, u.u_rad_s2[j])
        x.ul[j], none = take(x.buffer[j], due, x.ul[j])
        missing += none
    fresh = missing < 0.5
    x.played = where(fresh, 1.0, x.played)
    x.ul_tick = where(fresh | (due < 0.0), due, x.ul_tick)
    x.missed += where(fresh | (due < 0.0), 0.0, 1.0)


@inline
def receive(t: float, dt: float, bare: bool, p: Parameters, x: States, u: Inputs) -> float:
    """Bring xh to this tick (5), write ul and the arm; return the tick.

    `bare`: the law makes a double integrator, which rests under u = 0.
    """
    cycle = floor(t / dt + 0.5)
    begin(cycle, x, u)
    identify(cycle, p, x)
    now = operator_tick(cycle, x, u)
    due = now - u.delay
    if u.delay < 0.5:
        use_newest(due, x, u)
    else:
        use_due(now, due, x, u)
    waiting = x.played < 0.5
    for j in range(JOINTS):
        resting = where(bare, 0.0, -A21 * x.start[j])
        x.ul[j] = where(waiting, resting, x.ul[j])
    arm = x.arm
    arm.m11, arm.m12, arm.m22, arm.vm[0], arm.vm[1] = motion(p, p.m2_kg, u.q_rad, u.rate_rad_s)
    return now


@inline
def inertia_torque(a_1: float, a_2: float, x: States) -> tuple[float, float]:
    """Return Mhat a of both joints."""
    return inertia_times(x.arm.m11, x.arm.m12, x.arm.m22, a_1, a_2)


@inline
def computed_torque(
    a_1: float, a_2: float, p: Parameters, x: States, u: Inputs
) -> tuple[float, float]:
    """Return tau of both joints for the accelerations that are wanted (10)."""
    q, vm = u.q_rad, x.arm.vm
    g_1, g_2 = gravity_torque(q[0], q[1], p.a1_m, p.a2_m, p.m1_kg, p.m2_kg, p.gravity_m_s2)
    tau_1, tau_2 = inertia_torque(a_1, a_2, x)
    return tau_1 + (vm[0] + g_1), tau_2 + (vm[1] + g_2)


@inline
def limited_torque(j: int, wanted: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> float:
    """Write the torque of joint `j`, the brake's once tripped; return what the limits take."""
    before = where(x.trip > 0.5, -p.brake_Nms_rad * u.rate_rad_s[j], wanted)
    y.torque_Nm[j] = clip(before, -p.tau_max_Nm[j], p.tau_max_Nm[j])
    return y.torque_Nm[j] - before


@inline
def send(
    now: float,
    tau_1: float,
    tau_2: float,
    p: Parameters,
    x: States,
    u: Inputs,
    y: Outputs,
) -> None:
    """Write tau within its limits (9), what it leaves to drive (5), and all that is told."""
    heard = where(u.law > UNKNOWN, 1.0, 0.0)
    v = u.rate_rad_s
    fast = (abs(v[0]) > p.speed_limit_rad_s) | (abs(v[1]) > p.speed_limit_rad_s)
    x.trip = where(fast, 1.0, x.trip)
    cut_1 = limited_torque(0, heard * tau_1, p, x, u, y)
    cut_2 = limited_torque(1, heard * tau_2, p, x, u, y)
    lacking_1, lacking_2 = solved(x.arm.m11, x.arm.m12, x.arm.m22, cut_1, cut_2)
    x.driving[0], x.driving[1] = x.ul[0] + lacking_1, x.ul[1] + lacking_2
    y.sample_tick = wire_tick(now)
    y.echo = where(u.law > UNKNOWN, wire_tick(x.ul_tick), 0.0)
    y.held_u, y.tripped = x.missed, x.trip
    for j in range(JOINTS):
        y.ul_rad_s2[j], y.network_rad_s2[j] = x.ul[j], x.learned[j]
        y.model_rad[j], y.model_rate_rad_s[j] = x.xh.q[j], x.xh.v[j]


def prepare(settings: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
    """Return the gains, Ad, Bd and V (5, 20) uniform in +-1, drawn row by row."""
    own = {one.name: settings[one.name] for one in Gains.ports}
    v = first_layer(settings["network_seed"], NET_INPUTS, NODES)
    return Prepared({**own, **sampled(1.0 / rate_hz), "v": v})
