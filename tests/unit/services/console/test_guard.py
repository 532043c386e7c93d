"""Who may speak to the console: only its own page, by its own names, with the token where one is demanded."""

from __future__ import annotations

from collections.abc import MutableMapping
from typing import Any

import pytest

from services.console.guard import Guard, Receive, Rules, Scope, Send, is_loopback, rules_for
from tests.support.asgi import ask, knock

JSON = "application/json"
TOKEN = "a-token-of-a-stack"


async def app(scope: Scope, receive: Receive, send: Send) -> None:
    """Lets everybody in."""
    if scope["type"] == "websocket":
        await send({"type": "websocket.accept"})
        return
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"in"})


def guard(rules: Rules | None = None) -> Guard:
    return Guard(app, rules or rules_for("127.0.0.1", 8750, None), lambda: ("aGFzaA==",))


@pytest.mark.parametrize("host", ["127.0.0.1:8750", "localhost:8750", "[::1]:8750", "LOCALHOST:8750"])
def test_its_own_names_with_its_port_are_let_in(host: str) -> None:
    assert ask(guard(), "GET", "/live", host=host).body == b"in"


@pytest.mark.parametrize(
    "host", ["evil.example:8750", "127.0.0.1", "127.0.0.1:80", "localhost:8751", "", "192.168.1.5:8750", "localhost"]
)
def test_a_foreign_name_for_this_machine_is_refused(host: str) -> None:
    """DNS rebinding: the browser believes that evil.example is here."""
    watch = guard()
    answer = ask(watch, "GET", "/api/status", host=host)
    assert (answer.status, answer.json["error"]["code"]) == (421, "wrong_host")
    assert knock(watch, host=host)[0]["type"] == "websocket.close"
    assert watch.refused == 2


def test_two_hosts_in_one_request_are_none() -> None:
    answer = ask(guard(), "GET", "/live", Host="evil.example:8750")
    assert answer.status == 421


@pytest.mark.parametrize(
    "origin",
    ["http://evil.example", "https://127.0.0.1:8750", "http://127.0.0.1:8751", "http://localhost:8750", "null", ""],
)
def test_a_page_of_another_origin_can_neither_read_nor_record_nor_listen(origin: str) -> None:
    watch = guard()
    for answer in (
        ask(watch, "GET", "/api/status", origin=origin),
        ask(watch, "POST", "/api/commands/record", b"{}", origin=origin, content_type=JSON),
    ):
        assert (answer.status, answer.json["error"]["code"]) == (403, "wrong_origin")
    assert knock(watch, origin=origin) == [
        {"type": "websocket.close", "code": 1008, "reason": "a page of another origin may not use this console"}
    ]


def test_the_own_page_and_programs_without_an_origin_are_let_in() -> None:
    assert (
        ask(guard(), "POST", "/api/commands/stop", b"{}", origin="http://127.0.0.1:8750", content_type=JSON).status
        == 200
    )
    assert ask(guard(), "GET", "/metrics").status == 200
    assert knock(guard(), origin="http://127.0.0.1:8750") == [{"type": "websocket.accept"}]


def test_pictures_and_scripts_that_a_foreign_page_embeds_are_refused_but_a_link_works() -> None:
    assert ask(guard(), "GET", "/api/status", sec_fetch_site="cross-site", sec_fetch_mode="no-cors").status == 403
    assert ask(guard(), "GET", "/live", sec_fetch_site="cross-site", sec_fetch_mode="navigate").status == 200


@pytest.mark.parametrize("kind", ["text/plain", "application/x-www-form-urlencoded", "multipart/form-data", ""])
def test_what_a_form_can_send_is_refused(kind: str) -> None:
    assert ask(guard(), "POST", "/api/commands/record", b"{}", content_type=kind).status == 415


def test_every_answer_has_the_security_headers() -> None:
    headers = ask(guard(), "GET", "/live").headers
    policy = headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "script-src 'self' 'sha256-aGFzaA=='" in policy
    assert "unsafe" not in policy
    assert "frame-ancestors 'none'" in policy
    assert (headers["x-content-type-options"], headers["referrer-policy"]) == ("nosniff", "no-referrer")
    assert headers["cross-origin-resource-policy"] == "same-origin"


# --- off loopback


@pytest.fixture
def open_rules() -> Rules:
    return rules_for("0.0.0.0", 8750, TOKEN)


def cookie_of(headers: MutableMapping[str, Any]) -> str:
    return str(headers["set-cookie"]).split(";")[0]


def test_without_the_token_nothing_but_the_health_is_told(open_rules: Rules) -> None:
    watch = guard(open_rules)
    for path in ("/live", "/api/status", "/metrics", "/static/js/app.js"):
        assert ask(watch, "GET", path, host="192.168.1.5:8750").status == 401
    assert knock(watch, host="192.168.1.5:8750")[0]["type"] == "websocket.close"
    assert ask(watch, "GET", "/healthz", host="192.168.1.5:8750").status == 200


def test_the_address_with_the_token_gives_a_cookie_and_a_clean_address(open_rules: Rules) -> None:
    watch = guard(open_rules)
    answer = ask(watch, "GET", f"/gallery?object=box-1&token={TOKEN}", host="192.168.1.5:8750")
    assert (answer.status, answer.headers["location"]) == (303, "/gallery?object=box-1")
    cookie = answer.headers["set-cookie"]
    assert "HttpOnly" in cookie
    assert "SameSite=Strict" in cookie
    assert ask(watch, "GET", "/live", host="192.168.1.5:8750", cookie=cookie_of(answer.headers)).status == 200
    assert knock(watch, host="192.168.1.5:8750", cookie=f"other=1; {cookie_of(answer.headers)}")[0]["type"] == (
        "websocket.accept"
    )


def test_the_token_s_redirect_stays_here(open_rules: Rules) -> None:
    answer = ask(guard(open_rules), "GET", f"//evil.example/?token={TOKEN}", host="192.168.1.5:8750")
    assert answer.headers["location"] == "/evil.example/"


@pytest.mark.parametrize("given", ["", "a-token", TOKEN + "x", "é"])
def test_a_wrong_token_is_none(open_rules: Rules, given: str) -> None:
    watch = guard(open_rules)
    assert ask(watch, "GET", f"/live?token={given}", host="192.168.1.5:8750").status == 401
    assert ask(watch, "GET", "/live", host="192.168.1.5:8750", cookie=f"tagmill_console_8750={given}").status == 401
    assert ask(watch, "GET", "/metrics", host="192.168.1.5:8750", authorization=f"Bearer {given}").status == 401


def test_prometheus_brings_the_token_as_a_bearer(open_rules: Rules) -> None:
    answer = ask(guard(open_rules), "GET", "/metrics", host="192.168.1.5:8750", authorization=f"Bearer {TOKEN}")
    assert answer.status == 200


def test_bound_to_all_addresses_it_takes_any_address_but_no_foreign_name(open_rules: Rules) -> None:
    assert open_rules.host_allowed("10.1.2.3:8750")
    assert open_rules.host_allowed("[fe80::1]:8750")
    assert not open_rules.host_allowed("10.1.2.3:80")
    assert not open_rules.host_allowed("evil.example:8750")
    assert not rules_for("192.168.1.5", 8750, TOKEN).host_allowed("10.1.2.3:8750")


def test_what_is_loopback() -> None:
    assert all(map(is_loopback, ("127.0.0.1", "127.8.8.8", "::1", "localhost")))
    assert not any(map(is_loopback, ("0.0.0.0", "::", "192.168.1.5", "box.local")))


def test_who_guesses_is_told_so_ten_times_a_minute_and_the_right_token_is_heard_all_the_while(
    open_rules: Rules, capsys: pytest.CaptureFixture[str]
) -> None:
    watch = guard(open_rules)
    told = [ask(watch, "GET", f"/live?token=guess-{n}", host="192.168.1.5:8750").status for n in range(50)]
    assert told == [401] * 10 + [429] * 40
    cookie = "tagmill_console_8750=stale"
    assert ask(watch, "GET", "/live", host="192.168.1.5:8750", cookie=cookie).status == 429
    assert ask(watch, "GET", f"/live?token={TOKEN}", host="192.168.1.5:8750").status == 303
    assert ask(watch, "GET", "/healthz", host="192.168.1.5:8750").status == 200
    assert watch.refused == 51
    lines = [line for line in capsys.readouterr().err.splitlines() if "console.refused" in line]
    assert 1 <= len(lines) <= 3
    assert "address=" in lines[0]
