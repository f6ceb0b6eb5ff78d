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

import pcpc
from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.own_laws.carried_files import sha256
from pcpc.tools.run.mcp import policy, tools, workspace
from pcpc.tools.run.mcp.audit import Audit, Ran
from pcpc.tools.run.mcp.policy import Policy, Refused
from pcpc.tools.start.children import end_with

_LOOK_S = 0.2
_PATIENCE_S = 5.0  # of a command that was asked to end
_DOCS = Path(pcpc.__file__).resolve().parents[1] / "docs"
_NO_MESSAGE = types.JSONRPCError(
    jsonrpc="2.0",
    id=None,
    error=types.ErrorData(code=types.PARSE_ERROR, message="not a message of JSON-RPC"),
)


@dataclass
class Door:
    """One client, its workspace, and what is at work for it."""

    folder: Path
    rules: Policy
    policy: Path
    digest: str  # of the policy, when it was read
    audit: Audit
    scratch: Path
    live: dict[int, tuple[str, str]] = field(default_factory=dict)  # processes, tools, folders

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
        (self.folder / workspace.RUNS).mkdir(exist_ok=True)
        self.audit.add("start", policy=self.digest)
        out = anyio.wrap_file(open(os.dup(1), "w", encoding="utf-8"))  # noqa: SIM115  until the end
        os.dup2(2, 1)  # for what is printed by mistake
        async with stdio_server(_messages(out), out) as (read, write):
            await server.run(read, write, server.create_initialization_options())
        self.audit.add("stop")

    async def _list_tools(self, context: Any, _: Any) -> types.ListToolsResult:
        found = []
        for name in tools.TOOLS:
            with suppress(ValueError):
                about, asked, told = tools.described(name)
                found += [types.Tool(
                    name=name, description=about, input_schema=asked, output_schema=told
                )] * (name in self.rules.commands)  # fmt: skip
        return types.ListToolsResult(tools=found)

    async def _call_tool(self, context: Any, asked: Any) -> types.CallToolResult:
        name, given = asked.name, asked.arguments or {}
        try:
            jsonschema.validate(given, tools.described(name)[1])
            tools.words(name, given)
        except (jsonschema.ValidationError, ValueError) as error:
            what = getattr(error, "message", str(error))
            raise MCPError(types.INVALID_PARAMS, f"{name}: {what}") from None
        entry = self.audit.add("call", tool=name, arguments=given)
        folder = f"{workspace.RUNS}/{entry.number:04}-{name}"
        place = self.folder / folder
        end: dict[str, Any] = {"why": "cancelled"}
        try:
            line = self._allowed(name, given, folder)
            told = await self._carried_out(context, name, folder, line)
            told["answer"] = answer = tools.answer(name, told["answer"], given.get("columns", ()))
            end = {"code": told["exit"], "why": told.get("why", "")}
            if tools.TOOLS[name].keeps:
                log = place / workspace.LOG
                facts = answer if isinstance(answer, dict) else {}
                about = {key: facts[key] for key in ("verdict", "changed") if key in facts}
                about["own"] = any(Path(word).is_relative_to(self.folder) for word in line)
                told["run"] = folder
                end["ran"] = Ran(folder=folder, log=sha256(log) if log.is_file() else "", **about)
        except (Refused, UserError, OSError, ValueError) as error:
            told = {"refused": getattr(error, "rule", "input"), "why": str(error)}
            end = {"why": f"{told['refused']}: {error}"}
        finally:
            self.audit.add("end", call=entry.number, tool=name, **end)
        told = {key: own for key, own in told.items() if own or key == "exit"}
        told["audit"] = self.audit.last
        content: list[Any] = [types.TextContent(text=json.dumps(told))]
        if given.get("picture") and (picture := place / "figure.png").is_file():
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
        rules.limit("processes", len(self.live) + 1)
        if name in ("set", "operate") and all(of != "run" for of, _ in self.live.values()):
            raise Refused("commands", "no run of this session is in progress")
        workspace.check(self.folder, rules)
        known = {one.ran.folder: one.ran.log for one in self.audit.entries if one.ran}
        rules.limit("runs", len(known) + tool.keeps)
        for log in [said[tool.reads]] if tool.reads == "log" else said.get(tool.reads, ()):
            place = self.folder / log / workspace.LOG
            if not known.get(log) or not place.is_file() or sha256(place) != known[log]:
                raise Refused("runs", f"{log}: not a run folder as a call has left it")
        kept = [f"--output={folder}"] * tool.keeps
        no_figure = ["--no-figure"] * ("--judge" in tool.words and not given.get("picture"))
        return [*tools.words(name, said), *kept, *no_figure]

    async def _carried_out(
        self, context: Any, name: str, folder: str, line: list[str]
    ) -> dict[str, Any]:
        """Return exit code, output and messages of a command; Refused past a limit."""
        place, own, begin_s = self.scratch / str(time.monotonic_ns()), os.getpid(), time.monotonic()
        environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
        environment |= dict.fromkeys(("TMPDIR", "MPLCONFIGDIR"), str(self.scratch))
        environment |= {"PYTHONPYCACHEPREFIX": str(self.scratch.with_name("mcp-bytecode"))}
        environment["PATH"] = os.devnull  # git's filters would be programs of the workspace
        begun_ns, at_work = self.audit.written_ns, tuple(of for _, of in self.live.values())
        files = [one for one in self.audit.files if not one.startswith(at_work)]
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
            self.live[process.pid] = name, folder
            try:
                while process.poll() is None:
                    spent_s = time.monotonic() - begin_s
                    await context.session.report_progress(spent_s, self.rules.time_s)
                    self.rules.limit("time_s", spent_s)
                    workspace.check_size(self.folder, self.rules, os.fstat(out.fileno()).st_size)
                    await anyio.sleep(_LOOK_S)
            finally:
                with anyio.CancelScope(shield=True):
                    await self._end(process)
            texts = [(one.seek(0), one.read().decode("utf-8", "replace"))[1] for one in (out, err)]
        told = {"exit": process.returncode, "said": texts[1].splitlines()[-5:], "answer": texts[0]}
        if late := workspace.touched(self.folder, files, begun_ns):
            told["why"] = f"{', '.join(late[:5])}: changed while the call was at work"
        return told

    async def _end(self, process: "subprocess.Popen[bytes]") -> None:
        """Ask a command to end, then kill it, and all that it has left behind."""
        process.terminate()  # none that has ended
        with anyio.move_on_after(_PATIENCE_S):
            while process.poll() is None:
                await anyio.sleep(_LOOK_S)
        process.kill()
        process.wait()
        del self.live[process.pid]
        children = Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children")
        while strays := {*map(int, children.read_text().split())} - self.live.keys():
            for one in strays:
                with suppress(OSError):
                    os.kill(one, signal.SIGKILL)
                    os.waitpid(one, 0)

    async def _list_resources(self, context: Any, _: Any) -> types.ListResourcesResult:
        rigs = [*self.rules.rigs, *(one for one in self.audit.files if one.endswith(".yaml"))]
        names = ["schema", *(f"rig/{one}" for one in rigs if "*" not in one)]
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


async def _messages(out: "anyio.AsyncFile[str]") -> Any:  # stdio_server only iterates over it
    """Yield what comes on stdin, as far as it is a message; answer what is none."""
    with open(os.dup(0), encoding="utf-8", errors="replace", newline="\n") as stdin:
        async for line in anyio.wrap_file(stdin):
            try:
                known = type(json.loads(line).get("id", "")) in (str, int)
                types.jsonrpc_message_adapter.validate_json(line, by_name=False)
            except (ValueError, AttributeError, RecursionError):
                known = False
            if known:
                yield line
            else:
                await out.write(
                    _NO_MESSAGE.model_dump_json(by_alias=True, exclude_unset=True) + "\n"
                )
                await out.flush()
