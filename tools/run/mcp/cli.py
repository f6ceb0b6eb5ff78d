"""`pcpc mcp`: the policy is read and the audit opened, then the process can write neither."""

import hashlib
import os
import tempfile
from pathlib import Path

from pcpc.drivers.compiled.compile_cache import cache_folder
from pcpc.drivers.errors import Exit, UserError
from pcpc.tools.run.mcp import lock, policy
from pcpc.tools.run.mcp.audit import Audit
from pcpc.tools.run.mcp.commands import McpRequest
from pcpc.tools.terminal.extras import need


def command(request: McpRequest) -> int:
    """Serve until stdin ends. UserError."""
    need("`pcpc mcp` needs", "mcp")
    workspace = request.workspace.resolve()
    if not workspace.is_dir():
        raise UserError(f"{request.workspace}: no such folder")
    text = request.policy.read_bytes()
    rules = policy.read(text, request.policy)
    cache = Path(cache_folder() or tempfile.gettempdir()).resolve()
    writable = [workspace, cache, Path("/dev/null"), Path("/dev" if rules.buses else "/dev/shm")]
    for path in (request.policy, request.audit):
        if any(path.resolve().is_relative_to(one) for one in writable):
            raise UserError(f"{path}: a tool could write it; put it elsewhere")
    with tempfile.TemporaryDirectory(prefix="mcp-", dir=cache) as scratch:
        audit = Audit(request.audit, workspace)
        lock.adopt_orphans()
        if not lock.confine(writable):
            _need_foreign(request.policy.resolve())
        import anyio

        from pcpc.tools.run.mcp.server import Door  # packages that not all have

        digest, place = hashlib.sha256(text).hexdigest(), request.policy.resolve()
        anyio.run(Door(workspace, rules, place, digest, audit, Path(scratch)).serve)
    return Exit.OK


def _need_foreign(path: Path) -> None:
    """Raise UserError where this kernel has no Landlock, and the policy is the user's own."""
    if any(os.access(one, os.W_OK) for one in (path, *path.parents)):
        what = "this user can write it, and this kernel has no Landlock"
        raise UserError(f"{path}: {what}", Exit.ENVIRONMENT)
