"""A drawn world as files: rig.yaml, its DBC file, its laws, and history.yaml.

A frame of the world: its length, whether it is FD, the bits of its CRC (0: none), its period in ms
(none: every cycle), and its signals, each with its first bit, length, byte order, kind ("signed",
"unsigned", "float"), and layout.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pcpc.executive.rig import yamlfile
from pcpc.tools.study.swarm.expressions import law_text
from pcpc.tools.terminal.outfile import whole_file

World = dict[str, Any]
RIG, HISTORY = "rig.yaml", "history.yaml"
MOST_LAWS = 3  # of an executive, each with its reference
SPAN = 128.0  # what a signal carries at least, either side of 0
FRAMES = ("CMD", 160, "command"), ("FB", 288, "back"), ("SLOW", 416, "slow")  # id; key of a plant
TUNABLE = "controller.first", "controller.second"  # within +-100
ACTS = "stop", "set", "send"  # from outside: an end, a request, frames of a node's own id
WORDS = range(4)  # of 16 bits, in a frame of a drive's master
DRIVE_NODE = 3  # whose ids are nobody else's
DRIVES: dict[str, tuple[tuple[int, int], list[int]]] = {  # two ids, words that switch on
    "cia402": ((0x203, 0x303), [15, 0, 0, 0]),
    "mit": ((3, 0x203), [0xFFFF, 0xFFFF, 0xFFFF, 0xFCFF]),
    "moteus": ((1 << 31 | 0x8003, 1 << 31 | 3), [0x0001, 0x500A, 0x1F50, 0x5001]),
    "odrive": ((0x67, 0x6D), [8, 0, 0, 0]),
    "robstride": ((1 << 31 | 0x300FD03, 1 << 31 | 0x17FFF03), [0, 0, 0, 0]),
}
_LAWS = "pcpc.tools.study.swarm.laws"
_HEAD = """VERSION ""
BU_: EXEC DRIVE {nodes}
BO_ 128 SYNC: 2 EXEC
 SG_ sequence : 0|8@1+ (1,0) [0|255] "" {all}
 SG_ crc : 8|8@1+ (1,0) [0|255] "" {all}
BO_ 1793 HB_EXEC: 1 EXEC
 SG_ nmt_state : 0|8@1+ (1,0) [0|255] "" {all}
"""
_KEYS = """BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_ BO_ "GenMsgSendType" ENUM "EveryCycle","Cyclic";
BA_DEF_ BO_ "VFrameFormat" ENUM {formats};
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_DEF_DEF_ "GenMsgSendType" "Cyclic";
BA_DEF_DEF_ "VFrameFormat" "StandardCAN";
"""
_FORMATS = ["StandardCAN", "ExtendedCAN", *["reserved"] * 12, "StandardCAN_FD", "ExtendedCAN_FD"]


def write(world: World, folder: Path, laws: Path | None = None) -> Path:
    """Write the files of a world into a folder; return the rig's.

    `laws`: where those of all seeds lie, so that each is tried and compiled once; none: there.
    """
    folder.mkdir(parents=True, exist_ok=True)
    rig = rig_of(world, "" if laws is None else f"{laws}/")
    if world["around"] is None:
        (folder / "swarm.dbc").write_text(dbc_text(world))
        write_laws(world, laws or folder)
    (folder / RIG).write_text(yamlfile.dump(rig))
    (folder / HISTORY).write_text(yamlfile.dump(world))
    return folder / RIG


def write_laws(world: World, folder: Path) -> None:
    """Write the laws of a world that are not there."""
    for shape in {one["shape"] for one in world["plants"]}:
        law = folder / f"law_{shape}.py"
        if not law.exists():
            with whole_file(law) as unfinished:
                unfinished.write_text(law_text(shape))


def rig_of(world: World, laws: str) -> World:
    """Return what rig.yaml says; `laws`: what stands before the name of a law's file."""
    keys = {"rig": "swarm", "duration_s": world["cycles"] / world["rate_hz"], **world["keys"]}
    if world["around"] is not None:
        return {"base": world["around"], **keys}
    found = _drawn_rig(world, laws)
    for role in ("executive", *nodes(world)):
        found[role] |= keys.pop(role, {})
    found |= keys
    for path, value in world["wrong"]:
        place = found
        for key in path[:-1]:
            place = place[key]
        place[path[-1]] = value
    return found


def nodes(world: World) -> dict[str, int]:
    """Return the plants' roles, each with its number."""
    return {"plant" if i == 1 else f"plant_{i}": i for i in range(1, len(world["plants"]) + 1)}


def frames_of(world: World) -> Iterator[tuple[str, int, World, str, str]]:
    """Yield the frames of plants: name, id, what the world says, who sends it, who hears it."""
    for role, i in nodes(world).items():
        for name, word, key in FRAMES:
            if frame := world["plants"][i - 1].get(key):
                ends = ("executive", role) if key == "command" else (role, "executive")
                yield f"{name}_{i}", word + i, frame, *ends


def _drawn_rig(world: World, laws: str) -> World:
    blocks: World = {}
    sent = {"HB_EXEC.nmt_state": "supervisor.nmt"}
    found: World = {"dbc": "swarm.dbc", "rate_hz": world["rate_hz"], "controller": "first"}
    plants: World = {}
    for role, i in nodes(world).items():
        one = world["plants"][i - 1]
        alone = i > MOST_LAWS  # without a law: its command is that of the first
        name = "controller" if i == 1 or alone else f"controller_{i}"
        law = {"law": f"{laws}law_{one['shape']}.py:BLOCK", "parameters": one["gains"]}
        inputs = {"position": f"rx.FB_{i}.position", "target": f"reference_{i}.value"}
        if i == 1:
            found["controllers"] = {"first": law, "second": law | {"parameters": one["others"]}}
        if not alone:
            blocks[f"reference_{i}"] = one["reference"]
            blocks[name] = {"inputs": inputs} | ({} if i == 1 else law)
        sent |= {f"CMD_{i}.command": f"{name}.command", f"CMD_{i}.mode": "supervisor.state"}
        back = {f"HB_{i}.nmt_state": "supervisor.nmt"}
        own = {"which": "lag.which", "estop": "lag.pressed", "position": "lag.position"}
        for name, _, frame, sender, _ in frames_of(world):
            signals = frame["signals"] if sender == role else ()
            back |= {f"{name}.{signal}": own.get(signal, "lag.twice")
                     for signal in signals if signal not in ("counter", "crc")}  # fmt: skip
        plants[role] = {
            "node": f"PLANT_{i}",
            "blocks": {"lag": {"law": f"{_LAWS}:BLOCK",
                               "inputs": {"command": f"rx.CMD_{i}.command"},
                               "parameters": {"tau_s": one["tau_s"],
                                              "press_s": one.get("press_s", 1e6)}}},
            "transmit": back, "safe": {f"CMD_{i}.command": one["safe"]},
        }  # fmt: skip
    if drive := world.get("drive"):
        asked = {f"on_{i}": word for i, word in enumerate(drive["on"])}
        asked |= {name: drive[name] for name in ("on_s", "hold_s", "seed")}
        blocks["master"] = {"law": f"{_LAWS}:MASTER", "parameters": asked}
        sent |= {f"{name}.w{i}": f"master.{name.lower()}_{i}" for name in "AB" for i in WORDS}
        plants["plant"]["blocks"]["lag"]["inputs"]["command"] = "drive.command"
        plants["plant"]["drive"] = {
            "profile": drive["profile"], "node": DRIVE_NODE, "position": "lag.position",
            "rated": 1.0, "gains": {"position_per_s": 20.0, "velocity": 0.2},
        }  # fmt: skip
    return found | {"executive": {"node": "EXEC", "blocks": blocks, "transmit": sent}} | plants


def dbc_text(world: World) -> str:
    """Return the DBC file: SYNC, heartbeats, and a command and a feedback of each plant."""
    names = {"executive": "EXEC"} | {role: f"PLANT_{i}" for role, i in nodes(world).items()}
    plants = [*names.values()][1:]
    text = _HEAD.format(nodes=" ".join(plants), all=",".join(plants))
    slow_ms = world.get("slow_ms", 100)
    keys = [(128, 1, 0), (1793, slow_ms, 1)]
    formats: list[int] = []
    floats: list[str] = []
    for i, plant in enumerate(plants, 1):
        text += f"BO_ {1793 + i} HB_{i}: 1 {plant}\n"
        text += ' SG_ nmt_state : 0|8@1+ (1,0) [0|255] "" EXEC\n'
        keys.append((1793 + i, slow_ms, 1))
    for name, word, one, sender, receiver in frames_of(world):
        text += f"BO_ {word} {name}: {one['length']} {names[sender]}\n"
        text += "".join(_signal_lines(one["signals"], names[receiver]))
        keys.append((word, one.get("ms", 1), int("ms" in one)))
        formats += [word] * one["fd"]
        floats += [
            f"SIG_VALTYPE_ {word} {signal} : {about['bits'] // 32};\n"
            for signal, about in one["signals"].items()
            if about["kind"] == "float"
        ]
    for name, word in _orders(world).items():
        text += f"BO_ {word} {name}: 8 EXEC\n"
        text += "".join(f' SG_ w{i} : {16 * i}|16@1+ (1,0) [0|0] "" DRIVE\n' for i in WORDS)
        keys.append((word, 1, 0))
    text += _KEYS.format(formats=",".join(f'"{one}"' for one in _FORMATS))
    for word, time_ms, kind in keys:
        text += f'BA_ "GenMsgCycleTime" BO_ {word} {time_ms};\n'
        text += f'BA_ "GenMsgSendType" BO_ {word} {kind};\n'
    text += "".join(f'BA_ "VFrameFormat" BO_ {word} 14;\n' for word in formats)
    return text + "".join(floats)


def _orders(world: World) -> dict[str, int]:
    """Return the ids of what a drive's master sends, by name."""
    ids = DRIVES[world["drive"]["profile"]][0] if "drive" in world else ()
    return dict(zip("AB", ids, strict=False))


def _signal_lines(signals: Mapping[str, Any], receiver: str) -> Iterator[str]:
    for name, one in signals.items():
        layout = {None: "", -1: "M "}.get(one["layout"], f"m{one['layout']} ")
        sign = "+" if one["kind"] == "unsigned" else "-"
        factor, offset = scale(one)
        yield (
            f" SG_ {name} {layout}: {one['start']}|{one['bits']}@{int(not one['big'])}{sign} "
            f'({factor!r},{offset!r}) [0|0] "" {receiver}\n'
        )


def bits_of(one: Mapping[str, Any]) -> list[int]:
    """Return the bits of a frame in which a signal lies, as a DBC file numbers and orders them."""
    at, found = one["start"], []
    for _ in range(one["bits"]):
        found.append(at)
        at = at + 1 if not one["big"] else at - 1 if at % 8 else at + 15
    return found


def scale(one: Mapping[str, Any]) -> tuple[float, float]:
    """Return factor and offset of a signal, so that it carries +-SPAN."""
    if one["kind"] == "float" or one["whole"]:
        return 1.0, 0.0
    return 2.0 * SPAN / (1 << one["bits"]), -SPAN if one["kind"] == "unsigned" else 0.0
