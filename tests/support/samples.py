"""The label process's side of the store for tests: real pixels in a real sample ring, real orders."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any, Literal

import numpy as np

from common import clock
from common.bus import Endpoints, OrderClient, Poller
from common.dataset import SessionReader
from common.frames import SampleRing, segment_name
from common.ids import new_boot, sample_name
from common.labels import (
    CameraLabel,
    Corner,
    DepthLabel,
    Erased,
    ErasedPolygon,
    Label,
    ObjectLabel,
    PoseLabel,
    Quality,
    SideLabel,
    Window,
)
from common.ledgers import CameraLedger, RecordingSpec
from common.messages import (
    Answer,
    ErrorInfo,
    LedgerOrder,
    LedgerQuery,
    ListOrder,
    MoveOrder,
    Order,
    ReloadOrder,
    SampleFilter,
    SampleList,
    SessionOrder,
    StoreOrder,
)

WIDTH, HEIGHT = 64, 48
ANSWER_S = 60.0
START_NS = 1_788_000_000_000_000_000


def camera_label(name: str = "cam0", focal_px: float = 50.0, width: int = WIDTH, height: int = HEIGHT) -> CameraLabel:
    """A camera with its principal point in the middle."""
    matrix = ((focal_px, 0.0, width / 2), (0.0, focal_px, height / 2), (0.0, 0.0, 1.0))
    return CameraLabel(name=name, width=width, height=height, matrix=matrix, distortion=(0.01, -0.02, 0.0, 0.0, 0.0))


def object_label(number: int = 0) -> ObjectLabel:
    """An object with everything that a label can say of one."""
    window = Window(x_min=1.5, y_min=2.25, x_max=30.0, y_max=40.125)
    quad = ((1.0, 2.0), (3.5, 2.0), (3.5, 4.0), (1.0, 4.0))
    pose = PoseLabel(
        rvec=(0.1, -0.2, 0.3),
        tvec_mm=(10.0, 20.0, 1000.125),
        matrix=((1.0, 0.0, 0.0, 10.0), (0.0, 1.0, 0.0, 20.0), (0.0, 0.0, 1.0, 1000.125), (0.0, 0.0, 0.0, 1.0)),
    )
    side = SideLabel(
        class_name="front",
        face="front",
        marker=number,
        marker_corners=quad,
        corners_kind="subpix",
        distance_mm=1000.0,
        distance_joint_mm=1000.5,
        viewing_angle_deg=12.5,
        residual_px=0.25,
        polygon=quad,
    )
    corner = Corner(name="front_top_left", x=1.0, y=2.0, in_image=True)
    return ObjectLabel(
        id=number,
        name=f"box-{number}",
        type="box",
        sides=(side,),
        pose=pose,
        corners=(corner, Corner(name="front_top_right", x=None, y=None, in_image=False)),
        window=window,
        window_unclipped=window,
        distance_mm=1000.125,
        quality=Quality(reprojection_error_px=0.3, markers=1),
    )


def label_for(
    frame: int,
    camera: CameraLabel | None = None,
    *,
    recording: str | None = "rec-a",
    depth: bool = True,
    wall_ns: int | None = None,
) -> Label:
    """A whole label of frame ``frame``; its capture time follows from the frame."""
    camera = camera or camera_label()
    wall = START_NS + frame * 33_000_000 if wall_ns is None else wall_ns
    polygon = ErasedPolygon(marker=0, because="detected", polygon=((1.0, 1.0), (2.0, 1.0), (2.0, 2.0)))
    return Label(
        sample=sample_name(wall, camera.name, frame),
        session="unknown",
        recording=recording,
        camera=camera,
        frame=frame,
        boot="abcd1234",
        source_name=None,
        captured_at=clock.iso_utc(wall),
        captured_wall_ns=wall,
        captured_mono_ns=frame,
        device_ns=None,
        depth=DepthLabel(unit_mm=0.25) if depth else None,
        background=False,
        objects=(object_label(0),),
        left_out=(),
        inpainted=Erased(method="telea", margin="0.15", polygons=(polygon,)),
        versions={"tagmill": "0"},
    )


def pixels(frame: int, width: int = WIDTH, height: int = HEIGHT) -> tuple[np.ndarray, np.ndarray]:
    """Colour (H, W, 3) uint8 and depth (H, W) uint16 that follow from the frame's number."""
    random = np.random.default_rng(frame)
    colour = random.integers(0, 256, (height, width, 3), dtype=np.uint8)
    return colour, random.integers(0, 65536, (height, width), dtype=np.uint16)


class StoreSide:
    """Orders samples as the label process does: a slot is free again when its answer has come."""

    def __init__(
        self, endpoints: Endpoints, slots: int = 16, *, with_original: bool = False, identity: str = "label.0"
    ) -> None:
        name = segment_name(endpoints.prefix, f"{identity}.cam0", new_boot())
        self.ring = SampleRing(name, WIDTH, HEIGHT, True, slots, with_original)
        self.client = OrderClient(endpoints.orders_store, identity, window=256)
        self.answers: dict[str, Answer] = {}
        self._slots: dict[str, int] = {}
        self._poller = Poller(self.client)
        self._sent = 0

    def order(
        self, frame: int, recording: str | None = "rec-a", camera: CameraLabel | None = None
    ) -> StoreOrder | None:
        """An order for ``frame`` with its pixels in the ring, not sent; None while no slot is free."""
        slot = self.ring.acquire()
        if slot is None:
            return None
        view = self.ring.view(slot)
        colour, depth = pixels(frame)
        view.bgr[:] = colour
        assert view.depth is not None
        view.depth[:] = depth
        if view.original is not None:
            view.original[:] = 255 - colour
        label = label_for(frame, camera, recording=recording)
        self._slots[label.sample] = slot
        return StoreOrder(
            key=label.sample, recording=recording, camera=label.camera.name, ring=self.ring.name, slot=slot, label=label
        )

    def send(self, order: Order) -> str:
        """Send any order; returns its key."""
        self.client.send(order)
        return order.key

    def store(self, frame: int, recording: str | None = "rec-a", camera: CameraLabel | None = None) -> str:
        """Order ``frame``; returns the sample's name."""
        order = self.order(frame, recording, camera)
        assert order is not None, "no slot is free"
        return self.send(order)

    def ledger(self, spec: RecordingSpec, account: CameraLedger, camera: str = "cam0", *, ended: bool = False) -> str:
        """Send an account; returns the order's key."""
        self._sent += 1
        key = f"ledger-{spec.recording}-{camera}-{self._sent}"
        return self.send(LedgerOrder(key=key, spec=spec, camera=camera, account=account, ended=ended))

    def query(self, recording: str | None = None) -> Answer:
        """Ask for ledgers and wait for the answer."""
        self._sent += 1
        return self.answer_to(self.send(LedgerQuery(key=f"query-{self._sent}", recording=recording)))

    def session(self, name: str, *, new_if_different: bool = False) -> Answer:
        """Open a session and wait for the answer."""
        self._sent += 1
        order = SessionOrder(key=f"session-{self._sent}", name=name, new_if_different=new_if_different)
        return self.answer_to(self.send(order))

    def reload(self) -> Answer:
        """Have the rig read again and wait for the answer."""
        self._sent += 1
        return self.answer_to(self.send(ReloadOrder(key=f"reload-{self._sent}")))

    def move(self, to: Literal["bin", "session"], *samples: str) -> str:
        """Have samples moved; returns the order's key."""
        self._sent += 1
        return self.send(MoveOrder(key=f"move-{self._sent}", to=to, samples=samples))

    def listed(self, *, session: str | None = None, offset: int = 0, limit: int = 100, **wanted: Any) -> SampleList:
        """Ask for a list and wait for it."""
        self._sent += 1
        answer = self.answer_to(
            self.send(
                ListOrder(
                    key=f"list-{self._sent}",
                    session=session,
                    filter=SampleFilter(**wanted),
                    offset=offset,
                    limit=limit,
                )
            )
        )
        assert answer.listed is not None, answer.error
        return answer.listed

    def receive(self, wait_s: float = 0.2) -> None:
        """Take the answers that come within ``wait_s``."""
        self._poller.wait(wait_s)
        for answer in self.client.receive():
            self.answers[answer.key] = answer
            if answer.key in self._slots:
                self.ring.release(self._slots.pop(answer.key))

    def answer_to(self, key: str, deadline_s: float = ANSWER_S) -> Answer:
        """Wait for one answer."""
        deadline = time.monotonic() + deadline_s
        while key not in self.answers:
            if time.monotonic() > deadline:
                raise AssertionError(f"no answer to {key} within {deadline_s:g} s")
            self.receive()
        return self.answers[key]

    def error_of(self, key: str) -> ErrorInfo:
        """Wait for a refusal."""
        error = self.answer_to(key).error
        assert error is not None, f"{key} was not refused"
        return error

    def close(self) -> None:
        self.client.close()
        self.ring.close()


def spec(recording: str = "rec-a", *cameras: str) -> RecordingSpec:
    """A recording of ``cameras`` (default cam0)."""
    return RecordingSpec(
        recording=recording, mode="all", cameras=cameras or ("cam0",), started_at="2026-08-30T12:00:00.000Z"
    )


def check_whole(folder: Path, *acknowledged: str) -> None:
    """Each sample of a session is whole and shows its frame's pixels; the acknowledged are among them; nothing torn."""
    reader = SessionReader(folder)
    samples = reader.samples()
    missing = set(acknowledged) - set(samples)
    assert not missing, f"acknowledged and not there: {sorted(missing)}"
    expected = {"session.json"}
    for sample in samples:
        label = reader.label(sample)
        reader.verify(label)
        colour, depth = pixels(label.frame)
        assert np.array_equal(reader.colour(label), colour)
        assert np.array_equal(reader.depth(label), depth)
        assert label.files is not None
        named = (label.files.rgb, label.files.depth, label.files.original)
        expected |= {file.path for file in named if file is not None}
        expected.add(f"label/label_{sample}.json")
    found = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    assert found == expected
