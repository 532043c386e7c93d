"""The grab thread: opens the camera, reopens it, stamps its frames, writes the ring and announces.

Written once for all drivers. It waits for the camera and, for a paced file, for labels; never for a reader.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from structlog.typing import FilteringBoundLogger

from common import clock
from common.errors import CameraError, ConfigError, NoSpaceError
from common.messages import FrameRef
from services.capture.announcer import Announcer
from services.capture.cameras.base import (
    Camera,
    Description,
    EndOfStreamError,
    FrameSkippedError,
    Grabbed,
    Rewindable,
)
from services.capture.cues import Cues
from services.capture.device_clock import Stamper
from services.capture.repeats import Repeats
from services.capture.rings import Rings
from services.capture.watchdog import Watchdog

GRAB_S = 0.5
"""One call of a driver waits this long at most, so that a stop is heeded soon."""
PREVIEW_S = 0.5
LABEL_DEADLINE_S = 5.0
SILENT_S = 5.0
SILENT_PERIODS = 5
"""A camera that gave nothing for this long (the longer of the two) is taken for lost."""
BACK_OFF_S = (1.0, 2.0, 4.0, 8.0, 10.0)
JOIN_S = 5.0


class Grabber:
    """Runs one camera in a thread of its own. ``open_camera`` is called in it, again after each loss.

    ``failure`` is a ConfigError that no retry can mend; the main loop has to raise it. ``attempts``: losses before
    this life, from which the back-off goes on.
    """

    def __init__(
        self,
        open_camera: Callable[[], Camera],
        announcer: Announcer,
        rings: Rings,
        cues: Cues,
        boot: str,
        log: FilteringBoundLogger,
        label_deadline_s: float = LABEL_DEADLINE_S,
        back_off_s: tuple[float, ...] = BACK_OFF_S,
        attempts: int = 0,
    ) -> None:
        self.failure: ConfigError | None = None
        self._open_camera = open_camera
        self._announcer = announcer
        self.watchdog = Watchdog(announcer, log)
        self._rings = rings
        self._cues = cues
        self._boot = boot
        self._log = log
        self._label_deadline_s = label_deadline_s
        self._back_off_s = back_off_s
        self._description: Description | None = None
        self._attempts = attempts
        self._position: int | None = None
        self._last_frame_ns = 0
        self._arrived_ns = 0
        self._serial: str | None = None
        self._repeats = Repeats()
        self._stamper = Stamper()
        self._thread = threading.Thread(target=self._run, name="grabber", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread and remove the rings; a driver that hangs is left behind after ``JOIN_S``."""
        self._cues.stop()
        if self._thread.ident is not None:
            self._thread.join(JOIN_S)
        if self._thread.is_alive():
            self._log.error("camera.stuck", waited_s=JOIN_S)
        self._rings.close()

    def _run(self) -> None:
        while not self._cues.stopping():
            try:
                with self.watchdog.of("open"):
                    camera = self._open_camera()
                try:
                    self._serve(camera)
                finally:
                    with self.watchdog.of("close"):
                        camera.close()
            except ConfigError as error:
                self.failure = error
                return
            except (CameraError, NoSpaceError) as error:
                self._lost(error)

    def _lost(self, error: CameraError | NoSpaceError) -> None:
        pause_s = self._back_off_s[min(self._attempts, len(self._back_off_s) - 1)]
        self._attempts += 1
        self._announcer.lose("reconnect")
        self._announcer.enter("lost", error.message)
        self._log.warning("camera.lost", reason=error.message, attempt=self._attempts, retry_in_s=pause_s)
        self._cues.wait_stop(pause_s)

    def _serve(self, camera: Camera) -> None:
        """Everything with one opened camera; returns when the thread must end."""
        description = camera.describe()
        self._check_serial(description)
        self._adopt(description)
        self._repeats, self._stamper = Repeats(), Stamper()
        self._log.info("camera.opened", width=description.camera.width, height=description.camera.height)
        if description.waits_for_start:
            if not isinstance(camera, Rewindable):
                raise ConfigError("a camera that waits for a start must be able to rewind: its driver has a mistake")
            self._perform(camera, camera)
            return
        self._announcer.enter("streaming")
        if self._stream(camera):
            self._announcer.enter("ended")
            self._log.info("camera.ended", captured=self._announcer.captured)
            while not self._cues.wait_stop(SILENT_S):
                pass

    def _perform(self, camera: Camera, tape: Rewindable) -> None:
        """A file camera: preview, play for a recording, and again. A pass that a loss interrupted goes on."""
        at_end = False
        while not self._cues.stopping():
            if self._position is None and not self._next_pass(camera, tape, preview=not at_end):
                return
            assert self._position is not None
            tape.rewind(self._position)
            self._announcer.enter("streaming")
            at_end = self._stream(camera)
            self._position = None
            if at_end:
                self._announcer.enter("ended")
                self._log.info("camera.ended", captured=self._announcer.captured)

    def _next_pass(self, camera: Camera, tape: Rewindable, *, preview: bool) -> bool:
        """Wait for the recording to play for, meanwhile show the first frame; False if the thread must end."""
        shown = self._first_frame(camera, tape) if preview else None
        if preview:
            self._announcer.enter("waiting")
        while not self._cues.stopping():
            if shown is not None:
                self._put(shown, preview=True)
            recording = self._cues.wait_play(PREVIEW_S)
            if recording is not None:
                self._announcer.play(recording)
                self._log.info("camera.plays", recording=recording)
                self._position = 0
                return True
        return False

    def _first_frame(self, camera: Camera, tape: Rewindable) -> Grabbed | None:
        tape.rewind()
        self._last_frame_ns = clock.monotonic_ns()
        while not self._cues.stopping():
            try:
                first = self._grab(camera)
            except TimeoutError:
                self._check_silence("timeout", "gave no picture")
                continue
            except FrameSkippedError:
                continue  # counted when it is played
            except EndOfStreamError:
                return None
            self._adopt(camera.describe())
            return first
        return None

    def _stream(self, camera: Camera) -> bool:
        """Grab until the end of the stream (True), or until that must be broken off (False)."""
        self._last_frame_ns = clock.monotonic_ns()
        self._repeats = Repeats()
        while not self._cues.cut():
            try:
                grabbed = self._grab(camera)
            except EndOfStreamError:
                return True
            except TimeoutError:
                self._check_silence("timeout", "gave no picture")
                continue
            except FrameSkippedError as error:
                self._announcer.lose(error.reason, error.message)
                self._log.warning("frame.skipped", reason=error.reason, why=error.message)
                self._advance()
                continue
            if self._repeats.repeated(grabbed):
                self._check_silence("frozen", "gave the same picture again and again")
                continue
            self._check_still(grabbed)
            self._take(camera, grabbed)
        return False

    def _grab(self, camera: Camera) -> Grabbed:
        with self.watchdog.of("grab"):
            grabbed = camera.grab(GRAB_S)
        self._arrived_ns = clock.monotonic_ns()
        return grabbed

    def _take(self, camera: Camera, grabbed: Grabbed) -> None:
        self._last_frame_ns = self._arrived_ns
        self._attempts = 0
        self._adopt(camera.describe())
        if grabbed.missed:
            self._announcer.lose("missed", count=grabbed.missed)
        assert self._description is not None
        taken_ns = self._stamper.stamp(self._description.stamps, grabbed.device_ns, self._arrived_ns)
        if self._announcer.phase == "stalled":
            self._announcer.enter("streaming")
        frame = self._put(grabbed, captured_ns=taken_ns)
        self._advance()
        if self._description.paced and not self._cues.wait_label(frame, self._label_deadline_s):
            self._announcer.lose("label_late")
            self._log.warning("frame.label_late", frame=frame, deadline_s=self._label_deadline_s)

    def _put(self, grabbed: Grabbed, *, preview: bool = False, captured_ns: int | None = None) -> int:
        """Stamp a frame, write it, announce it; returns its number."""
        mono = clock.monotonic_ns() if captured_ns is None else captured_ns
        wall = clock.wall_ns() - (clock.monotonic_ns() - mono)
        assert self._description is not None
        if self._description.depth_unit_mm is not None and grabbed.depth is None and not preview:
            self._announcer.lose("depth_missing")
        number = self._rings.write(grabbed)
        ref = FrameRef(
            camera=self._description.camera.name,
            boot=self._boot,
            ring=self._rings.name,
            frame=number,
            count=0 if preview else self._announcer.captured + 1,
            captured_mono_ns=mono,
            captured_wall_ns=wall,
            device_ns=grabbed.device_ns,
            source_name=grabbed.source_name,
            preview=preview,
        )
        self._announcer.frame(ref, grabbed.truth)
        return number

    def _adopt(self, description: Description) -> None:
        """Take over what the camera says of itself: a ring that fits, and the news of it before the frame."""
        if description is self._description:
            return
        camera = description.camera
        new_ring = self._rings.fit(camera.width, camera.height, description.depth_unit_mm is not None)
        if new_ring:
            self._log.info("ring.made", ring=self._rings.name, width=camera.width, height=camera.height)
        if new_ring or description != self._description:
            self._announcer.describe(description, self._rings.name)
        self._description = description

    def _check_serial(self, description: Description) -> None:
        """A camera that was lost is taken up again by its serial number: another one is not this camera."""
        serial, known = description.camera.serial, self._serial
        if None not in (serial, known) and serial != known:
            raise CameraError(
                f"the camera with serial {known} is gone and {serial} is there instead; plug the first one in again, "
                "or restart this camera's capture process to go on with the other (give it `serial:` in the rig file)"
            )
        self._serial = serial or known

    def _advance(self) -> None:
        if self._position is not None:
            self._position += 1

    def _check_still(self, grabbed: Grabbed) -> None:
        """CameraError if a live camera that has no clock has given one picture, bit by bit, for too long."""
        assert self._description is not None
        if self._description.stamps == "media":
            return
        still_s = self._repeats.still_ns(grabbed, self._arrived_ns) / 1e9
        if still_s > max(SILENT_S, SILENT_PERIODS / self._description.fps):
            self._announcer.lose("frozen")
            raise CameraError(
                f"the camera gave one and the same picture for {still_s:.0f} s, without even its noise; it is reopened"
            )

    def _check_silence(self, reason: str, what: str) -> None:
        """Count a grab without a frame; CameraError if that has gone on for too long."""
        assert self._description is not None
        silent_s = (clock.monotonic_ns() - self._last_frame_ns) / 1e9
        period_s = 1 / self._description.fps
        if silent_s > 2 * period_s or reason == "frozen":
            self._announcer.lose(reason)
        if silent_s > max(SILENT_S, SILENT_PERIODS * period_s):
            raise CameraError(f"the camera {what} for {silent_s:.0f} s; check its cable and power; it is reopened")
