"""CMAC: triangles or cubic B-splines on a uniform grid, evaluated by index.

    q = (x - low)/d, limited to the grid;  i = floor(q), f = q - i                              (1)
    order 2   nodes i, i+1:      1 - f,  f                        triangles                     (2)
    order 4   nodes i .. i+3:    (1-f)^3/6,  (3 f^3 - 6 f^2 + 4)/6,
                                 (-3 f^3 + 3 f^2 + 3 f + 1)/6,  f^3/6                           (3)
    node of several inputs: the product over the axes, first input slowest                      (4)
    y = sum of phi_j W_j over the 2^n (or 4^n) nodes touched, tuned only there                  (5)

On an axis from low to high, n_k nodes of order 2 have d = (high - low)/(n_k - 1) and are triangles
max(0, 1 - |x - c_j|/d); of order 4 they have d = (high - low)/(n_k - 3), the outermost centres one
d outside. Beyond the grid everything keeps its edge value (one-sided edges). All phi >= 0, sum 1.
A NaN input gives NaN values at safe indices.

The general receptive field on knots t, of which (2) and (3) are uniform cases:

    B_j,1 = 1 if t_j <= x < t_j+1, else 0                                                       (6)
    B_j,o = (x - t_j)/(t_j+o-1 - t_j) B_j,o-1 + (t_j+o - x)/(t_j+o - t_j+1) B_j+1,o-1           (7)

x, low, d and t in the units of the input. Source: Lewis, Campos, Selmic (SIAM 2002), chapter 1.
"""

from pcpc.drivers.compiled.jit import inline
from pcpc.drivers.compiled.views import Array
from pcpc.executive.laws.emath import clip, floor, where


@inline
def _cell(x: float, low: float, d: float, cells: int) -> tuple[int, float]:
    """Return i and f (1); i is in 0..cells - 1 even for NaN, f in 0..1 or NaN."""
    q = clip((x - low) / d, 0.0, 1.0 * cells)
    whole = clip(floor(q), 0.0, cells - 1.0)
    return int(where(whole >= 0.0, whole, 0.0)), q - whole


@inline
def axis(order: int, x: float, low: float, d: float, count: int, out: Array, at: int) -> int:
    """Write the `order` values of (2) or (3) to out[at..]; return the first node's index.

    `out`: (at + order,) or longer.
    """
    if order == 2:
        i, f = _cell(x, low, d, count - 1)
        out[at], out[at + 1] = 1.0 - f, f
        return i
    i, f = _cell(x, low, d, count - 3)
    g, f2 = 1.0 - f, f * f
    f3 = f2 * f
    out[at] = g * g * g / 6.0
    out[at + 1] = (3.0 * f3 - 6.0 * f2 + 4.0) / 6.0
    out[at + 2] = (3.0 * (f2 - f3) + 3.0 * f + 1.0) / 6.0
    out[at + 3] = f3 / 6.0
    return i


@inline
def touched(
    order: int,
    x: Array,
    low: Array,
    d: Array,
    counts: Array,
    index: Array,
    value: Array,
    work: Array,
) -> int:
    """Write index and value of the nodes touched (4); return how many, order^n.

    `x`, `low`, `d`, `counts` (n,), `index`, `value` (order^n,) float64, `work` (order,).
    """
    index[0], value[0] = 0.0, 1.0
    size = 1
    for k in range(len(x)):
        first = axis(order, x[k], low[k], d[k], int(counts[k]), work, 0)
        for j in range(size - 1, -1, -1):  # backwards: the lists grow in place
            at, factor = index[j] * counts[k] + first, value[j]
            for i in range(order):
                index[j * order + i] = at + i
                value[j * order + i] = factor * work[i]
        size *= order
    return size


@inline
def output(index: Array, value: Array, size: int, w: Array, y: Array) -> None:
    """Write y (5) from the `size` nodes touched: `w` (nodes, m), `y` (m,).

    `index`, `value`: (size,).
    """
    for i in range(len(y)):
        total = 0.0
        for j in range(size):
            total += w[int(index[j]), i] * value[j]
        y[i] = total


@inline
def tune(gain: float, index: Array, value: Array, size: int, e: Array, w: Array) -> None:
    """W <- W + gain phi E' in place, only the rows touched (5).

    `index`, `value` (size,), `e` (m,), `w` (nodes, m).
    """
    for j in range(size):
        for i in range(len(e)):
            w[int(index[j]), i] += gain * value[j] * e[i]


@inline
def recursion(order: int, x: float, t: Array, b: Array) -> None:
    """Write all B_j,order (6) (7), j = 0..knots - order - 1, to `b` (knots - 1,).

    `t`: (knots,), rising.
    """
    knots = len(t)
    for j in range(knots - 1):
        b[j] = where((t[j] <= x) & (x < t[j + 1]), 1.0, 0.0)
    for o in range(2, order + 1):
        for j in range(knots - o):
            left = (x - t[j]) / (t[j + o - 1] - t[j]) * b[j]
            b[j] = left + (t[j + o] - x) / (t[j + o] - t[j + 1]) * b[j + 1]
