"""Whether the supervisor that has just started this process wants it gone already."""

from __future__ import annotations

import os
import socket
from xml.sax.saxutils import escape

_URL, _GROUP, _NAME = "SUPERVISOR_SERVER_URL", "SUPERVISOR_GROUP_NAME", "SUPERVISOR_PROCESS_NAME"
_LIMIT_S = 2.0
_MOST_BYTES = 1 << 16
_CALL = (
    "<?xml version='1.0'?><methodCall><methodName>supervisor.getProcessInfo</methodName>"
    "<params><param><value><string>{name}</string></value></param></params></methodCall>"
)


def stop_was_asked() -> bool:
    """True if supervisord is waiting for this program's end.

    Between its fork and its exec, supervisord's child has supervisord's own signal handlers: a SIGTERM that comes
    then is swallowed, and on a busy machine that moment is long. Ask once, with handlers of one's own in place.
    False without a supervisor, or if it doesn't answer within two seconds.
    """
    url, name = os.environ.get(_URL, ""), os.environ.get(_NAME)
    if not url.startswith("unix://") or name is None:
        return False
    body = _CALL.format(name=escape(f"{os.environ.get(_GROUP, name)}:{name}")).encode()
    head = f"POST /RPC2 HTTP/1.0\r\nContent-Type: text/xml\r\nContent-Length: {len(body)}\r\n\r\n".encode()
    answer = b""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as line:
        line.settimeout(_LIMIT_S)
        try:
            line.connect(url.removeprefix("unix://"))
            line.sendall(head + body)
            while b"</methodResponse>" not in answer and len(answer) < _MOST_BYTES:
                part = line.recv(4096)
                if not part:
                    break
                answer += part
        except OSError:  # no supervisor there, or it is slow: its signal may still come
            return False
    # While it shuts down as a whole, it answers nothing but that.
    return b"<string>STOPPING</string>" in answer or b"SHUTDOWN_STATE" in answer
