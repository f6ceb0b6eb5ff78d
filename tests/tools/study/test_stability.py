"""The four systems of `pcpc experiment stability` do what their Lyapunov functions say."""

from pathlib import Path

import numpy as np
import pytest

from pcpc.tools.study.book import stability as s
from pcpc.tools.terminal.progress import Progress


def test_the_lyapunov_function_falls_as_the_closed_form() -> None:
    x, y = s.solution(s._spiral, (2.0, 0.0))
    v = (x**2 + y**2) / 2
    assert (np.diff(v) < 0).all()
    np.testing.assert_allclose(v, 2.0 / (1 + 8.0 * s.T_S), rtol=1e-6)


@pytest.mark.parametrize(("size", "falls"), [(0.99, True), (1.001, False)])
def test_it_falls_only_within_the_circle(size: float, falls: bool) -> None:
    x, y = s.solution(s._circle, (size, 0.0))
    v = ((x**2 + y**2) / 2)[s.T_S < 3.0]
    assert (np.diff(v) < 0).all() == falls and (np.diff(v) > 0).all() != falls
    exact = 1 / (2 + (2 / size**2 - 2) * np.exp(2 * s.T_S[s.T_S < 3.0]))
    np.testing.assert_allclose(v, exact, rtol=1e-5)


def test_the_error_goes_to_zero_and_the_parameter_need_not() -> None:
    e, p, spent = s.solution(s._adaptive, (1.0, 1.0, 0.0))
    np.testing.assert_allclose((e**2 + p**2) / 2 + spent, 1.0, atol=1e-9)  # V' = -e^2
    assert abs(e[-1]) < 0.01 and abs(p[-1]) > 0.1, (e[-1], p[-1])


@pytest.mark.parametrize("d", [-1.0, 1.0])
def test_the_ultimate_bound_is_met_and_no_larger_than_needed(d: float) -> None:
    (x,) = s.solution(lambda t, x: d - x, (3.0,))
    np.testing.assert_allclose(x, d + (3.0 - d) * np.exp(-s.T_S), atol=1e-9)
    assert 0.98 < abs(x[-1]) < 1.02


def test_figure_and_table_are_written(tmp_path: Path) -> None:
    assert s.run(tmp_path, Progress(quiet=True), None) == 0
    assert (tmp_path / "figures/stability.png").stat().st_size > 10_000
    rows = [line.split("|") for line in (tmp_path / "results.md").read_text().splitlines()]
    same = [row for row in rows if len(row) > 3 and row[1].strip().startswith(("(1)", "(2)"))]
    assert len(same) == 5 and all(row[2].strip() == row[3].strip() for row in same), same
