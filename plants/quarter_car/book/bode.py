"""The linear quarter car from road to body acceleration: no friction, no stops, no liquid strut.

    zs'' = F/ms,  x3' = zs' - zu',  zu'' = (-F + Kt (zr - zs + x3))/mu                       (1)
    xb' = wb (v3 - xb),  xk' = wk (x3 - xk),  v3 = x3'                                       (2)

    passive      F = -Bs v3 - Ks x3                                                          (3)
    filtered     F = -Bs xb - Ks (x3 - xk)                                                   (4)
    full         F = (4) - Bsky zs' - Krh x3                                                 (5)

At w0 = sqrt(Kt/mu) no F whatsoever changes the response: summing (1), ms zs'' + mu zu'' =
Kt (zr - zu), and with zu'' = -w0^2 zu there the wheel drops out: zs'' = Kt zr/ms.           (6)

dB re 1 m/s2 per m of road. Source: Lewis, Campos, Selmic (SIAM 2002), chapter 6, figure 6.3.2.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
LAWS = ("passive", "filtered", "full")


def system(law: str, car: Mapping[str, float], gains: Mapping[str, float]) -> tuple[Vector, ...]:
    """Return A (6, 6), B (6,) and the row of zs'' for states zs, zs', x3, zu', xb, xk."""
    ms, mu, kt = car["ms_kg"], car["mu_kg"], car["kt_N_m"]
    bs, ks = gains["bs_Ns_m"], gains["ks_N_m"]
    wb, wk = gains["wb_rad_s"], gains["wk_rad_s"]
    if law == "passive":
        force = np.array([0.0, -bs, -ks, bs, 0.0, 0.0])  # (3)
    else:
        force = np.array([0.0, 0.0, -ks, 0.0, -bs, ks])  # (4)
    if law == "full":
        force += np.array([0.0, -gains["bsky_Ns_m"], -gains["krh_N_m"], 0.0, 0.0, 0.0])  # (5)
    tyre = np.array([-kt, 0.0, kt, 0.0, 0.0, 0.0])
    a = np.array([
        [0.0, 1.0, 0.0, 0.0, 0.0, 0.0],
        force / ms,
        [0.0, 1.0, 0.0, -1.0, 0.0, 0.0],
        (tyre - force) / mu,
        [0.0, wb, 0.0, -wb, -wb, 0.0],
        [0.0, 0.0, wk, 0.0, 0.0, -wk],
    ])  # fmt: skip
    return a, np.array([0.0, 0.0, 0.0, kt / mu, 0.0, 0.0]), force / ms


def response_db(
    law: str, w_rad_s: Vector, car: Mapping[str, float], gains: Mapping[str, float]
) -> Vector:
    """Return the gain from zr to zs'' at each frequency, dB. Both (n,)."""
    a, b, row = system(law, car, gains)
    found = [abs(row @ np.linalg.solve(1j * w * np.eye(6) - a, b)) for w in w_rad_s]
    return 20.0 * np.log10(np.array(found))


def peak(
    law: str, low: float, high: float, car: Mapping[str, float], gains: Mapping[str, float]
) -> tuple[float, float]:
    """Return frequency (rad/s) and height (dB) of the highest point between two frequencies."""
    w = np.linspace(low, high, 2001)
    gain = response_db(law, w, car, gains)
    return float(w[gain.argmax()]), float(gain.max())
