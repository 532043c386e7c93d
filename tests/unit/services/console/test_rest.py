"""The command socket as HTTP: the same fields, the same answers; the page's files and nothing else."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from fastapi import FastAPI

from common.commands import COMMANDS
from services.console import rest
from services.console.app import add_page
from services.console.line import Plain
from services.console.page import Page
from services.console.rest import MOST_BODY_BYTES, limit_s
from tests.support.asgi import Answered, ask

JSON = "application/json"


class Socket:
    """Answers as it is told to; keeps what it was asked."""

    def __init__(self, answer: Plain) -> None:
        self.answer, self.asked = answer, list[tuple[Plain, float]]()

    async def ask(self, fields: Plain, limit: float) -> Plain:
        self.asked.append((fields, limit))
        return self.answer


def post(socket: Socket, command: str, body: bytes) -> Answered:
    app = FastAPI()
    app.include_router(rest.router(socket.ask))
    return ask(app, "POST", f"/api/commands/{command}", body, content_type=JSON)  # type: ignore[arg-type]


def refused(code: str) -> Plain:
    return {"ok": False, "error": {"code": code, "message": "a sentence"}}


def test_a_command_is_passed_on_as_it_is() -> None:
    socket = Socket({"ok": True, "samples": ["a"]})
    answer = post(socket, "record", b'{"camera": "cam0", "timeout_s": 7, "frame": null}')
    assert (answer.status, answer.json) == (200, {"ok": True, "samples": ["a"]})
    assert socket.asked == [({"command": "record", "camera": "cam0", "timeout_s": 7, "frame": None}, 12.0)]


@pytest.mark.parametrize(
    ("code", "status"),
    [("no_object", 409), ("unknown_field", 422), ("out_of_bounds", 422), ("no_answer", 503), ("failed", 500)],
)
def test_refusals_keep_their_code_and_get_a_status(code: str, status: int) -> None:
    answer = post(Socket(refused(code)), "stop", b"{}")
    assert (answer.status, answer.json["error"]["code"]) == (status, code)


@pytest.mark.parametrize(
    "body",
    [b"{", b"[]", b"3", b'"record"', b"\xff\xfe", b'{"timeout_s": NaN}', b"[" * 50_000, b'{"command": "stop"}'],
)
def test_a_bad_body_is_refused_here_in_words(body: bytes) -> None:
    socket = Socket({"ok": True})
    answer = post(socket, "record", body)
    assert (answer.status, answer.json["error"]["code"]) == (422, "not_a_command")
    assert not socket.asked


def test_a_large_body_is_refused_before_it_is_read_whole() -> None:
    socket = Socket({"ok": True})
    assert post(socket, "delete", b" " * (MOST_BODY_BYTES + 1)).status == 413
    assert not socket.asked


def test_there_is_a_route_and_a_schema_for_every_command_and_nothing_else() -> None:
    app = FastAPI()
    app.include_router(rest.router(Socket({}).ask))
    document = app.openapi()
    assert set(document["paths"]) == {f"/api/commands/{name}" for name in COMMANDS}
    for name, row in COMMANDS.items():
        schema = document["paths"][f"/api/commands/{name}"]["post"]["requestBody"]["content"][JSON]["schema"]
        assert set(schema.get("properties", {})) == set(row.model.model_fields)
    assert "$ref" not in json.dumps(document["paths"]["/api/commands/samples"]["post"]["requestBody"])


@pytest.mark.parametrize("given", [True, "9", -1, 1e9, None])
def test_a_senseless_time_limit_is_the_socket_s_to_refuse(given: Any) -> None:
    assert limit_s(COMMANDS["record"], {"timeout_s": given}) == 5.0
    assert limit_s(COMMANDS["record"], {}) == 10.0


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "static" / "js").mkdir(parents=True)
    (tmp_path / "static" / "index.html").write_text(
        '<script type="importmap">{"imports": {}}</script><script type="module" src="/static/js/app.js"></script>'
    )
    (tmp_path / "static" / "js" / "app.js").write_text("export {}")
    (tmp_path / "secret.txt").write_text("no")
    return tmp_path / "static"


@pytest.mark.parametrize(
    "path",
    ["/static/../secret.txt", "/static/js/../../secret.txt", "/static//etc/passwd", "/static/%2e%2e/secret.txt",
     "/static/js", "/static/", "/static/js/app.js\x00"],
)  # fmt: skip
def test_no_path_leads_out_of_the_page_s_folder(folder: Path, path: str) -> None:
    app = FastAPI()
    add_page(app, Page(folder))
    assert ask(app, "GET", path).status == 404  # type: ignore[arg-type]


def test_the_page_s_files_and_views(folder: Path) -> None:
    app = FastAPI()
    add_page(app, Page(folder))
    found = ask(app, "GET", "/static/js/app.js")  # type: ignore[arg-type]
    assert (found.status, found.body) == (200, b"export {}")
    assert found.headers["content-type"].startswith("text/javascript")
    assert ask(app, "GET", "/gallery").status == 200  # type: ignore[arg-type]
    assert ask(app, "GET", "/").headers["location"] == "/live"  # type: ignore[arg-type]


def test_the_import_map_s_hash_is_that_of_the_text_between_the_tags(folder: Path) -> None:
    import base64
    import hashlib

    expected = base64.b64encode(hashlib.sha256(b'{"imports": {}}').digest()).decode()
    assert Page(folder).hashes() == (expected,)
    assert re.fullmatch(r"[A-Za-z0-9+/=]+", expected)
    assert Page(folder / "js").hashes() == ()
