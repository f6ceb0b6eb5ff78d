"""A run of a system's rig in virtual time, judged."""

from pathlib import Path
from types import ModuleType

from pcpc.executive.log.reader import Log
from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.rig.reading import load_rig


def judged(
    evaluation: ModuleType, rig: str, controller: str | None, *settings: str
) -> tuple[Log, dict[str, float]]:
    """Return log and metrics of a rig of the system whose evaluation is given."""
    folder = Path(str(evaluation.__file__)).parent
    loaded = load_rig(folder / f"rigs/{rig}.yaml", controller, settings)
    log, of = in_memory(loaded), loaded.evaluation
    assert of is not None
    period_s = 1.0 / loaded.config.rate_hz
    return log, evaluation.EVALUATION.judge(log, of.window_s, of.numbers, period_s)
