"""`--at`: the commands on nodes of another machine say and do what they do here."""

import json
import os
import signal
import subprocess
import threading
from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hosting import ANSWER_S, Host, hosting
from live_run import ERROR, KV, LAM, Run, Screen, pcpc, said, there
from processes import until
from test_scope import own
from websockets.sync.server import ServerConnection, serve

from pcpc.executive.log import reader as logs
from pcpc.executive.loop.events import Event
from pcpc.executive.nodes import live
from pcpc.tools.cli import main
from pcpc.tools.live.remote.link import Link
from pcpc.tools.live.remote.live import RemoteNodes


@pytest.fixture(scope="module")
def host(run: Run, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Host]:
    with hosting(tmp_path_factory.mktemp("token"), "--write", "--node", run.node) as one:
        yield one


@pytest.fixture(autouse=True)
def token(host: Host, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PCPC_TOKEN", host.token)


# What is read


@pytest.mark.parametrize(
    "words",
    [["list", "controller.k*"], ["list", "controller.k*", "-l"], ["list", KV, "--json"],
     ["get", KV], ["get", KV, LAM, "--json"], ["fault"], ["fault", "--json"],
     ["get", "plant:barrel.gap_rad"]],
)  # fmt: skip
def test_it_says_what_it_says_here(
    run: Run, host: Host, capsys: Screen, words: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    here = {name: one for name, one in live.running().items() if same_run(name, run)}
    elsewhere = there(capsys, host, *words)
    monkeypatch.setattr(live, "running", lambda rig="": here)
    assert main(words) == elsewhere[0] == 0, elsewhere
    assert capsys.readouterr() == elsewhere[1:]


def same_run(name: str, run: Run) -> bool:
    return name.startswith(run.node.removesuffix("executive"))


def test_values_and_the_screen_move(
    run: Run, host: Host, capsys: Screen, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("LINES", "80")
    code, out, _ = there(capsys, host, "top", "--once")
    found = {line.split()[0]: line.split() for line in out.splitlines() if line.strip()}
    assert code == 0 and float(found["executive"][3]) > 50.0 and int(found["FB_A"][3]) > 0, out
    watcher = pcpc("watch", ERROR, "--every", "30ms", "--at", host.name)
    assert watcher.stdout is not None
    lines = [watcher.stdout.readline().split() for _ in range(12)]
    assert (lines[0], lines[1]) == (["cycle", ERROR], ["[rad]"])
    cycles = [int(line[0]) for line in lines[2:]]
    assert cycles == sorted(set(cycles)), cycles
    watcher.send_signal(signal.SIGINT)
    watcher.communicate(timeout=ANSWER_S)
    assert watcher.returncode == 130


def test_a_host_that_dies_is_a_line(run: Run, tmp_path: Path) -> None:
    with hosting(tmp_path, "--node", run.node) as other:
        environment = os.environ | {"PCPC_TOKEN": other.token}
        words = ["watch", ERROR, "--at", other.name]
        watcher = subprocess.Popen(
            [*pcpc("--version").args[:1], *words],
            env=environment,
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        assert watcher.stdout is not None
        watcher.stdout.readline()
        other.process.kill()
        other.process.wait()
        _, error = watcher.communicate(timeout=ANSWER_S)
    lost = [line for line in error.splitlines() if "alarm" not in line]
    assert (watcher.returncode, len(lost)) == (4, 1) and "connection was lost" in lost[0], error


# What is tuned


def test_what_is_set_there_holds_here_from_the_cycle_that_is_told(
    run: Run, host: Host, capsys: Screen, tmp_path: Path
) -> None:
    node, file = live.find(run.node), tmp_path / "tuned.yaml"
    words = ("set", f"{KV}=121", f"{LAM}=13.125", "--json")
    code, out, err = there(capsys, host, *words)
    told = json.loads(out)
    assert code == 0 and told["values"] == {KV: 121.0, LAM: 13.125}, err
    assert (node[KV], node[LAM]) == (121.0, 13.125)
    rows, _ = node.rows("event", 0)
    tuned = [
        (int(row[1]), float(row[4:].view(float)[0])) for row in rows if row[2] == Event.TUNING
    ][-2:]
    assert tuned == [(told["cycle"], 121.0), (told["cycle"], 13.125)]
    assert there(capsys, host, "save", str(file))[0] == 0
    undone = there(capsys, host, "undo")
    assert undone[0] == 0 and f"{KV} = 110" in undone[1] and node[KV] == 110.0
    assert there(capsys, host, "load", str(file))[0] == 0
    assert (node[KV], node[LAM]) == (121.0, 13.125)
    assert there(capsys, host, "undo")[0] == 0 and node[KV] == 110.0


def link_to(host: Host) -> Link:
    return Link(Namespace(at=host.name, token_file=None, ca=None, plain=False))


def test_what_was_set_is_what_is_read_next(run: Run, host: Host) -> None:
    link = link_to(host)
    node = RemoteNodes(link).find(run.node)
    for value in (111.0, 112.0, 113.0, 110.0):
        assert node.tune({KV: value}) > 0
        assert node[KV] == value
    link.close()


@pytest.mark.parametrize(
    "words",
    [["set", f"{KV}=1e9"], ["set", f"{KV}=nan"], ["set", "controller.kv=1"], ["set", f"{ERROR}=1"],
     ["set", f"{KV}=115", f"{LAM}=-1"], ["get", "controller.kv"], ["set", KV], ["fault", "fire"],
     ["undo", "99"], ["load", "nowhere.yaml"], ["watch", "x*"], ["lock", "open"]],
)  # fmt: skip
def test_what_is_refused_here_is_refused_there_in_the_same_words(
    run: Run, host: Host, capsys: Screen, words: list[str]
) -> None:
    before = live.find(run.node)[KV]
    node = ("--node", run.node)
    here = said(capsys, run, *words)
    assert there(capsys, host, *words, *node) == here and here[0] == 2, here
    assert live.find(run.node)[KV] == before


def test_a_node_that_is_locked_refuses(run: Run, host: Host, capsys: Screen) -> None:
    assert there(capsys, host, "lock", "tune", "--node", "executive")[:2] == (0, "lock tune\n")
    code, _, err = there(capsys, host, "set", f"{KV}=120")
    assert code == 2 and "locked (tune)" in err
    assert there(capsys, host, "lock", "none", "--node", "executive")[0] == 0
    assert there(capsys, host, "reset")[0] == 1  # no fault


def test_a_host_without_write_refuses_whatever_changes(
    run: Run, capsys: Screen, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = live.find(run.node)[KV]
    with hosting(tmp_path, "--node", run.node) as other:
        monkeypatch.setenv("PCPC_TOKEN", other.token)
        for words in (["set", f"{KV}=99"], ["stop"], ["lock", "tune", "--node", "executive"]):
            code, out, err = there(capsys, other, *words)
            assert (code, out) == (2, "") and "pcpc host --write" in err, words
        assert there(capsys, other, "get", KV)[0] == 0
    assert live.find(run.node)[KV] == before


# Who is let in


def test_the_token_comes_from_a_file_of_ones_own(
    host: Host, capsys: Screen, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, words = tmp_path / "token", ("get", KV, "--token-file", str(tmp_path / "token"))
    monkeypatch.delenv("PCPC_TOKEN")
    assert there(capsys, host, "get", KV)[0] == 2
    file.write_text(host.url)  # as `pcpc host` printed it
    file.chmod(0o644)
    code, _, err = there(capsys, host, *words)
    assert code == 2 and f"chmod 600 {file}" in err
    file.chmod(0o600)
    assert there(capsys, host, *words)[0] == 0
    file.write_text("\n")
    code, _, err = there(capsys, host, *words)
    assert code == 2 and err.startswith(f"--token-file {file}: holds no token; "), err
    file.write_text("wrong")
    code, _, err = there(capsys, host, *words)
    assert code == 2 and "wrong token" in err


def test_a_rig_that_does_not_run_there_is_told_with_those_that_do(
    run: Run, host: Host, capsys: Screen
) -> None:
    for words in (["top", "nowhere", "--once"], ["stop", "nowhere"], ["reset", "nowhere"]):
        told = there(capsys, host, *words)
        assert told == (4, "", "nowhere: no run of this rig; there are runs of hull\n"), told


def test_what_is_about_another_machine_is_refused_without_one(run: Run, capsys: Screen) -> None:
    for option, more in (("--token-file", ["x"]), ("--ca", ["x"]), ("--plain", [])):
        told = said(capsys, run, "get", KV, option, *more)
        assert told == (2, "", f"{option}: only with --at HOST:PORT\n"), told


@pytest.mark.parametrize(
    ("at", "more", "code", "message"),
    [("127.0.0.1:1", (), 4, "is `pcpc host` running there?"),
     ("localhost.:{port}", ("--plain",), 4, "start it there with --name localhost."),
     ("127.0.0.1:{port}", ("--ca", "/dev/null"), 2, "--ca /dev/null: "),
     ("127.0.0.1:{port}", ("--ca", "a", "--plain"), 2, "exclude each other"),
     ("localhost.:{port}", (), 4, "127.0.0.1"), ("127.0.0.1:x", (), 2, "HOST:PORT"),
     ("127.0.0.1:0", (), 2, "HOST:PORT"),
     ("127.0.0.1:{port}", ("--token-file", "."), 2, ".: is a folder"),
     ("127.0.0.1:{port}", ("--node", "plant", "--token-file", "/dev/null"), 2, "can read it"),
     ("a@127.0.0.1:{port}", (), 2, "HOST:PORT"), ("", (), 2, "HOST:PORT"),
     ("127.0.0.1:{port}/x", (), 2, "HOST:PORT")],
)  # fmt: skip
def test_a_way_that_leads_nowhere_is_a_line(
    host: Host, capsys: Screen, at: str, more: tuple[str, ...], code: int, message: str
) -> None:
    place = at.format(port=host.port)
    assert main(["get", KV, "--at", place, *more]) == code
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and (message in err or at.startswith("localhost.:")), err


def test_a_host_with_a_certificate_of_its_own(
    run: Run, capsys: Screen, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    key, certificate = str(tmp_path / "key.pem"), str(tmp_path / "cert.pem")
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "1", "-subj",
         "/CN=rig", "-addext", "subjectAltName=IP:127.0.0.1", "-keyout", key, "-out", certificate],
        check=True, capture_output=True,
    )  # fmt: skip
    words = ("--tls-cert", certificate, "--tls-key", key, "--node", run.node)
    with hosting(tmp_path, *words) as other:
        monkeypatch.setenv("PCPC_TOKEN", other.token)
        assert there(capsys, other, "get", KV, "--ca", certificate)[0] == 0
        code, _, err = there(capsys, other, "get", KV)
        assert code == 4 and "does it use TLS" in err
        system = "/etc/ssl/certs/ca-certificates.crt"
        if Path(system).is_file():
            code, _, err = there(capsys, other, "get", KV, "--ca", system)
            assert code == 4 and "certificate" in err and "--ca FILE" in err


class Older(Link):
    """A line to a host of another version."""

    def ask(self, what: str, **about: Any) -> Any:
        """Ask, and hear of another layout."""
        found = super().ask(what, **about)
        return found | {"version": "0"} if what == "nodes" else found


def test_a_host_of_another_version_is_refused(host: Host) -> None:
    link = Older(Namespace(at=host.name, token_file=None, ca=None, plain=False))
    with pytest.raises(live.LiveError, match="another version of pcpc runs there"):
        RemoteNodes(link).running()
    link.close()


@pytest.mark.parametrize("said", ["[]", '"x"', "nonsense", '{"refused": 1}',
                                  '{"refused": 1, "why": "x", "code": 77}'])  # fmt: skip
def test_what_is_no_host_is_a_line(said: str, capsys: Screen) -> None:
    def answer(line: ServerConnection) -> None:
        line.recv(timeout=ANSWER_S)
        line.recv(timeout=ANSWER_S)
        line.send(said)

    with serve(answer, "127.0.0.1", 0) as server:
        serving = threading.Thread(target=server.serve_forever)
        serving.start()
        port = server.socket.getsockname()[1]
        assert main(["get", KV, "--at", f"127.0.0.1:{port}"]) == 4
        server.shutdown()
        serving.join()
    err = capsys.readouterr().err
    assert err.startswith(f"127.0.0.1:{port}: ") and err.count("\n") == 1, err


# The end of the run: this comes last


def test_what_is_captured_there_is_what_the_log_holds(
    run: Run, host: Host, capsys: Screen, tmp_path: Path
) -> None:
    file = tmp_path / "burst.mcap"
    words = ["scope", "controller.*", "time.t_s", "timing.wake_late_us", "--trigger",
             "controller.e_rad > 0.2 mrad", "--pre", "100ms", "--post", "200ms", "--mode", "normal",
             "--count", "2", "-o", str(file), "--json"]  # fmt: skip
    code, out, err = there(capsys, host, *words)
    answer = json.loads(out.splitlines()[-1])
    assert (code, answer["lost"], len(answer["bursts"])) == (0, 0, 2), out + err
    code, out, _ = there(capsys, host, "stop", "hull")
    assert code == 0 and out.startswith(f"stop: {run.node} in cycle "), out
    until(lambda: run.host.poll() is not None, "the run ends")
    log, captured = logs.read(run.folder / "log.mcap"), logs.read(file)
    own(log, "executive", captured)
    assert there(capsys, host, "get", KV)[0] == 4
