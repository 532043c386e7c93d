"""What an error of the disk under a dataset means to the operator: a code and one sentence."""

from __future__ import annotations

import errno
from pathlib import Path

from common.messages import ErrorInfo

DISK_FULL = "disk_full"
READ_ONLY = "read_only"
NO_DATASET = "no_dataset"
DISK_ERROR = "disk_error"

_MEANING = {
    errno.ENOSPC: DISK_FULL,
    errno.EDQUOT: DISK_FULL,
    errno.EFBIG: DISK_FULL,
    errno.EROFS: READ_ONLY,
    errno.EACCES: READ_ONLY,
    errno.EPERM: READ_ONLY,
    errno.ENOENT: NO_DATASET,
    errno.ENOTDIR: NO_DATASET,
    errno.ESTALE: NO_DATASET,
}
SENTENCES = {
    DISK_FULL: "the disk of {folder} is full ({detail}); free some space there or move the dataset (dataset.root)",
    READ_ONLY: "{folder} can't be written ({detail}); remount the disk writable or correct the folder's permissions",
    NO_DATASET: "{folder} is not there any more ({detail}); bring the folder or its disk back, or open another session",
    DISK_ERROR: "writing to {folder} failed ({detail}); the disk may be broken, see the kernel's log",
}


def explain(error: OSError, folder: Path) -> ErrorInfo:
    """The refusal for an error of the operating system: a code and one sentence."""
    code = _MEANING.get(error.errno or 0, DISK_ERROR)
    return ErrorInfo(code=code, message=SENTENCES[code].format(folder=folder, detail=error.strerror or error))
