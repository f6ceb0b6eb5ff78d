"""A drive below a local node: the rig of a drive's master, which is the local node now."""

import re
from pathlib import Path

from places import ROOT

from pcpc.executive.rig import yamlfile

_NEW = """BO_ 126 START: 2 EXEC
 SG_ sequence : 0|8@1+ (1,0) [0|255] "" LOCAL
 SG_ crc : 8|8@1+ (1,0) [0|255] "" LOCAL
BO_ 1796 HB_TOP: 1 EXEC
 SG_ nmt_state : 0|8@1+ (1,0) [0|255] "" LOCAL
BO_ 1795 HB_LOCAL: 1 LOCAL
 SG_ nmt_state : 0|8@1+ (1,0) [0|255] "" EXEC
BO_ 127 TELL: 6 LOCAL
 SG_ counter : 32|4@1+ (1,0) [0|15] "" EXEC
 SG_ crc : 40|8@1+ (1,0) [0|255] "" EXEC
"""
_HEARD = ' SG_ {} : {}|16@1- (0.001,0) [-32.768|32.767] "{}" EXEC\n'
_CYCLES = {126: 1, 127: 1, 1795: 100, 1796: 100}
_RIG = """base: {base}
rig: below_local
dbc: below.dbc
controllers:
  master: {{inputs: {{{heard}}}}}
executive:
  transmit: {{{away}, HB_TOP.nmt_state: supervisor.nmt}}
local:
  node: LOCAL
  blocks:
    master: {{law: "{law}", inputs: {{{inputs}}}}}
  transmit: {{{sends}, {tells}, HB_LOCAL.nmt_state: supervisor.nmt}}
"""


def _listed(pairs: dict[str, str]) -> str:
    return ", ".join(f"{key}: {value}" for key, value in pairs.items())


def below_local(folder: Path, rig: str) -> Path:
    """Write the rig: to the executive the local node only tells what it hears of the drive."""
    path = ROOT / rig
    data = yamlfile.load(path).data
    master, transmit = data["controllers"]["master"], data["executive"]["transmit"]
    sends = {key: source for key, source in transmit.items() if source}
    inputs: dict[str, str] = master["inputs"]
    heard = ""
    for i, name in enumerate(inputs):
        unit = "rad/s" if name.endswith("_rad_s") else "rad" if name.endswith("_rad") else ""
        heard += _HEARD.format(name, 16 * i, unit)
    dbc = re.sub(r"\bEXEC\b", "LOCAL", (path.parent / data["dbc"]).read_text())
    dbc = dbc.replace("BU_: LOCAL", "BU_: EXEC LOCAL")
    dbc = dbc.replace("BO_ 128 SYNC:", _NEW + heard + "BO_ 128 SYNC:")
    for number, cycles in _CYCLES.items():
        dbc += f'BA_ "GenMsgCycleTime" BO_ {number} {cycles};\n'
        dbc += f'BA_ "GenMsgSendType" BO_ {number} {int(cycles > 1)};\n'
    (folder / "below.dbc").write_text(dbc)
    text = _RIG.format(
        base=path,
        heard=_listed({name: f"rx.TELL.{name}" for name in inputs}),
        away=_listed(dict.fromkeys(sends, "null")),
        law=path.parent / master["law"],
        inputs=_listed(inputs),
        sends=_listed({k: v.replace("controller.", "master.") for k, v in sends.items()}),
        tells=_listed({f"TELL.{name}": source for name, source in inputs.items()}),
    )
    (folder / "rig.yaml").write_text(text)
    return folder / "rig.yaml"
