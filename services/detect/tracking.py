"""Follow known markers from frame to frame instead of searching each picture.

Pure state machine around a detector: a full search, then looks at where the known markers must be, predicted with
constant velocity, and if one isn't there, at where it was. If it isn't there either, the same frame is searched whole;
one that enters the picture is found by the next full search, at most ``SEARCH_EVERY`` frames later.

Of a live camera that search can come after the frame's markers are told (``later``, then ``look_around``), and a
frame sooner: it takes several times as long as following, and the frame need not wait for what enters only now. It
comes in pieces, between which another camera's frame can have its turn.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from common.messages import DetectedMarker
from services.detect.markers.base import Grey, MarkerDetector, Search
from services.detect.markers.quads import as_quad, merged

Array = NDArray[np.float64]

SEARCH_EVERY = 5
"""Of so many frames at least one is searched whole."""
SAME_MARKER_SIDES = 1.5
"""How far, in sides, a marker may move between frames and still give its velocity to the next prediction."""


@runtime_checkable
class Follower(Protocol):
    """A detector that can look for expected markers without a search."""

    def follow(self, grey: Grey, expected: Sequence[DetectedMarker]) -> list[DetectedMarker | None]:
        """Each expected marker where it is now, or None where it isn't close to where it was expected."""
        ...


@runtime_checkable
class Searcher(Protocol):
    """A detector whose search can be cut into pieces."""

    def search(self, grey: Grey) -> Search:
        """``detect``, a piece at a time; the picture must stay as it is until the last."""
        ...


@dataclass(frozen=True)
class _Track:
    """A known marker; ``velocity`` (4, 2) px a frame of its corners."""

    seen: DetectedMarker
    velocity: Array

    def expected(self) -> DetectedMarker:
        corners = np.array(self.seen.corners) + self.velocity
        return DetectedMarker(id=self.seen.id, corners=as_quad(corners), kind=self.seen.kind)


class Tracker:
    """The markers of one camera's frames, in their order. ``searches`` counts full searches.

    With a detector that can't follow, each frame is searched whole.
    """

    def __init__(self, detector: MarkerDetector) -> None:
        self._detector = detector
        self._follower = detector if isinstance(detector, Follower) else None
        self._searcher = detector if isinstance(detector, Searcher) else None
        self.searches = 0
        self.reset()

    def reset(self) -> None:
        """Forget everything: the next frame is searched whole."""
        self._tracks: list[_Track] = []
        self._since_search = SEARCH_EVERY
        self._later = False
        self._shape: tuple[int, ...] = ()

    @property
    def owes_search(self) -> bool:
        """Whether the last frame was to be searched, but that was left to ``look_around``."""
        return self._later and bool(self._tracks) and self._since_search >= SEARCH_EVERY - 1

    def detect(self, grey: Grey, *, later: bool = False) -> list[DetectedMarker]:
        """The markers in the next frame (H, W) uint8; a changed size begins anew.

        With ``later`` the frame before the one whose turn it is to be searched is followed, if that succeeds, and
        ``look_around`` is to be called with it; where it wasn't, the next frame is searched at once.
        """
        if grey.shape != self._shape:
            self.reset()
            self._shape = grey.shape
        self._later = later
        found = self._followed(grey)
        if found is None:
            found = self._search(grey)
        self._tracks = [_Track(one, self._velocity(one)) for one in found]
        return found

    def look_around(self, grey: Grey) -> Iterator[None]:
        """Search the frame that ``detect`` has just followed, for the sake of the next ones; each item is a piece.

        The picture must stay as it is until the last, and ``detect`` not be called before: who wants the next frame
        sooner drops what is left of the search.
        """
        found = (yield from self._searcher.search(grey)) if self._searcher else self._detector.detect(grey)
        self._searched()
        seen = [(one, self._track_of(one)) for one in found]
        self._tracks = [_Track(one, np.zeros((4, 2)) if track is None else track.velocity) for one, track in seen]

    def _search(self, grey: Grey) -> list[DetectedMarker]:
        found = self._detector.detect(grey)
        self._searched()
        return found

    def _searched(self) -> None:
        self.searches += 1
        self._since_search = 0

    def _followed(self, grey: Grey) -> list[DetectedMarker] | None:
        """The known markers in this frame; None where it has to be searched."""
        self._since_search += 1
        if self._follower is None or not self._tracks or self._since_search >= SEARCH_EVERY:
            return None
        found = self._follower.follow(grey, [track.expected() for track in self._tracks])
        missed = [k for k, one in enumerate(found) if one is None]
        if missed:
            # What turned round is as far from where it was as it moved, and twice as far from the prediction.
            again = self._follower.follow(grey, [self._tracks[k].seen for k in missed])
            for k, one in zip(missed, again, strict=True):
                found[k] = one
        there = [one for one in found if one is not None]
        # Two of equal id must not end on one marker.
        apart = merged([(one.id, np.array(one.corners)) for one in there])
        return there if len(apart) == len(found) else None

    def _velocity(self, marker: DetectedMarker) -> Array:
        """How the marker's corners moved since the last frame; 0 for one that wasn't known."""
        track = self._track_of(marker)
        return np.zeros((4, 2)) if track is None else np.array(marker.corners) - np.array(track.seen.corners)

    def _track_of(self, marker: DetectedMarker) -> _Track | None:
        """The known marker that this one is: of those with its id the nearest, if it is near enough."""
        same = [track for track in self._tracks if track.seen.id == marker.id]
        nearest = min(same, key=lambda track: _apart(track.seen, marker), default=None)
        if nearest is None or _apart(nearest.seen, marker) >= SAME_MARKER_SIDES * _side(marker):
            return None
        return nearest


def _side(marker: DetectedMarker) -> float:
    """Mean side (px)."""
    corners = np.array(marker.corners)
    return float(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).mean())


def _apart(first: DetectedMarker, second: DetectedMarker) -> float:
    """By how much (px) two markers' corners differ at most."""
    return float(np.abs(np.array(first.corners) - np.array(second.corners)).max())
