"""From a tree to a ``RigConfig``: each broken field is told in plain words, with its line."""

from __future__ import annotations

import json
import re
import types
from collections.abc import Callable, Mapping
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError

from common.config.models import DRIVER_OPTIONS, CameraConfig, RigConfig
from common.config.problems import FieldPath, Problems, suggestion
from common.config.tree import Tree

Model = TypeVar("Model", bound=BaseModel)


def read_schema(tree: Tree, problems: Problems) -> RigConfig:
    """The rig as far as it is well-formed.

    Every broken field is noted and then taken out of ``tree`` (with what can't stand without it), so that what
    a section means can be checked although another section is broken.
    """
    first = True
    while True:
        try:
            return RigConfig.model_validate_json(json.dumps(tree.plain()), strict=True)
        except ValidationError as error:
            broken = error.errors(include_url=False)
        cuts: list[FieldPath] = []
        for one in broken:
            path = _path(one["loc"])
            if first:
                _note(tree, path, one, problems, RigConfig)
            if not _stand_in(tree, path):
                cuts.append(path[:-1] if one["type"] == "missing" else path)
        removed = [tree.remove(path) for path in sorted(set(cuts), key=_last_first, reverse=True)]
        if not first and not any(removed):
            return RigConfig()
        first = False


def read_model(tree: Tree, problems: Problems, model: type[Model]) -> Model | None:
    """A small file as a whole; None, with everything that is wrong with it noted, unless all of it is right."""
    try:
        return model.model_validate_json(json.dumps(tree.plain()), strict=True)
    except ValidationError as error:
        for one in error.errors(include_url=False):
            _note(tree, _path(one["loc"]), one, problems, model)
    return None


def _stand_in(tree: Tree, path: FieldPath) -> bool:
    """Give an object without a usable name another one: its sides can still be checked. Whether ``path`` was that."""
    if len(path) != 3 or path[0] != "objects" or path[2] != "name":
        return False
    holder = tree.nearest(path[:2])
    if isinstance(holder.value, dict):
        holder.value["name"] = Tree((*holder.path, "name"), holder.line, f"nameless.{path[1]}")
    return True


def check_options(tree: Tree, name: str, camera: CameraConfig, problems: Problems) -> None:
    """Check the driver's own keys of a camera; keys of a third party's driver are its own affair."""
    model = DRIVER_OPTIONS.get(camera.driver)
    here = tree.nearest(("cameras", name))
    if model is None or here.path != ("cameras", name):
        return
    options = {key: value for key, value in here.plain().items() if key not in CameraConfig.model_fields}
    try:
        model.model_validate_json(json.dumps(options), strict=True)
    except ValidationError as error:
        for one in error.errors(include_url=False):
            _note(here, _path(one["loc"]), one, problems, model, CameraConfig)


def _path(location: tuple[int | str, ...]) -> FieldPath:
    return tuple(part for part in location if part != "[key]")


def _last_first(path: FieldPath) -> list[tuple[int, int, str]]:
    """Sorts list items by number, so that taking out the last first leaves the others where they are."""
    return [(1, part, "") if isinstance(part, int) else (0, 0, part) for part in path]


def _note(
    tree: Tree,
    path: FieldPath,
    error: Mapping[str, Any],
    problems: Problems,
    model: type[BaseModel],
    *further: type[BaseModel],
) -> None:
    """Note one of pydantic's errors; ``path`` counts from ``tree``, whose keys are those of the models."""
    holder = tree.nearest(path[:-1])
    at = tree.nearest(path)
    full = (*holder.path, path[-1]) if path and at is holder else at.path
    if problems.touch(full):
        return  # the reader has said already why the value is not there
    kind = error["type"]
    if kind == "extra_forbidden":
        known = [name for one in (model, *further) for name in _keys(one, path[:-1])]
        reason = f"unknown key{suggestion(str(path[-1]), known)}; allowed here: {', '.join(known)}"
    elif kind == "missing":
        reason = "is missing"
    else:
        reason = _REASONS.get(kind, _otherwise)(at.plain(), error)
    problems.add(at.line, full, reason)


def _keys(model: type[BaseModel], path: FieldPath) -> list[str]:
    """The keys that the model allows at ``path``."""
    kind: Any = model
    for part in path:
        kind = _below(kind, part)
    kind = _bare(kind)
    return list(kind.model_fields) if isinstance(kind, type) and issubclass(kind, BaseModel) else []


def _below(kind: Any, part: str | int) -> Any:
    kind = _bare(kind)
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        field = kind.model_fields.get(str(part))
        return field.annotation if field else None
    arguments = get_args(kind)
    return arguments[1] if get_origin(kind) is dict else arguments[0] if get_origin(kind) is tuple else None


def _bare(kind: Any) -> Any:
    """Without ``Annotated`` and ``| None``."""
    while get_origin(kind) in (Annotated, Union, types.UnionType):
        kind = next(argument for argument in get_args(kind) if argument is not type(None))
    return kind


def shown(value: Any) -> str:
    """A value as a reason quotes it."""
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, dict):
        return "a map"
    if isinstance(value, list):
        return "a list"
    text = repr(value)
    return text if len(text) <= 60 else text[:56] + "...'"


_UNIT = re.compile(r"^([-+]?[0-9.]+)\s*[a-zA-Z°]+$")
_Reason = Callable[[Any, Mapping[str, Any]], str]


def _expected(what: str) -> _Reason:
    def reason(value: Any, _: Mapping[str, Any]) -> str:
        bare = _UNIT.match(value) if isinstance(value, str) else None
        hint = f"; write {bare[1]} without the unit" if bare and "number" in what else ""
        return f"must be {what}, not {shown(value)}{hint}"

    return reason


def _text(value: Any, _: Mapping[str, Any]) -> str:
    quoted = isinstance(value, int | float)
    return f"must be text, not {shown(value)}" + (f'; write it in quotes: "{shown(value)}"' if quoted else "")


def _bound(words: str, key: str) -> _Reason:
    return lambda value, error: f"{shown(value)} is not allowed; must be {words} {error['ctx'][key]:g}"


def _choice(value: Any, error: Mapping[str, Any]) -> str:
    allowed = re.findall(r"'([^']*)'", error["ctx"]["expected"])
    hint = suggestion(value, allowed) if isinstance(value, str) else ""
    return f"{shown(value)} is not allowed{hint}; one of {', '.join(allowed)}"


def _name(value: Any, error: Mapping[str, Any]) -> str:
    text = shown(error["input"] if not isinstance(value, str) else value)
    return f"{text} can't be a name; letters, digits, '_', '.' and '-', a letter or digit first, at most 63"


def _length(value: Any, error: Mapping[str, Any]) -> str:
    context = error["ctx"]
    bound = f"at least {context['min_length']}" if "min_length" in context else f"at most {context['max_length']}"
    count = len(value) if isinstance(value, list | dict) else 0
    return f"has {count} {'entry' if count == 1 else 'entries'}; needs {bound}"


def _said(_: Any, error: Mapping[str, Any]) -> str:
    """A model's own words."""
    return str(error["msg"])


def _otherwise(value: Any, error: Mapping[str, Any]) -> str:
    return f"{shown(value)} is not allowed: {error['msg']}"


_REASONS: dict[str, _Reason] = {
    "unfit": lambda _, error: str(error["msg"]),
    "int_type": _expected("a whole number"),
    "int_from_float": _expected("a whole number"),
    "int_parsing": _expected("a whole number"),
    "float_type": _expected("a number"),
    "float_parsing": _expected("a number"),
    "bool_type": _expected("true or false"),
    "tuple_type": _expected("a list"),
    "dict_type": _expected("a map (key: value)"),
    "model_type": _expected("a map (key: value)"),
    "path_type": _expected("a path"),
    "string_type": _text,
    "literal_error": _choice,
    "string_pattern_mismatch": _name,
    "greater_than": _bound("greater than", "gt"),
    "greater_than_equal": _bound("at least", "ge"),
    "less_than": _bound("less than", "lt"),
    "less_than_equal": _bound("at most", "le"),
    "too_short": _length,
    "too_long": _length,
    "said": _said,
}
