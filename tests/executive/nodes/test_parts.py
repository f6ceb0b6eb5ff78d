"""Parts of a node: each can be taken out or added alone, and the order is that of the table."""

import re
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fd_rig import fd_rig
from installed import loop_of
from motors import motors
from places import ROOT

from pcpc.executive.errors import RigError
from pcpc.executive.log.description import NodeDescription
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.injection_layout import MAX_FAULTS
from pcpc.executive.loop.ring_layout import RECORD_HEAD, frame_words
from pcpc.executive.loop.sending import LastWord
from pcpc.executive.loop.supervisor import Overrun
from pcpc.executive.loop.table import Variable
from pcpc.executive.loop.variables import DISARMED
from pcpc.executive.nodes import install as installing
from pcpc.executive.nodes import plan as planning
from pcpc.executive.nodes import planned_blocks
from pcpc.executive.nodes.fmus import Fmus
from pcpc.executive.nodes.part import Part, Plan, Size
from pcpc.executive.nodes.parts import PARTS
from pcpc.executive.nodes.planned_drive import PlantDrive
from pcpc.executive.nodes.planned_faults import Faults
from pcpc.executive.nodes.planned_intrusion import Intrusion
from pcpc.executive.nodes.planned_keyframes import Keyframes
from pcpc.executive.nodes.planned_losses import Losses
from pcpc.executive.nodes.planned_overrun import OverrunPolicy
from pcpc.executive.nodes.planned_plausible import Plausible
from pcpc.executive.nodes.planned_schedule import Schedule
from pcpc.executive.rig.messages import is_heartbeat
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.executive.rig.roles import Role

FEATURES: dict[type[Part], tuple[str, list[str]]] = {  # where it writes, what a log says of it
    Losses: ("rx", []),
    OverrunPolicy: ("guard blocks", []),
    Intrusion: ("intrusion", []),
    Plausible: ("plausible", []),
    PlantDrive: ("canopen drive robot", []),
    Schedule: ("tuning blocks", []),
    Faults: ("faults", ["faults"]),
    Fmus: ("", []),
    Keyframes: ("keep", ["keyframe_passes", "keyframe_bytes", "keyframe_layout"]),
}


@pytest.fixture(scope="module")
def rig() -> Rig:
    """Return a rig that uses none of the features."""
    return load_rig(ROOT / "plants/probe/rig.yaml")


def use(monkeypatch: pytest.MonkeyPatch, *parts: Part) -> None:
    """Let nodes have these parts."""
    for module in (planning, installing):
        monkeypatch.setattr(module, "PARTS", parts)


def made_node(rig: Rig) -> tuple[Plan, NodeDescription, Any]:
    """Return plan, description and LOOP record of the executive."""
    made = planning.plan(rig, "executive", "lockstep")
    loop = np.recarray(1, sh.LOOP, sh.blank())[0]
    installing.install_in_memory(made, loop)
    return made, planning.describe(made, {}), loop


@pytest.mark.parametrize("feature", FEATURES, ids=lambda one: one.__name__)
def test_a_feature_that_a_rig_does_not_use_can_be_taken_out(
    feature: type[Part], rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    places, keys = FEATURES[feature]
    whole, said, loop = made_node(rig)
    use(monkeypatch, *(one for one in PARTS if not isinstance(one, feature)))
    made, less, bare = made_node(rig)
    assert made.table.variables == whole.table.variables and made.values == whole.values
    assert {**less, **{key: said.get(key) for key in keys}} == said
    assert [key for key in said if key not in less] == keys
    differ = {name for name in sh.LOOP.names or () if bare[name].tobytes() != loop[name].tobytes()}
    assert differ <= set(places.split()), differ


class Beats(Part):
    """A part that nobody has: a counter, how large it may be, what is said of it."""

    def variables(self, made: Plan) -> None:
        """Add the counter; RigError for more than there are."""
        self.place = made.add(Variable("beats.count", "", "health", "loop", "beats"), 7.0)

    def sizes(self, made: Plan) -> list[Size]:
        """Return how many there are."""
        return [("beats", 3, 2 if made.rig.config.seed == 5 else 3)]

    def install(self, made: Plan, loop: Any) -> None:
        """Count the variables before it."""
        loop.guard.grace_passes = self.place
        self.is_open = True

    def described(self, made: Plan) -> NodeDescription:
        """Return its name."""
        return {"watch": "beats.count"}

    def failures(self, made: Plan) -> list[str]:
        """Return what is open."""
        return [f"{self.place} is open"] * self.is_open

    def close(self, made: Plan) -> None:
        """Close it."""
        self.is_open = False


def test_a_part_more_adds_its_variables_behind_all_others(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, said, _ = made_node(rig)
    use(monkeypatch, *PARTS, Beats())
    made, more, loop = made_node(rig)
    assert made.names == [*whole.names, "beats.count"]
    assert loop.v[len(whole.names)] == 7.0 and loop.guard.grace_passes == len(whole.names)
    assert more["watch"] == "beats.count" and list(more) == list(said)
    assert more["state_columns"][-1] == "beats.count"
    assert list(planning.failures(made)) == [f"{len(whole.names)} is open"]
    planning.close(made)
    assert not list(planning.failures(made))
    with pytest.raises(RigError, match=r"executive: 3 beats; one node holds 2 \(see"):
        planning.plan(rig.changed(seed=5), "executive", "lockstep")


def test_each_part_is_there_once() -> None:
    kinds = [type(one) for one in PARTS]
    assert len(kinds) == len(set(kinds)) and set(FEATURES) < set(kinds)


def test_tunings_of_a_cycle_keep_their_order(rig: Rig) -> None:
    made = planning.plan(rig, "executive", "lockstep")
    for cycle, place in ((3, 1), (1, 2), (3, 0), (2, 9), (1, 1)):
        made.tune_at(cycle, place, 0.5)
    assert [row[:2] for row in made.schedule] == [(1, 2), (1, 1), (2, 9), (3, 1), (3, 0)]


def test_parts_write_what_the_role_and_the_pacing_are() -> None:
    top, low = loop_of("executive", "real"), loop_of("plant", "lockstep")
    for n, leads in ((top, 1), (low, 0)):
        assert (n.meeting.seeks_below, n.guard.safe_start, n.blocks.owe_periods) == (
            leads, leads, 1 - leads,
        )  # fmt: skip
        assert n.tx.last_word == (LastWord.ALL_FRAMES if leads else LastWord.HEARTBEAT)
        assert (n.guard.mode_index < 0) == bool(leads)
        assert n.guard.odd_output == (Fault.OUTPUT_NOT_FINITE, Fault.PLANT_NOT_FINITE)[1 - leads]
        assert n.guard.cycles == (10_000 if leads else 2**62)
        assert n.clock.arm_pass == 1 - leads and n.meeting.ordered == 1 - leads
        columns = RECORD_HEAD + n.rings.n_state + 1 + n.rings.n_timing
        assert n.rings.record_rows * columns <= sh.RECORD_RING_WORDS
        assert n.tx.past - n.tx.first == 2 + leads  # its value, its heartbeat, and the mode


def test_only_the_executive_is_armed_scheduled_and_judged_for_overruns() -> None:
    more = "schedule: [{at_s: 0.1, set: {controller.gain: 2.0}}]\nnote: [controller.gain]"
    settings = "supervisor.arm=manual", "overrun.fault_after=5"
    roles: tuple[tuple[Role, int], ...] = (("executive", 1), ("plant", 0))
    for role, leads in roles:
        n = loop_of(role, "real", *settings, text=more)
        assert (n.guard.manual, n.guard.disarmed, n.v[DISARMED]) == (leads,) * 3
        assert n.tuning.value[0] == 2.0 * leads and n.tuning.schedule[0].cycle == 100 * leads
        assert n.guard.gain == 1 - leads and n.tuning.n == n.blocks.n_noted == leads
        assert n.guard.overrun_policy == (Overrun.FAULT_AFTER if leads else Overrun.SKIP)


@pytest.mark.parametrize(("settings", "text", "care", "limited"), [
    ((), "", [0, 1], []),  # of the heartbeat alone
    (("supervisor.intrusion=hold",), "", [1, 1], []),
    ((), "executive: {plausible: {FB.position: {low: -1, high: 1}}}", [0, 1], [0]),
])  # fmt: skip
def test_frames_that_may_be_doubted_are_marked_by_what_doubts_them(
    settings: tuple[str, ...], text: str, care: list[int], limited: list[int]
) -> None:
    n = loop_of("executive", "real", *settings, text=text)
    assert n.intrusion.care[: n.rx.n].tolist() == care and n.intrusion.beat_every[1] > 1
    assert n.plausible.row[: n.plausible.n].tolist() == limited


@pytest.mark.parametrize(("text", "said"), [
    (f"note: [{', '.join(['controller.gain'] * 65)}]", "65 noted variables; one node holds 64"),
    ("schedule:\n" + "- {at_s: 0.1, set: {controller.gain: 1.0}}\n" * 2049,
     "2049 scheduled values; one node holds 2048"),
    ("faults:\n" + "".join(f"  f{i}: {{kind: nan, at: tx.CMD.command}}\n" for i in range(33)),
     "faults: 33 faults; one node holds 32"),
    ("losses: {FB_X: {share: 0.1}}", "losses.FB_X: no frame FB_X; did you mean FB?"),
    ("supervisor: {stop_frame: STOP}", "no node receives a frame of GenMsgSendType Event STOP"),
    ("record: {keep: 0s}", "record.keep: 0s: expected more than 0 and no more than 12 days"),
    ("record: {keep: 16667min}", "record.keep: 16667min: expected more than 0 and no more"),
    ("record: {keyframe: 99ms}", "record.keyframe: 99ms: expected 100ms to 12 days, or 0s for"),
    ("record: {keyframe: 16667min}", "record.keyframe: 16667min: expected 100ms to 12 days"),
    ("executive: {plausible: {FB.position: {low: 1e9, high: 2e9}}}", "lies within these bounds"),
    ("executive: {plausible: {FB.position: {low: -2e9, high: -1e9}}}", "lies within these bounds"),
    ("losses: {HB_PLANT: {share: 0.1}}", "is a heartbeat, for which the start waits; losses"),
    ("faults: {a: {kind: noise, at: tx.CMD.command, value: -1}}", "-1 is outside 0..inf"),
    ("faults: {a: {kind: flood, node: plant, value: 201}}", "201 is outside 1..200, which a flood"),
    ("faults: {a: {kind: masquerade, frame: HB_PLANT}}", "HB_PLANT has no counter and CRC"),
])  # fmt: skip
def test_each_part_refuses_what_it_cannot_hold_or_find(text: str, said: str) -> None:
    with pytest.raises(RigError) as caught:
        loop_of("executive", "real", text=text)
    assert said in str(caught.value)


@pytest.mark.parametrize("name", [
    "plants/atb1000/rigs/hull.yaml", "plants/telerobot/rigs/telerobot-u0.yaml",
    "plants/probe/rig.yaml",
])  # fmt: skip
@pytest.mark.parametrize("role", ["executive", "plant"])
def test_what_a_part_counts_is_what_it_writes_and_what_the_record_holds(
    name: str, role: Role
) -> None:
    made = planning.plan(load_rig(ROOT / name), role, "lockstep")
    n = np.recarray(1, sh.LOOP, sh.blank())[0]
    installing.install(made, n)
    rx, tx, blocks, limits, tuning = n.rx, n.tx, n.blocks, n.limits, n.tuning
    beats = [is_heartbeat(frame) for frame in made.rx_frames]
    assert (n.intrusion.beat_every[: rx.n] > 0).tolist() == beats
    assert {what: sizes for part in PARTS for what, *sizes in part.sizes(made)} == {
        "variables": [n.n_variables, len(n.v)],
        "frames": [max(rx.n, tx.n), len(rx.frames)],
        "signals": [max(rx.frames["end"].max(), tx.frames["end"].max()), len(rx.signals)],
        "blocks": [blocks.n, len(blocks.views)],
        "wires": [blocks.copies_end.max(), len(blocks.copies)],
        "limits": [max(limits.n, n.guard.n_safe), len(limits.place)],
        "limits of received values": [n.plausible.n, len(n.plausible.row)],
        "scheduled values": [tuning.n, len(tuning.schedule)],
        "noted variables": [blocks.n_noted, len(blocks.noted_index)],
    }


def test_alarms_are_described_where_a_clock_runs_and_long_frames_where_there_are_some(
    rig: Rig,
) -> None:
    paced, free = (
        planning.describe(planning.plan(rig, "executive", pacing), {})
        for pacing in ("real", "lockstep")
    )
    assert set(paced["alarms"]) and not free["alarms"] and "data_bytes" not in free


def test_a_description_has_the_metadata_and_the_text_only_if_a_log_is_written(rig: Rig) -> None:
    made = planning.plan(rig, "plant", "lockstep")
    kept, bare = (planning.describe(made, {"seed": "1"}, kept=kept) for kept in (True, False))
    assert kept["metadata"] == bare["metadata"] == {"seed": "1"} and made.metadata == {}
    assert kept["attachments"]["rig-resolved.yaml"] == rig.resolved()
    assert "rig-resolved.yaml" not in bare["attachments"] and "probe.dbc" in bare["attachments"]


def test_a_node_is_disarmed_by_a_client_only_where_it_is_armed(rig: Rig) -> None:
    roles: tuple[tuple[Role, float], ...] = (("executive", 1.0), ("plant", 0.0))
    for role, most in roles:
        said = planning.describe(planning.plan(rig, role, "real"), {})
        assert said["ranges"]["supervisor.disarmed"] == [0.0, most]
        assert said["ranges"]["supervisor.stop"] == [0.0, 2.0]
        assert loop_of(role, "real").tuning.high[DISARMED] == most
        recorded = {*said["state_columns"], *said["timing_columns"]}
        assert "supervisor.gain" in recorded and "supervisor.disarmed" not in recorded


def test_the_mode_that_a_plant_obeys_is_that_of_the_node_above(tmp_path: Path) -> None:
    made = planning.plan(load_rig(ROOT / "plants/probe/rig.yaml"), "plant", "real")
    n = loop_of("plant", "real")
    assert made.names[n.guard.mode_index] == "rx.CMD.mode"
    counter = ' SG_ counter : 52|4@1+ (1,0) [0|15] "" EXEC'
    also = (counter, f'{counter}\n SG_ mode : 60|4@1+ (1,0) [0|15] "" EXEC')
    made = planning.plan(load_rig(fd_rig(tmp_path, changes=(also,))), "executive", "real")
    installing.install(made, n := np.recarray(1, sh.LOOP, sh.blank())[0])
    assert "rx.FB.mode" in made.names and n.guard.mode_index == -1, "nobody is above"


def test_rows_of_frames_are_as_long_as_the_longest_frame_needs(tmp_path: Path, rig: Rig) -> None:
    for one, size in ((rig, 8), (load_rig(fd_rig(tmp_path)), 64)):
        made = planning.plan(one, "executive", "real")
        n = np.recarray(1, sh.LOOP, sh.blank())[0]
        installing.install(made, n)
        said = planning.describe(made, {})
        assert (made.data_bytes, said.get("data_bytes", 8), bool(n.wire.fd)) == (
            size, size, size > 8,
        )  # fmt: skip
        assert n.rings.frame_words == frame_words({"data_bytes": size})
        assert n.rings.frame_rows == sh.FRAME_RING_WORDS // n.rings.frame_words


def test_who_is_in_charge_is_noted_and_only_the_choice_of_outputs_is_judged() -> None:
    made = planning.plan(load_rig(ROOT / "tests/rigs/handover.yaml"), "executive", "lockstep")
    assert [made.names[place] for place in made.noted] == ["handover.in_charge"]
    n = np.recarray(1, sh.LOOP, sh.blank())[0]
    installing.install(made, n)
    ends = dict(zip([spec.name for spec in made.spec.blocks], n.blocks.views, strict=False))
    sizes = {spec.name: len(list(spec.block.outputs)) for spec in made.spec.blocks}
    judged = {name: int(view.y_end - view.y) for name, view in ends.items()}
    assert judged["pd_nn"] == judged["pid"] == 0 < sizes["pd_nn"]
    assert 0 < judged["handover"] < made.views[-1].outputs.stop - made.views[-1].outputs.start


FAULTS = """faults:
  flood: {kind: flood, node: executive, value: 1}
  still: {kind: stall, node: plant}
  frame: {kind: corruption, frame: FB, from: 50ms}
  own: {kind: stall, node: executive}
  sent: {kind: bias, at: tx.CMD.command, value: 0.5}
"""


def test_faults_stand_in_the_order_of_their_groups_and_have_the_size_of_their_kind() -> None:
    n = loop_of("executive", "lockstep", text=FAULTS).faults
    names = list(planned(FAULTS, "executive"))
    assert names == ["sent", "frame", "flood", "own", "still"]
    assert (n.n_values, n.n, n.n_floods, n.n_places) == (1, 2, 1, 5)
    assert (n.n_own_stalls, n.n_peer_stalls) == (1, 1) and n.kind[2] == 0 != n.kind[1]
    assert n.own_stall[0] == n.every_place[3] and n.peer_stall[0] == n.every_place[4]
    assert n.spoiled.tolist()[:2] == [1, 0] and n.since[:3].tolist() == [-1] * 3
    values = planned(FAULTS, "executive")
    assert values["frame"] == 1.0, "what a corruption has where the rig gives none"
    assert (values["sent"], values["own"]) == (0.5, 0.0)


def planned(text: str, role: Role) -> dict[str, float]:
    """Return the sizes of the faults of the probe in the order in which a node holds them."""
    made = plan_of(text, role)
    return {one.name: made.values[one.place + 1] for one in made.faults}


def plan_of(text: str, role: Role) -> Plan:
    """Return the plan of a node of the probe with more in its rig."""
    probe = ROOT / "plants/probe/rig.yaml"
    own = load_rig(probe.with_name("more.yaml"), text=f"base: {probe}\nrig: more\n{text}")
    return planning.plan(own, role, "lockstep")


@pytest.mark.parametrize(("begins", "cycle"), [("50ms", 50), ("0ms", 0)])
def test_a_fault_is_set_in_the_cycle_before_it_acts_or_in_its_own(begins: str, cycle: int) -> None:
    text = re.sub(r"}\n", f", from: {begins}}}\n", FAULTS.replace(", from: 50ms", ""))
    early = max(cycle - 1, 0)
    own = {"sent": cycle, "flood": cycle, "frame": early, "own": early, "still": early}
    roles: tuple[tuple[Role, dict[str, int]], ...] = (
        ("executive", own),
        ("plant", {"own": cycle, "still": early}),
    )
    for role, cycles in roles:
        made = plan_of(text, role)
        places = {one.place: one.name for one in made.faults}
        assert {places[place]: at for at, place, _ in made.schedule} == cycles


def test_a_fault_behind_the_end_is_refused_but_for_a_run_that_is_cut_short() -> None:
    text = "faults: {it: {kind: nan, at: tx.CMD.command, from: 50ms}}"
    assert loop_of("executive", "real", "duration_s=0.02", text=text).faults.n == 1
    for settings in (("duration_s=0.02", "faults.it.from=50ms"), ("faults.it.from=1min",)):
        with pytest.raises(RigError, match="is after the end of the run at"):
            loop_of("executive", "real", *settings, text=text)


@pytest.mark.parametrize(("begins", "first", "cycles"), [
    ("from: 9.94s, every: 20ms, for: 5ms", 9940, {9940, 9960, 9980}),
    ("every: 4s, for: 5ms", 0, {0, 4000, 8000}),
    ("from: 9.96s, times: 30, for: 1ms", 9960, None),
])  # fmt: skip
def test_a_fault_begins_again_from_its_first_begin_to_the_end_of_the_run(
    begins: str, first: int, cycles: set[int] | None
) -> None:
    made = plan_of(f"faults: {{it: {{kind: nan, at: tx.CMD.command, {begins}}}}}", "executive")
    found = [at for at, place, _ in made.schedule if made.names[place] == "fault.it.left"]
    assert set(found) == cycles if cycles else len(found) == 30 and len(set(found)) > 10
    assert min(found) >= first and max(found) < 10_000


def test_a_fault_is_none_of_another_fault() -> None:
    text = "faults: {a: {kind: nan, at: tx.CMD.command}, b: {kind: nan, at: fault.a.value}}"
    with pytest.raises(RigError, match=r"faults\.b\.at: no variable fault\.a\.value"):
        plan_of(text, "executive")


def test_a_node_holds_as_many_faults_as_it_says() -> None:
    text = "".join(f"  f{i}: {{kind: nan, at: tx.CMD.command}}\n" for i in range(MAX_FAULTS))
    n = loop_of("executive", "real", text=f"faults:\n{text}")
    assert n.faults.n == n.faults.n_places == MAX_FAULTS


@pytest.mark.parametrize(("pacing", "waits"), [("lockstep", 1), ("real", 0)])
def test_a_node_knows_of_the_stall_of_another_only_where_it_would_wait(
    pacing: str, waits: int
) -> None:
    n = loop_of("executive", pacing, text="faults: {still: {kind: stall, node: plant}}")
    assert (n.faults.n_own_stalls, n.faults.n_peer_stalls, n.faults.n_places) == (0, waits, waits)


def test_a_fault_of_a_frame_acts_at_the_receiver_that_it_names_or_at_all(tmp_path: Path) -> None:
    faults = "own: {kind: loss, frame: SYNC, node: plant_2}, all: {kind: loss, frame: SYNC}"
    rig = load_rig(motors(tmp_path, 3, more=f"faults: {{{faults}}}\n"))
    found = {role: planning.plan(rig, role, "lockstep").faults for role in rig.roles}
    assert {role: [one.name for one in those] for role, those in found.items()} == {
        "executive": [], "plant": ["all"], "plant_2": ["own", "all"], "plant_3": ["all"],
    }  # fmt: skip


def test_a_wrong_length_is_at_most_that_of_the_longest_frame_of_its_kind(tmp_path: Path) -> None:
    for frame, most in (("FB", 64), ("HB_PLANT", 8)):
        for size, fits in ((most, True), (most + 1, False)):
            fault = f"faults: {{x: {{kind: length, frame: {frame}, value: {size}}}}}"
            (folder := tmp_path / f"{frame}{size}").mkdir()
            rig = load_rig(fd_rig(folder, fault))
            with nullcontext() if fits else pytest.raises(RigError, match=f"outside 0..{most},"):
                planning.plan(rig, "executive", "real")


def test_more_limits_of_received_values_than_a_node_holds_are_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    limited = "executive: {plausible: {FB.position: {low: -1, high: 1}}}"
    assert loop_of("executive", "real", text=limited).plausible.n == 1
    monkeypatch.setattr(sh, "MAX_LIMITS", 0)
    with pytest.raises(RigError, match="executive: 1 limits of received values; one node holds 0"):
        loop_of("executive", "real", text=limited)


def test_what_a_law_reads_while_it_is_prepared_is_carried_in_the_log(
    tmp_path: Path, rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    table = tmp_path / "table.csv"
    table.write_text("1")

    def prepared(*_: Any) -> Any:
        return table.read_text() and ((), ())

    monkeypatch.setattr(planned_blocks, "prepared_values", prepared)
    assert table in planning.plan(rig, "executive", "lockstep").read
