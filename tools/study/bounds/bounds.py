"""`pcpc bounds RIG|LOG`: a run compared with the theorem of its law.

V and its two derivatives, w, the ultimate bound and S_r, as plants/lyapunov.py says, with the
terms of the theorem.py that lies beside the plant's model or in `book/` there. A rig is run in
virtual time, a log is recomputed: weights stand in none.
"""

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pcpc import plants
from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.errors import did_you_mean
from pcpc.executive.log import reader as logs
from pcpc.executive.own_laws.law_errors import cause
from pcpc.executive.rig.blocks import BlockSpec, law_keys
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.executive.rig.roles import Role
from pcpc.plants.declared import declared
from pcpc.plants.judging import Run, effective_rig
from pcpc.plants.lyapunov import Account
from pcpc.plants.theorem import Cycles, NoTheorem, Theorem
from pcpc.tools.after.log.recorded import LATEST, known_logs, log_of
from pcpc.tools.after.trust import ASKED, Trust
from pcpc.tools.start.rigs import find
from pcpc.tools.study.bounds import figure, observed, text
from pcpc.tools.study.bounds.commands import BoundsRequest
from pcpc.tools.study.bounds.observed import BoundsError
from pcpc.tools.study.result import plain
from pcpc.tools.terminal import screen
from pcpc.tools.terminal.picture import check_picture

SHIPPED = Path(plants.__file__).parent
PLACES = ("theorem.py", "book/theorem.py")  # beside a model; a wheel has no book


@dataclass(frozen=True)
class Bounds:
    """The account of a run and its theorem; `left_out`: cycles that are not in it.

    `missing`: gaps of the log, in words; `rates_set`: tuning rates that --set changed.
    """

    name: str
    controller: str
    account: Account
    left_out: int = 0
    missing: tuple[str, ...] = ()
    rates_set: tuple[str, ...] = ()

    @property
    def holds(self) -> bool:
        """Whether all is shown and nothing violated in a whole log; see `account.checks()`."""
        return self.account.holds and not self.missing

    def draw(self, path: str | Path) -> Path:
        """Draw V, its derivatives, error and weights with their bounds; return `path`."""
        figure.draw(self.account, f"{self.name}, {self.controller}", Path(path))
        return Path(path)

    def to_dict(self) -> dict[str, object]:
        """Return all figures as plain values, for JSON."""
        return plain(text.figures(self.name, self.controller, self.account, self.left_out,
                                  self.missing, self.rates_set))  # fmt: skip

    def __str__(self) -> str:
        found = text.lines(self.name, self.controller, self.account, self.left_out)
        for one in self.rates_set:
            found.append(f"by --set   {one}: the theorem is judged with the rate that was set")
        return "\n".join(screen.fitted(found))


def command(request: BoundsRequest) -> int:
    """Print the account; NOT_MET if it does not hold, LOSS in a log that is not whole.

    OK also where no theorem is known.
    """
    check_picture("--plot", request.plot)
    code = request.code
    trust = Trust(code.trust, code.law, code.rig, code.fmu)
    try:
        with np.errstate(all="ignore"):  # a run may leave what floats hold: it violates V
            found = bounds_of(request.what, request.controller, request.set, request.law_as, trust)
            shown = json.dumps(found.to_dict(), indent=1) if request.json else str(found)
    except NoTheorem as error:
        if request.json:
            print(screen.json_text(text.Unknown(None, str(error)), None))
        else:
            print(f"no theorem: {error}")
        return Exit.OK
    print(shown)
    if request.plot is not None:
        found.draw(request.plot)
    for line in screen.fitted(f"missing  {one}" for one in found.missing):
        print(line, file=sys.stderr)
    if not found.account.holds:
        return Exit.NOT_MET
    return Exit.LOSS if found.missing else Exit.OK


def bounds_of(
    what: str,
    controller: str | None = None,
    settings: Sequence[str] = (),
    law_as: str | None = None,
    trust: Trust = ASKED,
) -> Bounds:
    """Return the account of a rig or a log; NoTheorem, BoundsError, RigError, LogError.

    `law_as`: by the theorem of another law; `trust`: of a log.
    """
    path = Path(what)
    if what == LATEST or path.suffix == ".mcap" or (path.is_dir() and any(path.glob("*.mcap"))):
        log = log_of(what)
        if controller or settings:
            raise BoundsError(f"{log}: --controller and --set need a rig; a log cannot be changed")
        return _of_log(log, law_as, trust)
    return of_rig(load_rig(find(what, known_logs(what)), controller, settings), law_as)


def of_rig(rig: Rig, law_as: str | None = None) -> Bounds:
    """Run a rig in virtual time and return its account; NoTheorem, RigError."""
    theorem = theorem_of(rig, law_as)
    log = observed.of_rig(rig, theorem.states)
    given = rig.evaluation
    begin = given.window_s[0] if given and given.window_s else None
    return _account(rig, theorem, log, begin)


def _of_log(path: Path, law_as: str | None, trust: Trust) -> Bounds:
    made: list[Theorem] = []

    def states(rig: Rig) -> tuple[str, ...]:
        made.append(theorem_of(rig, law_as))
        return tuple(made[0].states)

    rig, log = observed.of_log(path, states, trust)
    window = (effective_rig(log).get("evaluation") or {}).get("window_s")
    found = _account(rig, made[0], log, float(window[0]) if window else None)
    return replace(found, rates_set=_rate_settings(rig, made[0], log))


def _rate_settings(rig: Rig, theorem: Theorem, log: logs.Log) -> tuple[str, ...]:
    """Return the tuning rates of a log's run that are not those of its rig's files, in words."""
    role, spec = _tuned_block(rig, theorem)
    own = {one.name: one.default for one in spec.block.settings if isinstance(one.default, float)}
    own |= observed.given_rates(log, law_keys(rig.config, role, spec.name), theorem.said_by)
    return tuple(
        f"{name} {spec.settings[name]:g}, in the rig {own[name]:g}"
        for name in theorem.said_by
        if name in own and spec.settings[name] != own[name]
    )


def _account(rig: Rig, theorem: Theorem, log: logs.Log, begin_s: float | None) -> Bounds:
    run = Run(log, 1.0 / rig.config.rate_hz)
    if not run.plant_tells:
        raise NoTheorem("the log has no record of the plant, from which w is computed")
    cycles = Cycles(run, declared_rates(rig, theorem))
    try:
        proof = theorem.prove(cycles)
    except (NoTheorem, UserError):
        raise
    except Exception as error:
        raise BoundsError(cause(error)) from None
    settled_s = float(proof.t_s[len(proof.t_s) // 2])
    if begin_s is not None and begin_s < proof.t_s[-1]:
        settled_s = begin_s
    account = Account(proof, settled_s)
    missing = tuple(log.missing)
    return Bounds(rig.config.rig, rig.config.controller, account, cycles.left_out, missing)


def declared_rates(rig: Rig, theorem: Theorem) -> dict[str, float]:
    """Return the tuning rates of a theorem as the rig file declares them, whatever --set says."""
    role, spec = _tuned_block(rig, theorem)
    keys = (*law_keys(rig.config, role, spec.name), "parameters")
    tried = [name for name in theorem.said_by if rig.document.place((*keys, name)).option]
    settings = dict(spec.settings)
    if tried:
        own = _tuned_block(load_rig(rig.path, rig.config.controller), theorem)[1].settings
        settings |= {name: own[name] for name in tried}
    return theorem.declared(settings)


def _tuned_block(rig: Rig, theorem: Theorem) -> tuple[Role, BlockSpec]:
    return next(
        (role, spec)
        for role, node in rig.nodes().items()
        for spec in node.blocks
        if spec.name == theorem.block
    )


def model_files(rig: Rig) -> list[Path]:
    """Return where the steps of a rig's plant are written."""
    steps = (getattr(spec.block.step, "py_func", None) for spec in rig.nodes()["plant"].blocks)
    return [Path(step.__code__.co_filename) for step in steps if step]


def known_theorems(rig: Rig) -> dict[str, Theorem]:
    """Return the theorems of a rig's plant, by law; BoundsError for a file that declares none."""
    found: dict[str, Theorem] = {}
    for file in (model.parent / place for model in model_files(rig) for place in PLACES):
        if file.is_file():
            theorems = getattr(declared(file, BoundsError), "THEOREMS", None)
            if not isinstance(theorems, dict):
                what = 'expected THEOREMS = {"law": Theorem(...)} of pcpc.plants.theorem'
                raise BoundsError(f"{file}: {what}")
            found |= theorems
    return found


def theorem_of(rig: Rig, law_as: str | None = None) -> Theorem:
    """Return the theorem of a rig's law, or of the law `law_as` of its plant; NoTheorem."""
    law, theorems = law_as or law_of(rig, rig.config.controller), known_theorems(rig)
    if law in theorems:
        if not isinstance(theorems[law], Theorem):
            raise BoundsError(f"{law}: no Theorem(...) of pcpc.plants.theorem")
        return theorems[law]
    shipped = any(file.is_relative_to(SHIPPED) for file in model_files(rig))
    if shipped and not any(SHIPPED.glob(f"*/{PLACES[1]}")):
        raise NoTheorem("the proofs of shipped systems are in the repository of pcpc only")
    if law_as:
        raise BoundsError(f"--as {law_as}: no such law{did_you_mean(law_as, theorems)}")
    have = f"; its plant has those of {', '.join(sorted(theorems))}" if theorems else ""
    raise NoTheorem(f"none is known here of the law {law}{have}")


def law_of(rig: Rig, controller: str) -> str:
    """Return the law of a controller of a rig, as the rig names it."""
    return str(rig.config.controllers[controller].law)
