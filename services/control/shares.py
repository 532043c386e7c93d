"""Which instance of detect, and of label, serves which camera. Pure; sticky, balanced, relearnt after a restart."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable


class Sharing:
    """The cameras of one kind of service, shared out among its ``instances`` (0, 1, ...).

    A camera keeps its instance for good: an instance that is away is restarted by its supervisor, and moving its
    cameras meanwhile would end their recordings. New cameras go to the instance with the fewest.
    """

    def __init__(self, instances: int) -> None:
        self._instances = instances
        self._serves: dict[str, int] = {}

    @property
    def table(self) -> dict[str, int]:
        """Camera to instance."""
        return dict(sorted(self._serves.items()))

    def learn(self, instance: int, cameras: Iterable[str]) -> None:
        """An instance says what it serves: taken over for cameras that are not shared out yet."""
        if 0 <= instance < self._instances:
            for camera in cameras:
                self._serves.setdefault(camera, instance)

    def share_out(self, cameras: Iterable[str]) -> bool:
        """Give each camera that has no instance to the least busy one; True if anything changed."""
        new = sorted(set(cameras) - set(self._serves))
        if not new:
            return False
        load = Counter(dict.fromkeys(range(self._instances), 0))
        load.update(self._serves.values())
        for camera in new:
            instance = min(range(self._instances), key=lambda each: (load[each], each))
            self._serves[camera] = instance
            load[instance] += 1
        return True

    def instance(self, camera: str) -> int | None:
        """Who serves this camera, None if it isn't shared out."""
        return self._serves.get(camera)
