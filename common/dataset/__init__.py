"""The dataset on disk: names, ``session.json``, durable writing, reading. One package for store and tools."""

from common.dataset.durable import append_bytes, is_temporary, make_folder, sync_folder, write_bytes, write_json
from common.dataset.layout import (
    FOLDERS,
    LABELS,
    PICTURES,
    RECORDS_FILE,
    SESSION_FILE,
    PictureKind,
    label_path,
    picture_path,
)
from common.dataset.reader import SessionReader
from common.dataset.schema import SCHEMA_PAGE, label_schema, label_schema_text
from common.dataset.session import SESSION_SCHEMA, SessionCamera, SessionFile, StackLife, read_session

__all__ = [
    "FOLDERS",
    "LABELS",
    "PICTURES",
    "RECORDS_FILE",
    "SCHEMA_PAGE",
    "SESSION_FILE",
    "SESSION_SCHEMA",
    "PictureKind",
    "SessionCamera",
    "SessionFile",
    "SessionReader",
    "StackLife",
    "append_bytes",
    "is_temporary",
    "label_path",
    "label_schema",
    "label_schema_text",
    "make_folder",
    "picture_path",
    "read_session",
    "sync_folder",
    "write_bytes",
    "write_json",
]
