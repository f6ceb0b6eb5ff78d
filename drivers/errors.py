"""What a user gets to see when a bus, a DBC file or a device cannot be used."""


class BusError(Exception):
    """A DBC, bus or frame that cannot be used; one line: where, what was expected, what to do."""

    code = 4  # the exit code: something is missing on this machine


class DbcError(BusError):
    """A DBC file that is wrong, or says what the loop cannot do: wrong input on any machine."""

    code = 2
