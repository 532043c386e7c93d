"""The grab thread with a real ring and a real bus; the cameras are scripted or play files."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from queue import Empty, Queue
from threading import Event

import cv2
import numpy as np
import pytest

from common import log
from common.bus import Endpoints, Proxy, Publisher
from common.config import Rig
from common.config.models import NetworkConfig
from common.errors import CameraError, CameraStuckError, ConfigError
from common.frames import FrameReader, shm_folder
from common.geometry import CameraModel
from common.labels import Window
from common.messages import CameraState, FrameAnnounced, FrameRef, TrueObject, Truth
from common.topics import CAMERA, FRAME, TRUTH
from services.capture.announcer import NEXT_PHASES, Announcer
from services.capture.cameras.base import Camera, Description, EndOfStreamError, FrameSkippedError, Grabbed
from services.capture.cameras.files import FilesCamera
from services.capture.cameras.intrinsics import label_of
from services.capture.cues import Cues
from services.capture.grabber import Grabber
from services.capture.rings import Rings
from services.capture.watchdog import STUCK_S
from tests.support.hygiene import Place
from tests.support.stack import Listener, wait_for
from tests.unit.services.capture.conftest import grey_picture, write_pictures, write_video
from tests.unit.services.capture.test_cues import recording

BOOT = "0000abcd"
SLOTS = 6
Act = Grabbed | Exception


class Script:
    """A camera that does what the test says, one act a grab; a live camera's counterpart in a test."""

    def __init__(
        self, acts: Queue[Act], size: tuple[int, int] = (64, 48), unit: float | None = None, fps: float = 1
    ) -> None:
        self._acts = acts
        self._unit = unit
        self._fps = fps
        self._size = size
        self.closed = 0
        self._describe(*size)

    def grab(self, timeout_s: float) -> Grabbed:
        try:
            act = self._acts.get(timeout=timeout_s)
        except Empty:
            raise TimeoutError from None
        if isinstance(act, Exception):
            raise act
        height, width = act.bgr.shape[:2]
        if (width, height) != self._size:
            self._size = (width, height)
            self._describe(width, height)
        return act

    def describe(self) -> Description:
        return self._description

    def close(self) -> None:
        self.closed += 1

    def _describe(self, width: int, height: int) -> None:
        camera = label_of("cam0", CameraModel.guess(width, height), intrinsics_from="guess")
        self._description = Description(camera, self._fps, self._unit)


class Rigged:
    """A grabber on a real bus, and an ear on it."""

    def __init__(self, place: Place, label_deadline_s: float = 5.0) -> None:
        self.endpoints = Endpoints.of(NetworkConfig())
        self.endpoints.prepare()
        self._proxy = Proxy(self.endpoints)
        self._proxy.start()
        self._label_deadline_s = label_deadline_s
        self.publisher = Publisher(self.endpoints, "capture.cam0", BOOT)
        unopened = label_of("cam0", CameraModel.guess(1280, 720), intrinsics_from="guess")
        self.announcer = Announcer(self.publisher, BOOT, "script", unopened, 30.0)
        self.cues = Cues(BOOT)
        self.rings = Rings(place.prefix, "capture.cam0", BOOT, SLOTS)
        self.ear = Listener(self.endpoints, FRAME, CAMERA, TRUTH)
        self.grabber: Grabber | None = None

    def run(self, open_camera: Callable[[], Camera]) -> None:
        """Start the thread as soon as the ear hears this camera."""

        def heard() -> bool:
            self.announcer.enter("opening")
            return any(received.topic is CAMERA for received in self.ear.subscriber.receive())

        wait_for(heard, 20.0, "the bus")
        self.grabber = Grabber(
            open_camera,
            self.announcer,
            self.rings,
            self.cues,
            BOOT,
            log.get(),
            label_deadline_s=self._label_deadline_s,
            back_off_s=(0.05, 0.1),
        )
        self.grabber.start()

    def frame(self, preview: bool = False) -> FrameRef:
        """The next frame that is announced."""
        message = self.ear.wait_for(
            lambda received: isinstance(received.message, FrameAnnounced) and received.message.ref.preview == preview
        ).message
        assert isinstance(message, FrameAnnounced)
        return message.ref

    def state(self, *phases: str, **wanted: object) -> CameraState:
        """The next state of the camera in one of these phases with these fields."""

        def fits(received: object) -> bool:
            state = getattr(received, "message", None)
            return (
                isinstance(state, CameraState)
                and state.phase in phases
                and all(getattr(state, key) == value for key, value in wanted.items())
            )

        message = self.ear.wait_for(fits, why=f"a state {phases} {wanted}").message
        assert isinstance(message, CameraState)
        return message

    def refs(self) -> list[FrameRef]:
        """All announced frames heard so far that count."""
        return [
            received.message.ref
            for received in self.ear.heard
            if isinstance(received.message, FrameAnnounced) and not received.message.ref.preview
        ]

    def close(self) -> None:
        if self.grabber is not None:
            self.grabber.stop()
        self.rings.close()
        self.ear.close()
        self.publisher.close()
        self._proxy.close()


@pytest.fixture
def rigged(place: Place) -> Iterator[Rigged]:
    made = Rigged(place)
    yield made
    made.close()


def picture(value: int, device_ns: int | None = None) -> Grabbed:
    return Grabbed(grey_picture(value), device_ns=device_ns)


def test_a_frame_is_in_the_ring_when_it_is_announced(rigged: Rigged) -> None:
    acts: Queue[Act] = Queue()
    camera = Script(acts)
    rigged.run(lambda: camera)
    state = rigged.state("streaming")
    assert (state.camera.width, state.camera.height, state.captured) == (64, 48, 0)
    for number in (1, 2, 3):
        acts.put(Grabbed(grey_picture(number), device_ns=number * 1000, source_name=f"s{number}"))
        ref = rigged.frame()
        assert (ref.camera, ref.boot, ref.frame, ref.count) == ("cam0", BOOT, number, number)
        assert (ref.device_ns, ref.source_name, ref.ring) == (number * 1000, f"s{number}", state.ring)
        with FrameReader(ref.ring) as ring, ring.view(ref.frame) as view:
            assert (view.bgr == number).all()


def test_stamps_are_of_the_grab_and_of_both_clocks(rigged: Rigged) -> None:
    acts: Queue[Act] = Queue()
    rigged.run(lambda: Script(acts))
    acts.put(picture(1))
    first = rigged.frame()
    acts.put(picture(2))
    second = rigged.frame()
    assert first.captured_mono_ns < second.captured_mono_ns
    passed = (second.captured_mono_ns - first.captured_mono_ns) - (second.captured_wall_ns - first.captured_wall_ns)
    assert abs(passed) < 50_000_000, "both stamps are of the same moment"


def test_frames_that_a_camera_numbered_but_never_gave_are_counted(rigged: Rigged) -> None:
    acts: Queue[Act] = Queue()
    rigged.run(lambda: Script(acts))
    for missed in (0, 3, 2):
        acts.put(Grabbed(grey_picture(1), missed=missed))
        rigged.frame()
    assert rigged.announcer.report().dropped == {"missed": 5}


def test_truth_and_depth_travel_with_their_frame(rigged: Rigged) -> None:
    acts: Queue[Act] = Queue()
    rigged.run(lambda: Script(acts, unit=0.25))
    assert rigged.state("streaming").depth_unit_mm == 0.25
    known = TrueObject(
        name="box-1",
        rvec=(0.0, 0.0, 0.0),
        tvec_mm=(0.0, 0.0, 1000.0),
        corners=((1.0, 2.0),) * 8,
        window=Window(x_min=0, y_min=0, x_max=1, y_max=1),
        distance_mm=1000.0,
        markers=(),
    )
    acts.put(Grabbed(grey_picture(1), depth=np.full((48, 64), 4000, np.uint16), truth=(known,)))
    truth = rigged.ear.wait_for(lambda received: isinstance(received.message, Truth)).message
    assert isinstance(truth, Truth)
    ref = rigged.frame() if not rigged.refs() else rigged.refs()[0]
    assert (truth.frame, truth.boot, truth.objects) == (ref.frame, BOOT, (known,))
    with FrameReader(ref.ring) as ring, ring.view(ref.frame) as view:
        assert view.depth is not None
        assert (view.depth == 4000).all()
    acts.put(picture(2))
    rigged.frame()
    wait_for(lambda: rigged.announcer.report().dropped == {"depth_missing": 1}, 10.0)


def test_a_lost_camera_is_closed_reopened_and_its_count_goes_on(rigged: Rigged) -> None:
    acts: Queue[Act] = Queue()
    doors: Queue[bool] = Queue()
    opened: list[Script] = []

    def open_camera() -> Script:
        if not doors.get(timeout=30):
            raise CameraError("nobody there")
        opened.append(Script(acts))
        return opened[-1]

    rigged.run(open_camera)
    doors.put(True)
    acts.put(picture(1))
    assert rigged.frame().count == 1
    acts.put(CameraError("the cable is out"))
    assert rigged.state("lost").last_error == "the cable is out"
    assert rigged.announcer.report().faulty
    doors.put(False)
    assert rigged.state("lost", last_error="nobody there").lost == {"reconnect": 2}
    doors.put(True)
    assert rigged.state("streaming").last_error is None
    acts.put(picture(2))
    ref = rigged.frame()
    assert (ref.count, ref.frame) == (2, 2)
    assert (opened[0].closed, len(opened)) == (1, 2)
    assert rigged.announcer.report().dropped == {"reconnect": 2}


def test_skipped_and_frozen_frames_are_counted_not_announced(rigged: Rigged) -> None:
    acts: Queue[Act] = Queue()
    rigged.run(lambda: Script(acts))
    for act in (
        picture(1, 10),
        FrameSkippedError("x.png can't be read", "unreadable"),
        picture(2, 10),
        picture(3, 20),
        EndOfStreamError("over"),
    ):
        acts.put(act)
    state = rigged.state("ended")
    assert [ref.device_ns for ref in rigged.refs()][-1] == 20
    assert state.captured == 2
    assert state.lost == {"unreadable": 1, "frozen": 1}
    assert state.last_error == "x.png can't be read"


def test_a_silent_camera_is_taken_for_lost(rigged: Rigged, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("services.capture.grabber.SILENT_S", 0.05)
    rigged.run(lambda: Script(Queue(), fps=100))
    state = rigged.state("lost")
    assert "gave no picture" in (state.last_error or "")
    assert state.lost["timeout"] > 0


def test_a_live_camera_whose_picture_never_changes_is_taken_for_lost(
    rigged: Rigged, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("services.capture.grabber.SILENT_S", 0.2)
    acts: Queue[Act] = Queue()
    rigged.run(lambda: Script(acts, fps=100))
    for _ in range(400):
        acts.put(picture(7))
        if rigged.announcer.phase == "lost":
            break
        wait_for(lambda: acts.empty() or rigged.announcer.phase == "lost", 10.0)
    state = rigged.state("lost")
    assert "one and the same picture" in (state.last_error or "")
    assert state.lost["frozen"] == 1
    assert rigged.refs(), "until then it was believed"


class Hanging:
    """A camera whose driver doesn't come back from `grab` until the test lets it."""

    def __init__(self, script: Script, hang: Event, go_on: Event) -> None:
        self._script = script
        self._hang = hang
        self._go_on = go_on

    def grab(self, timeout_s: float) -> Grabbed:
        if self._hang.is_set():
            self._go_on.wait(60)
        return self._script.grab(timeout_s)

    def describe(self) -> Description:
        return self._script.describe()

    def close(self) -> None:
        self._script.close()


def test_a_driver_that_hangs_is_stalled_and_streams_again(rigged: Rigged, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("services.capture.watchdog.STALLED_S", 0.1)
    acts: Queue[Act] = Queue()
    hang, go_on = Event(), Event()
    rigged.run(lambda: Hanging(Script(acts), hang, go_on))
    acts.put(picture(1, 10))
    ref = rigged.frame()
    assert rigged.grabber is not None
    watchdog = rigged.grabber.watchdog
    hang.set()

    def stalled() -> bool:
        watchdog.look()
        return rigged.announcer.phase == "stalled"

    wait_for(stalled, 20.0, "the stall")
    state = rigged.state("stalled")
    assert "does not come back from 'grab'" in (state.last_error or "")
    assert (state.newest_mono_ns, state.lost) == (ref.captured_mono_ns, {"stalled": 1})
    assert rigged.announcer.report().faulty
    hang.clear()
    go_on.set()
    acts.put(picture(2, 20))
    assert rigged.frame().count == 2
    assert rigged.announcer.phase == "streaming"
    assert rigged.announcer.report().last_error is None


def test_a_driver_that_hangs_for_too_long_ends_its_process(rigged: Rigged, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(STUCK_S, "grab", 0.2)
    hang, go_on = Event(), Event()
    hang.set()
    rigged.run(lambda: Hanging(Script(Queue()), hang, go_on))
    assert rigged.grabber is not None
    watchdog = rigged.grabber.watchdog

    def stuck() -> CameraStuckError | None:
        try:
            watchdog.look()
        except CameraStuckError as error:
            return error
        return None

    error = wait_for(stuck, 20.0, "the end")
    assert error.exit_code == 1, "a supervisor starts it again"
    assert "not come back from 'grab'" in error.message
    go_on.set()


def test_another_camera_is_not_taken_for_the_one_that_was_lost(rigged: Rigged) -> None:
    acts: Queue[Act] = Queue()
    serials = Queue[str]()
    for serial in ("A", "B", "A"):
        serials.put(serial)

    def open_camera() -> Script:
        script = Script(acts)
        camera = label_of("cam0", CameraModel.guess(64, 48), intrinsics_from="factory", serial=serials.get(timeout=30))
        script._description = Description(camera, 1)
        return script

    rigged.run(open_camera)
    rigged.state("streaming")
    acts.put(CameraError("the cable is out"))
    assert "serial A is gone and B is there instead" in (
        rigged.ear.wait_for(
            lambda received: "instead" in (getattr(received.message, "last_error", None) or ""), why="the other one"
        ).message.last_error
    )
    assert rigged.state("streaming").camera.serial == "A"


def test_a_device_clock_takes_the_jitter_out_of_the_stamps(rigged: Rigged) -> None:
    acts: Queue[Act] = Queue()

    def open_camera() -> Script:
        script = Script(acts)
        script._description = Description(script._description.camera, 1, stamps="device")
        return script

    rigged.run(open_camera)
    refs = []
    for number in range(6):
        acts.put(picture(number, 1_000_000 * number))
        refs.append(rigged.frame())
    times = np.array([ref.captured_mono_ns for ref in refs])
    assert [ref.device_ns for ref in refs] == [1_000_000 * number for number in range(6)]
    assert (np.diff(times) > 0).all()
    assert times[-1] - times[0] <= 5_000_000, "as far apart as the camera says, however late they were grabbed"


def test_a_new_size_is_a_new_ring_told_before_its_first_frame(rigged: Rigged) -> None:
    acts: Queue[Act] = Queue()
    rigged.run(lambda: Script(acts))
    acts.put(picture(1))
    before = rigged.frame()
    acts.put(Grabbed(np.full((80, 100, 3), 2, np.uint8)))
    state = rigged.ear.wait_for(
        lambda received: (
            isinstance(received.message, FrameAnnounced)
            or (isinstance(received.message, CameraState) and received.message.camera.width == 100)
        )
    ).message
    assert isinstance(state, CameraState), "the frame came before the state that describes it"
    after = next((ref for ref in rigged.refs() if ref.ring == state.ring), None) or rigged.frame()
    assert after.ring == state.ring != before.ring
    assert (after.frame, after.count) == (2, 2), "numbers go on in the new ring"
    with FrameReader(after.ring) as ring, ring.view(2) as view:
        assert view.bgr.shape == (80, 100, 3)
    with FrameReader(before.ring) as ring, ring.view(1) as view:
        assert (view.bgr == 1).all(), "a reader that is behind still finds the ring before"


def test_no_room_is_a_lost_camera_that_says_so(rigged: Rigged) -> None:
    rigged.run(lambda: Script(Queue(), size=(60000, 60000)))
    state = rigged.state("lost")
    assert "shared memory is full" in (state.last_error or "")
    assert "--shm-size" in (state.last_error or "")


def test_a_config_error_is_handed_to_the_main_loop(rigged: Rigged) -> None:
    def open_camera() -> Camera:
        raise ConfigError("a key is wrong")

    rigged.run(open_camera)
    assert rigged.grabber is not None
    wait_for(lambda: rigged.grabber is not None and rigged.grabber.failure, 10.0, "the failure")


def test_stopping_closes_the_camera_and_removes_the_rings(rigged: Rigged, place: Place) -> None:
    acts: Queue[Act] = Queue()
    camera = Script(acts)
    rigged.run(lambda: camera)
    acts.put(picture(1))
    ring = rigged.frame().ring
    assert (shm_folder() / ring).exists()
    assert rigged.grabber is not None
    rigged.grabber.stop()
    assert camera.closed == 1
    assert not list(shm_folder().glob(f"tagmill-{place.prefix}-*"))


def player(rig: Rig) -> Callable[[], FilesCamera]:
    return lambda: FilesCamera("cam0", rig.camera("cam0"), rig)


def label_all(rigged: Rigged, until: Callable[[], bool]) -> None:
    """Be the label process: answer every frame at once, those that were heard already too."""
    for ref in rigged.refs():
        rigged.cues.on_labelled(ref)

    def answer(received: object) -> bool:
        message = getattr(received, "message", None)
        if isinstance(message, FrameAnnounced) and not message.ref.preview:
            rigged.cues.on_labelled(message.ref)
        return isinstance(message, CameraState) and until()

    rigged.ear.wait_for(answer, why="the end of the file")


@pytest.mark.parametrize("source", ["photos", "clip.avi"])
def test_a_paced_file_plays_from_frame_0_for_each_recording_and_loses_nothing(
    rigged: Rigged, rig_of: Callable[[str], Rig], tmp_path: Path, source: str
) -> None:
    write_pictures(tmp_path / "photos", 20)
    write_video(tmp_path / "clip.avi", 20)
    rigged.run(player(rig_of(f"{{driver: files, path: {source}, pace: consumer}}")))
    assert rigged.state("waiting").paced
    assert not rigged.announcer.unpaced
    shown = rigged.frame(preview=True)
    assert (shown.count, rigged.announcer.captured) == (0, 0)
    assert rigged.frame(preview=True).frame == shown.frame + 1, "repeated, for those who come late"
    for turn, name in enumerate(("one", "two")):
        rigged.cues.on_recording(recording(name))
        state = rigged.state("streaming", played_for=name)
        assert state.play_first == 1 + 20 * turn
        label_all(rigged, lambda: rigged.announcer.phase == "ended")
        assert rigged.announcer.captured == 20 * (turn + 1)
    refs = rigged.refs()
    assert [ref.count for ref in refs] == list(range(1, 41))
    names = [ref.source_name for ref in refs]
    assert names[:20] == names[20:]
    assert len(set(names)) == 20
    assert rigged.announcer.report().dropped == {}


def test_ended_is_told_after_the_last_frame(rigged: Rigged, rig_of: Callable[[str], Rig], tmp_path: Path) -> None:
    write_pictures(tmp_path / "photos", 3)
    rigged.run(player(rig_of("{driver: files, path: photos, fps: 200}")))
    rigged.state("waiting")
    rigged.cues.on_recording(recording("one"))
    state = rigged.state("ended")
    assert (state.captured, state.played_for, state.play_first) == (3, "one", 1)
    assert rigged.refs()[-1].count == 3


def test_one_that_begins_at_start_plays_at_once_and_only_once(
    rigged: Rigged, rig_of: Callable[[str], Rig], tmp_path: Path
) -> None:
    write_pictures(tmp_path / "photos", 3)
    assert not rigged.announcer.unpaced, "nobody knows before it is opened"
    rigged.run(player(rig_of("{driver: files, path: photos, fps: 200, begin: at_start}")))
    state = rigged.state("ended")
    assert (state.captured, state.played_for) == (3, None)
    assert rigged.announcer.unpaced
    rigged.cues.on_recording(recording("one"))
    assert not rigged.cues.cut()
    assert rigged.announcer.phase == "ended"


def test_a_label_that_does_not_come_is_counted_and_holds_nothing_up_for_ever(
    place: Place, rig_of: Callable[[str], Rig], tmp_path: Path
) -> None:
    write_pictures(tmp_path / "photos", 4)
    rigged = Rigged(place, label_deadline_s=0.02)
    try:
        rigged.run(player(rig_of("{driver: files, path: photos, pace: consumer, begin: at_start}")))
        state = rigged.state("ended")
        assert (state.captured, state.lost) == (4, {"label_late": 4})
    finally:
        rigged.close()


def test_a_recording_that_is_stopped_stops_its_file(
    rigged: Rigged, rig_of: Callable[[str], Rig], tmp_path: Path
) -> None:
    write_pictures(tmp_path / "photos", 20)
    rigged.run(player(rig_of("{driver: files, path: photos, pace: consumer}")))
    rigged.state("waiting")
    rigged.cues.on_recording(recording("one"))
    first = rigged.frame()
    rigged.cues.on_recording(recording("one", "finishing"))
    rigged.state("waiting")
    rigged.cues.on_recording(recording("two"))
    again = rigged.frame()
    assert (first.count, again.count) == (1, 2)
    assert first.source_name == again.source_name == "img1.png"
    assert rigged.announcer.report().dropped == {}


def test_a_pass_that_a_loss_interrupts_goes_on_where_it_was(
    rigged: Rigged, rig_of: Callable[[str], Rig], tmp_path: Path
) -> None:
    folder, away = write_pictures(tmp_path / "photos", 6), tmp_path / "away"
    (folder / "img2.png").write_bytes(b"broken")
    rigged.run(player(rig_of("{driver: files, path: photos, pace: consumer}")))
    rigged.state("waiting")
    rigged.cues.on_recording(recording("one"))
    for _ in range(2):
        ref = rigged.frame()
        if ref.count == 2:
            folder.rename(away)
        rigged.cues.on_labelled(ref)
    assert str(folder) in (rigged.state("lost").last_error or "")
    away.rename(folder)
    assert rigged.state("streaming").played_for == "one"
    label_all(rigged, lambda: rigged.announcer.phase == "ended")
    assert [ref.source_name for ref in rigged.refs()] == [f"img{number}.png" for number in (1, 3, 4, 5, 6)]
    assert rigged.announcer.report().dropped["unreadable"] == 1


def test_pictures_of_differing_size_are_all_played(
    rigged: Rigged, rig_of: Callable[[str], Rig], tmp_path: Path
) -> None:
    folder = tmp_path / "photos"
    folder.mkdir()
    sizes = [(64, 48), (100, 80), (64, 48), (30, 20)]
    for number, (width, height) in enumerate(sizes):
        cv2.imwrite(str(folder / f"{number}.png"), grey_picture(number + 1, width, height))
    rigged.run(player(rig_of("{driver: files, path: photos, pace: consumer}")))
    rigged.state("waiting")
    rigged.cues.on_recording(recording("one"))
    for number, (width, height) in enumerate(sizes):
        ref = rigged.frame()
        with FrameReader(ref.ring) as ring, ring.view(ref.frame) as view:
            assert view.bgr.shape == (height, width, 3)
            assert (view.bgr == number + 1).all()
        rigged.cues.on_labelled(ref)
    assert rigged.state("ended").captured == 4


def test_phases_follow_their_table(rigged: Rigged) -> None:
    assert set(NEXT_PHASES) == {"opening", "waiting", "streaming", "ended", "stalled", "lost"}
    with pytest.raises(ValueError, match="ended does not follow opening"):
        rigged.announcer.enter("ended")
    for phase in (
        "waiting",
        "streaming",
        "ended",
        "streaming",
        "lost",
        "lost",
        "waiting",
        "lost",
        "streaming",
        "stalled",
    ):
        rigged.announcer.enter(phase)
        assert rigged.announcer.phase == phase
