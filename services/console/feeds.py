"""From frames to pictures: what is watched is encoded once, and laid into the slots of those who can take it."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

from common import clock
from common.errors import FrameLostError
from common.messages import CameraState, FrameRef, Labels, Preview
from common.service.meters import Rate, Tally
from services.console.encode import Encoded, Encoder, Kind, Quads
from services.console.join import Join, Joined

_LABEL_FIELDS = {"objects", "left_out", "missing"}
MEASURE_EVERY_NS = 400_000_000


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture that is ready to be sent; ``tail`` is its header's part that is the same for everybody."""

    jpeg: bytes
    tail: bytes
    captured_ns: int


class View(Protocol):
    """One viewer's wish for one camera's pictures."""

    def wants(self, source_width: int) -> int | None:
        """The divisor of the size that it takes now, None while it can take none."""

    def offer(self, picture: Picture) -> None:
        """Take the newest picture; an older one that is not sent yet is overwritten."""


@dataclass(eq=False)
class Feed:
    """One (camera, kind) that somebody watches."""

    camera: str
    kind: Kind
    views: list[View] = field(default_factory=list)
    next: tuple[FrameRef, FrameRef, Labels | None] | None = None
    busy: bool = False


class Feeds:
    """All feeds. ``why`` says why a camera's frame has no label; ``listen`` is told whose frames are needed."""

    def __init__(
        self, loop: asyncio.AbstractEventLoop, why: Callable[[str], str], listen: Callable[[str, bool], None]
    ) -> None:
        self.skipped = Tally()
        self.encoded = Rate()
        self.sharpness: dict[str, float] = {}
        self._loop = loop
        self._why = why
        self._listen = listen
        self._encoder = Encoder()
        self._feeds: dict[tuple[str, Kind], Feed] = {}
        self._joins: dict[str, Join] = {}
        self._cameras: dict[str, CameraState] = {}
        self._timers: dict[str, asyncio.TimerHandle] = {}
        self._measured_ns: dict[str, int] = {}

    # --- who watches --------------------------------------------------------------------------------------

    def join(self, camera: str, kind: Kind, view: View) -> None:
        """A view begins."""
        if not self._watched(camera):
            self._joins[camera] = Join()
            self._listen(camera, True)
        self._feeds.setdefault((camera, kind), Feed(camera, kind)).views.append(view)

    def leave(self, camera: str, kind: Kind, view: View) -> None:
        """A view ends; the last one's camera is heard no more."""
        feed = self._feeds.get((camera, kind))
        if feed is None or view not in feed.views:
            return
        feed.views.remove(view)
        if feed.views:
            return
        del self._feeds[camera, kind]
        self._encoder.forget(camera, kind)
        if not self._watched(camera):
            self._joins.pop(camera, None)
            timer = self._timers.pop(camera, None)
            if timer is not None:
                timer.cancel()
            self._listen(camera, False)

    def previews_wanted(self) -> list[str]:
        """The cameras whose erased picture somebody watches."""
        return [camera for camera, kind in self._feeds if kind == "after"]

    @property
    def watched(self) -> list[tuple[str, Kind]]:
        """What is encoded at present."""
        return list(self._feeds)

    def _watched(self, camera: str) -> bool:
        return any(name == camera for name, _ in self._feeds)

    # --- news ---------------------------------------------------------------------------------------------

    def hear_camera(self, state: CameraState) -> None:
        """A camera said what it is."""
        self._cameras[state.camera.name] = state

    def hear_frame(self, ref: FrameRef) -> None:
        """A frame is in the ring."""
        join = self._joins.get(ref.camera)
        if join is not None:
            self._show(join.frame(ref, clock.monotonic_ns()))
            self._wait_for_label(ref.camera, join)

    def hear_labels(self, labels: Labels) -> None:
        """A frame's label came."""
        join = self._joins.get(labels.ref.camera)
        if join is not None:
            self._show(join.labels(labels, clock.monotonic_ns()))

    def hear_preview(self, preview: Preview) -> None:
        """An erased picture is in the preview ring."""
        join = self._joins.get(preview.of.camera)
        if join is not None:
            self._give(preview.of.camera, "after", preview.shown, preview.of, join.of(preview.of))

    def _wait_for_label(self, camera: str, join: Join) -> None:
        due_ns = join.next_due_ns()
        if due_ns is not None and camera not in self._timers:
            delay_s = max(0.0, (due_ns - clock.monotonic_ns()) / 1e9)
            self._timers[camera] = self._loop.call_later(delay_s, self._label_is_late, camera)

    def _label_is_late(self, camera: str) -> None:
        self._timers.pop(camera, None)
        join = self._joins.get(camera)
        if join is not None:
            self._show(join.due(clock.monotonic_ns()))
            self._wait_for_label(camera, join)

    # --- pictures -----------------------------------------------------------------------------------------

    def _show(self, joined: Joined | None) -> None:
        if joined is not None:
            self._give(joined.ref.camera, "rgb", joined.ref, joined.ref, joined.labels)
            self._give(joined.ref.camera, "depth", joined.ref, joined.ref, joined.labels)

    def _give(self, camera: str, kind: Kind, shown: FrameRef, of: FrameRef, labels: Labels | None) -> None:
        feed = self._feeds.get((camera, kind))
        if feed is None:
            return
        if feed.next is not None:
            self.skipped.add("superseded")
        feed.next = (shown, of, labels)
        self._begin(feed)

    def _begin(self, feed: Feed) -> None:
        """Encode the newest frame for those who can take one; one picture of a feed is under way at a time."""
        state = self._cameras.get(feed.camera)
        if feed.busy or feed.next is None or state is None:
            return
        (shown, of, labels), feed.next = feed.next, None
        wanting = [(view, divisor) for view in feed.views if (divisor := view.wants(state.camera.width)) is not None]
        if not wanting:
            self.skipped.add("nobody_ready")
            return
        feed.busy = True
        divisors = (divisor for _, divisor in wanting)
        quads = self._to_measure(feed, labels)
        job = self._encoder.encode(shown, feed.kind, divisors, state.depth_unit_mm, quads)
        done = asyncio.wrap_future(job, loop=self._loop)
        done.add_done_callback(lambda future: self._encoded(feed, future, wanting, of, labels))

    def _to_measure(self, feed: Feed, labels: Labels | None) -> Quads:
        """Now and then, how sharp the objects' markers are."""
        now = clock.monotonic_ns()
        if feed.kind != "rgb" or labels is None or now - self._measured_ns.get(feed.camera, 0) < MEASURE_EVERY_NS:
            return {}
        self._measured_ns[feed.camera] = now
        return {item.name: tuple(side.marker_corners for side in item.sides) for item in labels.objects}

    def _encoded(
        self,
        feed: Feed,
        done: asyncio.Future[Encoded],
        wanting: list[tuple[View, int]],
        of: FrameRef,
        labels: Labels | None,
    ) -> None:
        feed.busy = False
        if done.cancelled():
            return
        error = done.exception()
        if isinstance(error, FrameLostError):
            self.skipped.add("frame_lost")
        elif error is not None:
            raise error
        else:
            self._hand_out(feed, done.result(), wanting, of, labels)
        self._begin(feed)

    def _hand_out(
        self, feed: Feed, encoded: Encoded, wanting: list[tuple[View, int]], of: FrameRef, labels: Labels | None
    ) -> None:
        self.encoded.mark()
        self.sharpness |= {f"{feed.camera}/{name}": value for name, value in encoded.sharpness.items()}
        label = b"null" if labels is None else _label_json(labels)
        pictures = {
            divisor: Picture(jpeg, self._tail(feed, encoded, (width, height), of, label), of.captured_mono_ns)
            for divisor, (jpeg, width, height) in encoded.sizes.items()
        }
        for view, divisor in wanting:
            if view in feed.views:
                view.offer(pictures[divisor])

    def _tail(self, feed: Feed, encoded: Encoded, size: tuple[int, int], of: FrameRef, label: bytes) -> bytes:
        fields: dict[str, Any] = {
            "camera": feed.camera,
            "kind": feed.kind,
            "frame": of.frame,
            "boot": of.boot,
            "captured_ns": of.captured_mono_ns,
            "size": size,
            "source_size": encoded.source,
        }
        if encoded.range_mm is not None:
            fields["depth_range_mm"] = [round(value, 1) for value in encoded.range_mm]
        if label == b"null":
            fields["why"] = self._why(feed.camera)
        return json.dumps(fields, separators=(",", ":")).encode()[1:-1] + b',"label":' + label

    def close(self) -> None:
        """End the worker thread and the timers; idempotent."""
        for timer in self._timers.values():
            timer.cancel()
        self._timers.clear()
        self._encoder.close()


def _label_json(labels: Labels) -> bytes:
    return labels.model_dump_json(include=_LABEL_FIELDS, by_alias=True).encode()
