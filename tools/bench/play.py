"""`pcpc play` against a plain player in C (`play.c`) on the same recording, bus and settings.

Both play the whole log at its own speed, in turn: C, Python, C, ... A slow or busy moment of the
machine falls on both. Their figures are the timing errors of each round; the ratio is that of the
medians over the rounds.

    python -m tools.bench.play LOG [--bus udp_multicast:239.74.163.7:43117] [--rounds 5]
"""

import argparse
import json
import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from drivers import bus as buses
from executive import logs
from tools import play_frames
from tools.play import PRIORITY, words_of
from tools.play_frames import Frames
from tools.progress import Progress

SOURCE = Path(__file__).with_name("play.c")
BUS = "udp_multicast:239.74.163.7:43117"
FIGURES = ("p50", "p99", "max")


class CompilerError(Exception):
    """There is no C compiler, or it refuses play.c. One line, ready to print."""


def build(folder: Path) -> Path:
    """Compile play.c into `folder`; CompilerError."""
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        raise CompilerError("no C compiler; run: sudo apt-get install -y gcc libc6-dev")
    out = folder / "play"
    done = subprocess.run(
        [compiler, "-O2", "-o", str(out), str(SOURCE)], capture_output=True, text=True
    )
    if done.returncode:
        raise CompilerError(f"{SOURCE}: {done.stderr.strip().splitlines()[-1]}")
    return out


def candump_text(frames: Frames) -> str:
    """Return frames as `candump -L` writes them, with nanoseconds."""
    lines = []
    for stamp, word, raw in zip(frames.stamp_ns, frames.words, frames.raw, strict=True):
        number = f"{int(word) & 0x1FFFFFFF:{'08X' if int(word) >> 31 else '03X'}}"
        seconds, ns = divmod(int(stamp), 1_000_000_000)
        data = raw[8 : 8 + min(int(raw[4]), 8)].tobytes().hex().upper()
        lines.append(f"({seconds}.{ns:09d}) can0 {number}#{data}\n")
    return "".join(lines)


def run_c(program: Path, text: Path, bus: buses.Bus) -> dict[str, Any]:
    """Play once in C and return its figures; OSError, ValueError if it fails."""
    place = bus.channel
    if bus.interface == "udp_multicast":
        place = "{}:{}".format(*buses.udp_address(bus.channel))
    words = [str(program), str(text), place, str(PRIORITY)]
    return dict(json.loads(subprocess.run(words, capture_output=True, text=True).stdout))


def run_python(log: Path, bus: buses.Bus) -> dict[str, Any]:
    """Play once with `pcpc play` and return its figures."""
    words = [*words_of(str(log)), "--bus", str(bus), "--json", "--quiet"]
    return dict(json.loads(subprocess.run(words, capture_output=True, text=True).stdout))


def compare(log: Path, bus: buses.Bus, rounds: int, progress: Progress) -> dict[str, list[Any]]:
    """Play `rounds` times with each, in turn; return the figures of all rounds by player."""
    out: dict[str, list[Any]] = {"C": [], "Python": []}
    with tempfile.TemporaryDirectory() as folder:
        program, text = build(Path(folder)), Path(folder) / "log"
        text.write_text(candump_text(play_frames.of(logs.read(log))))
        for number in range(rounds):
            progress.show(f"round {number + 1} of {rounds}")
            out["C"].append(run_c(program, text, bus))
            out["Python"].append(run_python(log, bus))
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
    parser = argparse.ArgumentParser("tools.bench.play")
    parser.add_argument("log", type=Path)
    parser.add_argument("--bus", default=BUS)
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    bus = buses.choose(*buses.parse(options.bus))
    try:
        rounds = compare(options.log, bus, options.rounds, Progress())
    except (CompilerError, logs.LogError, play_frames.PlayError) as error:
        print(error, file=sys.stderr)
        return 2
    for number in range(options.rounds):
        for name in rounds:
            one = rounds[name][number]
            late = "  ".join(f"{key} {one['timing_error_us'][key]:7.1f}" for key in FIGURES)
            print(
                f"{name:7} {one['frames']} frames  us: {late}  within 200 us "
                f"{one['within_200us_percent']:.3f} %  total {one['total_error_percent']:+.6f} %"
            )
    print("Python/C  " + "  ".join(f"{key} {ratio(rounds, key):.2f}" for key in FIGURES))
    return 0


if __name__ == "__main__":
    sys.exit(main())
