"""What a client's code cannot write, which policies are refused, and that a cut audit is found."""

import subprocess
import sys
from pathlib import Path

import pytest
from mcp_door import Door

from pcpc.drivers.errors import UserError
from pcpc.tools import cli
from pcpc.tools.run.mcp import policy, workspace
from pcpc.tools.run.mcp.audit import Audit
from pcpc.tools.run.mcp.policy import Refused

_TRIES = """
import os, sys
from pathlib import Path
from pcpc.tools.run.mcp import lock

inside, outside = Path(sys.argv[1]), Path(sys.argv[2])
assert lock.confine([inside])
(inside / "own").write_text("x")
tries = {
    "write": lambda: outside.write_text("x"),
    "append": lambda: outside.open("a"),
    "truncate": lambda: os.truncate(outside, 0),
    "remove": outside.unlink,
    "rename": lambda: outside.rename(outside.with_name("y")),
    "replace": lambda: os.replace(inside / "own", outside),
    "link": lambda: os.link(outside, inside / "link"),
    "create": lambda: outside.with_name("new").touch(),
    "folder": lambda: outside.with_name("folder").mkdir(),
    "symlink": lambda: outside.with_name("symlink").symlink_to(inside),
    "child": lambda: os.system(f"echo x > {outside}") and outside.with_name("z").touch(),
}
for name, attempt in tries.items():
    try:
        attempt()
    except OSError:
        print(name)
"""


_DOUBLED = "".join(f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}]\n" for i in range(1, 60))
WIDE = f"a0: &a0 [x]\n{_DOUBLED}"


def test_a_document_that_holds_itself_or_repeats_itself_is_looked_at_once(tmp_path: Path) -> None:
    (tmp_path / "wide.yaml").write_text(WIDE)
    (tmp_path / "own.yaml").write_text("a: &a [*a, /etc/passwd]\n")
    with pytest.raises(Refused, match="'/etc/passwd', outside the workspace"):
        workspace.check(tmp_path, policy.Policy())
    (tmp_path / "own.yaml").unlink()
    workspace.check(tmp_path, policy.Policy())


def test_what_is_locked_in_writes_nowhere_else(tmp_path: Path) -> None:
    inside, outside = tmp_path / "in", tmp_path / "policy.yaml"
    inside.mkdir()
    outside.write_text("commands: []")
    done = subprocess.run(
        [sys.executable, "-c", _TRIES, str(inside), str(outside)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    refused = "write append truncate remove rename replace link create folder symlink child"
    assert done.stdout.split() == refused.split()
    assert outside.read_text() == "commands: []"
    assert sorted(one.name for one in tmp_path.iterdir()) == ["in", "policy.yaml"]


@pytest.mark.parametrize(
    "text, rule, tool, given",
    [
        ("{}", "commands", "simulate", {}),
        ("commands: [simulate]", "rigs", "simulate", {"rig": "hull"}),
        ("commands: [check]", "commands", "simulate", {"rig": "hull"}),
        (
            "{commands: [simulate], rigs: [hull]}",
            "set",
            "simulate",
            {"rig": "hull", "set": ["a=1"]},
        ),
        ("{commands: [run], rigs: [hull]}", "buses", "run", {"rig": "hull"}),
        ("{commands: [run], buses: [vcan0]}", "buses", "run", {"bus": "can0"}),
        ("{commands: [sweep], draws: 5}", "draws", "sweep", {"draws": 6}),
        ("{commands: [sweep]}", "set", "sweep", {"vary": ["a=x0.5:2"]}),
        ("{commands: [branch]}", "faults", "branch", {"fault": ["stuck:1s"]}),
        ("{commands: [set]}", "set", "set", {"names": ["plant:a.b=1"]}),
    ],
)
def test_what_a_policy_does_not_say_is_denied(
    text: str, rule: str, tool: str, given: dict[str, object], tmp_path: Path
) -> None:
    rules = policy.read(text.encode(), tmp_path)
    with pytest.raises(Refused) as refused:
        policy.check(rules, tool, given, tmp_path)
    assert refused.value.rule == rule


@pytest.mark.parametrize("text", ["comands: []", "commands: simulate", "time_s: long", "[", "1"])
def test_a_policy_with_a_mistake_is_refused(text: str, tmp_path: Path) -> None:
    with pytest.raises(UserError):
        policy.read(text.encode(), tmp_path)


def test_policy_and_audit_in_the_workspace_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    door = Door(tmp_path)
    inside = door.work / "policy.yaml"
    inside.write_text("{}")
    (tmp_path / "link.yaml").symlink_to(inside)
    for places in ((inside, door.audit), (tmp_path / "link.yaml", door.audit),
                   (door.policy, door.work / "audit")):  # fmt: skip
        words = ["--policy", str(places[0]), "--audit", str(places[1])]
        assert cli.main(["mcp", str(door.work), *words]) == 2
        assert "a tool could write it" in capsys.readouterr().err


@pytest.fixture
def written(tmp_path: Path) -> Door:
    """Return a door whose audit has five lines."""
    door = Door(tmp_path)
    audit = Audit(door.audit, door.work)
    for tool in ("", "rigs", "check", "rigs", ""):
        audit.add("call" if tool else "start", tool=tool)
    return door


@pytest.mark.parametrize("text", ["a: &a [*a]\n", WIDE, "a: 2001-99-99\n", "[", "word", ""])
def test_a_file_that_became_no_rig_is_a_finding(text: str, tmp_path: Path) -> None:
    door = Door(tmp_path)
    file, audit = door.work / "rig.yaml", Audit(door.audit, door.work)
    file.write_text("a: 1\n")
    audit.add("start")
    file.write_text(text)
    audit.add("call", tool="check")
    code, told = door.report()
    assert code == 1 and "rig.yaml" in told, told


def test_an_audit_without_a_finding_ends_with_zero(tmp_path: Path) -> None:
    door = Door(tmp_path)
    audit = Audit(door.audit, door.work)
    audit.add("start")
    assert door.report()[0] == 0
    assert door.report("--audit-end", audit.last)[0] == 0
    assert door.report("--audit-end", "2:00")[0] == 3


@pytest.mark.parametrize("cheat", ["change", "remove", "swap", "cut", "cut both", "empty"])
def test_a_changed_audit_is_found(written: Door, cheat: str) -> None:
    lines = written.audit.read_bytes().splitlines(keepends=True)
    end = written.audit.with_name("audit.jsonl.end")
    known = end.read_text().strip()
    changed = {
        "change": [lines[0], lines[1].replace(b"rigs", b"sets"), *lines[2:]],
        "remove": [*lines[:2], *lines[3:]],
        "swap": [lines[0], lines[2], lines[1], *lines[3:]],
        "empty": [lines[0]],
    }.get(cheat, lines[:-1])
    written.audit.write_bytes(b"".join(changed))
    if cheat == "cut both":
        end.write_text(f"4:{written.entries_digest()}")
        assert written.report("--audit-end", known)[0] == 3
    else:
        assert written.report()[0] == 3
        with pytest.raises(UserError):
            Audit(written.audit, written.work)
