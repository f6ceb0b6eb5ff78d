"""Discrete linear design in portable arithmetic: sampling, Riccati equation, optimal gains.

    A = exp(F T),  B = integral of exp(F s) ds G over 0..T        held input              (1)
    X = A'X A - A'X B (R + B'X B)^-1 B'X A + Q                     Riccati equation        (2)
    K = (R + B'X B)^-1 B'X A                                       u = -K x                (3)
    L = X C'(C X C' + N)^-1   with (2) of A', C', N                x += L (y - C x)        (4)

(2) by structured doubling: A_0 = A, G_0 = B R^-1 B', H_0 = Q,
    W = I + G H,  A <- A W^-1 A,  G <- G + A W^-1 G A',  H <- H + A'H W^-1 A               (5)
whose H goes to X, with the square of the error in each pass. (A, B) must be stabilisable and (A,
sqrt Q) detectable.

For use in `prepare`: + - * / only, so that the gains have the same bits on every machine. Matrices
are lists of rows of floats. Source: Anderson, Moore, Optimal Control: Linear Quadratic Methods
(1990); doubling: Chu, Fan, Lin, Wang, Structure-preserving algorithms for periodic discrete-time
algebraic Riccati equations, Int. J. Control 77 (2004), 767-788.
"""

from collections.abc import Sequence

Matrix = list[list[float]]
PASSES, CLOSE, LARGEST = 60, 1e-15, 1e200


def eye(n: int) -> Matrix:
    """Return the unit matrix. Shape (n, n)."""
    return [[1.0 if i == j else 0.0 for j in range(n)] for i in range(n)]


def diagonal(entries: Sequence[float]) -> Matrix:
    """Return a matrix with these on its diagonal. Shape (n, n)."""
    return [[one if i == j else 0.0 for j in range(len(entries))] for i, one in enumerate(entries)]


def transpose(a: Matrix) -> Matrix:
    """Return the transpose. Shape (m, n) of an (n, m)."""
    return [list(column) for column in zip(*a, strict=True)]


def plus(a: Matrix, b: Matrix) -> Matrix:
    """Return a + b. All (n, m)."""
    return [[x + y for x, y in zip(p, q, strict=True)] for p, q in zip(a, b, strict=True)]


def times(*factors: Matrix) -> Matrix:
    """Return the product, from the left, each entry summed in the order of its terms.

    Shape (n, m).
    """
    product = factors[0]
    for b in factors[1:]:
        product = [
            [_dot(row, [other[j] for other in b]) for j in range(len(b[0]))] for row in product
        ]
    return product


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    total = 0.0
    for x, y in zip(a, b, strict=True):
        total += x * y
    return total


def solution(a: Matrix, b: Matrix) -> Matrix:
    """Return a^-1 b by elimination with the largest pivot. ValueError: `a` is singular.

    `a` is (n, n), `b` (n, m).
    """
    n = len(a)
    rows = [[*p, *q] for p, q in zip(a, b, strict=True)]
    for k in range(n):
        best = max(range(k, n), key=lambda i: abs(rows[i][k]))
        rows[k], rows[best] = rows[best], rows[k]
        if not abs(rows[k][k]) > 0.0:
            raise ValueError("a matrix of the design is singular; change weights or model")
        rows[k] = [value / rows[k][k] for value in rows[k]]
        for i in range(n):
            if i != k and rows[i][k] != 0.0:
                factor = rows[i][k]
                rows[i] = [x - factor * y for x, y in zip(rows[i], rows[k], strict=True)]
    return [row[n:] for row in rows]


def sampled_system(f: Matrix, g: Matrix, period_s: float) -> tuple[Matrix, Matrix]:
    """Return A (n, n) and B (n, m) of (1) for x' = F x + G u."""
    n, m = len(f), len(g[0])
    both = [[*p, *q] for p, q in zip(f, g, strict=True)] + [[0.0] * (n + m) for _ in range(m)]
    scale, halvings = period_s, 0
    while max(sum(abs(v) for v in row) for row in both) * scale > 0.25:
        scale, halvings = 0.5 * scale, halvings + 1
    small = [[scale * value for value in row] for row in both]
    term = total = eye(n + m)
    for k in range(1, 16):
        term = [[value / k for value in row] for row in times(term, small)]
        total = plus(total, term)
    for _ in range(halvings):
        total = times(total, total)
    return [row[:n] for row in total[:n]], [row[n:] for row in total[:n]]


def riccati(a: Matrix, b: Matrix, q: Matrix, r: Matrix) -> Matrix:
    """Return X of (2). ValueError if the doubling (5) does not settle. All (n, n)."""
    g, h = times(b, solution(r, transpose(b))), q
    for _ in range(PASSES):
        w = plus(eye(len(a)), times(g, h))
        wa, wg = solution(w, a), solution(w, g)
        a, g, grown = times(a, wa), plus(g, times(a, wg, transpose(a))), times(transpose(a), h, wa)
        h = plus(h, grown)
        largest = max(abs(value) for row in h for value in row)
        if not largest < LARGEST:
            break
        if max(abs(value) for row in grown for value in row) <= CLOSE * largest:
            return [
                [0.5 * (x + y) for x, y in zip(*rows, strict=True)]
                for rows in zip(h, transpose(h), strict=True)
            ]
    raise ValueError("the Riccati equation has no stabilising solution; change the weights")


def regulator(a: Matrix, b: Matrix, q: Matrix, r: Matrix) -> Matrix:
    """Return K (m, n) of (3)."""
    x = riccati(a, b, q, r)
    bx = times(transpose(b), x)
    return solution(plus(r, times(bx, b)), times(bx, a))


def filter_gain(a: Matrix, c: Matrix, q: Matrix, n: Matrix) -> Matrix:
    """Return L (n, p) of (4): for the measured state, before the step to the next sample."""
    x = riccati(transpose(a), transpose(c), q, n)
    cx = times(c, x)
    return transpose(solution(plus(n, times(cx, transpose(c))), cx))
