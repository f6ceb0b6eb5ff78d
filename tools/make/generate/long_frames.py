"""What CAN FD changes in the C that is the same for all rigs with classic frames only.

A rig with a frame of CAN FD has room for 64 bytes in each frame, and its kind in `flags`, as Linux'
struct canfd_frame has it. A frame of another kind than the DBC file says counts as one of a wrong
length, as in `drivers.can.codec`.
"""

from collections.abc import Mapping

from pcpc.drivers.can.wire_layout import LENGTHS, Flag

ROOM = 64  # bytes of a frame
_WIDE = "uint8_t data[8]", f"uint8_t data[{ROOM}]"
_KIND = f"""\
/* 255, a length that no frame has, where a frame is of another kind than the DBC file says. */
static uint8_t length_of(const frame_t *frame)
{{
    for (uint32_t row = 0u; row < RIG_HEARD; row++) {{
        bool other = ((frame->flags ^ rig_heard[row].flags) & {Flag.FD | Flag.BRS}u) != 0u;
        if ((rig_heard[row].id == frame->id) && other) {{
            return 255u;
        }}
    }}
    return frame->n;
}}

static int32_t hear"""
_CHANGES: Mapping[str, tuple[tuple[str, str], ...]] = {
    "codec.h": (
        (
            "uint8_t n; /* bytes, at most 8 */\n    uint8_t data[8];",
            f"uint8_t n; /* bytes, at most {ROOM} */\n    uint8_t data[{ROOM}];\n"
            "    uint8_t flags; /* 1 bit rate switch, 2 error state indicator, 4 CAN FD */",
        ),
        (
            "    bool emergency; /* sent when the error code changes */",
            "    bool emergency; /* sent when the error code changes */\n"
            "    uint8_t flags; /* of its frame_t */",
        ),
        ("void protect(uint8_t data[8]", f"void protect(uint8_t data[{ROOM}]"),
        ("judge(const uint8_t data[8]", f"judge(const uint8_t data[{ROOM}]"),
    ),
    "codec.c": (
        ("crc8(uint32_t id, const uint8_t data[8]",
         f"crc8(uint32_t id, const uint8_t data[{ROOM}]"),
        ("crc16(uint16_t data_id, const uint8_t data[8]",
         f"crc16(uint16_t data_id, const uint8_t data[{ROOM}]"),
        ("right_crc(const uint8_t data[8]", f"right_crc(const uint8_t data[{ROOM}]"),
        ("void protect(uint8_t data[8]", f"void protect(uint8_t data[{ROOM}]"),
        ("judge(const uint8_t data[8]", f"judge(const uint8_t data[{ROOM}]"),
    ),
    "device.h": (_WIDE,),
    "device.c": (
        ("rig_sent[row].n, {0u}}", "rig_sent[row].n, {0u}, rig_sent[row].flags}"),
        ("take(uint32_t row, const uint8_t data[8]",
         f"take(uint32_t row, const uint8_t data[{ROOM}]"),
        ("device_frame(uint32_t id, const uint8_t data[8]",
         f"device_frame(uint32_t id, const uint8_t data[{ROOM}]"),
        ("uint8_t whole[8]", f"uint8_t whole[{ROOM}]"),
        ("(i < n) && (i < 8u)", f"(i < n) && (i < {ROOM}u)"),
    ),
    "run.c": (
        ('#include "port.h"\n', '#include "port.h"\n#include "rig.h"\n'),
        ("static int32_t hear", _KIND),
        ("frame.data, frame.n)", "frame.data, length_of(&frame))"),
    ),
    "slcan.h": (
        ("       O            open",
         "       dIIIN..      one of CAN FD; N: 9 to F are 12 to 64 bytes         DIIIIIIIIN..\n"
         "       bIIIN..      that switches its bit rate                          BIIIIIIIIN..\n"
         "       O            open"),
        ("#define SLCAN_LINE 27u /* T, id, length, 8 bytes,",
         f"#define SLCAN_LINE {11 + 2 * ROOM}u /* D, id, length, {ROOM} bytes,"),
    ),
    "slcan.c": (
        ("#define BEL '\\a'\n", "#define BEL '\\a'\n\n"
         f"static const uint8_t LENGTHS[16] = {{{', '.join(f'{n}u' for n in LENGTHS)}}};\n"),
        (" || (n > 8u)) {\n        return false;\n    }\n", ") {\n        return false;\n    }\n"
         "    char kind = slcan->line[0];\n"
         "    bool is_fd = (kind != 't') && (kind != 'T');\n"
         "    if (!is_fd && (n > 8u)) {\n        return false;\n    }\n"
         "    n = LENGTHS[n];\n"
         f"    frame->flags = ((kind == 'b') || (kind == 'B')) ? {Flag.FD | Flag.BRS}u : "
         f"(is_fd ? {Flag.FD}u : 0u);\n"),
        ("    case 't':\n", "".join(f"    case '{kind}':\n" for kind in "tdDbB")),
        ("(slcan->line[0] == 't') ? 3u : 8u", "(slcan->line[0] >= 'a') ? 3u : 8u"),
        ("extended ? 'T' : 't';\n",
         f"((frame->flags & {Flag.FD}u) == 0u) ? 't' : (((frame->flags & {Flag.BRS}u) != 0u) ? "
         "'b' : 'd');\n"
         "    if (extended) {\n        line[0] = (char)(line[0] - ('a' - 'A'));\n    }\n"),
        ("    line[at++] = (char)('0' + (char)frame->n);\n",
         "    uint32_t code = 0u;\n"
         "    while ((code < 15u) && (LENGTHS[code] < frame->n)) {\n        code++;\n    }\n"
         "    line[at++] = DIGITS[code];\n"),
    ),
    "main_linux.c": (
        (
            "    return append(text, at, TAIL, sizeof TAIL - 1);",
            f"    at = append(text, at, TAIL, sizeof TAIL - 1);\n"
            f"    text[at - 40] = (frame->flags & {Flag.FD}) != 0 ? 0xC3 : 0xC2;\n"
            f"    text[at - 24] = (frame->flags & {Flag.BRS}) != 0 ? 0xC3 : 0xC2;\n"
            "    return at;",
        ),
        (
            "    bool has_id = false,",
            "    frame->flags = 0;\n    bool has_id = false,",
        ),
        (' || is(key, n, "is_fd")) {\n            other = other || b[value] == 0xC3;',
         ') {\n            other = other || b[value] == 0xC3;\n'
         '        } else if (is(key, n, "is_fd")) {\n'
         f"            frame->flags |= b[value] == 0xC3 ? {Flag.FD} : 0;\n"
         '        } else if (is(key, n, "bitrate_switch")) {\n'
         f"            frame->flags |= b[value] == 0xC3 ? {Flag.BRS} : 0;"),
        ("rest <= 9)", f"rest <= {ROOM + 1})"),
        ("    return has_id && has_data && !other;",
         f"    frame->flags = (frame->flags & {Flag.FD}) != 0 ? frame->flags : 0;\n"
         f"    return has_id && has_data && !other && (frame->n <= 8 || frame->flags != 0);"),
        (
            "    bus.rx = bus.tx = socket(AF_CAN, SOCK_RAW, CAN_RAW);\n",
            "    int on = 1;\n"
            "    bus.rx = bus.tx = socket(AF_CAN, SOCK_RAW, CAN_RAW);\n"
            "    if (setsockopt(bus.rx, SOL_CAN_RAW, CAN_RAW_FD_FRAMES, &on, sizeof on) != 0) {\n"
            "        return false;\n    }\n",
        ),
        (
            "struct can_frame can = {.can_id = frame->id, .can_dlc = frame->n};",
            "struct canfd_frame can = {\n        "
            "    .can_id = frame->id, .len = frame->n, .flags = frame->flags};",
        ),
        (
            "wanted = (ssize_t)sizeof can;\n        sent = send(bus.tx, &can, sizeof can, 0);",
            f"size_t size = (frame->flags & {Flag.FD}) != 0 ? CANFD_MTU : CAN_MTU;\n"
            "        wanted = (ssize_t)size;\n        sent = send(bus.tx, &can, size, 0);",
        ),
        (
            "    struct can_frame can;\n    uint32_t other",
            "    struct canfd_frame can;\n    uint32_t other",
        ),
        (
            "    if (recv(bus.rx, &can, sizeof can, 0) != (ssize_t)sizeof can || can.can_dlc > 8 ||"
            " (can.can_id & other) != 0) {",
            "    ssize_t size = recv(bus.rx, &can, sizeof can, 0);\n"
            "    if ((size != CAN_MTU || can.len > 8) && (size != CANFD_MTU || can.len > "
            f"{ROOM})) {{\n        return -1;\n    }}\n"
            "    if ((can.can_id & other) != 0) {",
        ),
        (
            "    frame->n = can.can_dlc;\n",
            "    frame->n = can.len;\n"
            f"    frame->flags = size == CANFD_MTU ? (uint8_t)(can.flags | {Flag.FD}) : 0;\n",
        ),
    ),
}  # fmt: skip


def with_long_frames(files: Mapping[str, str]) -> dict[str, str]:
    """Return the files of a device, of all rigs with classic frames, as one on CAN FD has them."""
    found = dict(files)
    for name, changes in _CHANGES.items():
        for old, new in changes:
            assert found[name].count(old) == 1, (name, old)
            found[name] = found[name].replace(old, new)
    return found
