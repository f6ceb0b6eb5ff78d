"""`pcpc experiment rough`: what a rougher world costs each law of the barrel."""

from pathlib import Path

from pcpc.plants.atb1000 import study_rough
from pcpc.tools.console.progress import Progress
from pcpc.tools.experiment import run_studies


def run(folder: Path, progress: Progress, jobs: int | None) -> int:
    """Run the study; NOT_MET if a run failed."""
    return run_studies([study_rough], folder, progress, jobs)
