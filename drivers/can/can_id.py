"""A CAN id and its flags in one word, as SocketCAN (linux/can.h), loop and logs hold them."""

EXTENDED_BIT = 31
EXTENDED, REMOTE, ERROR = 1 << EXTENDED_BIT, 1 << 30, 1 << 29
ID = 0x1FFFFFFF


def word_of(can_id: int, extended: bool | int) -> int:
    """Return an id as a word."""
    return can_id | (EXTENDED if extended else 0)


def text_of(word: int) -> str:
    """Return the id of a word as candump writes it: an extended one has eight digits."""
    return f"{word & ID:{'08X' if word & EXTENDED else '03X'}}"
