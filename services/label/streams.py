"""Labels the frames of cameras as streams: what earlier and later frames say of one, and when it pays to wait."""

from __future__ import annotations

from collections.abc import Sequence

from structlog.typing import FilteringBoundLogger

from common import clock
from common.errors import FrameLostError
from common.labels import ObjectLabel
from common.messages import Detections, FrameRef
from common.quality import sharpness_of
from services.label.cameras import Camera
from services.label.contradictions import Contradictions
from services.label.finish import Finisher
from services.label.held import LONGEST_NS, Wait, worth_waiting
from services.label.labelling import ALONE, Around, Labelled, Labeller
from services.label.requests import Request
from services.label.roster import Roster
from services.label.samples import Samples, Taker

_FINISH_NS = 700_000_000
"""Before its deadline a request stops waiting for further frames: what it has must still be finished and stored."""
_NEVER = 1 << 62


class Streams:
    """The cameras' frames, one after the other."""

    def __init__(self, labeller: Labeller, roster: Roster, log: FilteringBoundLogger) -> None:
        self._labeller = labeller
        self._roster = roster
        self._contradictions = Contradictions(log)

    def replace(self, labeller: Labeller) -> None:
        """Go on with another rig."""
        self._labeller = labeller
        self._contradictions.forget()

    def label(self, camera: Camera, detections: Detections) -> Labelled:
        """Label the next frame, and remember what it shows."""
        moment = camera.moment(detections.ref)
        if moment is None:
            labelled = self._labeller.label_once(detections.markers, camera.model)
        else:
            camera.labelled_ns = moment
            labelled = self._labeller.label(detections.markers, camera.model, camera.name, moment)
        self._contradictions.hear(camera.name, labelled)
        return labelled

    def label_past(self, camera: Camera, detections: Detections) -> Labelled:
        """Label a frame once more that has passed already."""
        return self._labeller.label_once(detections.markers, camera.model, around=self.around(camera, detections))

    def around(self, camera: Camera, detections: Detections) -> Around:
        """What is known by now around a frame."""
        moment = camera.moment(detections.ref)
        return ALONE if moment is None else self._labeller.around(camera.name, moment)

    def wait(
        self, camera: Camera, detections: Detections, around: Around, labelled: Labelled, takers: Sequence[Taker]
    ) -> Wait | None:
        """What a frame waits for whose objects were seen just before, but not in it: that they are seen again."""
        moment, now = camera.moment(detections.ref), clock.monotonic_ns()
        missing = frozenset(item.object for item in labelled.missing)
        objects = worth_waiting(around, missing, camera.labelled_ns)
        deadlines = [taker.deadline_ns - _FINISH_NS for taker in takers if isinstance(taker, Request)]
        until = min([now + LONGEST_NS, *deadlines])
        if moment is None or not objects or takers[0].background or until <= now:
            return None
        return Wait(camera.name, moment, objects, until)

    @staticmethod
    def sharpness(camera: Camera, ref: FrameRef, objects: Sequence[ObjectLabel]) -> dict[str, float]:
        """How sharp each object's markers are in a frame (0..100); none for a frame that is gone."""
        found: dict[str, float] = {}
        try:
            with camera.pixels(ref) as view:
                for item in objects:
                    value = sharpness_of(view.bgr, (side.marker_corners for side in item.sides))
                    if value is not None:
                        found[item.name] = value
        except FrameLostError:
            return {}
        return found

    def go_on(self, samples: Samples, finisher: Finisher, *, all_: bool = False) -> None:
        """Finish samples that have waited long enough (or ``all_``); after a camera's end no further frame comes."""

        def newest(name: str) -> int:
            camera = self._roster.get(name)
            return _NEVER if camera is None or camera.state.phase == "ended" else camera.labelled_ns

        samples.go_on(self._labeller.around, newest, finisher, all_=all_)
