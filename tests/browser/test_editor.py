"""An editor knows a rig file by its schema: the language server that editors start, unchanged."""

import json
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from places import ROOT
from small_rig import RIG, Case
from wrong_rigs import SCHEMA, UNKNOWN

from pcpc.tools.make import new

pytestmark = pytest.mark.browser

_FOLDER = ROOT / "build/editor"
_PACKAGE = "yaml-language-server@1.25"
HIDDEN = (*UNKNOWN, "kv_Nms_rad: 010")  # an octal, which pcpc alone refuses
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

    def problems(self, text: str) -> list[tuple[int, str]]:
        """Return what the editor underlines once the file has this text, and on which line.

        The first line, the editor's own, is not counted.
        """
        self._number += 1
        about = {"uri": self._uri, "version": self._number}
        self._send(method="textDocument/didChange",
                   params={"textDocument": about, "contentChanges": [{"text": text}]})  # fmt: skip
        told = self._read(lambda told: told.get("method") == "textDocument/publishDiagnostics")
        found = told["params"]["diagnostics"]
        return [(one["range"]["start"]["line"], one["message"]) for one in found]

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


@pytest.mark.parametrize("case", SCHEMA, ids=lambda case: case.new)
def test_an_editor_shows_a_mistake_on_the_line_that_check_names(
    editor: tuple[Editor, str], case: Case
) -> None:
    server, text = editor
    modeline, wrong = text.partition("\n")[0], RIG.replace(case.old, case.new, 1)
    assert server.problems(f"{modeline}\n{RIG}") == []
    lines = {line for line, _ in server.problems(f"{modeline}\n{wrong}")}
    wanted = set() if case.new in HIDDEN else {int(case.expected.partition(":")[0])}
    assert lines == wanted, case


def test_an_editor_completes_and_explains(editor: tuple[Editor, str]) -> None:
    server, text = editor
    assert {"real", "sync", "lockstep"} <= {*server.completed(f"{text}pacing: ")}
    assert {"faults", "losses", "schedule"} <= {*server.completed(f"{text}\n")}
    assert "rate_per_s" in server.completed(text.partition("high: 24.0}")[0] + "r")
    assert server.problems(text) == []
    for key, words in (("rate_hz", "cycles a second"), ("fault_after_cycles", "before a fault"),
                       ("laws/pid.py:B", "your own")):  # fmt: skip
        told = server.at("hover", text.partition(key)[0] + key[:2])
        assert words in told["contents"]["value"], told
