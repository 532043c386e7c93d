"""Everything that travels between processes; the only package that knows ZeroMQ."""

from common.addresses import is_local
from common.bus.commands import CommandClient, CommandServer
from common.bus.endpoints import DEFAULT_PREFIX, Endpoints, default_run_folder
from common.bus.keys import add_client, create_keys
from common.bus.locks import LOCK_SUFFIX, NameLock, clear_dead, holder_of
from common.bus.order_client import OrderClient
from common.bus.order_server import OrderServer, Return
from common.bus.poller import Poller
from common.bus.proxy import Proxy
from common.bus.publisher import Publisher
from common.bus.sockets import end_context
from common.bus.subscriber import Received, Subscriber

__all__ = [
    "DEFAULT_PREFIX",
    "LOCK_SUFFIX",
    "CommandClient",
    "CommandServer",
    "Endpoints",
    "NameLock",
    "OrderClient",
    "OrderServer",
    "Poller",
    "Proxy",
    "Publisher",
    "Received",
    "Return",
    "Subscriber",
    "add_client",
    "clear_dead",
    "create_keys",
    "default_run_folder",
    "end_context",
    "holder_of",
    "is_local",
]
