"""An editor knows a rig file by its schema: the language server that editors start, unchanged."""

import json
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from places import ROOT

from pcpc.tools.make import new

pytestmark = pytest.mark.browser

_FOLDER = ROOT / "build/editor"
_PACKAGE = "yaml-language-server@1.25"
_SETTINGS = {"validate": True, "hover": True, "completion": True, "schemaStore": {"enable": False}}


class Editor:
    """A client of the language server with one open file; Microsoft's Language Server Protocol."""

    def __init__(self, server: Any, file: Path) -> None:
        self._server, self._uri, self._number = server, file.as_uri(), 0
        self._ask("initialize", processId=None, rootUri=file.parent.as_uri(),
                  capabilities={"workspace": {"configuration": True}})  # fmt: skip
        self._send(method="initialized", params={})
        about = {"uri": self._uri, "languageId": "yaml", "version": 0, "text": ""}
        self._send(method="textDocument/didOpen", params={"textDocument": about})
        self._read(lambda told: told.get("method") == "textDocument/publishDiagnostics")

    def _send(self, **what: Any) -> None:
        body = json.dumps({"jsonrpc": "2.0", **what}).encode()
        self._server.stdin.write(b"Content-Length: %d\r\n\r\n%s" % (len(body), body))
        self._server.stdin.flush()

    def _read(self, is_it: Callable[[Any], bool]) -> Any:
        """Return the first message that is the one; answer what the server asks meanwhile."""
        while True:
            length = 0
            while line := self._server.stdout.readline().strip():
                if line.lower().startswith(b"content-length:"):
                    length = int(line.partition(b":")[2])
            told = json.loads(self._server.stdout.read(length))  # an error if the server has ended
            if "method" in told and "id" in told:
                asks = told["method"] == "workspace/configuration"
                answer = [_SETTINGS] * len(told["params"]["items"]) if asks else None
                self._send(id=told["id"], result=answer)
            if is_it(told):
                return told

    def _ask(self, method: str, **params: Any) -> Any:
        self._number += 1
        self._send(id=self._number, method=method, params=params)
        return self._read(lambda told: told.get("id") == self._number)["result"]

    def problems(self, text: str) -> list[str]:
        """Return what the editor underlines once the file has this text."""
        self._number += 1
        about = {"uri": self._uri, "version": self._number}
        self._send(method="textDocument/didChange",
                   params={"textDocument": about, "contentChanges": [{"text": text}]})  # fmt: skip
        told = self._read(lambda told: told.get("method") == "textDocument/publishDiagnostics")
        return [one["message"] for one in told["params"]["diagnostics"]]

    def at(self, method: str, before: str) -> Any:
        """Return what the server says at the end of a text."""
        place = {"line": before.count("\n"), "character": len(before.rpartition("\n")[2])}
        about = {"textDocument": {"uri": self._uri}, "position": place}
        return self._ask(f"textDocument/{method}", **about)

    def completed(self, text: str) -> list[str]:
        """Return what the editor proposes at the end of a text."""
        self.problems(text)
        told = self.at("completion", text)
        return [one["label"] for one in (told["items"] if isinstance(told, dict) else told)]


@pytest.fixture(scope="module")
def editor(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Editor, str]]:
    install = ["npm", "install", "--no-audit", "--no-fund", "--prefix", str(_FOLDER), _PACKAGE]
    if not (_FOLDER / "node_modules").exists():
        subprocess.run(install, check=True, stdout=subprocess.DEVNULL)
    new.write(folder := tmp_path_factory.mktemp("editor") / "own")
    command = [_FOLDER / "node_modules/.bin/yaml-language-server", "--stdio"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as server:
        yield Editor(server, folder / "rig.yaml"), (folder / "rig.yaml").read_text("utf-8")
        server.kill()


WRONG = {
    "rate_hz: 1000.0": ("rate_hz: fast", "Incorrect type"),
    "hold_cycles": ("hold_cycle", "Property hold_cycle is not allowed"),
    "{low: -24.0": ("{lower: -24.0", "Property lower is not allowed"),
    "within: 150ms": ("within: 150", "Incorrect type"),
    "    law: laws/pid.py:BLOCK\n": ("    law: pidd\n", "Value is not accepted"),
    "duration_s: 1.0": ("duration_s: -1.0", "Value is below"),
    "bus: {bitrate: 1000000}": ("bus: {bitrate: 0}", "Value is below"),
    "[0.1, 1.0]": ("[0.1]", "too few items"),
    "watch: ": ("pacing: rael\nwatch: ", "Value is not accepted"),
    "\nplant:\n": ("\nplants:\n", "Property plants is not allowed"),
}


def test_an_editor_shows_mistakes(editor: tuple[Editor, str]) -> None:
    server, text = editor
    assert server.problems(text) == []
    for old, (new_text, words) in WRONG.items():
        assert text.count(old) == 1, old
        told = server.problems(text.replace(old, new_text))
        assert any(words in one for one in told), (old, told)


def test_an_editor_completes_and_explains(editor: tuple[Editor, str]) -> None:
    server, text = editor
    assert {"real", "sync", "lockstep"} <= {*server.completed(f"{text}pacing: ")}
    assert {"faults", "losses", "schedule"} <= {*server.completed(f"{text}\n")}
    assert "rate_per_s" in server.completed(text.partition("high: 24.0}")[0] + "r")
    server.problems(text)
    for key, words in (("rate_hz", "cycles a second"), ("fault_after_cycles", "before a fault"),
                       ("laws/pid.py:B", "your own")):  # fmt: skip
        told = server.at("hover", text.partition(key)[0] + key[:2])
        assert words in told["contents"]["value"], told
