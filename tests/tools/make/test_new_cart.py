"""The cart of `pcpc new --cart` is that of the literature, and its poles are those it states.

A and B are published: "Control Tutorials for MATLAB and Simulink" (University of Michigan, Carnegie
Mellon), "Inverted Pendulum: System Modeling", with g = 9.8; phi there is -q here.
"""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from stepped import Stepped

from pcpc.executive.own_laws.modules import module_of
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.tools.make.new import CART

A = [[0, 1, 0, 0], [0, -0.1818, -2.6727, 0], [0, 0, 0, 1], [0, 0.4545, 31.1818, 0]]
B = [0, 1.8182, 0, -4.5455]
DT, H = 1e-3, 1e-6

Matrix = NDArray[np.float64]


@pytest.fixture(scope="module")
def rig() -> Rig:
    """Return the rig of the template."""
    return load_rig(CART.folder / "rig.yaml")


def after(rig: Rig, gravity_m_s2: float, start: Matrix) -> Matrix:
    """Return x, x', q, q' a period after `start`, which ends with the force, (5,)."""
    model: Any = module_of("", CART.folder / "model.py")
    given = rig.config.plant.blocks["cart"].parameters | {"gravity_m_s2": gravity_m_s2}
    cart = Stepped(model.BLOCK, given, DT)
    cart.step(0.0)
    motion = cart.x.motion.values()
    motion[:], cart.x.held_N = start[:4], start[4]
    cart.step(0.0)
    return motion.copy()


def linear(rig: Rig, gravity_m_s2: float) -> Matrix:
    """Return [A B] at the top, (4, 5), of the map of a period by differences."""
    steps = H * np.eye(5)
    ends = [after(rig, gravity_m_s2, d) - after(rig, gravity_m_s2, -d) for d in steps]
    both = np.vstack([np.array(ends).T / (2.0 * H), np.eye(5)[4]]) - np.eye(5)
    series = [np.linalg.matrix_power(both, k) * (-1.0) ** (k + 1) / k for k in range(1, 8)]
    return np.asarray(np.sum(series, axis=0)[:4] / DT)  # log(I + both)/dt


def test_near_the_top_it_has_the_published_linear_model(rig: Rig) -> None:
    found = linear(rig, 9.8)
    np.testing.assert_allclose(found, np.column_stack([A, B]), atol=1e-4)


@pytest.mark.parametrize(("controller", "pole_per_s"), [("state_feedback", -5.0), ("soft", -3.0)])
def test_the_loop_has_the_poles_that_its_rig_states(
    rig: Rig, controller: str, pole_per_s: float
) -> None:
    found = linear(rig, 9.81)
    own = rig.config.controllers
    gains = own["state_feedback"].parameters | own[controller].parameters
    law: Any = module_of("", CART.folder / "laws/state_feedback.py")
    feedback = [gains[name] for name in ("kx_N_m", "kv_Ns_m", "kq_N_rad", "kw_Ns_rad")]
    for place, gain in ((0, feedback[0]), (2, feedback[2])):
        controller_ = Stepped(law.BLOCK, gains, DT)
        sample = np.zeros(4)
        sample[2 + place // 2] = 0.01  # of the position, or the angle
        assert controller_.step(*sample).force_N == pytest.approx(0.01 * gain), "the sign"
    closed = found[:, :4] + np.outer(found[:, 4], feedback)
    np.testing.assert_allclose(np.poly(closed), np.poly([pole_per_s] * 4), rtol=0.01)
