"""`pcpc mcp`: the official client over stdio drives a rig, within a policy, under an audit."""

from pathlib import Path

from mcp_door import POLICY, Door


def test_a_client_lists_the_tools_simulates_a_rig_and_is_written_down(tmp_path: Path) -> None:
    door = Door(tmp_path)

    async def story(door: Door) -> None:
        tools = (await door.client.list_tools()).tools
        assert [one.name for one in tools] == [
            name for name in (
                "rigs", "check", "simulate", "report", "replay", "compare", "branch", "log",
            ) if name in POLICY["commands"]
        ]  # fmt: skip
        told = await door.call("simulate", rig="suspension-58")
        assert told["answer"]["verdict"] == "ok", told
        assert next(iter(told["answer"])) == "verdict"
        assert told["audit"] == f"3:{door.entries_digest()}"

    door.session(story)
    start, call, end, stop = door.entries()
    assert (start["kind"], call["kind"], end["kind"], stop["kind"]) == (
        "start",
        "call",
        "end",
        "stop",
    )
    assert call["arguments"] == {"rig": "suspension-58"}
    assert end["ran"]["verdict"] == "ok"
    assert end["files"][f"{end['ran']['folder']}/log.mcap"] == end["ran"]["log"]
