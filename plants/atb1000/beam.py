"""Modal data of a uniform tube, clamped at x = 0, with a point mass m_t at its free end x = L.

    A = pi/4 (do^2 - di^2)   I = pi/64 (do^4 - di^4)   m_b = rho A L   mu = m_t/m_b

    1 + cos b cosh b + mu b (cos b sinh b - sin b cosh b) = 0           frequency equation      (1)
    omega = (b/L)^2 sqrt(E I/(rho A))                                                           (2)
    f = cosh y - cos y - k (sinh y - sin y)                             y = b x/L               (3)
        k = (cosh b + cos b)/(sinh b + sin b)
    int rhoA f^2 dx + m_t f(L)^2 = 1, f(L) > 0                          normalisation           (4)
    m = int rhoA x f dx + m_t L f(L)                                    hub coupling            (5)
    gamma = int rhoA f dx + m_t f(L)                                    gravity                 (6)
    S_ij = int f_i' f_j' [rhoA (L^2 - x^2)/2 + m_t L] dx,  C = I - S    centrifugal stiffening  (7)

SI units; q is mass-normalised, sqrt(kg) m. Keep both halves of C or neither: I alone would soften
the turning beam. (1) is solved divided by cosh b, which keeps it of order 1. Everything here runs
at set-up, not in the step. Source: Euler-Bernoulli theory of a cantilever with a tip mass.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from numpy.typing import NDArray

GRAVITY_M_S2 = 9.81
_QUADRATURE_POINTS = 80  # exact to rounding for the first three modes
_SCAN_STEP = 0.05  # roots of (1) lie about pi apart
_BISECTIONS = 60  # 0.05 / 2^60 is below the spacing of doubles at the roots

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Tube:
    """The barrel as drawn: lengths in m, `young_Pa`, `density_kg_m3`, tip mass in kg."""

    length_m: float
    outer_m: float
    inner_m: float
    young_Pa: float
    density_kg_m3: float
    tip_mass_kg: float

    @property
    def line_mass_kg_m(self) -> float:
        """Mass per length, rho A."""
        return self.density_kg_m3 * np.pi / 4.0 * (self.outer_m**2 - self.inner_m**2)

    @property
    def stiffness_Nm2(self) -> float:
        """Bending stiffness E I."""
        return self.young_Pa * np.pi / 64.0 * (self.outer_m**4 - self.inner_m**4)


@dataclass(frozen=True)
class Beam:
    """What the equations of motion need; vectors (n,) by mode, `centrifugal` (n, n) is C of (7).

    `tip`, `slope`: f(L), f'(L); `root`: f''(0) (strain at the clamp is (do/2) root'q);
    `inertia_kg_m2`: of the straight beam with its tip mass about the clamp.
    """

    roots: Vector
    omega_rad_s: Vector
    coupling: Vector
    gravity: Vector
    tip: Vector
    slope: Vector
    root: Vector
    centrifugal: NDArray[np.float64]
    mass_kg: float
    inertia_kg_m2: float

    def static_sag(self) -> Vector:
        """Modal deflections (modes,) of the horizontal barrel at rest under gravity."""
        sag: Vector = -GRAVITY_M_S2 * self.gravity / self.omega_rad_s**2
        return sag

    def horizontal_droop_rad(self) -> float:
        """Muzzle slope of the horizontal barrel at rest; at elevation q it is this times cos q."""
        return float(self.slope @ self.static_sag())


def frequency_roots(mass_ratio: float, count: int) -> Vector:
    """Return the first `count` roots b of (1), ascending; `mass_ratio` is mu >= 0.

    Raises ValueError if mu is negative or not finite. Shape (count,).
    """
    if not 0.0 <= mass_ratio < np.inf:
        raise ValueError(f"mass ratio of tip and tube is {mass_ratio}; expected a number >= 0")

    def scaled_characteristic(b: float) -> float:
        return float(
            1.0 / np.cosh(b) + np.cos(b) + mass_ratio * b * (np.cos(b) * np.tanh(b) - np.sin(b))
        )

    roots: list[float] = []
    low = _SCAN_STEP
    while len(roots) < count:
        high = low + _SCAN_STEP
        if scaled_characteristic(low) * scaled_characteristic(high) <= 0.0:
            roots.append(_bisect(scaled_characteristic, low, high))
        low = high
    return np.array(roots)


def _bisect(function: Callable[[float], float], low: float, high: float) -> float:
    rising = function(low) < 0.0
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        if (function(middle) < 0.0) == rising:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


def mode_shapes(roots: Vector, length_m: float, x_m: Vector) -> tuple[Vector, Vector, Vector]:
    """Return f, f', f'' of (3), not normalised, each (modes, points), at `x_m` (points,).

    `roots`: (modes,).
    """
    b = roots[:, np.newaxis]
    y = b * x_m / length_m
    k = (np.cosh(b) + np.cos(b)) / (np.sinh(b) + np.sin(b))
    f = np.cosh(y) - np.cos(y) - k * (np.sinh(y) - np.sin(y))
    df = (b / length_m) * (np.sinh(y) + np.sin(y) - k * (np.cosh(y) - np.cos(y)))
    ddf = (b / length_m) ** 2 * (np.cosh(y) + np.cos(y) - k * (np.sinh(y) + np.sin(y)))
    return f, df, ddf


@cache
def _quadrature() -> tuple[Vector, Vector]:
    """Return nodes and weights on -1..1; not to be written."""
    nodes, weights = np.polynomial.legendre.leggauss(_QUADRATURE_POINTS)
    return nodes, weights


@lru_cache(maxsize=256)  # thousands of runs of a campaign have the same tube, or one of a few
def modal_data(tube: Tube, modes: int = 3) -> Beam:
    """Return the modal data of `tube` for its first `modes` bending modes; not to be written."""
    length, line_mass, tip_mass = tube.length_m, tube.line_mass_kg_m, tube.tip_mass_kg
    mass = line_mass * length
    roots = frequency_roots(tip_mass / mass, modes)
    nodes, weights = _quadrature()
    x = 0.5 * length * (nodes + 1.0)
    dm = 0.5 * length * weights * line_mass
    f, df, _ = mode_shapes(roots, length, x)
    f_end, df_end, _ = mode_shapes(roots, length, np.array([length]))
    _, _, ddf_root = mode_shapes(roots, length, np.array([0.0]))
    scale = np.sign(f_end[:, 0]) / np.sqrt(f**2 @ dm + tip_mass * f_end[:, 0] ** 2)  # (4)
    f, df = f * scale[:, np.newaxis], df * scale[:, np.newaxis]
    tip = f_end[:, 0] * scale
    tension = 0.5 * (length**2 - x**2) * dm + tip_mass * length * dm / line_mass  # of (7), times dx
    return Beam(
        roots=roots,
        omega_rad_s=(roots / length) ** 2 * np.sqrt(tube.stiffness_Nm2 / line_mass),  # (2)
        coupling=f @ (x * dm) + tip_mass * length * tip,  # (5)
        gravity=f @ dm + tip_mass * tip,  # (6)
        tip=tip,
        slope=df_end[:, 0] * scale,
        root=ddf_root[:, 0] * scale,
        centrifugal=np.eye(modes) - (df * tension) @ df.T,
        mass_kg=mass,
        inertia_kg_m2=mass * length**2 / 3.0 + tip_mass * length**2,
    )
