"""Names a marker that contradicts its object's others in the log: once, not per frame."""

from __future__ import annotations

from structlog.typing import FilteringBoundLogger

from services.label.labelling import Labelled


class Contradictions:
    """The markers that were named already, by camera. One that fits again may be named again."""

    def __init__(self, log: FilteringBoundLogger) -> None:
        self._log = log
        self._named: set[tuple[str, int]] = set()

    def hear(self, camera: str, labelled: Labelled) -> None:
        """A labelled frame: log what is new."""
        for entry in labelled.left_out:
            if entry.reason == "contradicts" and (camera, entry.marker) not in self._named:
                self._named.add((camera, entry.marker))
                self._log.warning(
                    "marker.contradicts",
                    camera=camera,
                    object=entry.object,
                    marker=entry.marker,
                    residual_px=None if entry.residual_px is None else round(entry.residual_px, 1),
                    hint="check its place, size and id in the rig file",
                )

    def forget(self) -> None:
        """The rig was changed: name what contradicts now."""
        self._named.clear()
