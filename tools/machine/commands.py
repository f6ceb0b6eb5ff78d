"""Commands: completion."""

from typing import Annotated, Literal

from pcpc.tools.terminal.command import BASIC_CODES, Command
from pcpc.tools.terminal.request import WORD, Request


class HelpRequest(Request):
    """A group of commands."""

    group: Annotated[str | None, WORD, "GROUP", "a group of commands, or all"] = None


class CompletionRequest(Request):
    """A shell."""

    shell: Annotated[Literal["bash", "zsh", "fish"], "the shell"]


COMMANDS = (
    Command(
        "help",
        "list the commands of a group, or all",
        "pcpc help live\npcpc help all",
        HelpRequest,
        module="cli.help",
        codes=BASIC_CODES,
    ),
    Command(
        "completion",
        "let a shell complete commands, rigs, controllers and variables",
        "pcpc completion bash",
        CompletionRequest,
        module="cli.completion",
        codes=BASIC_CODES,
        notes='~/.bashrc, ~/.zshrc: eval "$(pcpc completion bash)", or zsh\n'
        "~/.config/fish/config.fish: pcpc completion fish | source",
    ),
)
