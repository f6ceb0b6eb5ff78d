"""`pcpc play` against a plain player in C (`play.c`) on the same recording, bus and settings.

Both play the whole log at its own speed, in turn: C, Python, C, ... A slow or busy moment of the
machine falls on both. Their figures are the timing errors of each round; the ratio is that of the
medians over the rounds.

    python -m pcpc.tools.dev.bench.play LOG [--bus udp_multicast:239.74.163.7:43117] [--rounds 5]
"""

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pcpc.drivers.can import bus as buses
from pcpc.drivers.can import can_id
from pcpc.drivers.errors import Exit
from pcpc.executive.log import reader as logs
from pcpc.tools.after.log import frames as play_frames
from pcpc.tools.after.log.frames import Frames
from pcpc.tools.cli import parsed_options
from pcpc.tools.machine.jitter.compiler import compile_to
from pcpc.tools.terminal.ending import exit_code
from pcpc.tools.terminal.progress import Progress

SOURCE = Path(__file__).with_name("play.c")
BUS = "udp_multicast:239.74.163.7:43117"
FIGURES = ("p50", "p99", "max")


def build(folder: Path) -> Path:
    """Compile play.c into `folder`; CompilerError."""
    compile_to(folder / "play", [SOURCE], ["-O2"])
    return folder / "play"


def candump_text(frames: Frames) -> str:
    """Return frames as `candump -L` writes them, with nanoseconds."""
    lines = []
    for stamp, word, raw in zip(frames.stamp_ns, frames.words, frames.raw, strict=True):
        seconds, ns = divmod(int(stamp), 1_000_000_000)
        data = raw[8 : 8 + min(int(raw[4]), 8)].tobytes().hex().upper()
        lines.append(f"({seconds}.{ns:09d}) can0 {can_id.text_of(int(word))}#{data}\n")
    return "".join(lines)


def run_c(program: Path, text: Path, bus: buses.Bus) -> dict[str, Any]:
    """Play once in C and return its figures; OSError, ValueError if it fails."""
    place = bus.channel
    if bus.interface == "udp_multicast":
        place = "{}:{}".format(*buses.udp_address(bus.channel))
    words = [str(program), str(text), place, str(parsed_options(["play", str(text)]).priority)]
    return dict(json.loads(subprocess.run(words, capture_output=True, text=True).stdout))


def run_python(log: Path, bus: buses.Bus, words: Sequence[str] = ()) -> dict[str, Any]:
    """Play once with `pcpc play` and return its figures."""
    line = [sys.executable, "-P", "-m", "pcpc.tools.cli", "play", str(log), "--bus", str(bus)]
    line += ["--json", "--quiet", *words]
    return dict(json.loads(subprocess.run(line, capture_output=True, text=True).stdout))


def scheduled_frames(log: Path, words: Sequence[str]) -> Frames:
    """Return the frames that `pcpc play LOG WORDS` sends, at the times at which it does."""
    options = parsed_options(["play", str(log), *words])
    frames = play_frames.choose(play_frames.bus_frames(logs.read(log)), options, str(log))
    since = frames.stamp_ns - frames.stamp_ns[0]
    return replace(frames, stamp_ns=np.rint(since / options.rate).astype(np.int64))


def compare(
    log: Path, bus: buses.Bus, rounds: int, progress: Progress, words: Sequence[str] = ()
) -> dict[str, list[Any]]:
    """Play `rounds` times with each, in turn; return the figures of all rounds by player.

    `words` are options of `pcpc play` that choose frames or a rate above 0.
    """
    out: dict[str, list[Any]] = {"C": [], "Python": []}
    with tempfile.TemporaryDirectory() as folder:
        program, text = build(Path(folder)), Path(folder) / "log"
        text.write_text(candump_text(scheduled_frames(log, words)))
        for number in range(rounds):
            progress.show(f"round {number + 1} of {rounds}")
            out["C"].append(run_c(program, text, bus))
            out["Python"].append(run_python(log, bus, words))
    progress.close()
    return out


def ratio(rounds: dict[str, list[Any]], figure: str) -> float:
    """Return Python over C of a timing error, medians over the rounds."""
    medians = {
        name: statistics.median(one["timing_error_us"][figure] for one in all_of)
        for name, all_of in rounds.items()
    }
    return medians["Python"] / medians["C"]


def main() -> int:
    """Compare on one log; print a line a round and player."""
    parser = argparse.ArgumentParser("pcpc.tools.dev.bench.play")
    parser.add_argument("log", type=Path)
    parser.add_argument("--bus", default=BUS)
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    bus = buses.bus_named(*buses.parse(options.bus))
    rounds = compare(options.log, bus, options.rounds, Progress())
    for number in range(options.rounds):
        for name in rounds:
            one = rounds[name][number]
            late = "  ".join(f"{key} {one['timing_error_us'][key]:7.1f}" for key in FIGURES)
            print(
                f"{name:7} {one['frames']} frames  us: {late}  within 200 us "
                f"{one['within_200us_percent']:.3f} %  total {one['total_error_percent']:+.6f} %"
            )
    print("Python/C  " + "  ".join(f"{key} {ratio(rounds, key):.2f}" for key in FIGURES))
    return Exit.OK


if __name__ == "__main__":
    sys.exit(exit_code(main, goes_on=False))
