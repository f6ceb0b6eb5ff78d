"""The server of `pcpc host --foxglove`: follows what runs, and sends it to those who subscribed.

foxglove-sdk carries it: threads of its own, a bounded queue for each client, whose oldest messages
go when it is full. One that reads nothing holds up nobody.
"""

import threading
from typing import Any

import foxglove
from foxglove.channels import LogChannel
from foxglove.websocket import Capability

from pcpc.drivers.errors import Exit, UserError
from pcpc.tools.live.host.actions import Actions
from pcpc.tools.live.host.foxglove.names import LOG_TOPIC
from pcpc.tools.live.host.foxglove.parameters import Parameters
from pcpc.tools.live.host.foxglove.topics import NodeTopics
from pcpc.tools.live.host.sources import FollowedRun, RunSource

TICK_S = 0.02
LOOK_S = 0.5  # how soon another run, and what others have tuned, is seen
QUEUE = 512  # messages for a client: about two seconds of them


class FoxgloveServer:
    """One; `certificate`: with its key, both PEM. UserError: it cannot listen there."""

    def __init__(
        self,
        watch: FollowedRun,
        token: str,
        write: bool,
        address: str,
        port: int,
        certificate: tuple[bytes, bytes] | None = None,
    ) -> None:
        foxglove.set_log_level("CRITICAL")  # it would print what strangers send
        self._watch, self._number = watch, 0
        self._nodes: dict[str, NodeTopics] = {}
        self._context = foxglove.Context()
        self._log = LogChannel(LOG_TOPIC, context=self._context)
        actions = Actions(lambda: watch.source, write)
        self._parameters = Parameters(lambda: watch.source, actions, token, self._tell)
        cert, key = certificate or (None, None)
        try:
            self._server: Any = foxglove.start_server(
                name="pcpc",
                host=address,
                port=port,
                context=self._context,
                tls_cert=cert,
                tls_key=key,
                capabilities=[Capability.Parameters],
                server_listener=self._parameters,
                message_backlog_size=QUEUE,
            )
        except (RuntimeError, ValueError) as error:
            why = str(error).removeprefix("FoxgloveError: ")
            if "bind" in why:
                raise UserError(f"{address}:{port}: {why}", Exit.ENVIRONMENT) from None
            raise UserError(f"--tls-cert, --tls-key: {why}") from None

    @property
    def port(self) -> int:
        """Where it listens."""
        return int(self._server.port)

    def serve(self, ended: threading.Event) -> None:
        """Go on until `ended`."""
        ticks = 0
        while not ended.wait(TICK_S):
            if ticks % round(LOOK_S / TICK_S) == 0:
                self._look()
            ticks += 1
            for node in self._nodes.values():
                node.publish()
        self._server.stop()

    def _look(self) -> None:
        """Find runs and nodes that have come, tell what has been tuned."""
        self._watch.find()
        source = self._watch.source
        anew = source.number != self._number
        if anew:
            self._number = source.number
            self._server.clear_session(f"{source.rig} {_began_ns(source)}")  # tells it from others
            for node in self._nodes.values():
                node.close()
            self._nodes = {}
        for role, node in source.nodes.items():
            if role not in self._nodes:
                self._nodes[role] = NodeTopics(
                    node.live, self._context, self._log, _began_ns(source)
                )
        self._server.publish_parameter_values(self._parameters.changes(anew))

    def _tell(self, text: str, level: Any) -> None:
        self._server.publish_status(text, level, id="set")


def _began_ns(source: RunSource) -> str:
    """Return when the first node of a run began, on the wall's clock."""
    first = next(iter(source.nodes.values()))
    return str(first.live.block.description["metadata"]["clock_wall_ns"])
