"""The map behind its deadzone: the difference equation, a second implementation, the table."""

from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from stepped import Stepped

from pcpc.executive.errors import RigError
from pcpc.executive.log.reader import Log
from pcpc.executive.nodes.plan import check_pacing
from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.rig.reading import load_rig
from pcpc.plants.deadzone_map import evaluation, model

RIGS = Path(model.__file__).resolve().parent / "rigs"
EXACT = "controller.model_c=0.1875"
LATE = "map.delay_samples=1.0"


@lru_cache
def logged(rig: str, controller: str, *settings: str) -> Log:
    return in_memory(load_rig(RIGS / f"{rig}.yaml", controller, settings))


def measured(rig: str, controller: str, *settings: str) -> dict[str, float]:
    return evaluation.EVALUATION.judge(logged(rig, controller, *settings), (10.0, 30.0), {}, 0.1)


def plain(d: float, cf: float, fuzzy: bool, sign: float = -1.0) -> np.ndarray:
    """Return [x2, e2, u, d+, d-] of 300 ticks; `sign` of the tuning."""
    lam, kv, alpha, gam = 0.2, 0.3, 0.1, 0.001
    x, widths, fired = np.zeros(2), np.zeros(2), None
    rows = []
    for k in range(300):
        xd = [float(np.sin(0.5 * (k + i) * 0.1 + np.pi / 2)) for i in (-1, 0, 1)]
        e2, e1 = x[1] - xd[1], x[0] - xd[0]
        r = e2 + lam * e1
        if fired is not None and fuzzy:
            norm = np.linalg.norm(np.eye(2) - alpha * np.outer(fired, fired), 2)
            widths = widths + sign * alpha * fired * r - gam * norm * widths
        w = xd[2] - lam * e2 - (-cf * x[0] / (1 + x[1] ** 2) + x[1]) + kv * r
        fired = np.array([1.0, 0.0]) if w >= 0 else np.array([0.0, -1.0])
        u = w + float(widths @ fired)
        rows.append([x[1], e2, u, *widths])
        tau = u - d if u > d else u + d if u < -d else 0.0
        x = np.array([x[1], -3 / 16 * x[0] / (1 + x[1] ** 2) + x[1] + tau])
    return np.array(rows)


def test_one_step_is_the_difference_equation() -> None:
    made = Stepped(model.BLOCK, {"c": 0.1875, "d": 0.1}, 0.1)
    made.x.now.x1, made.x.now.x2 = 0.4, -0.7
    y = made.step(0.35)
    for seen in (y.sample, y.true):
        assert (seen.x1, seen.x2) == (0.4, -0.7), "the call at k = 0 moved the map"
    y = made.step(0.35)
    expected = (-0.7, -3 / 16 * 0.4 / 1.49 - 0.7 + 0.25)
    assert np.abs(y.sample.values() - expected).max() < 1e-15, y.sample.values()


def test_a_delay_waits_whole_steps() -> None:
    for delay in range(4):
        made = Stepped(model.BLOCK, {"c": 0.0, "d": 0.1, "delay_samples": delay}, 0.1)
        made.step(9.0)
        inputs = [made.step(1.1 if k == 1 else 0.0).tau for k in range(1, 7)]
        expected = [1.0 if k == delay else 0.0 for k in range(6)]
        assert np.allclose(inputs, expected, atol=1e-15), (delay, inputs)


@pytest.mark.parametrize("d", [0.0, 0.1, 0.3])
@pytest.mark.parametrize("cf", [0.15, 0.1875])
@pytest.mark.parametrize("controller", ["pd", "fuzzy"])
def test_the_rig_runs_as_plain_numpy_does(d: float, cf: float, controller: str) -> None:
    log = logged(f"fuzzy-d{round(10 * d):02d}", controller, f"controller.model_c={cf}")
    expected = plain(d, cf, controller == "fuzzy")
    found = log.node["executive"].columns
    x2 = log.node["plant"].columns["map.x2"][:300]
    wrong = [
        np.abs(x2 - expected[:, 0]).max(),
        np.abs(found["controller.command"] - expected[:, 2]).max(),
    ]
    if controller == "fuzzy":
        learned = np.stack([found["controller.d_plus"], found["controller.d_minus"]], axis=1)
        wrong.append(np.abs(learned - expected[:, 3:]).max())
    assert max(wrong) < 1e-8, f"{wrong}; frames carry steps of 1e-10"


PRINTED = {  # rms, largest error over k = 100..299; widths at the end
    ("fuzzy-d00", "pd", 0): (0.0184, 0.0226), ("fuzzy-d00", "pd", 1): (0.0, 0.0),
    ("fuzzy-d01", "pd", 0): (0.1305, 0.1413), ("fuzzy-d01", "pd", 1): (0.1147, 0.1190),
    ("fuzzy-d01", "fuzzy", 0): (0.0061, 0.0203, 0.113, 0.111),
    ("fuzzy-d01", "fuzzy", 1): (0.0022, 0.0068, 0.097, 0.099),
    ("fuzzy-d03", "pd", 0): (0.3384, 0.3772), ("fuzzy-d03", "pd", 1): (0.3266, 0.3571),
    ("fuzzy-d03", "fuzzy", 0): (0.0073, 0.0137, 0.307, 0.309),
    ("fuzzy-d03", "fuzzy", 1): (0.0067, 0.0208, 0.292, 0.297),
}  # fmt: skip


@pytest.mark.parametrize(("rig", "controller", "exact"), PRINTED)
def test_every_printed_digit_of_the_table(rig: str, controller: str, exact: int) -> None:
    found = measured(rig, controller, *([EXACT] if exact else []))
    names = ("error_rms", "error_max", "d_plus", "d_minus")
    expected = PRINTED[rig, controller, exact]
    for name, value in zip(names, expected, strict=False):
        digits = 3 if name.startswith("d_") else 4
        assert round(found[name], digits) == value, f"{name} {found[name]:.6f}, printed {value}"
    assert found["diverged"] == 0.0


@pytest.mark.parametrize("rig", ["fuzzy-d01", "fuzzy-d03"])
def test_the_precompensator_leaves_less_than_a_tenth_of_pds_error(rig: str) -> None:
    for settings in ([], [EXACT]):
        times = (
            measured(rig, "pd", *settings)["error_rms"]
            / measured(rig, "fuzzy", *settings)["error_rms"]
        )
        assert 10.0 < times < 60.0, f"{times:.1f} times better"


@pytest.mark.parametrize(
    ("rig", "controller", "settings", "rms"),
    [
        ("fuzzy-d01", "fuzzy_detuned", (), 0.0117),
        ("fuzzy-d01", "fuzzy_detuned", (EXACT,), 0.0123),
        ("fuzzy-d03", "fuzzy_detuned", (), 0.0279),
        ("fuzzy-d03", "fuzzy_detuned", (EXACT,), 0.0288),
        ("fuzzy-d03", "fuzzy", (EXACT,), 0.0167),  # the one case of the default gains that stays
    ],
)
def test_what_bears_one_more_sample(
    rig: str, controller: str, settings: tuple[str, ...], rms: float
) -> None:
    found = measured(rig, controller, *settings, LATE)
    assert round(found["error_rms"], 4) == rms and found["diverged"] == 0.0, found


@pytest.mark.parametrize(
    ("rig", "controller", "settings"),
    [
        ("fuzzy-d01", "fuzzy", ()), ("fuzzy-d01", "fuzzy", (EXACT,)), ("fuzzy-d03", "fuzzy", ()),
        ("fuzzy-d00", "fuzzy_detuned", ()),  # even detuned, where there is no deadzone
    ],
)  # fmt: skip
def test_what_does_not_is_ended_by_the_guard(
    rig: str, controller: str, settings: tuple[str, ...]
) -> None:
    log = logged(rig, controller, *settings, LATE)
    ended = log.node["executive"].columns["controller.diverged"]
    first = int(np.argmax(ended))
    assert ended[-1] == 1.0 and (ended[first:] == 1.0).all(), "not latched"
    u = log.node["executive"].columns["controller.command"][first:]
    assert not u.any(), f"command {np.abs(u).max()} after the end"
    assert (log.node["executive"].columns["supervisor.state"][1:-1] == 2.0).all(), "a fault"


def test_tuning_with_the_other_sign_runs_away() -> None:
    error = np.abs(plain(0.1, 0.15, True, sign=1.0)[:, 1])
    assert error[:100].max() > 100.0 * np.abs(plain(0.1, 0.15, True)[:100, 1]).max(), error.max()


def test_the_default_gains_refuse_a_clock_and_name_what_runs_on_one() -> None:
    for pacing in ("real", "sync"):
        with pytest.raises(RigError, match="one more and the run diverges") as found:
            check_pacing(load_rig(RIGS / "fuzzy-d01.yaml"), pacing)
        assert "pd or fuzzy_detuned" in str(found.value), found.value
    check_pacing(load_rig(RIGS / "fuzzy-d01.yaml"), "lockstep")
    check_pacing(load_rig(RIGS / "fuzzy-d01.yaml", "fuzzy_detuned"), "real")
