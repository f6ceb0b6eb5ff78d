"""What the virtual machine tool reports instead of a traceback."""

from pcpc.drivers.errors import Exit, UserError


class VmError(UserError):
    """The machine cannot be provided, or broke: one line that says what to do."""

    code = Exit.ENVIRONMENT
