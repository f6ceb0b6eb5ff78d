"""`pcpc report --require`: judge a log by the requirements of its rig, or by others."""

import sys
from pathlib import Path

from pcpc.drivers.errors import Exit
from pcpc.executive.errors import RigError
from pcpc.tools.after.log.commands import Requirements
from pcpc.tools.after.opened import opened
from pcpc.tools.after.trust import Trust, words_of
from pcpc.tools.terminal import screen
from pcpc.tools.terminal.outfile import LogCommandError
from pcpc.tools.terminal.progress import Progress
from pcpc.tools.terminal.request import Offers


def tell_requirements(path: Path, beside: Offers, trust: Trust, quiet: bool) -> int:
    """Print what became of each requirement; return the exit code.

    LogCommandError: nothing to judge.
    """
    from pcpc.tools.after.verdict import summary_file  # numba
    from pcpc.tools.after.verdict.judge import Judge

    request, progress = beside.of(Requirements), Progress(quiet)
    settings = [f"require=[{', '.join(f'{{{one}}}' for one in request.require)}]"]
    with opened(path, trust) as run:
        try:
            rig, note = run.judged(settings if request.require else ())
            if note:
                progress.say(f"{path}: {note}")
            judge = Judge.of(rig)
            log = run.part(lambda log: judge.needed_columns(log, False))
            results = judge.requirements(log)
        except RigError as error:
            what = words_of(error).replace(f"--set {settings[0]}", "--require")
            raise LogCommandError(what) from None
    if not results:
        name = rig.config.controller
        raise LogCommandError(f"{path}: its rig requires nothing of {name}; try --require")
    screen.answer(request.json, [one.json() for one in results], map(str, results), 2)
    if doubt := summary_file.beside(path)[1]:
        print(f"{path}: {doubt}", file=sys.stderr)
    if doubt or any(one.held is False for one in results) or not any(one.held for one in results):
        return Exit.NOT_MET  # one that nothing could be judged of is not met either
    return Exit.LOSS if log.missing else Exit.OK
