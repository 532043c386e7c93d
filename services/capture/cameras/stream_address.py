"""The address of a network camera: shown without its password, and asked for the reason when it doesn't open."""

from __future__ import annotations

import socket
from urllib.parse import SplitResult, urlsplit, urlunsplit

from common.config.addresses import without_login

ASK_S = 2.0
_PORTS = {"rtsp": 554, "http": 80}
_RTSP = "DESCRIBE {url} RTSP/1.0\r\nCSeq: 1\r\nAccept: application/sdp\r\n\r\n"
_HTTP = "GET {path} HTTP/1.0\r\nHost: {host}\r\n\r\n"
_LONGEST_ANSWER = 4096


def why_not(url: str) -> str:
    """Why nothing comes from ``url``, in one sentence with the cure; never with its login.

    Asked of the server itself within ``ASK_S``, since OpenCV only says that it didn't work.
    """
    parts = urlsplit(url)
    shown = without_login(url)
    if parts.scheme not in _PORTS or not parts.hostname:
        return f"nothing comes from {shown}; does its sender run, and send to this machine?"
    port = parts.port or _PORTS[parts.scheme]
    try:
        answer = _ask(parts, port)
    except socket.gaierror:
        return f"there is no host '{parts.hostname}' ({shown}); check the name, or write its IP address"
    except ConnectionRefusedError:
        return f"{parts.hostname} refuses the connection at port {port} ({shown}); is its server running?"
    except TimeoutError:
        return f"{parts.hostname} doesn't answer at port {port} ({shown}); is it switched on, in the same network?"
    except OSError as error:
        return f"{parts.hostname} can't be reached at port {port} ({shown}): {error.strerror or error}"
    return _reason(answer, shown, has_login=parts.username is not None)


def _ask(parts: SplitResult, port: int) -> str:
    """The first lines of the server's answer to a request without login."""
    bare = parts._replace(netloc=parts.netloc.rpartition("@")[2])
    path = urlunsplit(("", "", parts.path or "/", parts.query, ""))
    request = _RTSP if parts.scheme == "rtsp" else _HTTP
    text = request.format(url=bare.geturl(), path=path, host=parts.hostname)
    with socket.create_connection((parts.hostname or "", port), ASK_S) as connection:
        connection.settimeout(ASK_S)
        connection.sendall(text.encode("utf-8", "replace"))
        return connection.recv(_LONGEST_ANSWER).decode("latin-1")


def _reason(answer: str, shown: str, *, has_login: bool) -> str:
    protocol, _, rest = answer.partition(" ")
    status = rest[:3]
    if not protocol.startswith(("RTSP/", "HTTP/")) or not status.isdigit():
        return f"the server of {shown} speaks another protocol; check scheme and port"
    if status == "404":
        return f"the server of {shown} has no such stream (404); check the path"
    if status in ("401", "403"):
        cure = "check user name and password" if has_login else "write them into the url: scheme://user:password@host"
        return f"the server of {shown} wants a login ({status}); {cure}"
    if status.startswith("2"):
        return f"{shown} is there, but what it gives can't be read as a video; check that a player shows it"
    return f"the server of {shown} answers {answer.splitlines()[0][:80].strip()}"
