"""Fuzz every reader for a time: `python -m tests.fuzz --minutes 60`.

Of eight cases five are logs, two DBC files, one is a recording (BLF, ASC, candump, CSV, TRC, MDF).

A worker tries cases by number in bounded memory; what kills it or holds it up is a finding as well.
A case is tried again by `--case N`; the file that did it is kept in the folder `--keep`.
"""

import argparse
import os
import random
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))
MEMORY_BYTES = 6 << 30  # of address space: numba and numpy map a good part of it
RECORDINGS = (".blf", ".asc", ".log", ".csv", ".trc", ".mf4")
ROOT = Path(__file__).resolve().parents[2]


def base_logs(folder: Path) -> list[bytes]:
    """Return true logs, which differ in their rigs."""
    import zstandard

    from pcpc.executive.nodes.virtual import simulate
    from pcpc.executive.rig.reading import load_rig

    rig = ROOT / "plants" / "probe" / "rig.yaml"
    simulate(load_rig(rig, settings=["duration_s=0.05"]), folder / "probe.mcap")
    data = (folder / "probe.mcap").read_bytes()
    golden = sorted(ROOT.glob("tests/golden/*/*.mcap.zst"), key=lambda p: p.stat().st_size)[0]
    small = zstandard.ZstdDecompressor().decompressobj().decompress(golden.read_bytes())
    return [data, data, small]


def _write_recording(path: Path) -> None:
    """Write a recording of some frames of the probe, as python-can does."""
    import can

    with can.Logger(path) as writer:
        for i in range(60):
            data = bytes([i, 0, 0, 0, 0, i % 16, i % 16, i])
            frame = can.Message(1.5 + 1e-3 * i, (0x80, 0xA0, 0x120, 0x12345)[i % 4], i % 4 == 3,
                                data=data[: 8 - 6 * (i % 4 == 0)], channel=0)  # fmt: skip
            writer.on_message_received(frame)


def _dbc_case(folder: Path, dice: random.Random) -> tuple[bytes, str, list[Any]]:
    """Try an odd DBC file: in a rig, and to import with."""
    import commands
    import corpus

    text = (ROOT / "plants" / "probe" / "probe.dbc").read_text()
    encoding = dice.choice(("utf-8", "cp1252"))
    data = corpus.odd_text(text, dice).encode(encoding, "replace")
    (folder / "probe" / "probe.dbc").write_bytes(data)
    lines = commands.dbc_lines(folder / "probe" / "rig.yaml", folder / "out")
    lines.append(
        commands.import_line(folder / "true.asc", folder / "probe" / "probe.dbc", folder / "out")
    )
    found = [commands.tried(words, folder / "out") for words in lines]
    return data, "dbc", [one for one in found if one is not None]


def _recording_case(folder: Path, dice: random.Random) -> tuple[bytes, str, list[Any]]:
    """Try an odd recording."""
    import commands
    import corpus

    suffix = dice.choice(RECORDINGS)
    data = corpus.odd_recording((folder / f"true{suffix}").read_bytes(), suffix, dice)
    recording, dbc = folder / f"odd{suffix}", ROOT / "plants" / "probe" / "probe.dbc"
    recording.write_bytes(data)
    words = commands.import_line(recording, dbc, folder / "out")
    found = commands.tried(words, folder / "out")
    return data, f"recording{suffix}", [] if found is None else [found]


def work(options: argparse.Namespace) -> None:
    """Try cases until the time is over; tell each finding in a block of lines."""
    import commands
    import corpus

    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bases = base_logs(folder)
        (folder / "true.mcap").write_bytes(bases[0])
        (folder / "out").mkdir()
        shutil.copytree(ROOT / "plants" / "probe", folder / "probe")
        for suffix in RECORDINGS:
            _write_recording(folder / f"true{suffix}")
        log, number, end = folder / "log.mcap", options.first, time.monotonic() + options.seconds
        while time.monotonic() < end:
            print(f"case {number}", flush=True)
            dice = random.Random(number)
            began = sum(os.times()[:4])
            if number % 8 in (1, 5):
                data, what, found = _dbc_case(folder, dice)
            elif number % 8 == 3:
                data, what, found = _recording_case(folder, dice)
            else:
                data, what = corpus.odd_log(dice.choice(bases), dice)
                log.write_bytes(data)
                began = sum(os.times()[:4])
                found = commands.some_of(log, folder / "true.mcap", folder / "out", dice)
            spent_s = sum(os.times()[:4]) - began
            if spent_s > 20.0:
                print(f"FOUND slow {spent_s:.0f} s\t{number}\t{what}", flush=True)
            for one in found:
                print(f"FOUND {one.key}\t{number}\t{what}\t{' '.join(one.words[:2])}", flush=True)
                if options.show:
                    print(one.text, flush=True)
                if options.keep:
                    (options.keep / f"{number}").write_bytes(data)
            number += 1
            if options.case is not None:
                return


def watch(options: argparse.Namespace) -> int:
    """Run workers one after the other; return 1 if there was a finding."""
    first, end, found, tries = options.first, time.monotonic() + 60 * options.minutes, {}, 0
    while (left := end - time.monotonic()) > 1:
        words = [sys.executable, "-m", "tests.fuzz", "--work", "--first", str(first)]
        words += ["--seconds", str(left)] + (["--keep", str(options.keep)] if options.keep else [])
        worker = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
        assert worker.stdout is not None
        for line in worker.stdout:
            if line.startswith("case "):
                first = int(line.split()[1])
                tries += 1
            elif line.startswith("FOUND "):
                key = line.split("\t")[0]
                found[key] = found.get(key, 0) + 1
                if found[key] == 1:
                    print(line.rstrip(), flush=True)
        if worker.wait() != 0:
            key = f"worker ended with {worker.returncode}"
            found[key] = found.get(key, 0) + 1
            print(f"FOUND {key}\t{first}", flush=True)
        first += 1
    print(f"{tries} cases, {sum(found.values())} findings of {len(found)} kinds")
    for key, count in sorted(found.items(), key=lambda pair: -pair[1]):
        print(f"{count:6} {key}")
    return 1 if found else 0


def main() -> int:
    """Watch workers, or be one."""
    parser = argparse.ArgumentParser("tests.fuzz", description=__doc__)
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--keep", type=Path, help="folder for the files that did something")
    parser.add_argument("--case", type=int, help="try one case and show what came")
    parser.add_argument("--work", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--seconds", type=float, default=1e9, help=argparse.SUPPRESS)
    options = parser.parse_args()
    options.show = options.case is not None
    if options.show:
        options.first = options.case
    if options.work or options.show:
        work(options)
        return 0
    return watch(options)


if __name__ == "__main__":
    sys.exit(main())
