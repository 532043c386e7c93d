"""Inpainted previews: made only while somebody holds a lease, shown in a ring of their own.

A viewer renews its lease; when none is renewed for 5 s nothing is erased any more.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from common import clock
from common.errors import FrameLostError, NoSpaceError
from common.frames import FrameWriter, SampleRing, segment_name
from common.log import get
from common.messages import Detections, FrameRef, Preview
from services.label.cameras import Camera
from services.label.exact import Finished
from services.label.finish import Finisher, Job
from services.label.labelling import Around

LEASE_NS = 5_000_000_000
_SLOTS = 3
_JOB = "show:"
"""What a job's key begins with, to tell it from a sample's name."""


@dataclass(eq=False)
class _Show:
    """One camera's preview: a slot to erase in, the ring in which viewers find the result."""

    work: SampleRing
    shown: FrameWriter
    busy: FrameRef | None = None
    slot: int | None = None


class Previews:
    """The leases, and the previews under way (at most one a camera: a slow worker means fewer pictures)."""

    def __init__(self, prefix: str, owner: str, boot: str, publish: Callable[[Preview], None]) -> None:
        self._prefix, self._owner, self._boot = prefix, owner, boot
        self._publish = publish
        self._until: dict[str, int] = {}
        self._shows: dict[str, _Show] = {}
        self._made = 0

    def lease(self, camera: str) -> None:
        """Somebody watches: previews for 5 s from now."""
        self._until[camera] = clock.monotonic_ns() + LEASE_NS

    def watched(self, camera: str) -> bool:
        """Whether a lease runs; ends what is no longer watched."""
        if self._until.get(camera, 0) > clock.monotonic_ns():
            return True
        show = self._shows.get(camera)
        if show is not None and show.busy is None:
            self._drop(camera)
        return False

    def tidy(self) -> None:
        """End what nobody watches any more, also where no further frame comes."""
        for camera in list(self._shows):
            self.watched(camera)

    def begin(self, camera: Camera, detections: Detections, around: Around, finisher: Finisher) -> None:
        """Start on a preview of this frame, unless the one before is still being made."""
        ref = detections.ref
        known = self._shows.get(camera.name)
        if known is not None and known.busy is not None:
            return
        try:
            with camera.pixels(ref) as view:
                height, width = view.bgr.shape[:2]
                show = self._show(camera.name, width, height)
                if show is None or show.busy is not None:
                    return
                slot = show.work.acquire()
                if slot is None:
                    return
                show.busy, show.slot = ref, slot
                np.copyto(show.work.view(slot).bgr, view.bgr)
        except FrameLostError:
            self._free(camera.name)
            return
        except NoSpaceError as error:
            self._no_space(camera.name, error)
            return
        finisher.submit(Job(_JOB + camera.name, show.work.name, slot, camera.state.camera, detections.markers, around))

    def finished(self, job: Job, result: Finished | None) -> bool:
        """Show a finished preview; False if the job was none."""
        if not job.key.startswith(_JOB):
            return False
        camera = job.key.removeprefix(_JOB)
        show = self._shows.get(camera)
        if show is not None and show.busy is not None and show.slot is not None:
            if result is not None:
                number = show.shown.write(show.work.view(show.slot).bgr, None)
                shown = show.busy.model_copy(
                    update={"ring": show.shown.name, "frame": number, "boot": self._boot, "preview": True}
                )
                self._publish(Preview(shown=shown, of=show.busy))
            self._free(camera)
        return True

    def _show(self, camera: str, width: int, height: int) -> _Show | None:
        show = self._shows.get(camera)
        if (
            show is not None
            and (show.work.layout.width, show.work.layout.height) != (width, height)
            and show.busy is None
        ):
            self._drop(camera)
            show = None
        if show is None:
            self._made += 1
            owner = f"{self._owner}.{camera}.preview{self._made}"
            try:
                work = SampleRing(
                    segment_name(self._prefix, f"{owner}w", self._boot), width, height, False, 1, with_original=False
                )
                shown = FrameWriter(segment_name(self._prefix, owner, self._boot), width, height, False, _SLOTS)
            except NoSpaceError as error:
                self._no_space(camera, error)
                return None
            show = self._shows[camera] = _Show(work, shown)
        return show

    def _no_space(self, camera: str, error: NoSpaceError) -> None:
        get().warning("preview.no_space", camera=camera, reason=error.message)
        self._until.pop(camera, None)

    def _free(self, camera: str) -> None:
        show = self._shows.get(camera)
        if show is not None and show.slot is not None:
            show.work.release(show.slot)
            show.busy = show.slot = None

    def _drop(self, camera: str) -> None:
        show = self._shows.pop(camera)
        show.work.close()
        show.shown.close()

    def close(self) -> None:
        """Remove the rings."""
        for camera in list(self._shows):
            self._drop(camera)
