"""The base of all messages and their codec: msgpack, strict, bounded; never pickle."""

from __future__ import annotations

from typing import Any, Self, TypeVar

import msgpack
from pydantic import BaseModel, ConfigDict, ValidationError

from common.errors import CodecError

SCHEMA_VERSION = 1
MAX_BYTES = 1 << 20

M = TypeVar("M", bound=BaseModel)


class Stamp(BaseModel):
    """Who sent a message, as which of its messages, and when (``mono_ns`` orders, ``wall_ns`` is UTC)."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    v: int = SCHEMA_VERSION
    source: str
    boot: str
    seq: int
    mono_ns: int
    wall_ns: int


class Message(BaseModel):
    """A frozen message; the publisher fills in ``stamp``."""

    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=True)

    stamp: Stamp | None = None

    def stamped(self, stamp: Stamp) -> Self:
        """The same message with its sender's stamp."""
        return self.model_copy(update={"stamp": stamp})


def encode(message: BaseModel) -> bytes:
    """Pack a message; raises CodecError if it is larger than ``MAX_BYTES``."""
    return _pack(message, _plain(message))


def encode_stamped(message: Message, source: str, boot: str, seq: int, mono_ns: int, wall_ns: int) -> bytes:
    """``encode`` of the message with the ``Stamp`` of these values, without making either."""
    plain = _plain(message)
    plain["stamp"] = {
        "v": SCHEMA_VERSION,
        "source": source,
        "boot": boot,
        "seq": seq,
        "mono_ns": mono_ns,
        "wall_ns": wall_ns,
    }
    return _pack(message, plain)


def _plain(message: BaseModel) -> dict[str, Any]:
    # What model_dump calls. Between two frames the caches go cold, and then each call around it counts.
    plain: dict[str, Any] = message.__pydantic_serializer__.to_python(message, by_alias=True)
    return plain


def _pack(message: BaseModel, plain: dict[str, Any]) -> bytes:
    data: bytes = msgpack.packb(plain, use_bin_type=True)
    if len(data) > MAX_BYTES:
        raise CodecError(f"a {type(message).__name__} of {len(data)} bytes is larger than {MAX_BYTES}")
    return data


def unpack(data: bytes, limit: int = MAX_BYTES) -> Any:
    """Unpack plain msgpack within ``limit`` bytes; raises CodecError for garbage."""
    if len(data) > limit:
        raise CodecError(f"a message of {len(data)} bytes is larger than {limit}")
    try:
        return msgpack.unpackb(data, use_list=False, raw=False, strict_map_key=True)
    except Exception as error:
        raise CodecError(f"not MessagePack: {type(error).__name__}") from error


def decode(kind: type[M], data: bytes) -> M:
    """Unpack and validate strictly; raises CodecError naming the first wrong field."""
    return validate(kind, unpack(data))


def validate(kind: type[M], plain: Any) -> M:
    """Make a message of unpacked ``plain`` strictly; raises CodecError naming the first wrong field."""
    stamp = plain.get("stamp") if isinstance(plain, dict) else None
    version = stamp.get("v") if isinstance(stamp, dict) else SCHEMA_VERSION
    if version != SCHEMA_VERSION:
        raise CodecError(
            f"{kind.__name__} has schema version {version}, this tagmill reads {SCHEMA_VERSION}; "
            "all services of a stack must be of the same release"
        )
    try:
        # What model_validate calls; see _plain.
        made: M = kind.__pydantic_validator__.validate_python(plain, strict=True)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(str(part) for part in first["loc"]) or "the message"
        raise CodecError(f"{kind.__name__}: {where}: {first['msg']}") from error
    return made
