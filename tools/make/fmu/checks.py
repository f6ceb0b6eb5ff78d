"""What `pcpc check` tells of a rig's FMUs: what they are, and whether they keep up with the rig.

Each is made and stepped in a process of its own, since it is native code: a crash ends that alone.
Inputs stay at 0 and the steps are those of the rig, at most STEPS of them or MOST_S. Real-time
capable is an FMU of which not one step took longer than a period, on this machine as it is now.
"""

import faulthandler
import json
import multiprocessing
import signal
import time
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from pcpc.drivers.compiled.jit import JIT_OFF
from pcpc.executive.errors import RigError
from pcpc.executive.nodes import fmus
from pcpc.executive.nodes.plan import Plan
from pcpc.executive.rig import fmu_block
from pcpc.executive.rig.blocks import BlockSpec
from pcpc.tools.run.checked import Fmu

KEY = "fmus"  # of the report of a node
STEPS, MOST_S = 1000, 2.0
_HANGS_S = 60.0
_MOST_NAMES = 12  # of a line
_SHOWN = (("input",), ("output",), ("parameter", "start"))


def report(made: Plan) -> list[Fmu]:
    """Return for each FMU of a node what it is and how fast; RigError for one that cannot run."""
    return [_report(made, spec) for spec in made.spec.blocks if fmus.step_of(spec)]


def _report(made: Plan, spec: BlockSpec) -> Fmu:
    model, period_s = fmus.step_of(spec).model, 1.0 / made.rig.config.rate_hz
    steps = _in_a_child(spec, period_s)
    return Fmu(
        block=spec.name,
        model=model.name,
        fmi=model.fmi,
        made_by=model.made_by,
        sha256=model.sha256,
        variables=model.variables,
        steps=len(steps),
        median_us=1e-3 * float(np.median(steps)),
        worst_us=1e-3 * float(np.max(steps)),
        period_us=1e6 * period_s,
        real_time_capable=bool(1e-9 * np.max(steps) < period_s),
    )


def lines(about: dict[str, Any]) -> list[str]:
    """Return what is printed of an FMU."""
    by = f", {about['made_by']}" if about["made_by"] else ""
    yes = "yes" if about["real_time_capable"] else "no"
    return [
        f"  {about['block']}: FMU {about['model']}, FMI {about['fmi']}{by}, "
        f"sha256 {about['sha256'][:16]}",
        f"    real-time capable: {yes}; worst of {about['steps']} steps {about['worst_us']:.1f} "
        f"us, median {about['median_us']:.1f} us, of a period of {about['period_us']:g} us",
        *filter(None, (_names(about["variables"], *roles) for roles in _SHOWN)),
    ]


def _names(variables: list[dict[str, Any]], *roles: str) -> str:
    """Return the names of the variables of some roles, with unit and start; "" without any."""
    found = [one for role in roles for one in variables if one["role"] == role]
    words = [_word(one) for one in found[:_MOST_NAMES]]
    more = f" and {len(found) - len(words)} more, see --json" if len(found) > len(words) else ""
    return f"    {roles[0]}s: {', '.join(words)}{more}" if found else ""


def _word(one: dict[str, Any]) -> str:
    unit = f" {one['unit']}" if one.get("unit") else ""
    start = one.get("start")
    if start is None or one["role"] == "input":
        return f"{one['name']} [{one['unit']}]" if unit else str(one["name"])
    return f"{one['name']} = {start:g}{unit}"


def _in_a_child(spec: BlockSpec, period_s: float) -> list[int]:
    """Return how long each step took, ns; RigError."""
    context = multiprocessing.get_context("fork")
    here, there = context.Pipe(duplex=False)
    child = context.Process(target=_step_fmu, args=(spec, period_s, there))
    child.start()
    there.close()
    try:
        answer = json.loads(here.recv()) if here.poll(_HANGS_S) else {"error": "hangs"}
    except EOFError:
        child.join()
        code = child.exitcode or 0
        how = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        answer = {"error": f"{spec.where('law')}: {spec.name}: its process ended with {how}"}
    child.kill()
    child.join()
    if answer.get("error") == "hangs":
        what = f"does not answer within {_HANGS_S:g} s"
        raise RigError(f"{spec.where('law')}: {spec.name}: {what}")
    if "error" in answer:
        raise RigError(answer["error"])
    return list(answer["steps"])


def _step_fmu(spec: BlockSpec, period_s: float, there: Connection) -> None:

    faulthandler.disable()  # its end is told by how it ended
    try:
        one = fmus.Instance(spec, spec.where("law"))
    except RigError as error:
        there.send(json.dumps({"error": str(error)}))
        return
    block = spec.block
    p, x, u, y = (
        np.zeros(block.size(ports) + 1)
        for ports in (block.parameters, block.states, block.inputs, block.outputs)
    )
    for i, name in enumerate(name for port in block.parameters for name in port.names()):
        p[i] = float(f"{spec.settings[name]:.12g}")
    x[0] = float(one.address)
    views, took, end = (p, x, u, y), list[int](), time.monotonic() + MOST_S
    step = fmu_block.step if JIT_OFF else fmu_block.step.in_c
    given = views if JIT_OFF else [view.ctypes.data for view in views]
    for k in range(STEPS + 1):
        begin = time.perf_counter_ns()
        step(k * period_s, period_s, *given)
        took.append(time.perf_counter_ns() - begin)
        if time.monotonic() > end:
            break
    failed = one.failure()
    there.send(
        json.dumps(
            {"error": f"{spec.where('law')}: {failed}"} if failed else {"steps": took[1:] or took}
        )
    )
    one.close()
