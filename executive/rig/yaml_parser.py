"""From YAML text to a tree of PyYAML's nodes, without anchors and tags; quickly where that can be.

libyaml is several times as fast as PyYAML's own parser, whose words the messages are and who sees
some places otherwise. So libyaml reads what both are known to read alike, and what it refuses is
read again.
"""

import contextlib
import re
from typing import Any

import yaml
from yaml.composer import Composer

_SEEN_OTHERWISE = re.compile(r"[^\n ->@-~]|---")


class _Strict:
    """A parser that refuses what makes a value stand elsewhere than where it is read."""

    def compose_node(self, parent: yaml.Node | None, index: Any) -> Any:
        event: Any = self.peek_event()  # type: ignore[attr-defined]
        mark = event.start_mark
        if isinstance(event, yaml.AliasEvent) or event.anchor:
            raise yaml.MarkedYAMLError(
                None, None, "anchors are not supported; share values with `base:`", mark
            )
        if event.tag:
            raise yaml.MarkedYAMLError(None, None, f"tag {event.tag} is not supported", mark)
        return super().compose_node(parent, index)  # type: ignore[misc]


class SlowLoader(_Strict, yaml.SafeLoader):
    """PyYAML's own parser, whose words the messages are."""


if yaml.__with_libyaml__:

    class FastLoader(_Strict, Composer, yaml.CSafeLoader):
        """libyaml's, several times as fast."""

        __init__ = yaml.CSafeLoader.__init__


def compose(text: str) -> yaml.Node | None:
    """Return the tree of a text; yaml.YAMLError."""
    root: yaml.Node | None
    if reads_the_same(text):
        with contextlib.suppress(yaml.YAMLError):
            root = FastLoader(text).get_single_node()
            return root
    root = SlowLoader(text).get_single_node()
    return root


def reads_the_same(text: str) -> bool:
    """Return whether libyaml is there and known to read such a text in the same way."""
    return bool(yaml.__with_libyaml__) and not _SEEN_OTHERWISE.search(text)
