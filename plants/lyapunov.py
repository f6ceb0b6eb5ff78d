"""A proof of ultimate boundedness held against a run: its Lyapunov function, cycle by cycle.

A law's proof takes V = V_r + |Z~|^2/(2 gamma), V_r between low |r|^2/2 and high |r|^2/2, r the
error and Z~ = Z* - Z what the weights lack, and shows, with the tuning law inserted,

    V' = -D + sum of terms,   D >= K |r|^2                                                   (1)
       <= -K |r|^2 + |r| |w| + kappa |r| (|Z*| |Z~| - |Z~|^2)      leak "error", e-modification
       <= -K |r|^2 + |r| |w| + kappa     (|Z*| |Z~| - |Z~|^2)      leak "constant"            (2)
    |w| <= c0 + c1 |Z~|,  w: all that neither network nor damping cancels                     (3)

so that V' < 0 beyond r_b or z_b; a = |Z*| + c1/kappa:

    error      r_b = (kappa a^2/4 + c0)/K          z_b = a/2 + sqrt(a^2/4 + c0/kappa)         (4)
    constant   with c = kappa |Z*|^2/4 + c0^2/(4 K) + extra, for c1 = 0:
               r_b = c0/(2 K) + sqrt(c/K)          z_b = |Z*|/2 + sqrt(c/kappa)               (5)
    r_s^2 = (high r_b^2 + z_b^2/gamma)/low         the level set around both: never left      (6)

`extra` adds to the right side of (2) where some of w does not come with |r|. Where V holds a third
part, V_o with a damping of its own of at least 2 `other_rate` V_o, c/`other_rate` is added in the
bracket of (6); c of "error" is K r_b^2/4.

In a run V is known at the samples, so its difference quotient and (1) are two derivations of one
number. What they differ by is what sampling costs and (1) does not know of; where the weights do
not move as the proof has it, its cross terms do not cancel, and stand in this difference too.
`Account.unexplained` is the largest sum of the difference over the run against the sum of D; what
has a known cause beyond the theorem, as a limit of the command, stands in it, too.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Mask = NDArray[np.bool_]

UNEXPLAINED = 0.1  # of what is dissipated; shipped rigs stay far below, dead tuning far above


@dataclass(frozen=True)
class Bound:
    """Where V' turns negative (4) (5), and the error of the level set around it (6)."""

    error: float
    weights: float
    level: float


@dataclass(frozen=True)
class Constants:
    """What (2) to (6) take: K, kappa, |Z*|, c0, c1, low, high, gamma; all of the error's units."""

    damping: float
    kappa: float
    ideal: float
    c0: float
    c1: float = 0.0
    low: float = 1.0
    high: float = 1.0
    gamma: float = 1.0
    leak: str = "error"  # or "constant"
    extra: float = 0.0  # with a constant leak
    other_rate: float = math.inf

    def bound(self) -> Bound:
        """Return (4) or (5), and (6); infinite without damping or leak."""
        if self.damping <= 0.0 or self.kappa <= 0.0 or self.gamma <= 0.0:
            return Bound(math.inf, math.inf, math.inf)
        if self.leak == "error":
            a = self.ideal + self.c1 / self.kappa
            error = (self.kappa * a * a / 4.0 + self.c0) / self.damping
            weights = a / 2.0 + math.sqrt(a * a / 4.0 + self.c0 / self.kappa)
            c = self.damping * error**2 / 4.0
        else:
            c = self.kappa * self.ideal**2 / 4.0 + self.c0**2 / (4.0 * self.damping) + self.extra
            error = self.c0 / (2.0 * self.damping) + math.sqrt(c / self.damping)
            weights = self.ideal / 2.0 + math.sqrt(c / self.kappa)
        squares = self.high * error**2 + weights**2 / self.gamma + c / self.other_rate
        level = math.sqrt(squares / self.low)
        return Bound(error, weights, level)

    def slope(self, error: Vector, weights: Vector, rest: Vector) -> Vector:
        """Return the right side of (2) for |r|, |Z~| and |w| of each cycle."""
        leak = self.kappa * weights * (self.ideal - weights)
        return (
            error * rest - self.damping * error**2 + leak * (error if self.leak == "error" else 1.0)
        )


@dataclass(frozen=True)
class Asked:
    """Something that a theorem asks for, whether the run has it, and what was found."""

    what: str
    holds: bool
    found: str
    needed: bool = False  # without it nothing of the proof stands


@dataclass(frozen=True)
class Proof:
    """What a plant's theorem.py says of a run, by cycle.

    v: V; damping: D of (1); terms: the others of (1), by name, the same units a second; beyond:
    such terms that the theorem does not have, known by cause; error: |r|; weights: |Z~|; rest: |w|,
    with what is beyond. `step_s` is what a step of V is divided by: None the time between two
    samples, a number for maps, whose (1) is of a step.
    """

    theorem: str
    error_is: str  # with its unit, "|r| [rad/s]"
    t_s: Vector
    v: Vector
    damping: Vector
    terms: Mapping[str, Vector]
    error: Vector
    weights: Vector
    rest: Vector
    constants: Constants
    beyond: Mapping[str, Vector] = field(default_factory=dict)
    asked: Sequence[Asked] = ()
    ideal_by: str = "least squares over the cycles of the run"
    step_s: float | None = None
    extra: Vector | None = None  # of each cycle, 0 and above


@dataclass(frozen=True)
class Check:
    """One of the statements that a run can violate."""

    name: str
    holds: bool
    found: str


@dataclass(frozen=True)
class Account:
    """A proof held against its run; `settled_s`: from here on the ultimate bound is asked for."""

    proof: Proof
    settled_s: float

    @cached_property
    def period_s(self) -> Vector:
        """From each sample to the next, (n - 1,)."""
        if self.proof.step_s is not None:
            return np.full(len(self.proof.v) - 1, self.proof.step_s)
        return np.diff(self.proof.t_s)

    @cached_property
    def slope(self) -> Vector:
        """The difference quotient of V, (n - 1,)."""
        return np.diff(self.proof.v) / self.period_s

    @cached_property
    def proved(self) -> Vector:
        """The right side of (1), (n - 1,)."""
        return (sum(self.proof.terms.values()) - self.proof.damping)[:-1]

    @cached_property
    def dissipated(self) -> float:
        """The sum of D over the run."""
        return float(self.proof.damping[:-1] @ self.period_s)

    @cached_property
    def unexplained(self) -> float:
        """The largest sum of `slope` - `proved` from the start on, over what is dissipated.

        Infinite where nothing is.
        """
        return self._apart(self.proved)

    @cached_property
    def unnamed(self) -> float:
        """As `unexplained`, less what is `beyond` the theorem by a cause that is known."""
        return self._apart(self.proved + sum(v[:-1] for v in self.proof.beyond.values()))

    def _apart(self, slope: Vector) -> float:
        gap = np.abs(np.cumsum((self.slope - slope) * self.period_s))
        largest = float(gap.max(initial=0.0))
        return largest / self.dissipated if self.dissipated > 0.0 else math.inf

    @cached_property
    def late(self) -> Mask:
        """The cycles after the transient."""
        return self.proof.t_s >= self.settled_s

    @cached_property
    def stated(self) -> Bound:
        """The bound of the plant's constants."""
        return self.proof.constants.bound()

    @cached_property
    def own(self) -> Bound:
        """The bound with c0, extra as large as in this run, c1 = 0: how tight (4) to (6) can be."""
        proof = self.proof
        extra = 0.0 if proof.extra is None else float(proof.extra.max(initial=0.0))
        largest = float(proof.rest.max(initial=0.0))
        return replace(proof.constants, c0=largest, c1=0.0, extra=extra).bound()

    @cached_property
    def largest(self) -> float:
        """The largest |r| after the transient."""
        return float(self.proof.error[self.late].max(initial=0.0))

    @cached_property
    def outside(self) -> Mask:
        """Which cycles but the last are outside the ball of `own`, where V has to fall."""
        beyond = (self.proof.error > self.own.error) | (self.proof.weights > self.own.weights)
        return beyond[:-1]

    @cached_property
    def rising(self) -> float:
        """The share of the cycles outside in which V rises; NaN if none is outside."""
        rises = self.slope[self.outside] > 0.0
        return float(rises.mean()) if len(rises) else math.nan

    @cached_property
    def failing(self) -> Mask:
        """Which cycles but the last violate (2): the quotient of V is above its right side."""
        one = self.proof
        right = one.constants.slope(one.error, one.weights, one.rest)[:-1]
        right = right if one.extra is None else right + one.extra[:-1]
        return self.slope > right + 1e-9 * (1.0 + np.abs(one.damping[:-1]))

    @cached_property
    def start_within(self) -> float:
        """S_r: the largest |r(0)| from which |r| stays within 1.25 times that of the run.

        That is what the level set of V allows with the weights as they were; 0 where it allows
        none.
        """
        one, reach = self.proof.constants, 1.25 * float(self.proof.error.max(initial=0.0))
        left = one.low * reach**2 - float(self.proof.weights[0]) ** 2 / one.gamma
        return math.sqrt(max(left, 0.0) / one.high)

    def checks(self) -> list[Check]:
        """Return what can be violated, in order."""
        late_weights = float(self.proof.weights[self.late].max(initial=0.0))
        finite = bool(np.isfinite(self.proof.v).all())
        return [
            *(Check(one.what, one.holds, one.found) for one in self.proof.asked if one.needed),
            Check(
                "V follows its identity",
                finite and self.unexplained <= UNEXPLAINED,
                f"{100.0 * self.unexplained:.2g} % of the dissipation not explained, "
                f"{100.0 * UNEXPLAINED:.0f} % allowed" + self._named(),
            ),
            Check(
                "ultimate bound of the error",
                finite and self.largest <= min(self.own.level, self.stated.level),
                f"{self.largest:.3g} of {self.own.error:.3g}, never beyond {self.own.level:.3g}",
            ),
            Check(
                "ultimate bound of the weights",
                finite and late_weights <= self.own.weights,
                f"{late_weights:.3g} of {self.own.weights:.3g}",
            ),
        ]

    def _named(self) -> str:
        if not self.proof.beyond or self.unexplained <= UNEXPLAINED:
            return ""
        causes = "; ".join(self.proof.beyond)
        return f"; {100.0 * self.unnamed:.2g} % without {causes}"

    @property
    def holds(self) -> bool:
        """Whether nothing is violated."""
        return all(check.holds for check in self.checks())
