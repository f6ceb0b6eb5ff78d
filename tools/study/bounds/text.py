"""What `pcpc bounds` prints, and as JSON."""

import math
from collections.abc import Mapping, Sequence
from typing import Annotated

from msgspec import Meta, Struct

from pcpc.plants.lyapunov import Account, Assumption, Bound, Check, Constants
from pcpc.plants.weights import Vector
from pcpc.tools.terminal.answer import Count, Finite

_LEAKS = Meta(extra_json_schema={"properties": {"leak": {"enum": ["error", "constant"]}}})


class Weight(Struct):
    """How a weight moved."""

    declared: float
    "tuning rate"
    moves_like: float
    "tuning rate"
    apart: float
    "share"


class Figures(Struct):
    """A run and its theorem; null: not finite."""

    rig: str
    controller: str
    theorem: str
    error: str
    "what it is, with its unit"
    holds: bool
    "all is shown and nothing violated"
    verdict: str
    "in words"
    settled_s: Finite
    "s, from here on the ultimate bound is asked for"
    largest: float
    "|r| from settled_s on, in the unit of error"
    looseness: float
    "bound over largest"
    unexplained: float
    "share of the dissipation"
    steps: float
    "share of the dissipation that steps of the tuning bring back"
    inequality_fails: float
    "share of the cycles"
    outside: float
    "share of the cycles outside the bound"
    rising_outside: float
    "share of those in which V rises; null: there are none"
    start_within: float
    "largest |r(0)| that is known to stay in sight, in the unit of error"
    dissipated: float
    "in the unit of V"
    w_max: float
    "largest |w|, in the unit of error a second"
    weights_max: float
    "largest |Z~|"
    bound: Bound
    "with the largest |w| of the run; error and level, never left, of |r|, in the unit of error"
    bound_of_constants: Bound
    "of the plant's constants alone"
    constants: Annotated[Constants, _LEAKS]
    "of the proof, in the units of the error; other_rate null: V has no other part"
    weights: dict[str, Weight]
    "by name"
    terms: dict[str, float]
    "of the proof, summed over the run, in the unit of V"
    beyond: dict[str, float]
    "that the proof does not have, summed over the run, in the unit of V"
    checks: list[Check]
    "not shown: nothing is said against it, nor for it"
    assumptions: list[Assumption]
    "needed: without it nothing of the proof stands"
    left_out: Count
    "cycles"
    missing: list[str]
    "gaps of the log, in words"
    rates_set: list[str]
    "tuning rates that --set changed, in words"


class Unknown(Struct):
    """No theorem is known of the law; the exit code is 0."""

    theorem: None
    why: str


def figures(
    name: str,
    controller: str,
    account: Account,
    left_out: int,
    missing: Sequence[str],
    rates_set: Sequence[str],
) -> Figures:
    """Return all figures."""
    proof, period_s = account.proof, account.period_s
    return Figures(
        rig=name,
        controller=controller,
        theorem=proof.theorem,
        error=proof.error_is,
        holds=account.holds,
        verdict=account.verdict,
        settled_s=account.settled_s,
        largest=account.largest,
        looseness=loose(account),
        unexplained=account.unexplained,
        steps=account.stepping,
        inequality_fails=account.failing.mean(),
        outside=account.outside.mean(),
        rising_outside=account.rising,
        start_within=account.start_within,
        dissipated=account.dissipation,
        w_max=proof.rest.max(),
        weights_max=proof.weights.max(),
        bound=account.own,
        bound_of_constants=account.stated,
        constants=proof.constants,
        weights={
            one.name: Weight(one.rate, one.seen(period_s), one.apart(period_s))
            for one in proof.tuned
        },
        terms=_sums(account, proof.terms),
        beyond=_sums(account, proof.beyond),
        checks=account.checks(),
        assumptions=list(proof.asked),
        left_out=left_out,
        missing=list(missing),
        rates_set=list(rates_set),
    )


def _sums(account: Account, terms: Mapping[str, Vector]) -> dict[str, float]:
    return {key: float(values[:-1] @ account.period_s) for key, values in terms.items()}


def loose(account: Account) -> float:
    """Return the bound over the largest |r| after the transient."""
    return account.own.error / account.largest if account.largest > 0.0 else math.inf


def lines(name: str, controller: str, account: Account, left_out: int = 0) -> list[str]:
    """Return the account in lines."""
    proof, own, stated = account.proof, account.own, account.stated
    energy = account.dissipation
    rows = [
        ("run", f"{name}, {controller}: {proof.theorem}"),
        ("error", f"{proof.error_is}, largest {account.largest:.3g} from {account.settled_s:g} s"),
        ("bound", f"{own.error:.3g} with the largest |w| of the run, {proof.rest.max():.3g}: "
                  f"{loose(account):.3g} times the largest; level set {own.level:.3g}"),
        ("constants", f"{stated.error:.3g} from the plant's alone; level set {stated.level:.3g}"),
        ("weights", f"|Z~| up to {proof.weights.max():.3g} of {own.weights:.3g}; Z* by "
                    f"{proof.ideal_by}"),
        ("start", f"S_r {account.start_within:.3g}" if account.start_within > 0.0 else
                  "S_r is empty: with these weights no start is known to stay in sight"),
        ("V", f"{proof.v[0]:.4g} to {proof.v[-1]:.4g}; dissipated {energy:.4g}, of which are"),
        *(("", f"{100.0 * total / energy if energy else math.nan:8.3g} %  {key}")
          for key, total in _sums(account, {**proof.terms, **proof.beyond}).items()),
        ("V'", f"above the proof's inequality in {100.0 * account.failing.mean():.3g} % of the "
               f"cycles; {_outside(account)}"),
    ]  # fmt: skip
    if left_out:
        seen = f"{proof.t_s[0]:.4g} to {proof.t_s[-1]:.4g} s"
        rows.insert(
            1,
            (
                "of it",
                f"{seen}, the longest stretch without a skipped cycle or a "
                f"missing record; {left_out} cycles are left out",
            ),
        )
    for one in proof.asked:
        if not one.needed:
            rows.append(("assumed" if one.holds else "not given", f"{one.what}: {one.found}"))
    for check in account.checks():
        mark = "holds" if check.holds else "VIOLATED" if check.shown else "NOT SHOWN"
        rows.append((mark, f"{check.name}: {check.found}"))
    return [f"{label:11}{line}" for label, line in rows]


def _outside(account: Account) -> str:
    share = 100.0 * float(account.outside.mean())
    if share == 0.0:
        return "never outside the ball"
    return f"outside the ball in {share:.3g} %, rising in {100.0 * account.rising:.3g} % of them"
