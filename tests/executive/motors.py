"""A rig of several motors with a servo each, made from the template's: N plants, or two buses."""

from pathlib import Path
from string import Template

from places import ROOT

_TEMPLATE = ROOT / "tools/make/template"
_FRAMES = Template("""
BO_ $cmd CMD_$i: 8 EXEC
 SG_ voltage : 0|24@1- (1e-05,0) [-30|30] "V" PLANT_$i
 SG_ mode : 24|4@1+ (1,0) [0|15] "" PLANT_$i
 SG_ counter : 48|4@1+ (1,0) [0|15] "" PLANT_$i
 SG_ crc : 56|8@1+ (1,0) [0|255] "" PLANT_$i

BO_ $fb FB_$i: 8 PLANT_$i
 SG_ encoder : 0|32@1- (1e-06,0) [-1000|1000] "rad" EXEC
 SG_ current : 32|16@1- (0.001,0) [-30|30] "A" EXEC
 SG_ counter : 48|4@1+ (1,0) [0|15] "" EXEC
 SG_ crc : 56|8@1+ (1,0) [0|255] "" EXEC

BO_ $beat HB_PLANT_$i: 1 PLANT_$i
 SG_ nmt_state : 0|8@1+ (1,0) [0|255] "" EXEC
""")
_SECOND = """
BO_ 129 SYNC_2: 2 EXEC
 SG_ sequence : 0|8@1+ (1,0) [0|255] "" PLANT_{0}
 SG_ crc : 8|8@1+ (1,0) [0|255] "" PLANT_{0}
"""
_KEYS = """BA_ "GenMsgCycleTime" BO_ {0} {1};
BA_ "GenMsgSendType" BO_ {0} {2};
"""
_PLANT = Template("""
plant_$i:
  like: plant
  node: PLANT_$i$bus
  blocks: {motor: {inputs: {voltage_V: rx.CMD_$i.voltage}}}
  transmit:
    FB.encoder: null
    FB.current: null
    HB_PLANT.nmt_state: null
    FB_$i.encoder: motor.encoder_rad
    FB_$i.current: motor.sample_current_A
    HB_PLANT_$i.nmt_state: supervisor.nmt
  safe: {CMD.voltage: null, CMD_$i.voltage: 0.0}
""")


def motors(folder: Path, count: int, second: int = 0, more: str = "") -> Path:
    """Write a rig of `count` motors into `folder`; the last `second` of them are on a second bus.

    `more`: keys at its end. Its servo has the numbers of `pd`; motor i turns by 3/i rad.
    """
    dbc = (_TEMPLATE / "motor.dbc").read_text()
    frames, keys, plants, blocks, sent = "", "", "", "", ""
    names = range(2, count + 1)
    for i in names:
        ids = {"cmd": 160 + i, "fb": 288 + i, "beat": 1794 + i}
        frames += _FRAMES.substitute(ids, i=i)
        keys += "".join(_KEYS.format(ids[key], 1, 0) for key in ("cmd", "fb"))
        keys += _KEYS.format(ids["beat"], 100, 1)
        plants += _PLANT.substitute(i=i, bus="\n  bus: {}" if i > count - second else "")
        blocks += (
            f"    reference_{i}: {{law: references:step, parameters: {{amplitude_rad: {3 / i!r}, "
            "start_s: 0.1}}\n"
            f"    servo_{i}:\n      law: laws/pid.py:BLOCK\n      parameters: {{kp_V_rad: 30.0, "
            "ki_V_rads: 0.0, kd_Vs_rad: 0.47, weight: 1.0, filter_s: 0.002, u_max_V: 24.0, "
            "track_per_s: 0.0}\n      inputs: "
            f"{{q_d_rad: reference_{i}.q_d_rad, encoder_rad: rx.FB_{i}.encoder, "
            f"sent_V: tx.CMD_{i}.voltage}}\n"
        )
        sent += f"    CMD_{i}.voltage: servo_{i}.voltage_V\n    CMD_{i}.mode: supervisor.state\n"
    first = [f"PLANT_{i}" for i in names if i <= count - second]
    for signal in ('sequence : 0|8@1+ (1,0) [0|255] ""', 'crc : 8|8@1+ (1,0) [0|255] ""'):
        dbc = dbc.replace(f"SG_ {signal} PLANT", f"SG_ {signal} {','.join(['PLANT', *first])}", 1)
    for i in range(count - second + 1, count + 1) if second else ():
        assert second == 1, "one node hears a second SYNC here"
        frames += _SECOND.format(i)
        keys += _KEYS.format(129, 1, 0)
    receivers = ",".join(["PLANT", *(f"PLANT_{i}" for i in names)])
    dbc = dbc.replace(
        'BO_ 1793 HB_EXEC: 1 EXEC\n SG_ nmt_state : 0|8@1+ (1,0) [0|255] "" PLANT',
        'BO_ 1793 HB_EXEC: 1 EXEC\n SG_ nmt_state : 0|8@1+ (1,0) [0|255] "" '
        + (receivers if not second else ",".join(["PLANT", *first])),
    )
    nodes = " ".join(["BU_: EXEC PLANT", *(f"PLANT_{i}" for i in names)])
    dbc = dbc.replace("BU_: EXEC PLANT", nodes)
    dbc = dbc.replace("\nCM_ ", f"{frames}\nCM_ ", 1).replace("\nVAL_ ", f"{keys}\nVAL_ ", 1)
    (folder / "motors.dbc").write_text(dbc)
    executive = f"executive:\n  blocks:\n{blocks}  transmit:\n{sent}" if blocks else ""
    rig = (
        f"base: {_TEMPLATE / 'rig.yaml'}\nrig: motors-{count}-{second}\ndbc: motors.dbc\n"
        f"controller: pd\n{executive}{plants}expect: {{pid: null, pd: null}}\nrequire: null\n{more}"
    )
    path = folder / "motors.yaml"
    path.write_text(rig.replace("laws/pid.py", f"{_TEMPLATE}/laws/pid.py"))
    return path
