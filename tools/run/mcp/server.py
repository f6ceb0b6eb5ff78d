"""The server: each call is a process of its own, checked before and written down after."""

import base64
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import anyio
import jsonschema
import mcp_types as types
from mcp.server.lowlevel import Server
from mcp.server.stdio import stdio_server
from mcp.shared.exceptions import MCPError
from mcp.shared.message import SessionMessage

import pcpc
from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.own_laws.carried_files import sha256
from pcpc.tools.run.mcp import policy, tools, workspace
from pcpc.tools.run.mcp.audit import Audit
from pcpc.tools.run.mcp.policy import Policy, Refused
from pcpc.tools.run.mcp.recorded import ran
from pcpc.tools.start.children import end_with

_LOOK_S = 1.0
_MOST_ASKED = 100_000  # bytes of arguments; the kernel takes 131,072 of a word
_PATIENCE_S = 5.0  # of a command that was asked to end
_DOCS = Path(pcpc.__file__).resolve().parents[1] / "docs"


@dataclass
class Door:
    """One client, its workspace, and what is at work for it."""

    folder: Path
    rules: Policy
    policy: Path
    digest: str  # of the policy, when it was read
    audit: Audit
    scratch: Path
    live: dict[int, str] = field(default_factory=dict)  # processes, tools

    async def serve(self) -> None:
        """Answer until stdin ends."""
        server = Server(
            "pcpc",
            version=version("pcpc"),
            on_list_tools=self._list_tools,
            on_call_tool=self._call_tool,
            on_list_resources=self._list_resources,
            on_read_resource=self._read_resource,
        )
        self.audit.add("start", policy=self.digest)
        async with stdio_server(_lines()) as (read, write), anyio.create_task_group() as group:
            into, valid = anyio.create_memory_object_stream[SessionMessage | Exception](0)
            group.start_soon(_hand_on, read, into, write)
            await server.run(valid, write, server.create_initialization_options())
        self.audit.add("stop")

    async def _list_tools(self, context: Any, _: Any) -> types.ListToolsResult:
        return types.ListToolsResult(tools=[
            types.Tool(name=name, description=about, input_schema=schema)
            for name in filter(tools.is_here, tools.TOOLS) if name in self.rules.commands
            for about, schema in [tools.described(name)]
        ])  # fmt: skip

    async def _call_tool(self, context: Any, asked: Any) -> types.CallToolResult:
        name, given = asked.name, asked.arguments or {}
        try:
            if len(json.dumps(given, ensure_ascii=False).encode()) > _MOST_ASKED:
                raise ValueError("too long")
            jsonschema.validate(given, tools.described(name)[1])
            tools.words(name, given)
        except (jsonschema.ValidationError, ValueError) as error:
            what = getattr(error, "message", str(error))
            raise MCPError(types.INVALID_PARAMS, f"{name}: {what}") from None
        entry = self.audit.add("call", tool=name, arguments=given)
        folder = f"{workspace.RUNS}/{entry.number:04}-{name}"
        end: dict[str, Any] = {"why": "cancelled"}
        try:
            line = self._allowed(name, given, folder)
            code, text, said = await self._carried_out(context, name, line)
            end = {"code": code}
            if tools.TOOLS[name].keeps:
                end["ran"] = ran(self.folder / folder, text, folder)
            told = {"exit": code, "said": said[-5:], "run": folder if "ran" in end else ""}
            told["answer"] = tools.answer(name, text, given.get("columns", ()))
        except (Refused, UserError, OSError, ValueError) as error:
            told = {"refused": getattr(error, "rule", "input"), "why": str(error)}
            end = {"why": f"{told['refused']}: {error}"}
        finally:
            self.audit.add("end", call=entry.number, tool=name, **end)
        told = {key: own for key, own in told.items() if own or key == "exit"}
        told["audit"] = self.audit.last
        content: list[Any] = [types.TextContent(text=json.dumps(told))]
        picture = self.folder / folder / "figure.png"
        if given.get("picture") and picture.is_file():
            data = base64.b64encode(picture.read_bytes()).decode()
            content.append(types.ImageContent(data=data, mime_type="image/png"))
        is_error = told.get("exit") not in (Exit.OK, Exit.NOT_MET)
        return types.CallToolResult(content=content, structured_content=told, is_error=is_error)

    def _allowed(self, name: str, given: Mapping[str, Any], folder: str) -> list[str]:
        """Return the command line of a call; Refused, UserError."""
        rules, tool = self.rules, tools.TOOLS[name]
        if not self.policy.is_file() or sha256(self.policy) != self.digest:
            raise Refused("policy", "its file has changed since the start")
        said = policy.check(rules, name, given, self.folder)
        if len(self.live) >= rules.processes:
            raise Refused("processes", f"{len(self.live)} at work already")
        if name in ("set", "operate") and "run" not in self.live.values():
            raise Refused("commands", "no run of this session is in progress")
        workspace.check(self.folder, rules)
        runs = [one.ran for one in self.audit.entries if one.ran]
        if tool.keeps and len(runs) >= rules.runs:
            raise Refused("runs", f"{len(runs)} were made already")
        known = {one.folder: one.log for one in runs if one.log}
        for log in tool.logs_in(said):
            place = self.folder / log / workspace.LOG
            if log not in known or not place.is_file() or sha256(place) != known[log]:
                raise Refused("runs", f"{log}: not a run folder as a call has left it")
        kept = [f"--output={folder}"] * tool.keeps
        no_figure = ["--no-figure"] * (tool.keeps and name != "sweep" and not given.get("picture"))
        return [*tools.words(name, said), *kept, *no_figure]

    async def _carried_out(
        self, context: Any, name: str, line: list[str]
    ) -> tuple[int, str, list[str]]:
        """Return exit code, output and messages of a command; Refused past a limit."""
        place, own, begin_s = self.scratch / str(time.monotonic_ns()), os.getpid(), time.monotonic()
        environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
        environment |= dict.fromkeys(("TMPDIR", "MPLCONFIGDIR"), str(self.scratch))
        environment["PYTHONPYCACHEPREFIX"] = str(self.scratch.with_name("mcp-bytecode"))
        with place.with_suffix(".out").open("w+b") as out, place.open("w+b") as err:
            process = subprocess.Popen(
                [sys.executable, "-P", "-m", "pcpc.tools.cli", *line],
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err,
                cwd=self.folder,
                env=environment,
                start_new_session=True,
                preexec_fn=lambda: end_with(own),
            )
            self.live[process.pid] = name
            try:
                while not await _ends(process, _LOOK_S):
                    spent_s = time.monotonic() - begin_s
                    await context.session.report_progress(spent_s, self.rules.time_s)
                    if spent_s > self.rules.time_s:
                        raise Refused("time_s", f"it took longer than {self.rules.time_s:g} s")
                    workspace.check_size(self.folder, self.rules, os.fstat(out.fileno()).st_size)
            finally:
                with anyio.CancelScope(shield=True):
                    await self._end(process)
            texts = [(one.seek(0), one.read().decode("utf-8", "replace"))[1] for one in (out, err)]
        return process.returncode, texts[0], texts[1].splitlines()

    async def _end(self, process: "subprocess.Popen[bytes]") -> None:
        """Ask a command to end, then kill it, and all that it has left behind."""
        if process.poll() is None:
            process.terminate()
            if not await _ends(process, _PATIENCE_S):
                process.kill()
                process.wait()
        del self.live[process.pid]
        while strays := _children(os.getpid()) - self.live.keys():
            for one in strays:
                with suppress(OSError):
                    os.kill(one, signal.SIGKILL)
                    os.waitpid(one, 0)

    async def _list_resources(self, context: Any, _: Any) -> types.ListResourcesResult:
        rigs = [one for one in (*self.rules.rigs, *self.audit.files) if one.endswith(".yaml")]
        names = ["schema", *(f"rig/{one}" for one in (*self.rules.rigs, *rigs) if "*" not in one)]
        names += [f"docs/{one.relative_to(_DOCS)}" for one in sorted(_DOCS.rglob("*.md"))]
        return types.ListResourcesResult(
            resources=[types.Resource(uri=f"pcpc://{one}", name=one) for one in names]
        )

    async def _read_resource(self, context: Any, asked: Any) -> types.ReadResourceResult:
        kind, _, name = str(asked.uri).removeprefix("pcpc://").partition("/")
        try:
            if kind == "rig":
                said = policy.check(self.rules, "check", {"rig": name}, self.folder)
                text = Path(said["rig"]).read_text("utf-8")
            elif kind == "docs" and (_DOCS / name).resolve().is_relative_to(_DOCS):
                text = (_DOCS / name).read_text("utf-8")
            elif kind == "schema":
                given = {"schema": True} | ({"rig": name} if name else {})
                asked_check = types.CallToolRequestParams(name="check", arguments=given)
                told = (await self._call_tool(context, asked_check)).structured_content
                text = json.dumps(told.get("answer", told))
            else:
                raise UserError(f"no resource {asked.uri}")
        except (Refused, UserError, OSError, ValueError) as error:
            raise MCPError(types.INVALID_PARAMS, str(error)) from None
        content = types.TextResourceContents(uri=asked.uri, text=text)
        return types.ReadResourceResult(contents=[content])


async def _ends(process: "subprocess.Popen[bytes]", within_s: float) -> bool:
    """Return whether a process ends in time."""
    handle = os.pidfd_open(process.pid)
    try:
        with anyio.move_on_after(within_s):
            await anyio.wait_readable(handle)
    finally:
        os.close(handle)
    return process.poll() is not None


def _children(parent: int) -> set[int]:
    """Return the processes that a process has begun, or adopted."""
    text = Path(f"/proc/{parent}/task/{parent}/children").read_text()
    return {int(one) for one in text.split()}


async def _lines() -> Any:  # stdio_server only iterates over it
    """Yield what comes on stdin; in place of what is no message a line that is none either."""
    with open(os.dup(0), encoding="utf-8", errors="replace", newline="\n") as stdin:
        async for line in anyio.wrap_file(stdin):
            try:
                message = json.loads(line)
                known = type(message.get("id", "")) in (str, int)
            except (ValueError, AttributeError, RecursionError):
                known = False
            yield line if known else "null"


async def _hand_on(read: Any, into: Any, write: Any) -> None:
    """Hand on what is a message, and answer what is none."""
    async with into:
        async for one in read:
            if not isinstance(one, Exception):
                await into.send(one)
                continue
            error = types.ErrorData(code=types.PARSE_ERROR, message="not a message of JSON-RPC")
            answer = types.JSONRPCError(jsonrpc="2.0", id=None, error=error)
            await write.send(SessionMessage(answer))
