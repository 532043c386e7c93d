"""Expected errors: what a person or a peer can cause. A bug is any other exception."""

from __future__ import annotations

EXIT_OK = 0
EXIT_BUG = 1
EXIT_USAGE = 2
EXIT_REFUSED = 3
EXIT_NO_ANSWER = 4
EXIT_FOUND = 5
EXIT_NAME_TAKEN = 69
EXIT_BAD_CONFIG = 78
EXIT_INTERRUPTED = 130


class TagmillError(Exception):
    """Base of all expected errors.

    ``code`` is a stable machine-readable word (as on the command socket), ``message`` one sentence
    that says what, where and what to do.
    """

    code = "failed"
    exit_code = EXIT_REFUSED

    def __init__(self, message: str, *, code: str | None = None) -> None:
        super().__init__(message)
        self.message = message
        if code is not None:
            self.code = code


class ConfigError(TagmillError):
    """A configuration can't be used; ``problems`` holds one line for each mistake."""

    code = "bad_config"
    exit_code = EXIT_BAD_CONFIG

    def __init__(self, message: str, problems: tuple[str, ...] = ()) -> None:
        super().__init__(message)
        self.problems: tuple[str, ...] = problems or (message,)


class NameTakenError(TagmillError):
    """A socket, a ring or a service name is held by another live process."""

    code = "name_taken"
    exit_code = EXIT_NAME_TAKEN


class FrameLostError(TagmillError):
    """A frame was overwritten (or its ring went away) before its reader was through with it."""

    code = "frame_lost"


class NoSpaceError(TagmillError):
    """Shared memory or a disk has not enough room."""

    code = "no_space"


class CameraError(TagmillError):
    """A camera can't be opened or stopped delivering; the message says what to check."""

    code = "camera"


class CameraStuckError(CameraError):
    """A driver hangs in a call and can't be got out of it: the process must end, its supervisor starts it again."""

    code = "camera_stuck"
    exit_code = EXIT_BUG


class CodecError(TagmillError):
    """Bytes from the wire are no valid message of the expected type."""

    code = "bad_message"


class RefusedError(TagmillError):
    """A request was understood and refused; ``code`` and ``message`` go to whoever asked."""

    code = "refused"


class StateError(RefusedError):
    """A request doesn't fit the present state; the message says which state that is."""

    code = "wrong_state"


class PoseError(TagmillError):
    """No trustworthy pose follows from the given markers."""

    code = "no_pose"


class DatasetError(TagmillError):
    """A dataset's file can't be read or doesn't fit; the message names it."""

    code = "bad_dataset"


class NoAnswerError(TagmillError):
    """A peer didn't answer in time; the message says who, and how to see whether it runs."""

    code = "no_answer"
    exit_code = EXIT_NO_ANSWER
