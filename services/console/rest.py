"""The command socket as HTTP: one POST a command, the same fields, the same answer. The socket itself checks them."""

from __future__ import annotations

import json
from collections.abc import Awaitable, Callable
from typing import Any

from fastapi import APIRouter, Request, Response
from starlette.responses import JSONResponse

from common.commands import COMMANDS, Row
from services.console.line import Plain

MOST_BODY_BYTES = 64 * 1024
AFTER_S = 5.0
"""Control answers at the command's own limit and a little later."""
LONGEST_S = 40.0
"""The longest that control lets a command without a ``timeout_s`` take, and a little more."""

_STATUS = {"no_answer": 503, "stopping": 503, "failed": 500}
_BAD_FIELDS = {"unknown_field", "missing_field", "wrong_type", "out_of_bounds", "not_a_command", "unknown_command"}

Ask = Callable[[Plain, float], Awaitable[Plain]]


def router(ask: Ask) -> APIRouter:
    """A route for each command."""
    made = APIRouter(prefix="/api/commands", tags=["commands"])
    for row in COMMANDS.values():
        made.add_api_route(
            f"/{row.name}",
            _endpoint(row, ask),
            methods=["POST"],
            name=row.name,
            operation_id=row.name,
            summary=row.words,
            description=f"Answers: {row.answer}.",
            response_class=JSONResponse,
            response_model=None,
            responses=_RESPONSES,  # type: ignore[arg-type]
            openapi_extra={"requestBody": {"content": {"application/json": {"schema": _schema(row)}}}},
        )
    return made


_RESPONSES: dict[int, dict[str, str]] = {
    200: {"description": "done: the command socket's answer, ok true"},
    409: {"description": "refused: ok false, error {code, message}"},
    413: {"description": "larger than 64 KiB"},
    422: {"description": "a field is unknown, missing, of a wrong type or out of bounds"},
    503: {"description": "the command socket doesn't answer"},
}


def answered(answer: Plain) -> Response:
    """The command socket's answer as an HTTP response."""
    if answer.get("ok"):
        status = 200
    else:
        code = str((answer.get("error") or {}).get("code", "failed"))
        status = 422 if code in _BAD_FIELDS else _STATUS.get(code, 409)
    return JSONResponse(answer, status)


async def read_body(request: Request) -> Plain:
    """The fields; raises ValueError with a sentence, OverflowError if there are too many of them."""
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > MOST_BODY_BYTES:
            raise OverflowError(f"a command has at most {MOST_BODY_BYTES // 1024} KiB")
    try:
        fields = json.loads(body or b"{}", parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        raise ValueError("the body is no JSON") from error
    if not isinstance(fields, dict):
        raise ValueError(  # noqa: TRY004 - a mistake of the client's, told like its others
            'the body is the command\'s fields, a JSON object such as {"camera": "cam0"}'
        )
    if "command" in fields:
        raise ValueError("the address says which command it is; leave the field 'command' out")
    return fields


def _no_constant(word: str) -> float:
    raise ValueError(f"{word} is no JSON")


def _endpoint(row: Row, ask: Ask) -> Callable[[Request], Awaitable[Response]]:
    async def command(request: Request) -> Response:
        try:
            fields = await read_body(request)
        except OverflowError as error:
            return refusal(413, "not_a_command", str(error))
        except ValueError as error:
            return refusal(422, "not_a_command", str(error))
        return answered(await ask({"command": row.name, **fields}, limit_s(row, fields)))

    return command


def limit_s(row: Row, fields: Plain) -> float:
    """How long an answer to this command may take."""
    default = row.model.model_fields.get("timeout_s")
    if default is None:
        return LONGEST_S
    given = fields.get("timeout_s", default.default)
    sensible = isinstance(given, int | float) and not isinstance(given, bool) and 0 < given <= 3600
    return (float(given) if sensible else 0.0) + AFTER_S


def refusal(status: int, code: str, message: str) -> Response:
    """A refusal in the command socket's form."""
    return JSONResponse({"ok": False, "error": {"code": code, "message": message}}, status)


def _schema(row: Row) -> dict[str, Any]:
    schema = row.model.model_json_schema()
    shared = {f"#/$defs/{name}": part for name, part in schema.pop("$defs", {}).items()}
    found: dict[str, Any] = _inlined(schema, shared)
    return found


def _inlined(part: Any, shared: dict[str, Any]) -> Any:
    """The schema with its definitions in place, so that nothing is referred to across the document."""
    if isinstance(part, dict):
        if "$ref" in part and part["$ref"] in shared:
            return _inlined(shared[part["$ref"]], shared)
        return {name: _inlined(value, shared) for name, value in part.items()}
    if isinstance(part, list):
        return [_inlined(value, shared) for value in part]
    return part
