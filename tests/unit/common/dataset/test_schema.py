import json
import types
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import jsonschema
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydantic import BaseModel

from common.dataset import SCHEMA_PAGE, label_schema, label_schema_text
from common.labels import Label, SampleFiles, StoredFile
from common.messages import decode, encode
from common.messages.base import unpack
from tests.support.samples import label_for

ROOT = Path(__file__).resolve().parents[4]
FILES = SampleFiles(
    rgb=StoredFile(path="rgb/rgb_x.png", size=3, sha256="0" * 64),
    depth=StoredFile(path="depth/depth_x.png", size=3, sha256="1" * 64),
)


def values_of(kind: Any) -> st.SearchStrategy[Any]:
    """Any value of a type as the label's models use them."""
    origin, arguments = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return values_of(arguments[0])
    if origin is Literal:
        return st.sampled_from(arguments)
    if origin in (Union, types.UnionType):
        return st.one_of([values_of(argument) for argument in arguments])
    if origin is tuple and arguments[-1] is Ellipsis:
        return st.lists(values_of(arguments[0]), max_size=2).map(tuple)
    if origin is tuple:
        return st.tuples(*map(values_of, arguments))
    if origin is dict:
        return st.dictionaries(values_of(arguments[0]), values_of(arguments[1]), max_size=2)
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return st.builds(kind, **{name: values_of(field.annotation) for name, field in kind.model_fields.items()})
    simple: dict[Any, st.SearchStrategy[Any]] = {
        float: st.floats(allow_nan=False, allow_infinity=False),
        int: st.integers(-(2**63), 2**63 - 1),
        str: st.text(st.characters(exclude_categories=["Cs"]), max_size=8),
        bool: st.booleans(),
        type(None): st.none(),
    }
    return simple[kind]


def test_the_shipped_schema_is_up_to_date() -> None:
    assert (ROOT / SCHEMA_PAGE).read_text() == label_schema_text(), "run `make docs`"


def test_the_schema_is_one_and_a_stored_label_fits() -> None:
    jsonschema.Draft202012Validator.check_schema(label_schema())
    label = label_for(1).model_copy(update={"files": FILES})
    jsonschema.validate(json.loads(label.model_dump_json(by_alias=True)), label_schema())


@pytest.mark.parametrize("change", [{"files": None}, {"schema": "tagmill.label/2"}, {"frame": "1"}, {"unknown": 1}])
def test_the_schema_refuses_what_the_store_never_writes(change: dict[str, Any]) -> None:
    plain = json.loads(label_for(1).model_copy(update={"files": FILES}).model_dump_json(by_alias=True))
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({**plain, **change}, label_schema())


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
@given(values_of(Label))
def test_any_label_survives_file_and_wire(label: Label) -> None:
    text = label.model_dump_json(by_alias=True, indent=1)
    assert Label.model_validate_json(text) == label
    assert decode(Label, encode(label)) == label
    assert unpack(encode(label))["schema"] == "tagmill.label/1"
