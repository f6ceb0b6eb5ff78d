"""Whether CAN has a frame as a DBC file describes it, and where its signals lie."""

from pcpc.drivers.can.dbc_file import DbcSignal, Error, Message
from pcpc.drivers.can.wire_layout import LENGTHS
from pcpc.drivers.errors import DbcError


def check_format(message: Message, where: str) -> None:
    """Raise DbcError for a length that CAN does not have, and for signals that are in the way."""
    if not message.is_fd and not 0 <= message.length <= 8:
        problem = (
            f'{message.length} bytes need CAN FD; say VFrameFormat "StandardCAN_FD", or split it'
        )
        raise DbcError(f"{where}: {problem}")
    if message.length not in LENGTHS:
        longer = next((n for n in LENGTHS if n >= message.length), LENGTHS[-1])
        problem = f"{message.length} bytes; CAN FD has {longer}; say so, the rest is padding"
        raise DbcError(f"{where}: {problem}")
    names = [signal.name for signal in message.signals]
    if double := next((name for name in names if names.count(name) > 1), None):
        problem = f"{names.count(double)} signals {double}; give each a name of its own"
        raise DbcError(f"{where}: {problem}")
    for signal in message.signals:
        _check_place(signal, message.length, where)
    try:
        message.refresh(strict=True)
    except Error as error:  # they overlap
        raise DbcError(f"{where}: {error} correct their starts and lengths") from None


def _check_place(signal: DbcSignal, dlc: int, where: str) -> None:
    """Raise DbcError for a signal outside of its frame."""
    begins, first = signal.start, first_bit(signal)
    if not 0 <= first < first + signal.length <= 8 * dlc:
        what = f"bits {begins}|{signal.length} do not lie in the {dlc} bytes"
        raise DbcError(f"{where}: {signal.name}: {what}; correct start and length")


def first_bit(signal: DbcSignal) -> int:
    """Return where a signal begins, counted from the frame's first bit as its bytes are sent."""
    begins = int(signal.start)
    return begins // 8 * 8 + 7 - begins % 8 if signal.byte_order == "big_endian" else begins
