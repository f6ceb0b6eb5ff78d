"""Every family of approximators in one compiled step, as a law would call them."""

import hashlib
from typing import Any

import numpy as np

from pcpc.executive.laws.approximators import activations
from pcpc.executive.laws.block import Ports, inline, port, stage
from pcpc.tools.study.book.approximators import backprop, cmac, fuzzy, jumps, rbf


class Fixed(Ports):
    """Numbers that stay."""

    v = port("", "first layer of backprop", shape=(3, 4))
    w = port("", "its output weights", shape=(5, 2))
    low = port("", "of grids", shape=2)
    spacing = port("", "of grids", shape=2)
    counts = port("", "of grids and sets", shape=2)
    nodes = port("", "output weights of a grid", shape=(20, 1))
    means = port("", "of scattered nodes", shape=(2, 2))
    precisions = port("", "of scattered nodes", shape=(2, 2, 2))
    a = port("", "widths of sets", shape=9)
    b = port("", "centres of sets", shape=9)
    rules = port("", "sets of rules", shape=(4, 2))
    c = port("", "a column of W", shape=4)


class Scratch(Ports):
    """Weights that are tuned, and room."""

    v = port("", "first layer", shape=(3, 4))
    w = port("", "output weights", shape=(5, 2))
    z = port("", "inputs of nodes", shape=4)
    s = port("", "threshold and nodes", shape=5)
    slope = port("", "slopes of nodes", shape=4)
    back = port("", "error of nodes", shape=4)
    factors = port("", "of a grid", shape=9)
    phi = port("", "nodes of a grid", shape=20)
    index = port("", "nodes touched", shape=16)
    value = port("", "of nodes touched", shape=16)
    work = port("", "values of an axis", shape=4)
    tuned = port("", "output weights of a grid", shape=(20, 2))
    scattered = port("", "scattered nodes", shape=2)
    member = port("", "memberships", shape=9)
    fired = port("", "rules", shape=4)
    da = port("", "slopes by widths", shape=9)
    db = port("", "slopes by centres", shape=9)


class Point(Ports):
    """Where."""

    x = port("", "inputs of all families", shape=2)


class Found(Ports):
    """What the families answer."""

    nets = port("", "two-layer networks", shape=(5, 2))
    gaussians = port("", "on a grid, scattered", shape=2)
    grids = port("", "order 2, 4", shape=(2, 1))
    fuzzy = port("", "triangles, Gaussians", shape=2)
    jumps = port("", "of every basis", shape=(3, 3))
    v = port("", "tuned", shape=(3, 4))
    w = port("", "tuned", shape=(5, 2))


@inline
def networks(p: Any, x: Any, u: Any, y: Any) -> None:
    """Call backprop.py, every activation."""
    backprop.hidden(activations.LOGISTIC, u.x, p.v, x.z, x.s, x.slope)
    backprop.output(x.s, p.w, y.nets[0])
    backprop.hidden(activations.TANH, u.x, p.v, x.z, x.s, x.slope)
    backprop.output(x.s, p.w, y.nets[1])
    backprop.hidden(activations.SYMMETRIC, u.x, p.v, x.z, x.s, x.slope)
    backprop.output(x.s, p.w, y.nets[2])
    backprop.hidden(activations.GAUSSIAN, u.x, p.v, x.z, x.s, x.slope)
    backprop.output(x.s, p.w, y.nets[3])
    backprop.hidden(activations.HARD_LIMIT, u.x, p.v, x.z, x.s, x.slope)
    backprop.output(x.s, p.w, y.nets[4])
    backprop.hidden(activations.LOGISTIC, u.x, x.v, x.z, x.s, x.slope)
    backprop.tune(0.1, 0.2, u.x, u.x, x.s, x.slope, x.back, x.w, x.v)
    backprop.tune_hebbian(0.1, 0.2, 0.3, 9.0, u.x, u.x, x.s, x.w, x.v)


@inline
def grids(p: Any, x: Any, u: Any, y: Any) -> None:
    """Call rbf.py and cmac.py."""
    rbf.grid(u.x, p.low, p.spacing, p.counts, x.factors, x.phi)
    y.gaussians[0] = x.phi[3] + x.phi[7]
    rbf.scattered(u.x, p.means, p.precisions, x.scattered)
    y.gaussians[1] = x.scattered[0] + x.scattered[1]
    size = cmac.touched(2, u.x, p.low, p.spacing, p.counts, x.index, x.value, x.work)
    cmac.output(x.index, x.value, size, p.nodes, y.grids[0])
    cmac.tune(0.1, x.index, x.value, size, u.x, x.tuned)
    size = cmac.touched(4, u.x, p.low, p.spacing, p.counts, x.index, x.value, x.work)
    cmac.output(x.index, x.value, size, p.nodes, y.grids[1])


@stage
def everything(t: float, dt: float, p: Fixed, x: Scratch, u: Point, y: Found) -> None:
    """Call every family as a law does."""
    networks(p, x, u, y)
    grids(p, x, u, y)
    fuzzy.triangles(u.x, p.counts, p.b, x.member)
    fuzzy.by_product(x.member, p.rules, x.fired)
    y.fuzzy[0] = x.fired[0] + 2.0 * x.fired[3]
    fuzzy.by_logarithm(u.x, p.rules, p.a, p.b, x.fired)
    fuzzy.slopes(u.x, p.rules, p.a, p.b, x.fired, p.c, 0.3, x.da, x.db)
    fuzzy.clamp(x.da, 0.1, 0.5)
    y.fuzzy[1] = x.da[1] + x.db[6]
    jumps.jump_nodes(jumps.POLYNOMIAL, u.x[0], 3, y.jumps[0], 0)
    jumps.jump_nodes(jumps.SIGMOID, u.x[0], 3, y.jumps[1], 0)
    jumps.jump_nodes(jumps.TANH, u.x[0], 3, y.jumps[2], 0)
    for j in range(len(x.v)):
        for i in range(len(x.z)):
            y.v[j, i] = x.v[j, i]
    for j in range(len(x.w)):
        y.w[j, 0], y.w[j, 1] = x.w[j, 0], x.w[j, 1]


def digest() -> str:
    """Return a digest of `everything` at many points, its weights tuned on the way."""
    draw = np.random.default_rng(3)
    p = Fixed(draw.uniform(0.2, 1.2, Fixed.size))
    p.low[:], p.spacing[:], p.counts[:] = -1.0, (0.5, 0.4), (5.0, 4.0)
    p.b[:] = (-1.0, -0.5, 0.1, 0.4, 1.0, -1.0, -0.2, 0.5, 1.0)
    p.rules[:] = ((0, 5), (1, 6), (3, 7), (2, 8))
    x, y, found = np.zeros(Scratch.size), np.zeros(Found.size), hashlib.sha256()
    for u in draw.normal(size=(300, 2)):
        everything(0.0, 1e-3, p.values(), x, u, y)
        found.update(y.tobytes())
        found.update(Scratch(x).tuned.tobytes())
    assert np.isfinite(y).all() and Scratch(x).tuned.any()
    return found.hexdigest()
