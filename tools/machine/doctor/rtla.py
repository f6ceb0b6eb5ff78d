"""Who delayed a wake-up, in the words of `rtla timerlat`, the kernel's own analysis.

It traces threads of its own and stops at the first that is later than LATE_US.
"""

import re
import subprocess
import tempfile
from collections.abc import Iterator

LATE_US = 100  # a tenth of the period at 1 kHz, as a late cycle
WORDS = ("rtla", "timerlat", "top", "-q", "-d", "3s", "--aa-only", str(LATE_US))
_PATIENCE_S = 20.0
_CPU = re.compile(r"## CPU (\d+) hit stop tracing")
_CAUSE = re.compile(r"\s*([A-Za-z][\w ]*?):?\s+(?:\([a-z ]+\)\s+)?([\d.]+) us \(\s*([\d.]+) ?%\)")
_WHO = re.compile(r"\s+(\S.*:\d+)\s+[\d.]+ us\s*")


def run() -> str:
    """Return who delayed a wake-up within 3 s, or why nobody knows."""
    try:
        with tempfile.TemporaryDirectory(prefix="pcpc-rtla-") as folder:  # it may write a trace
            done = subprocess.run(
                WORDS,
                capture_output=True,
                text=True,
                errors="replace",
                cwd=folder,
                timeout=_PATIENCE_S,
            )
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"not measured: {error}"
    found = list(culprits(done.stdout))
    if found:
        return "; ".join(found)
    if done.returncode:
        why = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
        return f"not measured: rtla: {why}"
    return f"no wake-up later than {LATE_US} us within 3 s"


def culprits(text: str) -> Iterator[str]:
    """Yield for each processor that `rtla timerlat` analysed its latency, the cause and its name.

    The cause is the greatest share; the thread or interrupt is that below it, else the blocking
    thread.
    """
    _, *parts = _CPU.split(text)
    for cpu, part in zip(parts[::2], parts[1::2], strict=True):
        causes: list[tuple[float, str, list[str]]] = []
        latency = ""
        for line in part.splitlines():
            if cause := _CAUSE.match(line):
                name, us, percent = cause.groups()
                if name == "Thread latency":
                    latency = us
                    break
                causes.append((float(percent), name, []))
            elif causes and (who := _WHO.fullmatch(line)):
                causes[-1][2].append(who[1])
        if causes and latency:
            share, name, named = max(causes)
            named = named or next((who for _, n, who in causes if n == "Blocking thread"), [])
            by = ", ".join(named) or "nobody named"
            yield f"CPU {cpu}: {latency} us, {share:.0f} % of it {name}: {by}"
