"""`pcpc experiment rough`: what a rougher world costs each law of the barrel."""

from pathlib import Path

from pcpc.plants.atb1000.book import study_rough
from pcpc.tools.study.experiment.cli import run_studies
from pcpc.tools.terminal.progress import Progress


def run(folder: Path, progress: Progress, jobs: int | None) -> int:
    """Run the study; NOT_MET if a run failed."""
    return run_studies([study_rough], folder, progress, jobs)
