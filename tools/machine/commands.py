"""Commands: completion."""

from pcpc.tools.terminal.command import BASIC_CODES, Add, Command


def help_(add: Add) -> None:
    """Take a group."""
    add("group", nargs="?", metavar="GROUP", help="a group of commands, or all")


def completion(add: Add) -> None:
    """Take a shell."""
    add("shell", choices=("bash", "zsh", "fish"), help="the shell")


COMMANDS = (
    Command(
        "help",
        "list the commands of a group, or all",
        "pcpc help live\npcpc help all",
        help_,
        module="cli.help",
        codes=BASIC_CODES,
    ),
    Command(
        "completion",
        "let a shell complete commands, rigs, controllers and variables",
        "pcpc completion bash",
        completion,
        module="cli.completion",
        codes=BASIC_CODES,
        notes='~/.bashrc, ~/.zshrc: eval "$(pcpc completion bash)", or zsh\n'
        "~/.config/fish/config.fish: pcpc completion fish | source",
    ),
)
