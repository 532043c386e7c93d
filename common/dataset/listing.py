"""The samples of a session, to be listed and filtered: an index in memory, read from the label files.

Nothing of it is on the disk, so nothing of it can be stale or damaged there. It is read with plain JSON and not with
the label's model: 10,000 labels take a second or two, not ten. A label that can't be read is listed by its name.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from sys import intern
from typing import Any

from common.bounded import parse_json
from common.dataset.bin import bin_of, labelled
from common.dataset.layout import BIN, PICTURES, PictureKind, label_path
from common.dataset.packed import pack, peek, unpack
from common.geometry import view_direction
from common.ids import sample_camera, sample_captured_at, sample_frame
from common.labels import Label
from common.messages import SampleFilter, SampleItem, SampleList, SampleObject

_MOST_BYTES = 700_000
"""Of an answer; orders may have 1 MiB."""

_FAULTS = (ArithmeticError, ValueError, KeyError, TypeError, IndexError, AttributeError)
"""What a label without sense in it may raise."""


class SampleIndex:
    """The samples of one session and its bin. Not for two threads at a time, but for ``add``."""

    def __init__(self, session: Path) -> None:
        self._session = session
        self._stored: dict[str, bytes] = {}
        self._binned: dict[str, bytes] = {}
        self._order: dict[bool, list[str]] = {}
        self._added: deque[tuple[str, bytes]] = deque()

    def add(self, item: SampleItem) -> None:
        """A sample that has just been stored, by whoever knows its label. From any thread."""
        self._added.append((item.name, _packed(item)))

    def build(self, stop: Callable[[], bool] = lambda: False) -> None:
        """Read all labels; ``stop`` is asked in between and ends it early. Raises OSError."""
        for sample in sorted(labelled(self._session) | labelled(bin_of(self._session))):
            if stop():
                return
            self.refresh(sample)

    def refresh(self, sample: str) -> None:
        """Look where a sample is now, and what its label says; raises OSError."""
        self._take_added()
        self._order.clear()
        self._stored.pop(sample, None)
        self._binned.pop(sample, None)
        for folder, items in ((self._session, self._stored), (bin_of(self._session), self._binned)):
            try:
                text = (folder / label_path(sample)).read_bytes()
            except FileNotFoundError:
                continue
            items[sample] = _packed(item_of(sample, text, "" if folder == self._session else f"{BIN}/"))
            return

    def page(self, wanted: SampleFilter, offset: int, limit: int) -> SampleList:
        """The samples that match, the newest first, from ``offset`` on; fewer than ``limit`` if they are too large."""
        self._take_added()
        items = self._binned if wanted.bin else self._stored
        matching = self._newest_first(wanted.bin)
        if wanted != SampleFilter(bin=wanted.bin):
            matching = [name for name in matching if fits(peek(name, items[name]), wanted)]
        page: list[SampleItem] = []
        size = 0
        for name in matching[offset : offset + limit]:
            item = unpack(name, items[name])
            size += _size_of(item, items[name])
            if page and size > _MOST_BYTES:
                break
            page.append(item)
        end = offset + len(page)
        return SampleList(
            session=self._session.name,
            samples=tuple(page),
            total=len(matching),
            stored=len(self._stored),
            in_bin=len(self._binned),
            next_offset=end if page and end < len(matching) else None,
        )

    def _take_added(self) -> None:
        while self._added:
            name, packed = self._added.popleft()
            self._stored[name] = packed
            self._order.clear()

    def _newest_first(self, binned: bool) -> list[str]:
        if binned not in self._order:
            self._order[binned] = sorted(self._binned if binned else self._stored, reverse=True)
        return self._order[binned]


def fits(item: SampleItem, wanted: SampleFilter) -> bool:
    """Whether a sample is one of those that are wanted (``bin`` apart)."""
    if not (
        wanted.camera in (None, item.camera)
        and wanted.recording in (None, item.recording)
        and wanted.complete in (None, item.complete)
        and wanted.background in (None, item.background)
    ):
        return False
    return not _asks_of_objects(wanted) or any(_object_fits(found, wanted) for found in item.objects)


_OF_OBJECTS = (
    *("object", "type", "side", "ambiguous"),
    *("min_distance_mm", "max_distance_mm", "max_reprojection_px", "max_uncertainty_mm"),
)


def _asks_of_objects(wanted: SampleFilter) -> bool:
    return any(getattr(wanted, name) is not None for name in _OF_OBJECTS)


def _object_fits(found: SampleObject, wanted: SampleFilter) -> bool:
    return (
        wanted.object in (None, found.name)
        and wanted.type in (None, found.type)
        and (wanted.side is None or wanted.side in found.sides)
        and wanted.ambiguous in (None, found.ambiguous)
        and (wanted.min_distance_mm is None or found.distance_mm >= wanted.min_distance_mm)
        and (wanted.max_distance_mm is None or found.distance_mm <= wanted.max_distance_mm)
        and (wanted.max_reprojection_px is None or found.reprojection_error_px <= wanted.max_reprojection_px)
        and (
            wanted.max_uncertainty_mm is None
            or (found.uncertainty_mm is not None and found.uncertainty_mm <= wanted.max_uncertainty_mm)
        )
    )


def item_of(sample: str, text: bytes, prefix: str = "") -> SampleItem:
    """A sample as it is listed, from its label file's text; ``prefix`` goes before its files' paths."""
    try:
        plain = parse_json(text)
        return _item_of(sample, plain, dict(_files_of(plain["files"], prefix)))
    except _FAULTS:
        return _unreadable(sample)


def item_of_label(label: Label, files: Mapping[PictureKind, str]) -> SampleItem:
    """The same of a label at hand; ``files``: its pictures' paths in the session."""
    try:
        return _item_of(
            label.sample, label.model_dump(by_alias=True), {str(kind): path for kind, path in files.items()}
        )
    except _FAULTS:
        return _unreadable(label.sample)


def _item_of(sample: str, plain: dict[str, Any], files: dict[str, str]) -> SampleItem:
    return SampleItem.model_construct(
        name=sample,
        captured_at=str(plain["captured_at"]),
        camera=intern(plain["camera"]["name"]),
        frame=int(plain["frame"]),
        recording=None if plain["recording"] is None else intern(plain["recording"]),
        complete=bool(plain.get("complete", True)),
        background=bool(plain["background"]),
        objects=tuple(map(_object_of, plain["objects"])),
        files=files,
    )


def _object_of(plain: dict[str, Any]) -> SampleObject:
    azimuth, elevation = view_direction(plain["pose"]["matrix"])
    quality = plain["quality"]
    uncertainty = quality.get("uncertainty")
    return SampleObject.model_construct(
        name=intern(plain["name"]),
        type=intern(plain["type"]),
        sides=tuple(dict.fromkeys(intern(side["class"]) for side in plain["sides"])),
        distance_mm=float(plain["distance_mm"]),
        azimuth_deg=round(azimuth, 2),
        elevation_deg=round(elevation, 2),
        reprojection_error_px=float(quality["reprojection_error_px"]),
        uncertainty_mm=None if uncertainty is None else float(uncertainty["distance_mm"]),
        ambiguous=bool(quality.get("ambiguous", False)),
        pose_source=intern(plain.get("pose_source", "measured")),
    )


def _packed(item: SampleItem) -> bytes:
    """Packed; one that no answer can hold by its name alone: JSON may have 10**30, half a surrogate, megabytes."""
    try:
        packed = pack(item)
    except _FAULTS:
        return pack(_unreadable(item.name))
    return packed if _size_of(item, packed) <= _MOST_BYTES else pack(_unreadable(item.name))


def _files_of(plain: dict[str, Any], prefix: str) -> Iterator[tuple[str, str]]:
    for kind in PICTURES:
        if plain.get(kind) is not None:
            yield kind, prefix + str(plain[kind]["path"])


def _unreadable(sample: str) -> SampleItem:
    return SampleItem(
        name=sample,
        captured_at=sample_captured_at(sample),
        camera=sample_camera(sample),
        frame=sample_frame(sample),
        recording=None,
        complete=False,
        background=False,
        objects=(),
        files={},
    )


def _size_of(item: SampleItem, packed: bytes) -> int:
    """At most its bytes in MessagePack, where its fields have their names, and its files' paths its own."""
    return len(packed) + 300 + len(item.files) * len(item.name) + 200 * len(item.objects)
