"""Modal data of the tube with a tip mass: the printed table, and the identities behind it."""

import numpy as np
import pytest

from pcpc.plants.atb1000.beam import Tube, frequency_roots, modal_data, mode_shapes

BARREL = Tube(1.20, 0.020, 0.014, 205e9, 7850.0, 0.15)
TABLE = {
    "roots": [1.723509, 4.400653, 7.452300],
    "omega_rad_s": [64.338325, 419.446917, 1202.883137],
    "coupling": [0.956187, -0.149052, 0.052368],
    "gravity": [1.016366, -0.555634, 0.325016],
    "tip": [1.385683, 1.053170, 0.849264],
    "slope": [1.631729, 5.695965, 9.168853],
    "root": [3.235057, -21.433401, 61.931083],
}
TABLE_C = np.array(
    [
        [-0.193844, -0.726034, 0.805915],
        [-0.726034, -5.979158, -0.153675],
        [0.805915, -0.153675, -19.259818],
    ]
)
LAST_DIGIT = 0.51e-6  # half a unit of the last printed digit


@pytest.mark.parametrize("name", TABLE)
def test_nominal_barrel_has_the_tabulated_modal_data(name: str) -> None:
    error = np.max(np.abs(getattr(modal_data(BARREL), name) - TABLE[name]))
    assert error < LAST_DIGIT, f"{name} is off by {error:.2e}"


def test_nominal_barrel_has_the_tabulated_integrals() -> None:
    beam = modal_data(BARREL)
    error = np.max(np.abs(beam.centrifugal - TABLE_C))
    assert error < LAST_DIGIT, f"C is off by {error:.2e}"
    assert beam.mass_kg == pytest.approx(1.509284, abs=LAST_DIGIT)
    assert beam.inertia_kg_m2 == pytest.approx(0.940456, abs=LAST_DIGIT)
    assert BARREL.stiffness_Nm2 == pytest.approx(1223.489, abs=0.51e-3)
    assert beam.horizontal_droop_rad() == pytest.approx(-3.77e-3, abs=0.005e-3)


def test_without_tip_mass_the_roots_are_those_of_the_clamped_free_beam() -> None:
    closed_form = np.array([1.87510406871196, 4.69409113297417, 7.85475743823761])
    error = np.max(np.abs(frequency_roots(0.0, 3) - closed_form))
    assert error < 1e-13, f"off by {error:.1e}"


def test_a_heavy_tip_turns_the_first_mode_into_a_mass_on_a_spring() -> None:
    heavy = Tube(1.20, 0.020, 0.014, 205e9, 7850.0, 1500.0)
    spring_N_m = 3.0 * heavy.stiffness_Nm2 / heavy.length_m**3
    omega = modal_data(heavy).omega_rad_s[0]
    ratio = omega / np.sqrt(spring_N_m / heavy.tip_mass_kg)
    assert 0.9997 < ratio < 1.0, f"ratio {ratio:.6f}; the tube's own mass can only lower it"


@pytest.mark.parametrize("mass_ratio", [0.0, 0.1, 1.0, 30.0])
def test_roots_solve_the_frequency_equation_and_none_is_skipped(mass_ratio: float) -> None:
    b = frequency_roots(mass_ratio, 5)
    c, s, ch, sh = np.cos(b), np.sin(b), np.cosh(b), np.sinh(b)
    residual = np.max(np.abs(1 + c * ch + mass_ratio * b * (c * sh - s * ch)) / ch)
    assert residual < 1e-11, f"residual {residual:.1e}"
    gaps = np.diff(b)
    assert np.all((gaps > 2.2) & (gaps < 4.0)), f"gaps {gaps}"


def test_modes_are_orthonormal_in_mass_and_give_omega_squared_in_strain_energy() -> None:
    beam = modal_data(BARREL)
    x = np.linspace(0.0, BARREL.length_m, 20_001)  # another quadrature than the module's
    f, _, ddf = mode_shapes(beam.roots, BARREL.length_m, x)
    scale = (beam.tip / f[:, -1])[:, np.newaxis]
    f, ddf = f * scale, ddf * scale
    mass = np.trapezoid(f[:, None] * f[None, :] * BARREL.line_mass_kg_m, x)
    mass += BARREL.tip_mass_kg * np.outer(beam.tip, beam.tip)
    strain = np.trapezoid(ddf[:, None] * ddf[None, :] * BARREL.stiffness_Nm2, x)
    assert np.max(np.abs(mass - np.eye(3))) < 1e-6, f"mass matrix {mass}"
    relative = strain / np.outer(beam.omega_rad_s, beam.omega_rad_s) - np.eye(3)
    assert np.max(np.abs(relative)) < 1e-6, f"stiffness matrix {relative}"


def test_free_end_carries_no_moment_and_the_clamp_does_not_give() -> None:
    beam = modal_data(BARREL)
    ends = np.array([0.0, BARREL.length_m])
    f, df, ddf = mode_shapes(beam.roots, BARREL.length_m, ends)
    assert np.all(f[:, 0] == 0.0) and np.all(df[:, 0] == 0.0)
    moment = np.max(np.abs(ddf[:, 1] / ddf[:, 0]))
    assert moment < 1e-11, f"relative moment at the muzzle {moment:.1e}"


def test_a_negative_tip_mass_is_refused() -> None:
    with pytest.raises(ValueError, match=r"-0\.1"):
        frequency_roots(-0.1, 1)
