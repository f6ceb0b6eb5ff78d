"""Firefox without a window, driven over WebDriver BiDi."""

import json
import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from websockets.sync.client import ClientConnection, connect

BROWSERS = "firefox-esr", "firefox"
_QUIET = "app.normandy.enabled", "app.update.enabled", "network.captive-portal-service.enabled"


class Tab:
    """A page, once it is loaded."""

    def __init__(self, line: ClientConnection) -> None:
        self._line, self._number = line, 0
        self.asked("session.new", capabilities={})
        (found,) = self.asked("browsingContext.getTree")["contexts"]
        self._tab = found["context"]

    def asked(self, method: str, **params: Any) -> dict[str, Any]:
        """Return the answer to a command; RuntimeError with what it says."""
        self._number += 1
        self._line.send(json.dumps({"id": self._number, "method": method, "params": params}))
        while (said := json.loads(self._line.recv(60.0))).get("id") != self._number:
            pass
        if said["type"] != "success":
            raise RuntimeError(said)
        return dict(said["result"])

    def goto(self, url: str) -> None:
        """Load a page whole."""
        self.asked("browsingContext.navigate", context=self._tab, url=url, wait="complete")

    def value(self, script: str) -> Any:
        """Return what JavaScript gives, once it is settled."""
        target = {"context": self._tab}
        said = self.asked("script.evaluate", expression=script, target=target, awaitPromise=True)
        if said["type"] != "success":
            raise RuntimeError(said)
        return said["result"].get("value")


@contextmanager
def firefox() -> Iterator[Tab]:
    """Give a tab of a browser of its own."""
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    assert found, "no Firefox here: make browser-tools"
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        quiet = "".join(f'user_pref("{name}", false);\n' for name in _QUIET)
        Path(profile, "user.js").write_text(quiet, encoding="utf-8")
        words = (found, "--headless", "--no-remote", "--profile", profile)
        child = subprocess.Popen(
            (*words, "--remote-debugging-port", "0"), stderr=subprocess.PIPE, text=True
        )
        try:
            assert child.stderr is not None
            said = (re.search(r"BiDi listening on (\S+)", line) for line in child.stderr)
            address = next(filter(None, said))[1]
            with connect(f"{address}/session", max_size=None, proxy=None) as line:
                yield Tab(line)
        finally:
            child.kill()
            child.wait()
