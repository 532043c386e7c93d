"""Who may touch a session. ``flock`` on its folders, so it ends with its holder and leaves no file behind.

The store holds the session's folder exclusively: two stacks with one dataset root don't mix their samples.
`tagmill dataset` holds it likewise where it moves samples without a stack.
Each writing worker holds the label folder shared, and recovery takes it exclusively: a worker of a killed store
that is still stuck in the disk can't finish a sample behind the back of the recovery that removes it.
"""

from __future__ import annotations

import errno
import fcntl
import os
from pathlib import Path
from typing import Self

from common.errors import RefusedError

SESSION_BUSY = "session_busy"
_WITHOUT_LOCKS = {errno.ENOTSUP, errno.ENOLCK, errno.ENOSYS, errno.EBADF, errno.EINVAL}
"""What file systems without flock on folders answer (some network ones); there only one store may run."""


class FolderLock:
    """A lock on a folder, taken at once or refused; raises RefusedError ``session_busy``, OSError if it is gone."""

    def __init__(self, folder: Path, *, shared: bool = False) -> None:
        self.folder = folder
        self._descriptor: int | None = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            fcntl.flock(self._descriptor, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
        except BlockingIOError:
            self.release()
            raise RefusedError(
                f"{folder} is being written by another tagmill; stop that stack or choose another session",
                code=SESSION_BUSY,
            ) from None
        except OSError as error:
            if error.errno not in _WITHOUT_LOCKS:
                self.release()
                raise

    def release(self) -> None:
        """Give the folder back; idempotent."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()
