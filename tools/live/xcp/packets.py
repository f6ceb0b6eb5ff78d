"""Words of XCP 1.x (ASAM MCD-1 XCP): command and error codes, packet layouts, little-endian."""

import math
from enum import IntEnum
from struct import Struct
from typing import NamedTuple


class Cmd(IntEnum):
    """The commands that a slave of ours knows."""

    CONNECT = 0xFF
    DISCONNECT = 0xFE
    GET_STATUS = 0xFD
    SYNCH = 0xFC
    GET_COMM_MODE_INFO = 0xFB
    GET_ID = 0xFA
    GET_SEED = 0xF8
    SET_MTA = 0xF6
    UPLOAD = 0xF5
    SHORT_UPLOAD = 0xF4
    BUILD_CHECKSUM = 0xF3
    DOWNLOAD = 0xF0
    DOWNLOAD_NEXT = 0xEF
    SHORT_DOWNLOAD = 0xED
    CLEAR_DAQ_LIST = 0xE3
    SET_DAQ_PTR = 0xE2
    WRITE_DAQ = 0xE1
    SET_DAQ_LIST_MODE = 0xE0
    GET_DAQ_LIST_MODE = 0xDF
    START_STOP_DAQ_LIST = 0xDE
    START_STOP_SYNCH = 0xDD
    GET_DAQ_CLOCK = 0xDC
    READ_DAQ = 0xDB
    GET_DAQ_PROCESSOR_INFO = 0xDA
    GET_DAQ_RESOLUTION_INFO = 0xD9
    GET_DAQ_LIST_INFO = 0xD8
    GET_DAQ_EVENT_INFO = 0xD7
    FREE_DAQ = 0xD6
    ALLOC_DAQ = 0xD5
    ALLOC_ODT = 0xD4
    ALLOC_ODT_ENTRY = 0xD3
    WRITE_DAQ_MULTIPLE = 0xC7


class Err(IntEnum):
    """Why a command is refused."""

    CMD_SYNCH = 0x00
    DAQ_ACTIVE = 0x11
    CMD_UNKNOWN = 0x20
    CMD_SYNTAX = 0x21
    OUT_OF_RANGE = 0x22
    WRITE_PROTECTED = 0x23
    ACCESS_DENIED = 0x24
    ACCESS_LOCKED = 0x25
    MODE_NOT_VALID = 0x27
    SEQUENCE = 0x29
    DAQ_CONFIG = 0x2A
    MEMORY_OVERFLOW = 0x30
    RESOURCE_TEMPORARY_NOT_ACCESSIBLE = 0x33


class CommandRefused(Exception):
    """A command that is answered by an error code, and `more` bytes."""

    def __init__(self, code: Err, *more: int) -> None:
        super().__init__(code.name)
        self.packet = bytes([NEGATIVE, code, *more])


class Link(NamedTuple):
    """Bytes of a command and of a DTO, what lists may ask for, and the pace of commands."""

    cto: int = 255
    dto: int = 1400  # fits into an Ethernet frame
    frames: float = math.inf  # of lists in a cycle
    apart: int = 0  # of the packets of a block, in 100 us

    @property
    def can(self) -> bool:
        """Whether it is CAN: long data come in blocks, and behind a packet is padding."""
        return self.cto <= 64

    @property
    def most_in_block(self) -> int:
        """How many packets a block of the master has at most; 0: there are none."""
        return -(-255 // (self.cto - 2)) if self.can else 0


POSITIVE, NEGATIVE, EVENT = b"\xff", 0xFE, 0xFD
EV_SESSION_TERMINATED, EV_DAQ_OVERLOAD, EV_USER = 0x07, 0x02, 0xFE
ETHERNET = Link()
CAL_PAG, DAQ = 0x01, 0x04  # resources
HEAD = Struct("<HH")  # of a message over UDP or TCP: length, counter

# Bytes behind the command's own; what is longer than that is refused as what is shorter.
LAYOUTS = {
    Cmd.CONNECT: Struct("<B"),
    Cmd.DISCONNECT: Struct(""),
    Cmd.GET_STATUS: Struct(""),
    Cmd.SYNCH: Struct(""),
    Cmd.GET_COMM_MODE_INFO: Struct(""),
    Cmd.GET_ID: Struct("<B"),
    Cmd.GET_SEED: Struct("<BB"),
    Cmd.SET_MTA: Struct("<xxBI"),
    Cmd.UPLOAD: Struct("<B"),
    Cmd.SHORT_UPLOAD: Struct("<BxBI"),
    Cmd.BUILD_CHECKSUM: Struct("<xxxI"),
    Cmd.CLEAR_DAQ_LIST: Struct("<xH"),
    Cmd.SET_DAQ_PTR: Struct("<xHBB"),
    Cmd.WRITE_DAQ: Struct("<BBBI"),
    Cmd.SET_DAQ_LIST_MODE: Struct("<BHHBB"),
    Cmd.GET_DAQ_LIST_MODE: Struct("<xH"),
    Cmd.START_STOP_DAQ_LIST: Struct("<BH"),
    Cmd.START_STOP_SYNCH: Struct("<B"),
    Cmd.GET_DAQ_CLOCK: Struct(""),
    Cmd.READ_DAQ: Struct(""),
    Cmd.GET_DAQ_PROCESSOR_INFO: Struct(""),
    Cmd.GET_DAQ_RESOLUTION_INFO: Struct(""),
    Cmd.GET_DAQ_LIST_INFO: Struct("<xH"),
    Cmd.GET_DAQ_EVENT_INFO: Struct("<xH"),
    Cmd.FREE_DAQ: Struct(""),
    Cmd.ALLOC_DAQ: Struct("<xH"),
    Cmd.ALLOC_ODT: Struct("<xHB"),
    Cmd.ALLOC_ODT_ENTRY: Struct("<xHBB"),
}
