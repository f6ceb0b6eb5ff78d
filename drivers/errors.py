"""What a user gets to see when a bus, a DBC file or a device cannot be used."""


class BusError(Exception):
    """A DBC, bus or frame that cannot be used; one line: where, what was expected, what to do."""
