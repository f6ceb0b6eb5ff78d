"""What watching costs the loop: lateness with hosts against without, in turn in one run.

A round is SPAN_S of the hull rig at 1 kHz without any host, then SPAN_S with `pcpc host`, eight
clients of it, of which one never reads, each with four panels of five curves at 60 Hz and the
plant's drawing, and a process that reads the whole table in a busy loop; then SPAN_S beside two
programs that only count, which is what any two busy programs cost on this machine. Lateness is that
of every cycle of the executive, by a tap. The clients run on the same machine; they take what a
browser would be sent, and draw nothing.
"""

import asyncio
import itertools
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.machine.bystander import keep_off
from pcpc.executive.nodes.live import Live, find
from pcpc.executive.nodes.tap import Tap
from pcpc.tools.api.live import running
from pcpc.tools.dev.bench.ratio import Ratio
from pcpc.tools.machine.jitter.compiler import BenchError
from pcpc.tools.terminal.progress import Progress

SUITE = "host"
SPAN_S, SETTLE_S = 6.0, 1.0
CLIENTS, PANELS, CURVES = 8, 4, 5
FIGURES = {"p50": 50.0, "p99": 99.0}
_PATIENT = {"duration_s": 3600.0, "supervisor.hold_cycles": 10**6,
            "supervisor.fault_after_cycles": 10**6, "alarms.held_per_s": None}  # fmt: skip


def measure(progress: Progress, rounds: int = 5) -> list[Ratio]:
    """Measure `rounds` rounds; BenchError if a client gets nothing."""
    beside: dict[str, Callable[[Live], AbstractContextManager[object]]]
    beside = {"alone": nullcontext, "hosts": _hosts, "counting": _counting}
    late: dict[str, list[NDArray[np.float64]]] = {name: [] for name in beside}
    with running("hull", pacing="real", set=_PATIENT) as run:
        run.wait_until("time.t_s", above=1.0, within_s=60.0)
        live = find("executive", "hull")
        for i, (name, others) in itertools.product(range(rounds), beside.items()):
            progress.show(f"host: round {i + 1} of {rounds}, {name}")
            with others(live):
                late[name].append(_lateness(live))
    at = {
        (name, share): [np.percentile(part, share) for part in parts]
        for name, parts in late.items()
        for share in FIGURES.values()
    }
    return [
        Ratio.from_rounds(
            SUITE, f"lateness {figure}{more}", "alone", at[name, share], at["alone", share], "us"
        )
        for name, more in (("hosts", ""), ("counting", ", two others"))
        for figure, share in FIGURES.items()
    ]


def _lateness(live: Live) -> NDArray[np.float64]:
    """Return the lateness of every cycle of a span, us."""
    time.sleep(SETTLE_S)
    tap, parts, end_s = Tap(live), [], time.monotonic() + SPAN_S
    while time.monotonic() < end_s:
        time.sleep(0.1)
        parts.append(tap.rows()["timing.wake_late_us"])
    return np.concatenate(parts)


@contextmanager
def _counting(live: Live) -> Iterator[None]:
    """Have two programs that only count."""
    count = "print(flush=True)\nwhile True: pass"
    started = [
        subprocess.Popen([sys.executable, "-c", count], stdout=subprocess.PIPE) for _ in range(2)
    ]
    try:
        for process in started:
            assert process.stdout
            process.stdout.readline()
        yield
    finally:
        for process in started:
            process.kill()
            process.communicate()


@contextmanager
def _hosts(live: Live) -> Iterator[None]:
    """Have a host, its clients and a busy reader."""
    started: list[subprocess.Popen[str]] = []

    def start(*words: str) -> "subprocess.Popen[str]":
        started.append(
            subprocess.Popen(
                [sys.executable, "-m", *words],
                stdout=subprocess.PIPE,
                text=True,
                stderr=subprocess.DEVNULL,
                env=os.environ | {"XDG_STATE_HOME": folder},
            )
        )
        return started[-1]

    with tempfile.TemporaryDirectory(prefix="pcpc-host-") as folder:
        try:
            host = start("pcpc.tools.cli", "host", "--port", "0", "--node", live.name)
            url = host.stdout.readline().strip() if host.stdout else ""
            for words in (("clients", url), ("reader", live.name)):
                other = start("pcpc.tools.dev.bench.host", *words)
                if not other.stdout or other.stdout.readline() != "ready\n":
                    raise BenchError(f"the {words[0]} got nothing; is websockets installed?")
            yield
        finally:
            for process in started:
                process.kill()
                process.communicate()


async def _clients(url: str) -> None:
    from websockets.asyncio.client import connect

    address, _, token = url.replace("http:", "ws:").partition("/#")
    waiting, ready = [CLIENTS - 1], asyncio.Event()

    async def one(number: int) -> None:
        async with connect(f"{address}/ws", max_size=None, proxy=None) as socket:
            await socket.send(json.dumps({"do": "hello", "token": token}))
            about = json.loads(await socket.recv())["about"]
            names = [v["name"] for node in about["nodes"].values() for v in node if v["plot"]]
            for i in range(PANELS):
                asked = names[CURVES * i : CURVES * (i + 1)]
                panel = {"do": "panel", "id": i, "names": asked, "bins": 900, "window_s": 5.0}
                await socket.send(json.dumps(panel))
            if number == 0:  # never reads
                await asyncio.Event().wait()
            while not isinstance(await socket.recv(), bytes):
                pass
            waiting[0] -= 1
            if not waiting[0]:
                ready.set()
            async for _ in socket:
                pass

    tasks = [asyncio.create_task(one(i)) for i in range(CLIENTS)]
    await ready.wait()
    print("ready", flush=True)
    await asyncio.gather(*tasks)


def _reader(name: str) -> None:
    live = find(name)
    keep_off([live.pid])
    print("ready", flush=True)
    while True:
        live.read()


if __name__ == "__main__":
    what, where = sys.argv[1:]
    asyncio.run(_clients(where)) if what == "clients" else _reader(where)
