"""`pcpc log require`: judge a log by the requirements of its rig, or by others."""

import argparse
import tempfile
from pathlib import Path

from pcpc.drivers.errors import Exit
from pcpc.executive.errors import RigError
from pcpc.executive.log import long_logs
from pcpc.executive.log import reader as logs
from pcpc.tools.after.log import rig as log_rig
from pcpc.tools.terminal import screen
from pcpc.tools.terminal.outfile import LogCommandError
from pcpc.tools.terminal.progress import Progress


def command(options: argparse.Namespace) -> int:
    """Print what became of each requirement; return the exit code.

    LogCommandError: nothing to judge.
    """
    from pcpc.tools.after.verdict import summary_file  # numba
    from pcpc.tools.after.verdict.judge import Judge

    path, progress = options.log, Progress(options.quiet)
    settings = [f"require=[{', '.join(f'{{{one}}}' for one in options.require)}]"]
    with tempfile.TemporaryDirectory() as folder:
        head = logs.head(path)
        try:
            asked = settings if options.require else ()
            rig, note = log_rig.judged_rig(head, Path(folder), options, asked)
        except RigError as error:
            what = str(error).replace(f"--set {settings[0]}", "--require")
            raise LogCommandError(what) from None
        if note:
            progress.say(f"{path}: {note}")
        judge = Judge.of(rig)
        log = long_logs.read(path, lambda log: judge.needed_columns(log, False))
        found = judge.requirements(log)
    if not found:
        name = rig.config.controller
        raise LogCommandError(f"{path}: its rig requires nothing of {name}; try --require")
    if options.json:
        print(summary_file.text_of([one.json() for one in found]))
    for one in () if options.json else found:
        print("\n".join(screen.wrapped_lines(str(one), "", "    ")))
    if any(one.held is False for one in found) or not any(one.held for one in found):
        return Exit.NOT_MET  # one that nothing could be judged of is not met either
    return Exit.LOSS if log.missing else Exit.OK
