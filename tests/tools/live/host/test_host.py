"""The host as a client sees it: what is drawn is what the log holds, what is set stands in it."""

import json
import os
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hosting import LONG, Client, Host, hosting
from places import PATIENCE_S
from processes import own_bus

import pcpc
from pcpc.tools.cli import main
from pcpc.tools.live.history import envelope

BINS, WHOLE, PHASE = range(3)
GAIN, ERROR, ANGLE = "controller.kv_Nms_rad", "controller.e_rad", "plant:barrel.theta_rad"


@pytest.fixture(scope="module")
def run() -> pcpc.Run:
    return pcpc.simulate("slew10", set={"duration_s": 1.0}, quiet=True)


@pytest.fixture(scope="module")
def shown(run: pcpc.Run, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Host]:
    with hosting(tmp_path_factory.mktemp("token"), str(run.path)) as host:
        yield host


def of_log(run: pcpc.Run, name: str, first: int, bins: int, width: int) -> Any:
    """Return the least and greatest values of bins as the log has them, in float32."""
    role, _, variable = name.rpartition(":")
    node = run.log.node[role or "executive"]
    values = node.columns[variable][:, None]
    low, high = envelope(node.cycle, values, first, bins, width)
    return low[0].astype(np.float32), high[0].astype(np.float32)


def assert_drawn(run: pcpc.Run, names: list[str], head: Any, values: Any) -> None:
    _, _, curves, first, bins, width, period_s, _ = head
    assert (curves, period_s) == (len(names), run.period_s)
    drawn = values.reshape(2, len(names), int(bins))
    for i, name in enumerate(names):
        low, high = of_log(run, name, int(first), int(bins), int(width))
        np.testing.assert_array_equal(drawn[0, i], low)
        np.testing.assert_array_equal(drawn[1, i], high)


@pytest.mark.parametrize(("from_s", "to_s", "bins"), [(0, 1, 100), (0.2, 0.21, 500), (-5, 9, 7)])
def test_a_log_is_drawn_as_it_is(
    shown: Host, run: pcpc.Run, from_s: float, to_s: float, bins: int
) -> None:
    with Client(shown) as client:
        assert client.about["live"] is False and client.about["rig"] == "slew10"
        names = [ERROR, ANGLE]
        client.say(do="panel", id=3, names=names, bins=bins, from_s=from_s, to_s=to_s)
        head, values = client.panel(3)
        assert head[0] == WHOLE and head[4] <= bins + 1
        covered = head[3] * head[5] * run.period_s, (head[3] + head[4]) * head[5] * run.period_s
        assert covered[0] <= max(from_s, 1e-3) and covered[1] >= min(to_s, 1.0)
        assert_drawn(run, names, head, values)


def test_what_is_calculated_is_that_of_the_values(shown: Host, run: pcpc.Run) -> None:
    with Client(shown) as client:
        texts = ["= 2 * abs(controller.e_rad)", f"=rate({ANGLE})", f"= {ANGLE} - controller.e_rad"]
        client.say(do="panel", id=1, names=texts, bins=2000, from_s=0.0, to_s=1.0)
        head, values = client.panel(1)
        t = run.log.node["executive"].cycle
        assert head[3] <= t[0] and head[5] == 1
        drawn = values.reshape(2, 3, int(head[4]))[0][:, t - int(head[3])]
        error, angle = run[ERROR], run[ANGLE]
        np.testing.assert_array_equal(drawn[0], (2.0 * np.abs(error)).astype(np.float32))
        np.testing.assert_allclose(drawn[1, 1:], np.diff(angle) / 1e-3, rtol=1e-5, atol=1e-9)
        np.testing.assert_array_equal(drawn[2], (angle - error).astype(np.float32))
        for wrong, why in (
            ("= 1 + ", "not an expression"),
            ("= 3", "needs"),
            ("= a.b", "no such"),
            ("= controller.e_rad > 1 rad", "condition"),
            ("= controller.e_rad + time.t_s", "rad"),
        ):
            told = client.ask(do="panel", names=[wrong], bins=9, from_s=0.0, to_s=1.0)
            assert why in told["why"]


def test_a_phase_plane_pairs_values_of_the_same_cycle(shown: Host, run: pcpc.Run) -> None:
    with Client(shown) as client:
        client.say(do="phase", id=1, names=[ANGLE, ERROR], points=4096, window_s=0.3, to_s=0.8)
        head, values = client.panel(1)
        x, y = values.reshape(2, -1)
    assert head[0] == PHASE
    cycles = run.log.node["executive"].cycle
    part = slice(*np.searchsorted(cycles, (head[3], 801)))
    assert (head[3], head[7], len(x)) == (500, 800, 301)
    np.testing.assert_array_equal(x, run[ANGLE][part].astype(np.float32))
    np.testing.assert_array_equal(y, run[ERROR][part].astype(np.float32))


def test_a_port_in_use_is_named_with_the_cure(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        assert main(["host", "--port", str(taken.getsockname()[1])]) == 4
        assert "choose another --port" in capsys.readouterr().err


def test_who_reads_the_address_is_answered_without_more_loading(tmp_path: Path) -> None:
    def worked(host: Host) -> float:
        """Return the host's processor time in s."""
        fields = Path(f"/proc/{host.process.pid}/stat").read_text().rpartition(")")[2].split()
        return sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")

    with hosting(tmp_path, before=["env"]) as host:
        start_s = worked(host)
        with host.connect():
            answer_s = worked(host) - start_s
    assert answer_s < 0.2 * start_s, f"{answer_s:g} s after a start of {start_s:g} s"


def test_a_run_is_drawn_while_it_goes_on_and_tuned(tmp_path: Path) -> None:
    names, pieces = [ERROR, ANGLE], []
    with pcpc.running("slew10", pacing="real", set=LONG, bus=own_bus()) as live:
        with (
            hosting(tmp_path, "--write", "--node", live._nodes["plant"].name) as host,
            Client(host) as client,
            Client(host) as other,
        ):
            client.say(do="panel", id=1, names=names, bins=20, window_s=1.0)
            while len(pieces) < 2 or pieces[-1][0][3] - pieces[0][0][3] < 30:
                pieces.append(client.panel(1))
            told = client.ask(do="set", values={GAIN: 111.0, "controller.lam_per_s": 11.0})
            assert told["undoes"] == 1 and live[GAIN] == 111.0
            event = other.event(GAIN)  # a busy machine skips cycles, which is told, too
            assert (event["topic"], event["value"]) == ("tunings", 111.0)
            assert event["cycle"] == told["cycle"]
            undone = client.ask(do="undo")
            assert undone["undoes"] == 0 and live[GAIN] == 110.0
            stopped = other.ask(do="act", what="stop")
            assert stopped["cycle"] > undone["cycle"]
        run = live.wait(within_s=PATIENCE_S)
    tuned = [(e["name"], e["value"], e["cycle"]) for e in run.events if e.get("name") == GAIN]
    assert tuned == [(GAIN, 111.0, told["cycle"]), (GAIN, 110.0, undone["cycle"])]
    assert pieces[0][0][0] == WHOLE and {head[0] for head, _ in pieces[1:]} == {BINS}
    seen = {}
    for head, values in pieces:  # the last word about each bin
        drawn = values.reshape(2, len(names), int(head[4]))
        seen |= {int(head[3]) + b: drawn[:, :, b] for b in range(int(head[4]))}
    bins = sorted(seen)
    assert bins == [*range(bins[0], bins[-1] + 1)] and pieces[0][0][5] == 10
    whole = bins[1:-5]  # the first is there in part, and the last where a node is behind another
    for i, name in enumerate(names):
        low, high = of_log(run, name, whole[0], len(whole), 10)
        np.testing.assert_array_equal([seen[b][0, i] for b in whole], low)
        np.testing.assert_array_equal([seen[b][1, i] for b in whole], high)


def test_a_client_that_never_reads_holds_nobody_and_the_next_run_is_found(tmp_path: Path) -> None:
    bus = own_bus()
    with pcpc.running("slew10", pacing="real", set=LONG, bus=bus) as live:
        node = live._nodes["plant"].name
        with hosting(tmp_path, "--node", node) as host, host.connect() as deaf:
            deaf.send(json.dumps({"do": "hello", "token": host.token}))
            for i in range(16):
                names = [ERROR, ANGLE] * 16
                wanted = {"do": "panel", "id": i, "names": names, "bins": 4096, "window_s": 60.0}
                deaf.send(json.dumps(wanted))
            with Client(host) as client:
                client.say(do="panel", id=1, names=[ERROR], bins=20, window_s=1.0)
                for _ in range(60):
                    client.panel(1)
                live.stop()
                while client.until("status")["status"]["nodes"]["plant"]["state"] != "ended":
                    pass
                with pcpc.running("slew10", pacing="real", set=LONG, bus=bus) as again:
                    assert again._nodes["plant"].name == node
                    found = client.until("about")
                    while len(found["about"]["nodes"]) < 2:
                        found = client.until("about")
                    assert found["about"]["run"] == 2
                    client.say(do="panel", id=1, names=[ERROR], bins=20, window_s=1.0)
                    assert client.panel(1)[0][0] == WHOLE
