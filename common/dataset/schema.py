"""The JSON Schema of the label file, generated from the one model (:class:`common.labels.Label`)."""

from __future__ import annotations

import json
from typing import Any

from common.labels import LABEL_SCHEMA, Label, SampleFiles

SCHEMA_PAGE = "docs/reference/label.schema.json"
"""Where the schema is shipped, relative to the project."""


def label_schema() -> dict[str, Any]:
    """The schema (JSON Schema 2020-12) of a stored label, in which ``schema`` and ``files`` are always there."""
    schema = Label.model_json_schema(by_alias=True, mode="serialization")
    schema["$defs"].setdefault("SampleFiles", SampleFiles.model_json_schema())
    schema["properties"]["files"] = {"$ref": "#/$defs/SampleFiles"}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": f"urn:{LABEL_SCHEMA.replace('/', ':')}",
        **schema,
    }


def label_schema_text() -> str:
    """The schema as it stands in the file, with a line end."""
    return json.dumps(label_schema(), indent=2, ensure_ascii=False) + "\n"
