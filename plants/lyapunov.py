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
number. Weights that move in steps dZ of T add |dZ|^2/(2 gamma T) to (1), exactly:

    V' = -D + sum of terms + steps                                                           (7)

What is left between both is that (1) is known at samples only. It is of the first order in T, so
that every second sample tells how much of it goes with T: 2 gap(T) - gap(2 T) is free of that.
Where the weights do not move as the proof has it, its cross terms do not cancel, and stand in this
difference too. `Account.unexplained` is the largest sum of the difference over the run against the
sum of D; what has a known cause beyond the theorem, as a limit of the command, stands in it, too.

A group of weights that hardly matters to V hides there, so that each is looked at alone as well
(plants/weights.py), with the rates that the rig declares, whatever the law tuned by.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pcpc.plants.weights import Vector, Weights

Mask = NDArray[np.bool_]

UNEXPLAINED = 0.1  # of what is dissipated; shipped rigs stay far below, dead tuning far above
EXACT = 1e-3  # the same of maps, whose V is exact but for the quanta of frames
APART = 0.05  # of what the proof has the weights move; shipped rigs stay below, dead tuning is 1
STEPS = 0.25  # of what is dissipated that steps of the tuning may bring back


@dataclass(frozen=True)
class Bound:
    """Where V' turns negative (4) (5), and the error of the level set around it (6)."""

    error: float
    weights: float
    level: float


ENDLESS = Bound(math.inf, math.inf, math.inf)


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
        """Return (4) or (5), and (6); infinite without damping or leak, or beyond all floats."""
        if self.damping <= 0.0 or self.kappa <= 0.0 or self.gamma <= 0.0:
            return ENDLESS
        try:
            return self._finite_bound()
        except OverflowError:
            return ENDLESS

    def _finite_bound(self) -> Bound:
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
        """Return the right side of (2) for |r|, |Z~| and |w| of each cycle, (n,)."""
        leak = self.kappa * weights * (self.ideal - weights)
        return (
            error * rest - self.damping * error**2 + leak * (error if self.leak == "error" else 1.0)
        )


@dataclass(frozen=True)
class Assumption:
    """Something that a theorem asks for, whether the run has it, and what was found."""

    what: str
    holds: bool
    found: str
    needed: bool = False  # without it nothing of the proof stands


Asked = Assumption  # the name until 0.1


@dataclass(frozen=True)
class Proof:
    """What a plant's theorem.py says of a run, by cycle.

    v: V; damping: D of (1); terms: the others of (1), by name, the same units a second; beyond:
    such terms that the theorem does not have, known by cause; error: |r|; weights: |Z~|; rest: |w|,
    with what is beyond; tuned: the weights by rate, whose `stored` V has. `step_s` is what a step
    of V is divided by: None the time between two samples, a number for maps, whose (1) is exact.
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
    tuned: Sequence[Weights] = ()
    beyond: Mapping[str, Vector] = field(default_factory=dict)
    asked: Sequence[Assumption] = ()
    ideal_by: str = "least squares over the cycles of the run"
    step_s: float | None = None
    extra: Vector | None = None  # of each cycle, 0 and above


@dataclass(frozen=True)
class Check:
    """One of the statements that a run can violate."""

    name: str
    holds: bool
    found: str
    shown: bool = True  # whether anything is said against it; if not, it does not hold either


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
    def steps(self) -> Vector:
        """What steps of the tuning add to (7), (n - 1,); 0 for maps, whose (1) has them."""
        steps = np.zeros(len(self.proof.v) - 1)
        for one in self.proof.tuned if self.proof.step_s is None else ():
            steps += one.steps(self.period_s)
        return steps

    @cached_property
    def stepping(self) -> float:
        """The sum of `steps` over what is dissipated; infinite where nothing is."""
        added = float(self.steps @ self.period_s)
        return added / self.dissipation if self.dissipation > 0.0 else math.inf

    @cached_property
    def _flow(self) -> Vector:
        return np.asarray(sum(self.proof.terms.values()) - self.proof.damping)[:-1]

    @cached_property
    def proved_slope(self) -> Vector:
        """The right side of (7), (n - 1,)."""
        return self._flow + self.steps

    @cached_property
    def dissipation(self) -> float:
        """The sum of D over the run."""
        return float(self.proof.damping[:-1] @ self.period_s)

    @property
    def allowed(self) -> float:
        """How much may stay unexplained."""
        return UNEXPLAINED if self.proof.step_s is None else EXACT

    @cached_property
    def unexplained(self) -> float:
        """The largest sum of `slope` - `proved_slope` from the start on, over what is dissipated.

        Infinite where nothing is. Of a law in continuous time it is the smaller one of what is seen
        at the samples and of its extrapolation to a period of 0.
        """
        return self._share_apart(self._flow)

    @cached_property
    def unnamed(self) -> float:
        """As `unexplained`, less what is `beyond` the theorem by a cause that is known."""
        return self._share_apart(self._flow + sum(v[:-1] for v in self.proof.beyond.values()))

    def _share_apart(self, flow: Vector) -> float:
        if not self.dissipation > 0.0:
            return math.inf
        period, known = self.period_s, np.cumsum((self.slope - self.steps) * self.period_s)
        largest = np.abs(known - np.cumsum(flow * period)).max(initial=0.0)
        if self.proof.step_s is None:
            end = len(flow) // 2 * 2
            middle = flow[1:end:2] * (period[0:end:2] + period[1:end:2])
            extrapolated = np.abs(known[1:end:2] - np.cumsum(middle)).max(initial=0.0)
            largest = np.minimum(largest, extrapolated)
        return float(largest) / self.dissipation

    @cached_property
    def late(self) -> Mask:
        """The cycles after the transient. Shape (n,)."""
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
        """Which cycles but the last are outside the ball of `own`, where V has to fall.

        Shape (n - 1,).
        """
        beyond = (self.proof.error > self.own.error) | (self.proof.weights > self.own.weights)
        return beyond[:-1]

    @cached_property
    def returned(self) -> bool:
        """Whether the error was in the ball of `own` after its largest value behind the transient.

        It may leave the ball, where V has to fall, but not the level set; on the way out or while
        it is out a run does not show that it comes back.
        """
        behind = self.proof.error[int(np.argmax(np.where(self.late, self.proof.error, -1.0))) :]
        return bool((behind <= self.own.error).any())

    @cached_property
    def rising(self) -> float:
        """The share of the cycles outside in which V rises; NaN if none is outside."""
        rises = self.slope[self.outside] > 0.0
        return float(rises.mean()) if len(rises) else math.nan

    @cached_property
    def failing(self) -> Mask:
        """Which cycles but the last violate (2): the quotient of V is above its right side.

        Shape (n - 1,).
        """
        proof = self.proof
        right = proof.constants.slope(proof.error, proof.weights, proof.rest)[:-1]
        right = right if proof.extra is None else right + proof.extra[:-1]
        return self.slope > right + 1e-9 * (1.0 + np.abs(proof.damping[:-1]))

    @cached_property
    def start_within(self) -> float:
        """S_r: the largest |r(0)| from which |r| stays within 1.25 times that of the run.

        That is what the level set of V allows with the weights as they were; 0 where it allows
        none.
        """
        constants, reach = self.proof.constants, 1.25 * float(self.proof.error.max(initial=0.0))
        try:
            rest = constants.low * reach**2 - float(self.proof.weights[0]) ** 2 / constants.gamma
        except OverflowError:
            return 0.0
        return math.sqrt(max(rest, 0.0) / constants.high)

    def checks(self) -> list[Check]:
        """Return what can be violated, in order."""
        finite = bool(np.isfinite(self.proof.v).all())
        return [
            *(Check(one.what, one.holds, one.found) for one in self.proof.asked if one.needed),
            *([self._moves()] if self.proof.tuned else ()),
            Check(
                "sampling keeps up with the tuning",
                self.stepping <= STEPS,
                f"its steps bring back {100.0 * self.stepping:.2g} % of what is dissipated, "
                f"{100.0 * STEPS:.0f} % allowed",
            ),
            Check(
                "V follows its identity",
                finite and self.unexplained <= self.allowed,
                f"{100.0 * self.unexplained:.2g} % of the dissipation not explained, "
                f"{100.0 * self.allowed:.2g} % allowed" + self._cause_text(),
            ),
            *self._bound_checks(finite),
        ]

    def _moves(self) -> Check:
        apart = [one.apart(self.period_s) for one in self.proof.tuned]
        layer_rates = [
            f"{layer.name} {100.0 * off:.2g} %"
            + ("" if off <= APART else f" (declared {layer.rate:.3g}, moves like {seen:.3g})")
            for layer, off in zip(self.proof.tuned, apart, strict=True)
            for seen in [layer.seen(self.period_s)]
        ]
        return Check(
            "weights move as the proof has them move",
            all(off <= APART for off in apart),
            f"apart by {', '.join(layer_rates)}; {100.0 * APART:.0f} % allowed",
        )

    def _bound_checks(self, finite: bool) -> list[Check]:
        weights = float(self.proof.weights[self.late].max(initial=0.0))
        level, shown = min(self.own.level, self.stated.level), math.isfinite(self.own.level)
        none = "" if shown else "; an infinite bound is none"
        settled, stays = self.returned, self.largest <= level
        apart = "; not yet within: a longer run may show it" if stays and not settled else ""
        return [
            Check(
                "ultimate bound of the error",
                finite and shown and settled and stays,
                f"{self.largest:.3g} of {self.own.error:.3g}, never beyond {self.own.level:.3g}"
                f"{none}{apart}",
                shown and not apart,
            ),
            Check(
                "ultimate bound of the weights",
                finite and shown and weights <= self.own.weights,
                f"{weights:.3g} of {self.own.weights:.3g}" + none,
                shown,
            ),
        ]

    def _cause_text(self) -> str:
        if not self.proof.beyond or self.unexplained <= self.allowed:
            return ""
        causes = "; ".join(self.proof.beyond)
        return f"; {100.0 * self.unnamed:.2g} % without {causes}"

    @property
    def holds(self) -> bool:
        """Whether all is shown and nothing violated."""
        return all(check.holds for check in self.checks())

    @property
    def verdict(self) -> str:
        """`holds`, `violated`, or `not shown` where nothing is violated, but no bound is found."""
        wrong = [check for check in self.checks() if not check.holds]
        return "violated" if any(one.shown for one in wrong) else "not shown" if wrong else "holds"
