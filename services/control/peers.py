"""The services that control gives orders to: the store and the label processes."""

from __future__ import annotations

from common.bus import Endpoints, OrderClient
from common.errors import RefusedError
from common.messages import Answer, Order, ServiceState
from services.control.conversations import MAX_WAITING

STORE = "store"
CONTROL = "control"
_WINDOW = MAX_WAITING
"""As many orders as clients may wait; the limits that count are the label processes' sample slots."""


class Peers:
    """An order client for each peer, by service id (``store``, ``label.0``)."""

    def __init__(self, endpoints: Endpoints, labels: int) -> None:
        addresses = {STORE: endpoints.orders_store}
        addresses |= {f"label.{instance}": endpoints.orders_label(instance) for instance in range(labels)}
        self._answers: list[Answer] = []
        self._clients = {peer: OrderClient(address, CONTROL, window=_WINDOW) for peer, address in addresses.items()}

    @property
    def clients(self) -> tuple[OrderClient, ...]:
        """For the Poller."""
        return tuple(self._clients.values())

    @property
    def pending(self) -> int:
        """Orders without an answer."""
        return sum(len(client.pending) for client in self._clients.values())

    def heard(self, state: ServiceState) -> None:
        """A service's heartbeat: a peer in a new life is given again what it hasn't answered."""
        client = self._clients.get(state.service)
        if client is not None:
            # What it has answered meanwhile is no longer asked: first its answers, then the count of what lacks one.
            self._answers += client.receive()
            client.peer_seen(state.boot)

    @property
    def resent(self) -> int:
        """Orders that were sent again."""
        return sum(client.resent for client in self._clients.values())

    def send(self, peer: str, order: Order, *, lasting: bool = False) -> None:
        """Send at once; raises RefusedError ``label_down`` or ``store_down``, and sends nothing, if the peer is silent.

        A ``lasting`` order is taken whatever the peer does: it goes once the peer can be reached.
        """
        client = self._clients[peer]
        # Asked first: a peer that hangs would carry the order out when it goes on and nobody expects it any more.
        if not (lasting or client.available):
            kind = peer.partition(".")[0]
            raise RefusedError(
                f"{peer} is not there; its supervisor restarts it, so try again in a few seconds", code=f"{kind}_down"
            )
        client.send(order)

    def forget(self, peer: str, key: str) -> None:
        """No answer to this order is wanted any more."""
        self._clients[peer].forget(key)

    def receive(self) -> list[Answer]:
        """The answers that are there, without waiting."""
        answers, self._answers = self._answers, []
        return answers + [answer for client in self._clients.values() for answer in client.receive()]

    def close(self) -> None:
        """Close at once; idempotent."""
        for client in self._clients.values():
            client.close()
