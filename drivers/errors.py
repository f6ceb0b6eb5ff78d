"""What a user gets to see when a bus, a DBC file or a device cannot be used."""


class BusError(Exception):
    """A DBC, bus or frame that cannot be used; one line: where, what was expected, what to do."""

    code = 4  # the exit code: something is missing on this machine


class DbcError(BusError):
    """A DBC file that is wrong, or says what the loop cannot do: wrong input on any machine."""

    code = 2


def printable(text: str, kept: str = "\xa0") -> str:
    """Return a text without characters that would steer a terminal; they become escapes."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in kept else repr(c)[1:-1] for c in text)
