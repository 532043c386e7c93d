"""A good rig file: what services get from it, and when two rigs are the same."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from common.config import Rig, differences, load_rig
from common.errors import ConfigError
from common.geometry import FACES

EXAMPLES = Path(__file__).resolve().parents[4] / "deploy" / "examples"
CALIBRATION = """\
width: 1280
height: 720
camera_matrix: [[900, 0, 639.5], [0, 901, 359.5], [0, 0, 1]]
distortion: [0.1, -0.2, 0, 0, 0.05]
"""


def write(folder: Path, text: str, name: str = "rig.yaml") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def one_box(**changes: Any) -> dict[str, Any]:
    side = {"marker": 0, "marker_size_mm": 50, **changes}
    size = {"width": 400, "height": 300, "depth": 200}
    return {"objects": [{"name": "box-1", "size_mm": size, "sides": {"front": side}}]}


def load(folder: Path, document: dict[str, Any]) -> Rig:
    return load_rig(write(folder, yaml.safe_dump(document)))


@pytest.mark.parametrize("name", ["synthetic.yaml", "paper.yaml", "video.yaml", "two-flat-objects.yaml"])
def test_the_examples_are_good(name: str) -> None:
    rig = load_rig(EXAMPLES / name)
    assert rig.boxes
    assert rig.config.cameras
    assert rig.warnings == ()


def test_the_examples_camera_file_adds_a_camera() -> None:
    rig = load_rig(EXAMPLES / "synthetic.yaml").with_camera_file(EXAMPLES / "conf.d" / "cam1.yaml")
    assert set(rig.config.cameras) == {"cam0", "cam1"}


def test_design_example_becomes_boxes(tmp_path: Path) -> None:
    rig = load_rig(
        write(
            tmp_path,
            """\
dataset: {root: ./dataset, session: boxes-monday}
objects:
  - name: box-1
    type: parcel
    size_mm: {width: 400, height: 300, depth: 200}
    sides:
      front: {marker: 0, marker_size_mm: 50, border_mm: 10, offset_mm: [0, 0], rotation_deg: 0}
      left: {marker: 1, marker_size_mm: 50, border_mm: 10, offset_mm: [20, -35, -4]}
      lid: {face: top, markers: [{marker: 2, marker_size_mm: 50}, {marker: 3, marker_size_mm: 20, offset_mm: [90, 0]}]}
cameras:
  cam0: {driver: synthetic, width: 1280, height: 720, fps: 30}
""",
        )
    )
    (box,) = rig.boxes
    assert (box.name, box.type, box.size_mm) == ("box-1", "parcel", (400.0, 300.0, 200.0))
    assert [(side.class_name, side.face) for side in box.sides] == [
        ("front", "front"),
        ("left", "left"),
        ("lid", "top"),
    ]
    assert box.sides[1].markers[0].offset_mm == (20.0, -35.0, -4.0)
    assert [marker.id for marker in box.sides[2].markers] == [2, 3]
    assert rig.dataset_root == tmp_path.resolve() / "dataset"
    assert rig.resolve(Path("photos")) == tmp_path.resolve() / "photos"
    assert rig.calibration("cam0") is None
    assert rig.camera("cam0").options == {}
    with pytest.raises(ConfigError, match="there is no camera 'cam9'; did you mean 'cam0'"):
        rig.camera("cam9")


@pytest.mark.parametrize("face", list(FACES))
def test_a_size_seen_from_a_side_is_the_object_s(face: str, tmp_path: Path) -> None:
    """By design.md's table: what the viewer of that side calls width, height, depth."""
    seen = {
        "front": (400, 300, 200),
        "back": (400, 300, 200),
        "left": (200, 300, 400),
        "right": (200, 300, 400),
        "top": (400, 200, 300),
        "bottom": (400, 200, 300),
    }[face]
    size = dict(zip(("width", "height", "depth"), seen, strict=True))
    side = {"size_mm": size, "marker": 0, "marker_size_mm": 50}
    rig = load(tmp_path, {"objects": [{"name": "box-1", "sides": {face: side}}]})
    assert rig.boxes[0].size_mm == (400.0, 300.0, 200.0)


def test_no_objects_is_a_warning(tmp_path: Path) -> None:
    rig = load_rig(write(tmp_path, "cameras: {}\n"))
    assert rig.boxes == ()
    assert "objects: there are none" in rig.warnings[0]


def test_yaml_means_what_it_looks_like(tmp_path: Path) -> None:
    rig = load_rig(
        write(
            tmp_path,
            "dataset: {session: on}\n"
            "cameras: {cam0: {driver: synthetic, width: 0640, height: 480, fps: 3e1, seed: 010}}\n",
        )
    )
    assert rig.config.dataset.session == "on"
    camera = rig.camera("cam0")
    assert (camera.width, camera.fps, camera.options) == (640, 30.0, {"seed": 10})


def test_an_alias_stands_for_its_value(tmp_path: Path) -> None:
    text = """\
objects:
  - {name: a, size_mm: &size {width: 100, height: 100, depth: 100}, sides: {front: {marker: 0, marker_size_mm: 50}}}
  - {name: b, size_mm: *size, sides: {front: {marker: 1, marker_size_mm: 50}}}
"""
    assert [box.size_mm for box in load_rig(write(tmp_path, text)).boxes] == [(100.0, 100.0, 100.0)] * 2


def test_a_third_party_s_driver_keeps_its_keys(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("common.config.surroundings.known_drivers", lambda: ("acme", "synthetic"))
    rig = load(tmp_path, {"cameras": {"cam0": {"driver": "acme", "exposure": {"mode": "auto"}, "serial": "17"}}})
    assert rig.camera("cam0").options == {"exposure": {"mode": "auto"}, "serial": "17"}


def test_a_calibration_comes_with_the_rig(tmp_path: Path) -> None:
    write(tmp_path, CALIBRATION, "cal.yaml")
    camera = {"driver": "synthetic", "width": 1280, "height": 720, "calibration": "cal.yaml"}
    label = load(tmp_path, {"cameras": {"cam0": camera}}).calibration("cam0")
    assert label is not None
    assert (label.name, label.width, label.height, label.intrinsics_from) == ("cam0", 1280, 720, "calibration")
    with pytest.raises(
        ConfigError, match=r"cameras\.cam0\.width: 640, but the calibration cal\.yaml is for 1280 x 720"
    ):
        load(tmp_path, {"cameras": {"cam0": {**camera, "width": 640}}})
    scaled = load(tmp_path, {"cameras": {"cam0": {**camera, "width": 640, "height": 360}}})
    assert scaled.calibration("cam0") == label  # the camera's process scales it, and says so


# --- cameras of a further file


def test_a_camera_file_brings_its_own_folder(tmp_path: Path) -> None:
    rig = load(tmp_path, {**one_box(), "cameras": {"cam0": {"driver": "synthetic"}}})
    folder = tmp_path / "conf.d"
    folder.mkdir()
    write(folder, CALIBRATION, "cal.yaml")
    further = write(folder, "cameras: {cam1: {driver: files, path: photos, calibration: cal.yaml}}\n", "cam1.yaml")

    both = rig.with_camera_file(further)

    camera = both.camera("cam1")
    assert both.resolve(Path(camera.options["path"])) == folder.resolve() / "photos"
    assert camera.calibration == folder.resolve() / "cal.yaml"
    assert both.calibration("cam1") is not None
    assert both.boxes == rig.boxes
    assert "cam1" not in rig.config.cameras
    assert differences(rig.as_plain(), both.as_plain()) == []


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("cameras: {cam0: {driver: synthetic}}", "1: cameras.cam0: the rig .* has a camera 'cam0' already"),
        ("cameras: {cam1: {driver: synthetik}}", "1: cameras.cam1.driver: there is no driver 'synthetik'"),
        ("cameras: {cam1: {driver: synthetic}}\nobjects: []", "2: objects: belongs to the rig file"),
        ("cameras: {}", "cameras: is missing"),
        ("", "is empty; a camera file"),
    ],
)
def test_a_broken_camera_file(text: str, says: str, tmp_path: Path) -> None:
    rig = load(tmp_path, {"cameras": {"cam0": {"driver": "synthetic"}}})
    with pytest.raises(ConfigError, match=f"more.yaml:? ?{says}"):
        rig.with_camera_file(write(tmp_path, text, "more.yaml"))


# --- sameness and differences


def test_rigs_of_the_same_content_are_equal_wherever_they_lie(tmp_path: Path) -> None:
    folders = [tmp_path / name for name in "ab"]
    rigs = []
    for folder in folders:
        folder.mkdir()
        rigs.append(load(folder, one_box()))
    assert rigs[0] == rigs[1]
    assert len(set(rigs)) == 1
    assert rigs[0] != load(folders[0], one_box(rotation_deg=90))


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"marker_size_mm": 40}, ["objects.box-1.sides.front.marker_size_mm: 50 -> 40"]),
        ({"marker": 7}, ["objects.box-1.sides.front.marker: 0 -> 7"]),
        ({"offset_mm": [5, 0]}, ["objects.box-1.sides.front.offset_mm: [0, 0, 0] -> [5, 0, 0]"]),
        ({"offset_mm": [0, 0, 0], "border_mm": 0.0, "rotation_deg": 0, "face": "front"}, []),
    ],
)
def test_differences_are_readable(changes: dict[str, Any], expected: list[str], tmp_path: Path) -> None:
    before, after = load(tmp_path, one_box()).as_plain(), load(tmp_path, one_box(**changes)).as_plain()
    assert differences(before, after) == expected
    assert differences(json.loads(json.dumps(before)), after) == expected


def test_added_objects_and_families_are_differences(tmp_path: Path) -> None:
    before = load(tmp_path, one_box()).as_plain()
    document = {**one_box(), "markers": {"family": "4X4_50"}}
    document["objects"].append(
        {**document["objects"][0], "name": "box-2", "sides": {"front": {"marker": 1, "marker_size_mm": 5}}}
    )
    found = differences(before, load(tmp_path, document).as_plain())
    assert found[0] == "markers.family: apriltag_36h11 -> 4x4_50"
    assert found[1].startswith("objects.box-2: (none) -> {type: box")
    assert len(found) == 2


def test_only_the_calibration_of_a_known_camera_is_a_difference(tmp_path: Path) -> None:
    write(tmp_path, CALIBRATION, "cal.yaml")
    write(tmp_path, CALIBRATION.replace("0.05", "0.06"), "other.yaml")
    cam0 = {"driver": "synthetic", "calibration": "cal.yaml", "fps": 30}
    before = load(tmp_path, {"cameras": {"cam0": cam0}}).as_plain()

    def after(**changes: Any) -> list[str]:
        cameras = {"cam0": {**cam0, **changes}, "cam1": {"driver": "synthetic"}}
        return differences(before, load(tmp_path, {"cameras": cameras}).as_plain())

    assert after(fps=15, seed=3) == []
    assert after(calibration="other.yaml") == [
        "cameras.cam0.calibration.distortion: [0.1, -0.2, 0, 0, 0.05] -> [0.1, -0.2, 0, 0, 0.06]"
    ]


def test_a_changed_dictionary_file_is_a_difference(tmp_path: Path) -> None:
    import cv2

    plain = []
    for start in (0, 4):
        path = tmp_path / "mine.yml"
        whole = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
        cv2.aruco.Dictionary(whole.bytesList[start : start + 4], 4, 0).writeDictionary(storage)
        storage.release()
        plain.append(load(tmp_path, {**one_box(), "markers": {"family": "mine.yml"}}).as_plain())
    (found,) = differences(*plain)
    assert found.startswith("markers.sha256: ")


# --- any good rig survives, any text is told about

sizes = st.floats(60, 2000, allow_nan=False).map(lambda value: round(value, 3))


@st.composite
def good_rigs(draw: st.DrawFn) -> dict[str, Any]:
    """Objects with one small marker a face, none beyond its side, ids used once."""
    ids = iter(draw(st.lists(st.integers(0, 586), min_size=30, max_size=30, unique=True)))
    objects = []
    for number in range(draw(st.integers(0, 3))):
        faces = draw(st.lists(st.sampled_from(list(FACES)), min_size=1, max_size=6, unique=True))
        sides = {
            f"class.{face}": {
                "face": face,
                "marker": next(ids),
                "marker_size_mm": draw(st.floats(1, 20)),
                "border_mm": draw(st.floats(0, 5)),
                "offset_mm": draw(st.lists(st.floats(-5, 5), min_size=2, max_size=3)),
                "rotation_deg": draw(st.floats(-360, 360)),
            }
            for face in faces
        }
        size = {key: draw(sizes) for key in ("width", "height", "depth")}
        objects.append({"name": f"object-{number}", "size_mm": size, "sides": sides})
    cameras = {
        f"cam{number}": {"driver": "synthetic", "width": draw(st.integers(16, 4096)), "seed": draw(st.integers(0, 9))}
        for number in range(draw(st.integers(0, 3)))
    }
    return {"objects": objects, "cameras": cameras}


@settings(deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(document=good_rigs())
def test_a_good_rig_is_read_as_written(document: dict[str, Any], tmp_path: Path) -> None:
    rig = load(tmp_path, document)
    assert [box.name for box in rig.boxes] == [one["name"] for one in document["objects"]]
    for box, one in zip(rig.boxes, document["objects"], strict=True):
        assert box.size_mm == tuple(one["size_mm"][key] for key in ("width", "height", "depth"))
        for side in box.sides:
            (marker,), given_side = side.markers, one["sides"][side.class_name]
            assert (side.face, marker.id, marker.size_mm) == (
                given_side["face"],
                given_side["marker"],
                given_side["marker_size_mm"],
            )
    plain = rig.as_plain()
    assert differences(json.loads(json.dumps(plain)), plain) == []
    assert load_rig(rig.path) == rig


@settings(deadline=None, max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_whatever_is_cut_or_put_in_is_told_and_never_a_crash(data: st.DataObject, tmp_path: Path) -> None:
    text = (EXAMPLES / "paper.yaml").read_text()
    at = data.draw(st.integers(0, len(text)))
    until = data.draw(st.integers(at, min(len(text), at + 60)))
    put_in = data.draw(st.text(st.sampled_from("[]{}:,-&*!|>'\"%@`#?\t\n 0.e~<\\xé\u2028"), max_size=12))
    path = tmp_path / "rig.yaml"
    path.write_text(text[:at] + put_in + text[until:], encoding="utf-8")
    try:
        load_rig(path, inputs=True)
    except ConfigError as error:
        assert all(problem.startswith(str(path)) for problem in error.problems)  # noqa: PT017 - both ways are right
