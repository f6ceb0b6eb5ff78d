"""What `pcpc bounds --plot` draws: V, its derivative by the run and by the proof, |r| and |Z~|."""

from pathlib import Path

import numpy as np

from pcpc.plants.lyapunov import Account
from pcpc.plants.pages import BLACK, BLUE, GREEN, GREY, POINTS, VERMILION, bare, sheet
from pcpc.plants.weights import Vector

SKY_WIDE = "#A9D5EE"  # below a thin line
SMOOTH_S = 0.02  # of drawn derivatives: a mean over so long


def draw(account: Account, title: str, path: Path) -> None:
    """Draw an account; OSError."""
    proof = account.proof
    page, axes = sheet((9.0, 8.4), 110, 4, sharex=True)
    t, thin = proof.t_s, slice(None, None, max(1, len(proof.t_s) // POINTS))
    axes[0].plot(t[thin], proof.v[thin], color=BLACK, linewidth=1.1, label="V")
    for values, colour, label, width in (
        (account.slope, SKY_WIDE, "V' of the run", 3.0),
        (account.proved_slope, BLACK, "V' of the proof", 0.8),
    ):
        axes[1].plot(
            t[:-1][thin], _mean(account, values)[thin], color=colour, linewidth=width, label=label
        )
    axes[1].set_yscale("symlog", linthresh=_scale(account.slope))
    axes[2].plot(t[thin], proof.error[thin], color=BLUE, linewidth=1.1, label=proof.error_is)
    axes[3].plot(t[thin], proof.weights[thin], color=GREEN, linewidth=1.1, label="|Z~|")
    for axis, bound in ((axes[2], account.own.error), (axes[3], account.own.weights)):
        axis.axhline(bound, color=VERMILION, linewidth=1.1, label=f"bound {bound:.3g}")
    axes[2].set_yscale("log")
    seen = proof.error[(proof.error > 0.0) & np.isfinite(proof.error)]
    if len(seen):
        reach = account.own.error if np.isfinite(account.own.error) else 0.0
        axes[2].set_ylim(max(float(np.quantile(seen, 0.02)), 1e-6 * reach))
    axes[3].set_ylim(0.0)
    if account.start_within > 0.0:
        axes[2].axhline(
            account.start_within,
            color=GREY,
            linestyle="--",
            linewidth=1.0,
            label=f"S_r {account.start_within:.3g}",
        )
    axes[2].axvspan(t[0], account.settled_s, color="#ECEFF3", zorder=-1)
    for axis in axes:
        bare(axis)
        axis.legend(frameon=False, fontsize=8, loc="upper right", ncols=3)
    share = f"{100.0 * account.unexplained:.2g} % not explained"
    axes[0].set_title(f"{title}: {proof.theorem}, {share}", loc="left", fontsize=11)
    axes[-1].set_xlabel("t [s]")
    page.savefig(path)


def _mean(account: Account, values: Vector) -> Vector:
    """Return the running mean over `SMOOTH_S`."""
    width = max(1, round(SMOOTH_S / float(np.median(np.diff(account.proof.t_s)))))
    if width >= len(values):
        return values
    return np.convolve(values, np.full(width, 1.0 / width), mode="same")


def _scale(values: Vector) -> float:
    found = float(np.quantile(np.abs(values), 0.7))
    return found if 0.0 < found < np.inf else 1.0
