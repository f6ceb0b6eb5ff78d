"""Theorem 8.3.1 on logs: the recurrent network of the telerobot as an identifier of the arm.

    xh'' = As-part + W'ph - A21 q - A22 q' + Mhat^-1 tau + (Kr + Kw |W|) st                     (1)
    st   = 10 (q - qh) + 2 (q' - qh')                                                           (2)
    W'   = Gam (ph st' - kap |st| W)                  e-modification, as the theorem has it     (3)
    W'   = Gam (ph st' - kap W)                       constant leak, as the rig has it          (4)
    f    = q'' - Mhat^-1 tau                          what W'ph is to become                    (5)

(1) to (4) run over the logged q, q' and tau, beside the loop and without any effect on it. f comes
from the plant's own motion. W that was found is then held and asked for f elsewhere in the log.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.plants.families.two_link.book.theory import LINKS, TwoLinks
from pcpc.plants.study import markdown
from pcpc.plants.telerobot.equations import A21, A22

Array = NDArray[np.float64]
RIGS = Path(__file__).resolve().parents[1] / "rigs"
RIG, SPLIT_S, SETTLED_S = "telerobot-u1", 10.0, 3.0  # U1: an arm that does not change
KR, KW, GAM, KAP, NODES, NETWORK_SEED = 20.0, 0.5, 100.0, 0.01, 20, 3  # those of the rig
RIDGE = 1e-8


@dataclass(frozen=True)
class Identified:
    """How well a tuning law did, each as rms over rms of f, in per cent, and |W| at the end.

    `state_mrad`: rms of q - qh; `follows`: W'ph while it is tuned; `again`, `elsewhere`: of W held
    as it was at SPLIT_S, before and after that.
    """

    name: str
    state_mrad: float
    follows: float
    again: float
    elsewhere: float
    norm: float


@dataclass(frozen=True)
class IdentifiedNetwork:
    """The identifier over the log of one run."""

    runs: int = 1

    def done(self) -> list[Identified]:
        """Run the rig and all tuning laws over it."""
        q, v, known, f, period_s, _ = recorded()
        ph = features(q, v)
        cut, begin = round(SPLIT_S / period_s), round(SETTLED_S / period_s)
        laws: dict[str, Callable[[Array, Array], Array]] = {
            "e-modification (3), Theorem 8.3.1": lambda w, st: KAP * np.linalg.norm(st) * w,
            "constant leak (4), as in the rig": lambda w, st: KAP * w,
            "no leak": lambda w, st: np.zeros_like(w),
        }
        identified = []
        for name, leak in laws.items():
            w, followed, error = tuned(q, v, known, ph, period_s, leak)
            fixed = w[cut]
            identified.append(Identified(
                name, 1e3 * _rms(error[cut:]), _share(followed[cut:], f[cut:]),
                _share(ph[begin:cut] @ fixed, f[begin:cut]), _share(ph[cut:] @ fixed, f[cut:]),
                float(np.linalg.norm(fixed)),
            ))  # fmt: skip
        best = _least_squares(ph[begin:cut], f[begin:cut])
        identified.append(
            Identified(
                "least squares, same nodes",
                np.nan,
                np.nan,
                _share(ph[begin:cut] @ best, f[begin:cut]),
                _share(ph[cut:] @ best, f[cut:]),
                float(np.linalg.norm(best)),
            )
        )
        return identified


def recorded(*settings: str) -> tuple[Array, Array, Array, Array, float, Any]:
    """Return q, q', Mhat^-1 tau and f, (ticks, 2) each, the period, s, and the log."""
    from pcpc.executive.nodes.virtual import in_memory  # time
    from pcpc.executive.rig.reading import load_rig

    rig = load_rig(RIGS / f"{RIG}.yaml", "rnn", settings)
    log = in_memory(rig)
    columns: Any = log.node["plant"].columns
    period_s = 1.0 / rig.config.rate_hz
    q = np.stack([columns[f"arm.q_{j}_rad"] for j in (1, 2)], axis=1)
    v = np.stack([columns[f"arm.rate_{j}_rad_s"] for j in (1, 2)], axis=1)
    tau = np.stack([columns[f"arm.acting_{j}_Nm"] for j in (1, 2)], axis=1)[1:]
    acceleration = np.diff(v, axis=0) / period_s
    servo = {spec.name: spec for spec in rig.nodes()["local"].blocks}["servo"].settings
    believed = TwoLinks(*(servo[name] for name in LINKS)).inertia(q[:-1])
    known = np.linalg.solve(believed, tau[..., None])[..., 0]
    return q[:-1], v[:-1], known, acceleration - known, period_s, log


def features(q: Array, v: Array) -> Array:
    """Return ph = tanh(V'[1; q; q']), (ticks, NODES), with the V of the rig."""
    layer = np.random.default_rng(NETWORK_SEED).uniform(-1.0, 1.0, (5, NODES))
    return np.asarray(np.tanh(np.hstack((np.ones((len(q), 1)), q, v)) @ layer))


def tuned(
    q: Array, v: Array, known: Array, ph: Array, h: float, leak: Callable[[Array, Array], Array]
) -> tuple[Array, Array, Array]:
    """Return W (ticks, NODES, 2), W'ph and q - qh (ticks, 2) of (1) to (4)."""
    w, qh, vh = np.zeros((NODES, 2)), q[0].copy(), v[0].copy()
    weights, learned = np.empty((len(q), NODES, 2)), np.empty_like(q)
    error = np.empty_like(q)
    for k in range(len(q)):
        st = 10.0 * (q[k] - qh) + 2.0 * (v[k] - vh)
        weights[k], learned[k], error[k] = w, w.T @ ph[k], q[k] - qh
        robust = (KR + KW * np.linalg.norm(w)) * st
        pull = A21 * (qh - q[k]) + A22 * (vh - v[k]) + learned[k] + known[k] + robust
        qh, vh = qh + h * vh, vh + h * pull
        w = w + h * GAM * (np.outer(ph[k], st) - leak(w, st))
    return weights, learned, error


def _least_squares(ph: Array, f: Array) -> Array:
    square = ph.T @ ph
    ridge = RIDGE * float(np.trace(square)) * np.eye(len(square))
    return np.asarray(np.linalg.solve(square + ridge, ph.T @ f))


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(x * x)))


def _share(guess: Array, f: Array) -> float:
    return 100.0 * _rms(guess - f) / _rms(f)


TEXT = """## Theorem 8.3.1: the telerobot's network as an identifier

{rig}, rnn, 20 s. The identifier of the theorem runs over the logged motion and torques with the
gains and nodes of the rig; what it is to learn is f, the acceleration that the nominal arm does not
explain (gravity, friction, the wrong mass). Follows: error of W'ph while W is tuned, from
{split:g} s on. Held: error of the W of {split:g} s, which then stays, from {settled:g} to
{split:g} s and from {split:g} s on. All as rms in per cent of that of f; 100 is what a network that
says 0 has. Last row: the W that fits f best from {settled:g} to {split:g} s.
"""


def table(identified: Sequence[Identified]) -> str:
    """Return the section with its table."""
    head = ("tuning", "q - qh, mrad rms", "follows, %", "held, before, %", "held, after, %",
            "norm of W")  # fmt: skip
    rows = [
        (one.name, *("-" if np.isnan(x) else f"{x:.3g}" for x in (
            one.state_mrad, one.follows, one.again, one.elsewhere, one.norm)))
        for one in identified
    ]  # fmt: skip
    text = TEXT.format(rig=RIG, split=SPLIT_S, settled=SETTLED_S)
    return f"{text}\n{markdown(head, rows)}"
