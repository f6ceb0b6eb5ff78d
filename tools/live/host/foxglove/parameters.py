"""The parameters of a run as Foxglove reads and sets them.

The SDK's server knows neither a token nor an Origin: whoever can open a WebSocket to it is a
client, which includes every page in a browser of this machine. So reading is free there, and
setting is for clients that have first set TOKEN to the token of the page. It always reads "".
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

from foxglove import Parameter, ParameterType, StatusLevel
from foxglove.websocket import ServerListener

from pcpc.drivers.errors import UserError, printable
from pcpc.tools.live.host import guard
from pcpc.tools.live.host.actions import Actions
from pcpc.tools.live.host.client_messages import Set
from pcpc.tools.live.host.foxglove.names import TOKEN
from pcpc.tools.live.host.sources import RunSource, full

MOST = 64  # parameters in one message
_MOST_LETTERS = 300
_MOST_CLIENTS = 256  # whose messages are counted


class Parameters(ServerListener):
    """What clients may ask and set; called by threads of the server.

    `tell` says something to all clients: a text, and whether it is a refusal.
    """

    def __init__(
        self,
        source: Callable[[], RunSource],
        actions: Actions,
        token: str,
        tell: Callable[[str, Any], None],
    ) -> None:
        self._source, self._actions, self._token, self._tell = source, actions, token, tell
        self._allowed: set[int] = set()
        self._floods: dict[int, guard.Flood] = {}
        self._values_sent: dict[str, float] = {}

    def on_get_parameters(
        self, client: Any, param_names: Sequence[str], request_id: str | None = None
    ) -> list[Parameter]:
        """Return the parameters of these names, all for none; nothing to one who floods."""
        return [] if self._too_many(client.id) else self._answer(param_names)

    def on_set_parameters(
        self, client: Any, parameters: Sequence[Parameter], request_id: str | None = None
    ) -> list[Parameter]:
        """Set them, all between the same two cycles or none; return what they are now."""
        if self._too_many(client.id):
            return []
        wanted = {one.name: one.get_value() for one in parameters[: MOST + 1]}
        values = dict[str, float]()
        try:
            values = self._set(client.id, dict(wanted))
        except UserError as error:
            self._tell(printable(str(error)), StatusLevel.Error)
        shown = {one.name: one for one in self._answer([*wanted])}
        shown |= {name: _parameter(name, value) for name, value in values.items()}
        return list(shown.values())

    def changes(self, anew: bool) -> list[Parameter]:
        """Return the parameters that have changes since, all if `anew`."""
        now = self._values()
        before = {} if anew else self._values_sent
        self._values_sent = now
        return [_parameter(k, value) for k, value in now.items() if before.get(k) != value]

    def _too_many(self, client: int) -> bool:
        """Note that a client has said something; return whether it was one thing too many."""
        flood = self._floods.pop(client, None) or guard.Flood()
        self._floods[client] = flood  # who spoke last stands last
        if len(self._floods) > _MOST_CLIENTS:
            del self._floods[next(iter(self._floods))]
        return flood.too_many()

    def _set(self, client: int, wanted: dict[str, Any]) -> dict[str, float]:
        """Return the values that have been set; UserError: refused, nothing has changes."""
        if not self._actions.write:
            raise UserError("this server is read-only; start `pcpc host --foxglove` with --write")
        if TOKEN in wanted:
            given = wanted.pop(TOKEN)
            if not guard.is_token(given, self._token):
                raise UserError(f"{TOKEN}: not the token that `pcpc host` printed; nothing was set")
            self._allowed.add(client)
            self._tell("a client gave the token and may tune", StatusLevel.Info)
        if not wanted:
            return {}
        if client not in self._allowed:
            raise UserError(f"set {TOKEN} to the token that `pcpc host` printed, then tune")
        values = _numbers(wanted)
        cycle = self._actions.do(Set(0, values))["cycle"]
        source = self._source()
        words = ", ".join(_value_text(source, name, value) for name, value in values.items())
        self._tell(f"{words} from cycle {cycle}", StatusLevel.Info)
        return values

    def _answer(self, names: Sequence[str]) -> list[Parameter]:
        answer = [_parameter(k, v) for k, v in self._values().items() if not names or k in names]
        if self._actions.write and (not names or TOKEN in names):
            answer.append(Parameter(TOKEN, value=""))
        return answer

    def _values(self) -> dict[str, float]:
        """Return all parameters that JSON can hold, empty where nothing runs."""
        values = dict[str, float]()
        for role, node in self._source().nodes.items():
            try:
                now = node.live.read()
            except UserError:  # it stands still or is gone
                continue
            for name, one in node.variables.items():
                if one.range is not None and math.isfinite(now[name]):
                    values[full(role, name)] = now[name]
        return values


def _parameter(name: str, value: float) -> Parameter:
    return Parameter(name, value=float(value), type=ParameterType.Float64)


def _numbers(wanted: dict[str, Any]) -> dict[str, float]:
    if len(wanted) > MOST:
        raise UserError(f"more than {MOST} parameters at once; nothing was set")
    for name, value in wanted.items():
        if len(name) > _MOST_LETTERS:
            raise UserError(f"{name[:40]}...: no such parameter; nothing was set")
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise UserError(f"{name}: expected a number; nothing was set")
    return {name: float(value) for name, value in wanted.items()}


def _value_text(source: RunSource, name: str, value: float) -> str:
    role, variable = source.place(name)
    return f"{name} = {source.nodes[role].variables[variable].shown(value)}"
