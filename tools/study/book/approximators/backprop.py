"""Two-layer neural network with thresholds, n inputs, L hidden nodes, m outputs, and its tuning.

    z  = V'[1; x]                  (L)      V (n+1, L), row 0: thresholds of the hidden layer   (1)
    s  = [1; sigma(z)]             (L+1)    sigma of activations.py                             (2)
    y  = W's                       (m)      W (L+1, m), row 0: thresholds of the output         (3)
    E  = y_d - y                   (m)      error that drives the tuning                        (4)

    backpropagation, discrete      W <- W + F s E'        V <- V + G [1; x] (s''W E)'           (5)
    backpropagation, continuous    dW/dt = F s E'         dV/dt = G [1; x] (s''W E)'            (6)
    Hebbian, continuous            dW/dt = F s E'
                                   dV/dt = G ([1; x] sigma(z)' - leak V),  |V|_F <= limit       (7)

s'' is the transpose of the hidden Jacobian s' = [0; diag sigma'(z)]. All right sides use the old W
and V. F and G are scalars times identity here. (6) sampled with Euler's step T is (5) with F T and
G T. With F = G = eta, (5) is -eta times the gradient of |E|^2/2.

Hebbian tuning does not see the error in its first layer and without leak and limit |V| grows
without bound; the book itself says that its performance is hard to guarantee. Nothing here uses it
unless asked to.

`x` (n,), `v` (n+1, L), `z`, `slope` (L,), `s` (L+1,), `w` (L+1, m), `e`, `y` (m,): arrays or ports.
No units but those of E and W. Source: Lewis, Campos, Selmic (SIAM 2002), chapter 1.
"""

from pcpc.drivers.compiled.jit import inline
from pcpc.drivers.compiled.views import Array
from pcpc.executive.laws.approximators.activations import activate
from pcpc.executive.laws.emath import sqrt, where


@inline
def hidden(kind: int, x: Array, v: Array, z: Array, s: Array, slope: Array) -> None:
    """Write z (1), s (2) and sigma'(z): `z`, `slope` (L,), `s` (L+1,); `x` (n,), `v` (n+1, L)."""
    nodes = len(z)
    for j in range(nodes):
        z[j] = v[0, j]
    for i in range(len(x)):
        for j in range(nodes):
            z[j] += v[i + 1, j] * x[i]
    s[0] = 1.0
    for j in range(nodes):
        s[j + 1], slope[j] = activate(kind, z[j])


@inline
def output(s: Array, w: Array, y: Array) -> None:
    """Write y = W's (3); for every net linear in W, of any number of nodes.

    `s` (nodes,), `w` (nodes, m), `y` (m,).
    """
    for i in range(len(y)):
        total = 0.0
        for j in range(len(w)):
            total += w[j, i] * s[j]
        y[i] = total


@inline
def tune_output(gain: float, s: Array, e: Array, w: Array) -> None:
    """W <- W + gain s E' in place, as in (5); for every net linear in W.

    `s` (nodes,), `e` (m,), `w` (nodes, m).
    """
    for j in range(len(w)):
        for i in range(len(e)):
            w[j, i] += gain * s[j] * e[i]


@inline
def back(slope: Array, w: Array, e: Array, b: Array) -> None:
    """Write b = s''W E (L,), the error as the hidden layer sees it; call it before `w` is tuned.

    `slope` (L,), `w` (L+1, m), `e` (m,).
    """
    for j in range(len(b)):
        total = 0.0
        for i in range(len(e)):
            total += w[j + 1, i] * e[i]
        b[j] = slope[j] * total


@inline
def tune_first(gain: float, x: Array, b: Array, v: Array) -> None:
    """V <- V + gain [1; x] b' in place, as in (5): `x` (n,), `b` (L,), `v` (n+1, L)."""
    for j in range(len(b)):
        v[0, j] += gain * b[j]
    for i in range(len(x)):
        for j in range(len(b)):
            v[i + 1, j] += gain * x[i] * b[j]


@inline
def tune(
    f: float, g: float, e: Array, x: Array, s: Array, slope: Array, b: Array, w: Array, v: Array
) -> None:
    """One step of (5) in place after `hidden`; for (6) give f T and g T. `b` (L,) is scratch.

    `e` (m,), `x` (n,), `s` (L+1,), `slope` (L,), `w` (L+1, m), `v` (n+1, L).
    """
    back(slope, w, e, b)
    tune_output(f, s, e, w)
    tune_first(g, x, b, v)


@inline
def tune_hebbian(
    f: float, g: float, leak: float, limit: float, e: Array, x: Array, s: Array, w: Array, v: Array
) -> None:
    """One Euler step of (7) in place after `hidden`; `f`, `g` hold the step size already.

    `leak` >= 0 with g leak < 1; `limit` of |V|_F, infinite for none. `e` (m,), `x` (n,), `s`
    (L+1,), `w` (L+1, m), `v` (n+1, L).
    """
    kept = 1.0 - g * leak
    nodes = len(w) - 1
    square = 0.0
    for i in range(len(v)):
        xi = 1.0 if i == 0 else x[i - 1]
        for j in range(nodes):
            v[i, j] = kept * v[i, j] + g * xi * s[j + 1]
            square += v[i, j] * v[i, j]
    norm = sqrt(square)
    scale = where(norm > limit, limit / norm, 1.0)
    for i in range(len(v)):
        for j in range(nodes):
            v[i, j] *= scale
    tune_output(f, s, e, w)
