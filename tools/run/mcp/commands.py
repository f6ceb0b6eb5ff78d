"""Commands: mcp."""

from pathlib import Path
from typing import Annotated

from pcpc.tools.terminal.command import Command, codes
from pcpc.tools.terminal.request import WORD, Request
from pcpc.tools.terminal.rooms import Room


class McpRequest(Request):
    """Where a program works, what it may do, and where that is written down."""

    workspace: Annotated[Path, WORD, "DIR", "the only folder it works in"] = Path(".")
    policy: Annotated[
        Path, "--policy", "FILE", "YAML: what is allowed; outside DIR", {"reads": True}
    ]
    audit: Annotated[Path, "--audit", "FILE", "the log of all calls, appended; outside DIR"]


class AuditRequest(Request):
    """An audit in place of a run."""

    audit: Annotated[
        Path | None, "FILE", "what `pcpc mcp` wrote: what was changed, run and found"
    ] = None
    audit_end: Annotated[str | None, "N:DIGEST", "--audit: the last line that is known"] = None


BESIDE_REPORT = AuditRequest
COMMANDS = (
    Command(
        "mcp",
        "let a program drive rigs by the Model Context Protocol, within a policy",
        "pcpc mcp . --policy ~/policy.yaml --audit ~/audit.jsonl",
        McpRequest,
        notes="stdin and stdout are the protocol's",
        module="run.mcp.cli",
        codes=codes(ENVIRONMENT="a package is missing, or a lock", INTERRUPTED=""),
    ),
)
ROOM = Room("docs/howto/agent.md", "tests/tools/run/test_mcp_cheats.py", "mcp --policy a --audit b")
