"""Several runs at once: which they are, which one is shown, and that a client's choice stays."""

import os
import time
from pathlib import Path
from typing import Any

import pytest
import standing
from hosting import ANSWER_S, LONG, Client, hosting
from processes import RIGS, own_bus
from scoped import HEAD

import pcpc
from pcpc.tools.live.host import runs

GAIN, ANGLE = "controller.kv_Nms_rad", "plant:barrel.theta_rad"
NAME = f"alone{os.getpid()}"  # a host shows all runs of its rig: those of another test run too


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("rig") / f"{NAME}.yaml"
    path.write_text(f"base: {RIGS / 'sin0.5.yaml'}\nrig: {NAME}\n")
    return path


def going_on(rig: Path) -> Any:
    return pcpc.running(rig, pacing="real", set=LONG, bus=own_bus())


def name_of(live: pcpc.Live) -> str:
    return live._nodes["plant"].name.rpartition(".")[0]


def offered(client: Client, shown: str, *names: str) -> list[dict[str, Any]]:
    """Wait until these runs are offered while `shown` is."""
    end_s = time.monotonic() + ANSWER_S
    while True:
        found = client.until("runs")
        assert time.monotonic() < end_s, found
        if (found["shown"], sorted(one["run"] for one in found["runs"])) == (shown, sorted(names)):
            return list(found["runs"])


def shown(client: Client, nodes: int = 2) -> dict[str, Any]:
    """Wait until a run of so many nodes is shown; return what is told of it."""
    while len((found := client.until("about"))["about"]["nodes"]) != nodes:
        pass
    return dict(found["about"])


def test_a_run_that_is_alone_is_shown_until_its_end(tmp_path: Path, rig: Path) -> None:
    began_s = time.time()
    with going_on(rig) as one, hosting(tmp_path, str(rig)) as host, Client(host) as client:
        (told,) = offered(client, name_of(one), name_of(one))
        assert told["rig"] == NAME and began_s < told["since_s"] < time.time()
        assert set(told["nodes"]) == {"executive", "plant"}
        with going_on(rig) as two:
            names = name_of(one), name_of(two)
            offered(client, names[0], *names)
            one.stop()
            offered(client, names[1], names[1])  # again the one that is alone
    assert one.run.log.node and two.run.log.node


def test_of_two_none_is_shown_until_one_is_chosen_and_tuned_alone(
    tmp_path: Path, rig: Path
) -> None:
    with going_on(rig) as one, going_on(rig) as two, hosting(tmp_path, str(rig), "--write") as host:
        names = name_of(one), name_of(two)
        with Client(host) as client, Client(host) as other:
            offered(client, "", *names)
            assert client.about["nodes"] == {}
            refused = client.ask(do="set", values={GAIN: 111.0})
            assert "choose one" in refused["why"]
            assert client.ask(do="run", run=names[0])["done"]
            shown(client)
            assert other.ask(do="run", run=names[1])["done"]
            shown(other)
            client.ask(do="set", values={GAIN: 111.0})
            other.ask(do="set", values={GAIN: 112.0})
            assert (one[GAIN], two[GAIN]) == (111.0, 112.0)
            assert client.event(GAIN)["value"] == 111.0  # of its own run alone
            client.say(do="panel", id=1, names=[ANGLE], bins=20, window_s=1.0)
            assert client.panel(1)[0][1] == 1
            client.ask(do="run", run=names[1])
            shown(client)
            told = client.ask(do="set", values={GAIN: 113.0})
            assert told["undoes"] == 2 and (one[GAIN], two[GAIN]) == (111.0, 113.0)
        with Client(host, run=names[1]) as again:  # as after a reconnect
            if not again.about["nodes"]:
                shown(again)
            offered(again, names[1], *names)
            again.ask(do="set", values={GAIN: 114.0})
            assert (one[GAIN], two[GAIN]) == (111.0, 114.0)
            two.stop()
            offered(again, names[1], names[0])  # it keeps what was chosen
        with Client(host, run="chosen.before") as late:
            offered(late, "", names[0])
            assert late.about["nodes"] == {}


def test_what_is_recorded_of_two_runs_has_its_size_together(rig: Path, tmp_path: Path) -> None:
    most_mb = 2
    words = ("--write", "--recordings", str(tmp_path), "--recordings-mb", str(most_mb))
    with (
        going_on(rig) as one,
        going_on(rig) as two,
        hosting(tmp_path, str(rig), *words) as host,
        Client(host) as client,
        Client(host) as other,
    ):
        clients = {name_of(one): client, name_of(two): other}
        for name, its in clients.items():
            its.ask(do="run", run=name)
            shown(its)
            its.ask(do="record")
        for its in clients.values():
            while its.until("status")["status"]["recording"]["going"]:
                pass
            assert "have their size" in its.until("status")["status"]["recording"]["why"]
        sizes = [path.stat().st_size for path in tmp_path.glob("*.mcap")]
    assert len(sizes) == 2 and most_mb * 1e6 <= sum(sizes) < 1.5 * most_mb * 1e6, sizes


def test_the_next_run_of_a_name_takes_the_place_of_the_one_before(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(runs, "AGAIN_S", 0.0)
    name = f"again.{os.getpid()}.executive"
    shown = runs.LiveRuns(run=runs.run_of(name))
    try:
        for process in (1, 2):
            standing.stand(name, HEAD).control.pid = process
            (live,) = shown.nodes().values()
            assert live.pid == process and shown.nodes()[name] is live, "attached anew"
    finally:
        standing.end_all()
    assert shown.nodes() == {}
