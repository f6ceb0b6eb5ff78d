"""A session of `pcpc mcp` with the official client, over stdio, in a workspace of its own."""

import hashlib
import json
import sys
from collections.abc import Awaitable, Callable
from contextlib import AbstractAsyncContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import anyio
import yaml

from pcpc.tools import cli

if TYPE_CHECKING:  # half a second, for each worker
    from mcp.client.client import Client

POLICY: dict[str, Any] = {
    "commands": ["rigs", "check", "simulate", "report", "replay", "compare", "log", "branch"],
    "rigs": ["suspension-58", "hull"],
    "folders": ["."],
    "set": ["controller.*"],
    "time_s": 300,
    "runs": 100,
}


class Door:
    """A workspace, a policy and an audit beside it, and a client while a session goes on."""

    client: "Client"

    def __init__(self, folder: Path, **policy: Any) -> None:
        self.folder, self.work = folder, folder / "motor"
        self.work.mkdir(exist_ok=True)
        self.policy, self.audit = folder / "policy.yaml", folder / "audit.jsonl"
        self.policy.write_text(yaml.safe_dump(POLICY | policy))

    @property
    def words(self) -> list[str]:
        """The server's command line, behind Python."""
        places = [str(self.work), "--policy", str(self.policy), "--audit", str(self.audit)]
        return ["-P", "-m", "pcpc.tools.cli", "mcp", *places]

    def connect(self) -> "AbstractAsyncContextManager[Client]":
        """Return a client of a new server."""
        from mcp.client.client import Client
        from mcp.client.stdio import StdioServerParameters, stdio_client

        return Client(stdio_client(StdioServerParameters(command=sys.executable, args=self.words)))

    def session(self, story: "Callable[[Door], Awaitable[Any]]") -> Any:
        """Let a client do something with a server of its own; return what that returns."""

        async def told() -> Any:
            async with self.connect() as self.client:
                return await story(self)

        return anyio.run(told)

    async def call(self, tool: str, **arguments: Any) -> dict[str, Any]:
        """Return the structured answer of a call."""
        result = await self.client.call_tool(tool, arguments)
        told: dict[str, Any] = result.structured_content
        assert json.loads(result.content[0].text) == told  # type: ignore[union-attr]
        return told | {"error": result.is_error, "contents": result.content}

    def entries(self) -> list[dict[str, Any]]:
        """Return the lines of the audit."""
        return [json.loads(line) for line in self.audit.read_text().splitlines()]

    def entries_digest(self) -> str:
        """Return the digest of the last line."""
        return hashlib.sha256(self.audit.read_bytes().splitlines()[-1]).hexdigest()

    def report(self, *more: str) -> tuple[int, str]:
        """Return the exit code and the page of `pcpc report --audit`."""
        page = self.folder / "audit.html"
        page.unlink(missing_ok=True)
        code = cli.main(["report", "--audit", str(self.audit), "-o", str(page), "--quiet", *more])
        return code, page.read_text()
