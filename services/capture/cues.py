"""What the main loop tells the grab thread: play, break off, this frame is labelled, stop."""

from __future__ import annotations

import threading

from common.messages import FrameRef, RecordingState

_PLAYED_MODES = frozenset({"all", "auto"})
_OVER = frozenset({"finishing", "ended"})


class Cues:
    """Thread-safe. The main loop calls ``on_...`` and ``stop``; the grab thread asks and waits with a deadline."""

    def __init__(self, boot: str) -> None:
        self._boot = boot
        self._changed = threading.Condition()
        self._stopping = False
        self._wanted: str | None = None
        self._playing: str | None = None
        self._cut = False
        self._played: set[str] = set()
        self._labelled = 0

    def stop(self) -> None:
        """End the grab thread."""
        with self._changed:
            self._stopping = True
            self._changed.notify_all()

    def on_recording(self, state: RecordingState) -> None:
        """A recording's state: one that begins is a cue to play, one that is over to stop playing.

        States repeat, so a recording that begins while another is played gets its turn after that.
        """
        recording, phase = state.ledger.spec.recording, state.ledger.phase
        if state.ledger.spec.mode not in _PLAYED_MODES:
            return
        with self._changed:
            if phase == "running" and recording not in self._played:
                self._wanted = recording
            elif phase in _OVER and recording == self._wanted:
                self._wanted = None
            elif phase in _OVER and recording == self._playing:
                self._cut = True
            self._changed.notify_all()

    def on_labelled(self, ref: FrameRef) -> None:
        """A frame's label is there."""
        if ref.boot == self._boot:
            with self._changed:
                self._labelled = max(self._labelled, ref.frame)
                self._changed.notify_all()

    def stopping(self) -> bool:
        """Whether the grab thread must end."""
        return self._stopping

    def cut(self) -> bool:
        """Whether what is played must be broken off: its recording is over, or all is."""
        return self._cut or self._stopping

    def wait_stop(self, timeout_s: float) -> bool:
        """Wait until ``stop``; False after ``timeout_s``."""
        with self._changed:
            return self._changed.wait_for(lambda: self._stopping, timeout_s)

    def wait_play(self, timeout_s: float) -> str | None:
        """The recording to play for, from now on the one that is played; None after ``timeout_s`` or ``stop``."""
        with self._changed:
            self._playing = None
            self._changed.wait_for(lambda: self._wanted is not None or self._stopping, timeout_s)
            if self._wanted is None or self._stopping:
                return None
            self._playing, self._wanted = self._wanted, None
            self._played.add(self._playing)
            self._cut = False
            return self._playing

    def wait_label(self, frame: int, timeout_s: float) -> bool:
        """Wait for the label of ``frame`` (or a later one), or until there is no need to; False after ``timeout_s``."""
        with self._changed:
            return self._changed.wait_for(lambda: self._labelled >= frame or self.cut(), timeout_s)
