"""Whatever names stand in a log, its report is a page in which they are text."""

import json
from pathlib import Path

import pytest
from html_page import Page
from log_parts import put_together, take_apart
from mcap.records import Attachment

from pcpc.executive.nodes.virtual import simulate
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.after.verdict import summary_file
from pcpc.tools.cli import main

ROOT = Path(__file__).resolve().parents[2]
EVIL = ("<script>alert(1)</script>", '"><img src=x onerror=alert(1)>', "</style><b>", "&lt;i&gt;",
        "\x1b[2J\x00\u202e")  # fmt: skip


@pytest.fixture(scope="module")
def true_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("true")
    base = f"base: {ROOT / 'plants/probe/rig.yaml'}\nrig: truth\nduration_s: 0.03\n"
    lines = "schedule: [{at_s: 0.01, set: {controller.gain: 1.5}}]\n"
    lines += "faults: {wrong: {kind: bias, at: controller.command, value: 0.1, from: 5ms}}\n"
    (folder / "true.yaml").write_text(base + lines)
    simulate(load_rig(folder / "true.yaml"), folder / "log.mcap")
    return folder / "log.mcap"


def named(log: Path, evil: str) -> bytes:
    """Return a log in which everything that has a name is called `evil`."""
    parts = take_apart(log.read_bytes())
    for one in parts.metadata:
        for key in ("rig", "controller", "bus", "version_numpy", "kernel"):
            if key in one.metadata:
                one.metadata[key] = evil.replace("\0", "")
    changed = []
    for one in parts.attachments:
        name, data = one.name, one.data
        if name.endswith(".json"):
            about = json.loads(data)
            about["frames"] = dict.fromkeys(about["frames"], evil)
            about["faults"] = {
                k: v | {"of": evil, "kind": evil} for k, v in about["faults"].items()
            }
            about["variables"] = [[row[0], evil, *row[2:4], evil] for row in about["variables"]]
            data = json.dumps(about).encode()
        elif name.endswith(".yaml") and "resolved" not in name:
            name, data = evil.replace("\0", "") + ".yaml", data + f"# {evil}\n".encode()
        changed.append(Attachment(0, 0, name, "", data))
    parts.attachments = changed
    for i, (channel, sequence, at, data) in enumerate(parts.content):
        if parts.channels[channel].topic.endswith(("/events", "/tunings")):
            entry = json.loads(data)
            if not entry["name"].startswith("fault."):
                entry["name"] = evil
            parts.content[i] = channel, sequence, at, json.dumps(entry).encode()
    return put_together(parts)


@pytest.mark.parametrize("evil", EVIL)
def test_names_of_a_log_are_text_in_its_report(evil: str, true_log: Path, tmp_path: Path) -> None:
    (tmp_path / "log.mcap").write_bytes(named(true_log, evil))
    summary = {
        "verdict": evil, "title": evil, "metrics": {evil: 1.0}, "faults": [evil],
        "changed": [evil], "frames_to": {evil: {evil: 1}}, "timing_us": {evil: {evil: 1.0}},
        "timing_level": evil, "latest_cycles": [{"cycle": evil, "cause": evil}],
        "most_cut": evil, "not_judged": {evil: evil}, "pacing": "real",
        "requirements": [{"name": evil, "held": False, "what": evil, "unit": evil, "margin": 1.0,
                          "margin_unit": evil, "first_s": 0.01}],
    }  # fmt: skip
    summary_file.write_json(summary_file.from_json(summary), tmp_path / "summary.json")
    assert main(["report", str(tmp_path), "--quiet"]) == 0
    page = Page(tmp_path / "report.html")
    page.check_alone()
    assert "i" not in page.tags and page.tags.count("style") == 1
    shown = "".join(c if c.isprintable() else repr(c)[1:-1] for c in evil)
    assert page.text.count(shown) > 20, page.text.count(shown)
    assert not any(c in page.source for c in "\0\x1b\u202e")
