"""Hardware-in-the-loop in Python: a compiled real-time executive and a plant emulator on CAN.

    import pcpc

    run = pcpc.simulate("atb1000/hull", "pd_nn_fast", set={"barrel.gap_rad": 0.003}, seed=7)
    run["controller.e_rad"], run["plant:barrel.theta_rad"], run.t_s      arrays, a value a cycle
    run.metrics, run.verdict, run.figure(), run.frames, run.events       what it came to
    run.check()                                                          raises if it is not ok

    with pcpc.running("atb1000/hull", pacing="real") as live:            real processes, a bus
        live["controller.e_rad"]
        live.set({"controller.kv_Nms_rad": 120.0})
        live.wait_until("controller.e_rad", below=1e-3, within_s=2)
    live.run                                                             its record

    for sample in (loop := pcpc.loop("atb1000/hull")):                   your controller
        sample.command["motor_torque_Nm"] = my_law(sample)
    loop.run

    run = pcpc.open("runs/20260101T120000Z-hull")                        the same of any log
    many = pcpc.sweep("atb1000/hull", ["pd", "pd_nn"], vary={"barrel.gap_rad": "x0.5:2"}, draws=200)
    many.table, many.failures("pd"), many.report("report")               thousands of runs

    pcpc.margin("sin0.5", "pd").phase_margin_deg                         how stable a loop is
    pcpc.bounds("deadzone-sine", "nn").holds                             a law's theorem on a run

    pcpc.compare(run, other).markdown()                                  what two runs differ in
    pcpc.fit("atb1000/slew10", run)["barrel.gap_rad"].value              parameters from a log
"""

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pcpc.drivers.errors import UserError as Error
    from pcpc.tools.study.bounds.api import bounds as bounds
    from pcpc.tools.after.compare.api import compare as compare
    from pcpc.tools.study.fit.api import fit as fit
    from pcpc.tools.api.live import Live as Live, NotMet as NotMet, running as running
    from pcpc.tools.api.loop import Loop as Loop, Sample as Sample, loop as loop
    from pcpc.tools.after.record import Figure as Figure, NotOk as NotOk, Run as Run, UnknownName as UnknownName
    from pcpc.tools.api.simulate import open as open, simulate as simulate
    from pcpc.tools.study.sweep.api import Sweep as Sweep, sweep as sweep
    from pcpc.tools.study.bounds.bounds import Bounds as Bounds
    from pcpc.tools.after.compare.comparison import Comparison as Comparison
    from pcpc.tools.study.fit.result import Fit as Fit
    from pcpc.tools.study.margin.find import margin as margin
    from pcpc.tools.study.margin.margins import Margins as Margins
    from pcpc.tools.study.margin.result import Margin as Margin, Response as Response

_WHERE = {
    "Bounds": "tools.study.bounds.bounds", "bounds": "tools.study.bounds.api",
    "Comparison": "tools.after.compare.comparison", "compare": "tools.after.compare.api",
    "Error": "drivers.errors:UserError",
    "Fit": "tools.study.fit.result", "fit": "tools.study.fit.api",
    "Figure": "tools.after.record", "NotOk": "tools.after.record", "Run": "tools.after.record",
    "UnknownName": "tools.after.record",
    "Loop": "tools.api.loop", "Sample": "tools.api.loop", "loop": "tools.api.loop",
    "Live": "tools.api.live", "NotMet": "tools.api.live", "running": "tools.api.live",
    "Margin": "tools.study.margin.result", "Margins": "tools.study.margin.margins",
    "Response": "tools.study.margin.result", "margin": "tools.study.margin.find",
    "open": "tools.api.simulate", "simulate": "tools.api.simulate",
    "Sweep": "tools.study.sweep.api", "sweep": "tools.study.sweep.api",
}  # fmt: skip
_HERE = Path(__file__).parent
_PLACES = {name: place.partition(":")[0].replace(".", "/") for name, place in _WHERE.items()}
__all__ = sorted(name for name, at in _PLACES.items() if (_HERE / f"{at}.py").is_file())


def __getattr__(name: str) -> Any:
    """Import what is asked for, not before: the command line needs a part of it only."""
    if name not in __all__:  # or its room was taken out
        raise AttributeError(f"module pcpc has no attribute {name}")
    module, _, other = _WHERE[name].partition(":")
    return getattr(import_module(f"pcpc.{module}"), other or name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
