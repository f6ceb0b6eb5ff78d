"""The probe on CAN FD: the same signals in long frames, spread over all of their bytes."""

from pathlib import Path

PROBE = Path(__file__).resolve().parents[1] / "plants" / "probe"
_FORMATS = ",".join(
    ['"StandardCAN"', '"ExtendedCAN"', *['"reserved"'] * 12, '"StandardCAN_FD"', '"ExtendedCAN_FD"']
)
_CHANGES = (
    ("BO_ 160 CMD: 8 EXEC", "BO_ 160 CMD: 48 EXEC"),
    (" SG_ command : 0|32@1-", " SG_ command : 300|32@1-"),
    (' SG_ crc : 56|8@1+ (1,0) [0|255] "" PLANT', ' SG_ crc : 376|8@1+ (1,0) [0|255] "" PLANT'),
    ("BO_ 288 FB: 8 PLANT", "BO_ 288 FB: 64 PLANT"),
    (" SG_ position : 0|32@1-", " SG_ position : 407|32@0-"),
    (' SG_ crc : 56|8@1+ (1,0) [0|255] "" EXEC', ' SG_ crc : 504|8@1+ (1,0) [0|255] "" EXEC'),
    ('BA_DEF_ "BusType"',
     f'BA_DEF_ BO_ "VFrameFormat" ENUM {_FORMATS};\nBA_DEF_ BO_ "CANFD_BRS" ENUM "0","1";\n'
     'BA_DEF_ "BusType"'),
    ('BA_DEF_DEF_ "BusType"',
     'BA_DEF_DEF_ "VFrameFormat" "StandardCAN";\nBA_DEF_DEF_ "CANFD_BRS" "1";\n'
     'BA_DEF_DEF_ "BusType"'),
    ("\nVAL_ 160",
     '\nBA_ "VFrameFormat" BO_ 128 14;\nBA_ "VFrameFormat" BO_ 160 14;\n'
     'BA_ "VFrameFormat" BO_ 288 14;\nBA_ "CANFD_BRS" BO_ 128 0;\n\nVAL_ 160'),
)  # fmt: skip

LONG_DBC = f"""VERSION ""
BU_: A B
BO_ 291 LONG: 64 A
 SG_ crc : 0|16@1+ (1,0) [0|0] "" B
 SG_ counter : 16|8@1+ (1,0) [0|0] "" B
 SG_ rest : 448|64@1+ (1,0) [0|0] "" B
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_ BO_ "E2EDataId" INT 0 65535;
BA_DEF_ BO_ "VFrameFormat" ENUM {_FORMATS};
BA_DEF_DEF_ "GenMsgCycleTime" 1;
BA_DEF_DEF_ "E2EDataId" 0;
BA_DEF_DEF_ "VFrameFormat" "StandardCAN_FD";
BA_ "E2EDataId" BO_ 291 4660;
"""  # a CRC of 16 bits over 64 bytes


def fd_rig(folder: Path, *lines: str, changes: tuple[tuple[str, str], ...] = ()) -> Path:
    """Write the rig and its DBC file, with further `lines`; SYNC is FD without BRS.

    CMD has 48 bytes, FB 64 with a Motorola signal; the heartbeats are classic. `changes`: of the
    DBC's text.
    """
    text = (PROBE / "probe.dbc").read_text()
    for old, new in (*_CHANGES, *changes):
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    (folder / "probe_fd.dbc").write_text(text)
    rig = folder / "probe_fd.yaml"
    head = (f"base: {PROBE / 'rig.yaml'}", "rig: probe_fd", "dbc: probe_fd.dbc", "duration_s: 0.6")
    rig.write_text("\n".join([*head, *lines]) + "\n")
    return rig
