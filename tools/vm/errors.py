"""What the virtual machine tool reports instead of a traceback."""


class VmError(Exception):
    """The machine cannot be provided, or broke: one line that says what to do; exit code 4."""

    exit_code = 4
