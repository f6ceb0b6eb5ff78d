"""A rig of N motors behind CANopen drives on one bus, whose master is one law of the executive."""

from pathlib import Path

_TEMPLATE = Path(__file__).parents[3] / "tools/make/template"
_LAW = '''"""The master of {n} drives: each up through CiA 402's states, then to a velocity."""

from pcpc.executive.laws.block import Block, Nothing, Ports, port, stage


class Asked(Ports):
    """What the drives are to do."""

    wanted_rad_s = port("rad/s", "of the first; drive i has 1/i of it", 2.0, -100.0, 100.0)
    until_s = port("s", "then they are switched off", 0.4, 0.0, 100.0)


class Heard(Ports):
    """What the drives say."""

    statusword = port("", "of each drive", shape={n})
    velocity_rad_s = port("rad/s", "of each drive", shape={n})


class Said(Ports):
    """What they are told."""

    controlword = port("", "of each drive", shape={n})
    target_rad_s = port("rad/s", "of each drive", shape={n})
    e_rad_s = port("rad/s", "what is missing, of the first")


@stage
def step(t: float, dt: float, p: Asked, x: Nothing, u: Heard, y: Said) -> None:
    """Answer each statusword with the next controlword."""
    for i in range({n}):
        power = int(u.statusword[i]) & 0x6F
        y.controlword[i] = 0.0
        if t < p.until_s:
            y.controlword[i] = 0x06
            if power == 0x21:
                y.controlword[i] = 0x07
            if power == 0x23 or power == 0x27:
                y.controlword[i] = 0x0F
        y.target_rad_s[i] = p.wanted_rad_s / (i + 1.0)
    y.e_rad_s = p.wanted_rad_s - u.velocity_rad_s[0]


BLOCK = Block(step)
'''
_FRAMES = """
BO_ {rpdo} RPDO4_{i}: 6 EXEC
 SG_ controlword : 0|16@1+ (1,0) [0|65535] "" {name}
 SG_ target_velocity : 16|32@1- (0.001,0) [-2147483.648|2147483.647] "rad/s" {name}

BO_ {tpdo} TPDO4_{i}: 6 {name}
 SG_ statusword : 0|16@1+ (1,0) [0|65535] "" EXEC
 SG_ velocity : 16|32@1- (0.001,0) [-2147483.648|2147483.647] "rad/s" EXEC

BO_ {beat} HB_{name}: 1 {name}
 SG_ nmt_state : 0|8@1+ (1,0) [0|255] "" EXEC
"""
_HEAD = """VERSION "1"

NS_ :

BS_:

BU_: EXEC {names}

BO_ 128 SYNC: 2 EXEC
 SG_ sequence : 0|8@1+ (1,0) [0|255] "" {all}
 SG_ crc : 8|8@1+ (1,0) [0|255] "" {all}

BO_ 1793 HB_EXEC: 1 EXEC
 SG_ nmt_state : 0|8@1+ (1,0) [0|255] "" {all}
"""
_TAIL = """
BA_DEF_ "BusType" STRING ;
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_ BO_ "GenMsgSendType" ENUM "EveryCycle","Cyclic";
BA_DEF_DEF_ "BusType" "CAN";
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_DEF_DEF_ "GenMsgSendType" "Cyclic";
BA_ "BusType" "CAN";
BA_ "GenMsgSendType" BO_ 128 0;
BA_ "GenMsgCycleTime" BO_ 1793 100;
"""
_CYCLIC = """BA_ "GenMsgSendType" BO_ {rpdo} 0;
BA_ "GenMsgSendType" BO_ {tpdo} 0;
BA_ "GenMsgCycleTime" BO_ {beat} 100;
"""
_RIG = """base: {template}/drive_cia402.yaml
rig: drives-{n}
dbc: drives.dbc
duration_s: 0.5
bus: {{bitrate: null}}
controller: master
controllers:
  pid: null
  pd: null
  master: {{law: "master.py:BLOCK", inputs: {{{inputs}}}}}
executive:
  blocks:
    reference: null
    controller: {{inputs: {{q_d_rad: null, encoder_rad: null}}}}
  transmit:
    CMD.voltage: null
    CMD.mode: null
{sent}  limits: {{CMD.voltage: null}}
plant:
  drive:
    node: 5
    objects: {objects}
  transmit: {{FB.encoder: null, FB.current: null}}
  safe: {{CMD.voltage: null}}
watch: controller.e_rad_s
evaluation: null
"""
_OBJECTS = (
    '{{"1F80": 8, "140{k}.1": {rpdo}, "140{k}.2": 1, "180{k}.1": {tpdo}, "180{k}.2": 1, '
    '"6060": 9, "1017": 50}}'
)
_PLANT = """
plant_{i}:
  like: plant
  node: {name}
  drive: {{node: {node}, objects: {objects}}}
  transmit: {{HB_PLANT.nmt_state: null, HB_{name}.nmt_state: supervisor.nmt}}
"""


def drives(folder: Path, count: int, more: str = "") -> Path:
    """Write a rig of `count` drives, nodes 5 and up, into `folder`; `more`: keys at its end."""
    names = ["PLANT", *(f"PLANT_{i}" for i in range(2, count + 1))]
    frames, cyclic, plants, sent, inputs, first = "", "", "", "", [], ""
    for i, name in enumerate(names):
        ids = {"rpdo": 0x505 + i, "tpdo": 0x485 + i, "beat": 0x740 + i}
        frames += _FRAMES.format(i=i, name=name, **ids)
        cyclic += _CYCLIC.format(**ids)
        objects = _OBJECTS.format(k=3, **ids)
        first = first or objects
        if i:
            plants += _PLANT.format(i=i + 1, name=name, node=5 + i, objects=objects)
        # a port of one has no number
        at = f"_{i}" if count > 1 else ""
        sent += f"    RPDO4_{i}.controlword: controller.controlword{at}\n"
        sent += f"    RPDO4_{i}.target_velocity: controller.target_rad_s{at}\n"
        inputs += [f"statusword{at}: rx.TPDO4_{i}.statusword"]
        inputs += [f"velocity_rad_s{at}: rx.TPDO4_{i}.velocity"]
    head = _HEAD.format(names=" ".join(names), all=",".join(names))
    (folder / "drives.dbc").write_text(head + frames + _TAIL + cyclic)
    law = _LAW.format(n=count)
    if count == 1:
        law = law.replace(", shape=1", "").replace("[i]", "").replace("[0]", "")
    (folder / "master.py").write_text(law)
    rig = _RIG.format(
        template=_TEMPLATE, n=count, inputs=", ".join(inputs), sent=sent, objects=first
    )
    path = folder / "drives.yaml"
    path.write_text(rig + plants + more)
    return path
