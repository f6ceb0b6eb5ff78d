"""A plant of its own: a mass on a spring, its law, rig and evaluation, as texts and as a run."""

from pathlib import Path

from processes import ROOT

from pcpc.executive.nodes.virtual import simulate
from pcpc.executive.rig.reading import load_rig

MODEL = '''\
"""A mass on a spring: m x'' = F - k x - c x'; one symplectic Euler step a cycle."""

from pcpc.executive.laws.block import Block, Ports, port, stage


class Parameters(Ports):
    mass_kg = port("kg", "m", None, 0.1, 100.0)
    spring_N_m = port("N/m", "k", None, 0.0, 1e4)
    damping_Ns_m = port("N s/m", "c", None, 0.0, 1e3)


class States(Ports):
    x_m = port("m", "position")
    v_m_s = port("m/s", "velocity")


class Inputs(Ports):
    force_N = port("N", "newest command")


class Outputs(Ports):
    position_m = port("m", "the sample")


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    if t > 0.0:
        force = u.force_N - p.spring_N_m * x.x_m - p.damping_Ns_m * x.v_m_s
        x.v_m_s += dt / p.mass_kg * force
        x.x_m += dt * x.v_m_s
    y.position_m = x.x_m


BLOCK = Block(step)
'''
LAW = '''\
"""Integral control: F' = ki (target - x)."""

from pcpc.executive.laws.block import Block, Ports, port, stage


class Gains(Ports):
    ki_N_ms = port("N/(m s)", "gain", None, 0.0, 1e4)
    target_m = port("m", "where to", None, -10.0, 10.0)


class States(Ports):
    sum_N = port("N", "integral")


class Inputs(Ports):
    position_m = port("m", "measured")


class Outputs(Ports):
    force_N = port("N", "command")


@stage
def step(t: float, dt: float, p: Gains, x: States, u: Inputs, y: Outputs) -> None:
    x.sum_N += dt * p.ki_N_ms * (p.target_m - u.position_m)
    y.force_N = x.sum_N


BLOCK = Block(step)
'''
RIG = """\
rig: spring
dbc: spring.dbc
rate_hz: 500.0
duration_s: 3.0
controller: integral
controllers:
  integral: {law: law.py:BLOCK, parameters: {ki_N_ms: 20.0, target_m: 0.5}}
supervisor: {hold_cycles: 1000, fault_after_cycles: 1001}
executive:
  node: EXEC
  blocks:
    controller: {inputs: {position_m: rx.FB.position}}
  transmit:
    CMD.command: controller.force_N
    CMD.mode: supervisor.state
    HB_EXEC.nmt_state: supervisor.nmt
plant:
  node: PLANT
  blocks:
    spring:
      law: model.py:BLOCK
      parameters: {mass_kg: 1.0, spring_N_m: 20.0, damping_Ns_m: 9.0}
      inputs: {force_N: rx.CMD.command}
  transmit: {FB.position: spring.position_m, HB_PLANT.nmt_state: supervisor.nmt}
  safe: {CMD.command: 0.0}
evaluation: {file: evaluation.py, window_s: [2.5, 3.0]}
expect:
  integral: {end_m: [0.45, 0.55]}      # a hundredth of the way is left then
"""
EVALUATION = """\
from pcpc.plants.evaluation import BLUE, RUN, Evaluation, Last, Line, Panel

POSITION = "plant:spring.position_m"
EVALUATION = Evaluation(
    merits={"end_m": Last(POSITION, RUN)},
    panels=(Panel("position [m]", (Line(POSITION, "mass", BLUE),)),),
    notes=(("ends at {end_m:.3f} m",), ()),
)
"""


def spring_dbc() -> str:
    """Return the frames of the probe with the units of a spring."""
    dbc = (ROOT / "plants" / "probe" / "probe.dbc").read_text(encoding="utf-8")
    dbc = dbc.replace('2147.483647] "" PLANT', '2147.483647] "N" PLANT')
    return dbc.replace('2147.483647] "" EXEC', '2147.483647] "m" EXEC')


def spring_run(folder: Path) -> Path:
    """Run a plant of its own, whose evaluation imports a module beside it; return the log."""
    evaluation = EVALUATION.replace("POSITION =", "from words import MASS\n\nPOSITION =")
    texts = {
        "model.py": MODEL, "law.py": LAW, "spring.yaml": RIG, "spring.dbc": spring_dbc(),
        "evaluation.py": evaluation.replace('"mass"', "MASS"), "words.py": "MASS = 'mass'\n",
    }  # fmt: skip
    folder.mkdir()
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    simulate(load_rig(folder / "spring.yaml", settings=["duration_s=0.1"]), folder / "log.mcap")
    return folder / "log.mcap"
