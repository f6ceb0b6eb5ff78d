"""What `pcpc bounds` prints, and as JSON."""

import math
from collections.abc import Mapping

from pcpc.plants.lyapunov import Account
from pcpc.plants.weights import Vector
from pcpc.tools.study import result
from pcpc.tools.terminal import screen


def plain(name: str, controller: str, account: Account) -> dict[str, object]:
    """Return all figures as plain values; None for what is not finite."""
    proof = account.proof
    found = {
        "rig": name,
        "controller": controller,
        "theorem": proof.theorem,
        "error": proof.error_is,
        "holds": account.holds,
        "verdict": account.verdict,
        "settled_s": account.settled_s,
        "largest": account.largest,
        "looseness": loose(account),
        "unexplained": account.unexplained,
        "steps": account.stepping,
        "inequality_fails": account.failing.mean(),
        "outside": account.outside.mean(),
        "rising_outside": account.rising,
        "start_within": account.start_within,
        "dissipated": account.dissipation,
        "w_max": proof.rest.max(),
        "weights_max": proof.weights.max(),
        "bound": vars(account.own),
        "bound_of_constants": vars(account.stated),
        "constants": vars(proof.constants),
        "weights": {
            one.name: {
                "declared": one.rate,
                "moves_like": one.seen(account.period_s),
                "apart": one.apart(account.period_s),
            }
            for one in proof.tuned
        },
        "terms": _sums(account, proof.terms),
        "beyond": _sums(account, proof.beyond),
        "checks": account.checks(),
        "assumptions": proof.asked,
    }
    return result.plain(found)


def _sums(account: Account, terms: Mapping[str, Vector]) -> dict[str, float]:
    return {key: float(values[:-1] @ account.period_s) for key, values in terms.items()}


def loose(account: Account) -> float:
    """Return the bound over the largest |r| after the transient."""
    return account.own.error / account.largest if account.largest > 0.0 else math.inf


def lines(name: str, controller: str, account: Account, left_out: int = 0) -> list[str]:
    """Return the account in lines of 80 columns."""
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
        *(("", f"{100.0 * float(v[:-1] @ account.period_s) / energy:8.3g} %  {key}")
          for key, v in {**proof.terms, **proof.beyond}.items()),
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
    found = screen.rows(rows)
    for one in proof.asked:
        if not one.needed:
            found += screen.wrapped_lines(
                f"{one.what}: {one.found}", "assumed    " if one.holds else "not given  "
            )
    for check in account.checks():
        mark = "holds      " if check.holds else "VIOLATED   " if check.shown else "NOT SHOWN  "
        found += screen.wrapped_lines(f"{check.name}: {check.found}", mark)
    return found


def _outside(account: Account) -> str:
    share = 100.0 * float(account.outside.mean())
    if share == 0.0:
        return "never outside the ball"
    return f"outside the ball in {share:.3g} %, rising in {100.0 * account.rising:.3g} % of them"
