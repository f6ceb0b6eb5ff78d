"""Statements on a probability of failure: how sure, after how many runs, how many more.

    p_fail < 1e-3 at 95%                 of all requirements and safety stops of a run
    p_fail(peak error) < 1e-3 at 95%     of the requirement of this name
    ... against 5e-4                     the alternative p1, in place of p0/10

A campaign looks at its failures again and again, and an interval made for a fixed number of runs
is then wrong too often. Wald's sequential test is not: with k failures in n runs

    L = (p1/p0)^k ((1 - p1)/(1 - p0))^(n - k),  p1 < p0                                   (1)

is, where p = p0, a non-negative martingale of mean 1, which ever reaches 1/alpha with probability
alpha at most (Ville), and so it is where p > p0. Hence:

    holds       L >= 1/alpha, alpha = 1 - confidence: p < p0
    refuted     the lower bound (3) has reached p0: p > p0
    not shown   L <= beta: p <= p1 is excluded, and to go on would seldom show that p < p0
    open        neither of these yet

Power: of campaigns whose p is p1 or less, beta end as not shown at most (Ville, of 1/L).

L grows with p0; the p0 at which it is 1/alpha is therefore an upper bound of p that holds at all n
at once (a confidence sequence), and says p < p0 exactly when the test does. With R = p0/p1

    upper  (g - 1)/(g - 1/R),  g = (R^k/alpha)^(1/(n - k))                                (2)

The lower bound is where the same martingale, its alternative mixed over all p by Jeffreys' prior,
reaches 1/alpha below k/n (Robbins); it needs no p1 and gets ever closer:

    lower  B(k + 1/2, n - k + 1/2) / (B(1/2, 1/2) p^k (1 - p)^(n - k)) = 1/alpha          (3)

`against 0` is the test without failure: 1/alpha is reached after as many failure-free runs as a
fixed number would have needed, and one failure ends it as not shown.

Wald, Sequential Analysis, 1947, ch. 3; Ville 1939; Robbins 1970; Clopper and
Pearson, Biometrika 26, 1934.
"""

import math
import re
from dataclasses import dataclass

from pcpc.executive.errors import RigError
from pcpc.executive.rig import yamlfile
from pcpc.tools.study.binomial import check_counts

RATIO = 10.0  # p0/p1 where nothing is said: 11 % more failure-free runs than a fixed number needs
BETA = 0.05  # how often `not shown` ends a campaign whose p is p1
HOLDS, REFUTED, NOT_SHOWN, OPEN = "holds", "refuted", "not shown", "open"


class NothingToTellError(RigError):
    """A campaign whose rows tell nothing of what was asked: those that it made are taken back."""


_UNTIL = re.compile(
    r"p_fail\s*(?:\((?P<of>[^()]+(?:\([^()]*\)[^()]*)*)\))?\s*<\s*(?P<p0>[^\s%]+)"
    r"\s+at\s+(?P<percent>[^\s%]+)\s*%(?:\s+against\s+(?P<p1>\S+))?"
)
_CURE = "expected p_fail < 1e-3 at 95%, or p_fail(REQUIREMENT) < 1e-3 at 95% against 5e-4"


def anytime_bounds(
    failures: int, runs: int, confidence: float, ratio: float = RATIO
) -> tuple[float, float]:
    """Return a lower and an upper bound, each of `confidence` for all numbers of runs at once."""
    check_counts(failures, runs)
    sure, lower, upper = -math.log(1.0 - confidence), 0.0, 1.0
    if failures < runs and (ratio < math.inf or failures == 0):
        grown = (sure + (failures * math.log(ratio) if failures else 0.0)) / (runs - failures)
        if grown < 700.0:  # ln g, of a float64
            upper = 1.0 / (1.0 + (1.0 - 1.0 / ratio) / math.expm1(grown))

    def excess(p: float) -> float:
        return _log_mixture(failures, runs, p) - sure

    if failures:  # below 0 at p = k/n, where nothing is likelier
        from scipy.optimize import brentq

        lower = float(brentq(excess, 1e-300, failures / runs, xtol=1e-18))
    return lower, upper


def _log_mixture(failures: int, runs: int, p: float) -> float:
    """Return the logarithm of (3), left, at 0 < p < 1, or p = 1 without a clean run."""
    from scipy.special import betaln

    clean = (runs - failures) * math.log1p(-p) if runs > failures else 0.0
    prior = float(betaln(0.5, 0.5))
    whole = float(betaln(failures + 0.5, runs - failures + 0.5)) - prior
    return whole - failures * math.log(p) - clean


@dataclass(frozen=True)
class Statement:
    """`p_fail < p0 at confidence`, of one requirement or of all; `p1` is the alternative."""

    p0: float
    confidence: float
    p1: float
    requirement: str | None = None
    beta: float = BETA

    @property
    def ratio(self) -> float:
        """p0/p1; infinite of the test without failure."""
        return self.p0 / self.p1 if self.p1 else math.inf

    @property
    def without_failure(self) -> int:
        """How many runs the statement needs if none fails."""
        return math.ceil(self._acceptance_threshold / self._clean)

    @property
    def _acceptance_threshold(self) -> float:
        return -math.log(1.0 - self.confidence)

    @property
    def _clean(self) -> float:
        """By how much a run without failure moves ln L."""
        return math.log1p(-self.p1) - math.log1p(-self.p0)

    @property
    def _failed(self) -> float:
        """By how much a failure moves ln L, down to -inf."""
        return -math.log(self.ratio)

    def likelihood(self, failures: int, runs: int) -> float:
        """Return ln L, (1)."""
        check_counts(failures, runs)
        return (failures * self._failed if failures else 0.0) + (runs - failures) * self._clean

    def bounds(self, failures: int, runs: int) -> tuple[float, float]:
        """Return (3) and (2): each holds with the statement's confidence, whenever it is looked."""
        return anytime_bounds(failures, runs, self.confidence, self.ratio)

    def outcome(self, failures: int, runs: int, unjudged: int = 0) -> str:
        """Return HOLDS, REFUTED, NOT_SHOWN or OPEN; a campaign ends with the first but OPEN.

        `unjudged`: further runs, of which nobody knows: all failures, but none to refute it.
        """
        runs += unjudged
        likelihood = self.likelihood(failures + unjudged, runs)
        if likelihood >= self._acceptance_threshold:
            return HOLDS
        if (
            failures > self.p0 * runs
            and _log_mixture(failures, runs, self.p0) >= self._acceptance_threshold
        ):
            return REFUTED
        return NOT_SHOWN if likelihood <= math.log(self.beta) else OPEN

    def more(self, failures: int, runs: int) -> int:
        """Return how many more runs decide it if failures go on at the present rate."""
        rate = failures / runs if runs else 0.0
        drift = self._drift(rate)
        end = self._acceptance_threshold if drift > 0.0 else math.log(self.beta)
        gap = (end - self.likelihood(failures, runs)) / drift if drift else math.inf
        return math.ceil(max(gap, 1.0)) if math.isfinite(gap) else 1

    def _drift(self, p: float) -> float:
        return (p * self._failed if p else 0.0) + (1.0 - p) * self._clean

    @property
    def power_text(self) -> str:
        """How often campaigns show the statement where it is true: 1 - beta at p1, and below it."""
        if not self.p1:
            return "power: shown for sure if p_fail is 0 alone"
        sure = f"{_short(100.0 * (1.0 - self.beta))} %"
        return f"power: shown by {sure} of campaigns if p_fail is {_short(self.p1)} or less"

    def __str__(self) -> str:
        of = f"({self.requirement})" if self.requirement else ""
        return f"p_fail{of} < {_short(self.p0)}"

    def text(self, failures: int, runs: int, unjudged: int = 0) -> str:
        """Return the outcome in words, in one line."""
        outcome = self.outcome(failures, runs, unjudged)
        if not unjudged:
            return self._text(outcome, failures, runs, failures)
        said = self._text(outcome, failures, runs + unjudged, failures + unjudged)
        return f"{said}; {unjudged_text(unjudged, outcome == REFUTED)}"

    def _text(self, outcome: str, failures: int, runs: int, most: int) -> str:
        """Return it; `most`: failures, if all of those that were not judged are."""
        sure = f"at {_short(100.0 * self.confidence)} %"
        found = f"{count_text(failures, 'failure')} in {count_text(runs, 'run')}"
        lower, upper = self.bounds(failures, runs)[0], self.bounds(most, runs)[1]
        if outcome == HOLDS:
            need = f"{self.without_failure:,} were needed without failure"
            return f"{self} holds {sure}: {found}, bound {bound_text(upper)}; {need}"
        if outcome == REFUTED:
            return f"{self} is refuted {sure}: {found}, p_fail is above {bound_text(lower)}"
        if outcome == NOT_SHOWN and self.p1 == 0.0:
            return f"{self} is not shown: {found}, and the test allowed for none"
        between = f"p_fail is above {bound_text(lower)} and below {bound_text(upper)}, each {sure}"
        if outcome == NOT_SHOWN:
            near = f"p_fail <= {_short(self.p1)} is excluded at {_short(100 * (1 - self.beta))} %"
            return f"{self} is not shown: {found}, {near}; {between}; {self.power_text}"
        rest = self.more(most, runs)
        rising = self._drift(most / max(runs, 1)) > 0.0
        end = "to show it" if rising else "until it is not shown"
        ahead = f"about {rest:,} more {end}, if it continues like this"
        said = f"{self} is open after {found}: bound {bound_text(upper)}; {ahead}"
        return f"{said}; {self.power_text}"


def parse(text: str) -> Statement:
    """Return what `--until` says. Raises RigError, one line with the cure."""
    found = _UNTIL.fullmatch(text.strip())
    if not found:
        raise RigError(f"--until {text!r}: {_CURE}")
    p0, percent = _number(text, found["p0"]), _number(text, found["percent"])
    p1 = p0 / RATIO if found["p1"] is None else _number(text, found["p1"])
    if not 0.0 < p0 < 1.0:
        raise RigError(f"--until {text!r}: {found['p0']} is no probability between 0 and 1")
    if not 50.0 <= percent < 100.0:
        raise RigError(f"--until {text!r}: {found['percent']}%; expected 50% or more, below 100%")
    if not 0.0 <= p1 < p0:
        raise RigError(f"--until {text!r}: against {found['p1']}; expected 0 or more, below {p0:g}")
    name = found["of"]
    return Statement(p0, percent / 100.0, p1, name.strip() if name else None)


def _number(text: str, word: str) -> float:
    try:
        number = yamlfile.parse_scalar(word)
    except ValueError:
        number = None
    if type(number) not in (int, float):
        raise RigError(f"--until {text!r}: {word} is not a number; {_CURE}")
    return float(number)


def _short(number: float) -> str:
    """Return a number as one writes it: 1e-3, 0.05, 99.9."""
    mantissa, exponent = f"{number:e}".split("e")
    power = int(exponent)
    if -3 < power < 5 or number == 0.0:
        return f"{number:.12g}"
    return f"{float(mantissa):g}e{power}"


def bound_text(number: float) -> str:
    """Return a bound with four digits, 9.998e-4."""
    return _short(float(f"{number:.4g}"))


def unjudged_text(count: int, refutes: bool) -> str:
    """Return what became of runs that were not judged, in a statement against them or for them."""
    return f"{count:,} not judged, counted as {'no failures' if refutes else 'failures'}"


def count_text(count: int, word: str) -> str:
    """Return `1 run`, `2,995 runs`."""
    return f"{count:,} {word}{'' if count == 1 else 's'}"
