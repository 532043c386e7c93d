"""Sessions made again from their originals, against sessions that were recorded with the other rig at once."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from common.config.calibration import write_calibration
from common.dataset import SessionReader, read_session
from common.dataset.locks import FolderLock
from common.geometry import Box, Pose
from services.capture.cameras.intrinsics import label_of
from services.label.labelling import Around
from services.label.pose import Prior
from services.label.sightings import Expected, Sighting
from tests.support.rendered_session import BOXES, Plan, camera, record_session
from tools.cli import main
from tools.relabel import session as session_module
from tools.relabel.carry import Described, carried
from tools.relabel.recipe import recipe_of

COUNT = 6


def mistaken(box: Box) -> Box:
    """The box with its front marker noted 12 mm beside its place."""
    sides = tuple(
        replace(
            side,
            markers=tuple(
                replace(marker, offset_mm=(marker.offset_mm[0] + 12.0, *marker.offset_mm[1:]))
                for marker in side.markers
            ),
        )
        if side.face == "front"
        else side
        for side in box.sides
    )
    return replace(box, sides=sides)


WRONG = (mistaken(BOXES[0]), BOXES[1])


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The same frames recorded with the right rig (``right``) and with the mistaken one (``wrong``)."""
    root = tmp_path_factory.mktemp("dataset")
    for name, boxes in (("right", BOXES), ("wrong", WRONG)):
        record_session(Plan(root / name, apart=9, width=480, height=270, original=True, boxes=boxes), COUNT, 1)
    assert len(SessionReader(root / "wrong").samples()) > COUNT // 2
    return root / "right", root / "wrong"


def rig_file(path: Path, boxes: tuple[Box, ...] = BOXES, **more: Any) -> Path:
    """A rig file of boxes."""
    objects = [
        {
            "name": box.name,
            "type": box.type,
            "size_mm": dict(zip(("width", "height", "depth"), box.size_mm, strict=True)),
            "sides": {
                side.class_name: {
                    "face": side.face,
                    "marker": marker.id,
                    "marker_size_mm": marker.size_mm,
                    "border_mm": marker.border_mm,
                    "offset_mm": list(marker.offset_mm),
                }
                for side in box.sides
                for marker in side.markers
            },
        }
        for box in boxes
    ]
    path.write_text(yaml.safe_dump({"dataset": {"root": str(path.parent)}, "objects": objects, **more}))
    return path


def relabel(*words: str | Path, code: int = 0, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    capsys.readouterr()
    assert main(["relabel", *map(str, words), "--json"]) == code
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def content(folder: Path) -> dict[str, bytes]:
    """Pictures and labels by name; the session's own name is cut out of the labels."""
    name = f'"session": "{folder.name}",'.encode()
    return {
        f"{path.parent.name}/{path.name}": path.read_bytes().replace(name, b"")
        for kind in ("rgb", "depth", "original", "label")
        for path in (folder / kind).iterdir()
    }


def test_by_the_same_rig_every_byte_is_the_same(recorded, tmp_path, capsys):
    right, _ = recorded
    found = relabel(right, "--as-recorded", "--into", "again", "--diff", capsys=capsys)["made"][0]
    count = len(SessionReader(right).samples())
    assert (found["samples"], found["moved"]["same_labels"], found["moved"]["same_pictures"]) == (count, count, count)
    assert found["moved"]["objects"]["box-1"]["corners_px"]["largest"] == 0
    again = right.with_name("again")
    assert content(again) == content(right)
    assert SessionReader(again).session.recordings == SessionReader(right).session.recordings
    assert (again / "original").stat().st_mtime_ns
    for path in (right / "original").iterdir():
        assert path.samefile(again / "original" / path.name), "originals are linked"


def test_a_corrected_rig_gives_what_it_would_have_recorded(recorded, tmp_path, capsys):
    right, wrong = recorded
    found = relabel(wrong, "--rig", rig_file(tmp_path / "rig.yaml"), "--into", "mended", "--diff", capsys=capsys)[
        "made"
    ][0]
    assert found["changes"] == ["objects.box-1.sides.front.offset_mm: [-48, 40, 0] -> [-60, 40, 0]"]
    mended, truth = content(wrong.with_name("mended")), content(right)
    both = mended.keys() & truth.keys()
    assert len(both) == len(mended)
    assert {name: mended[name] for name in both} == {name: truth[name] for name in both}
    moved = found["moved"]["objects"]
    assert moved["box-1"]["corners_px"]["largest"] > 1
    assert moved["box-1"]["position_mm"]["largest"] > 1
    assert moved["box-2"]["corners_px"]["largest"] == 0
    session = SessionReader(wrong.with_name("mended")).session
    assert session.rig["objects"] == SessionReader(right).session.rig["objects"]


def test_another_calibration_and_another_fill(recorded, tmp_path, capsys):
    right, _ = recorded
    known = SessionReader(right).label(SessionReader(right).samples()[0]).camera
    (fx, _, cx), (_, fy, cy), last = known.matrix
    longer = known.model_copy(update={"matrix": ((fx * 1.1, 0.0, cx), (0.0, fy * 1.1, cy), last)})
    write_calibration(tmp_path / "cam0.yaml", longer)
    camera = {"driver": "synthetic", "width": known.width, "height": known.height, "fps": 10}
    rig = rig_file(tmp_path / "rig.yaml", inpaint={"method": "telea"}, cameras={"cam0": camera})
    found = relabel(
        right, "--rig", rig, "--calibration", f"cam0={tmp_path / 'cam0.yaml'}", "--into", "longer", "--diff",
        code=78, capsys=capsys,
    )  # fmt: skip
    assert "the session has none" in found["error"]["message"]
    camera["calibration"] = "cam0.yaml"
    rig = rig_file(tmp_path / "rig.yaml", inpaint={"method": "telea"}, cameras={"cam0": camera})
    found = relabel(right, "--rig", rig, "--into", "longer", "--diff", capsys=capsys)["made"][0]
    moved = found["moved"]["objects"]["box-1"]["distance_mm"]
    reader = SessionReader(right.with_name("longer"))
    label = reader.label(reader.samples()[0])
    assert label.camera.matrix == longer.matrix
    assert label.inpainted.method == "telea"
    before = [SessionReader(right).label(sample).objects[0].distance_mm for sample in reader.samples()]
    # Seen from several sides a box resists: not each is further away by the whole 10 %.
    assert 0.04 < moved["median"] / float(np.median(before)) < 0.12


def test_a_run_that_was_cut_off_is_gone_on_with(recorded, tmp_path, capsys):
    right, _ = recorded
    target = right.with_name("resumed")
    done: list[int] = []

    def interrupted(total: int):
        def tick() -> None:
            done.append(total)
            if len(done) == 3:
                raise KeyboardInterrupt

        return tick

    made = recipe_of(read_session(right), right, None, ())
    with pytest.raises(KeyboardInterrupt):
        session_module.relabel(right, target, made, interrupted)
    assert not target.exists()
    found = relabel(right, "--as-recorded", "--into", "resumed", capsys=capsys)["made"][0]
    assert found["made_before"] >= 3
    assert found["samples"] == len(SessionReader(right).samples())
    assert content(target) == content(right)
    times = {path: path.stat().st_mtime_ns for path in target.rglob("*")}
    found = relabel(right, "--as-recorded", "--into", "resumed", capsys=capsys)["made"][0]
    assert found["unchanged"]
    assert times == {path: path.stat().st_mtime_ns for path in target.rglob("*")}
    refused = relabel(
        right, "--rig", rig_file(tmp_path / "rig.yaml", WRONG), "--into", "resumed", code=3, capsys=capsys
    )
    assert refused["error"]["code"] == "session_exists"


def test_what_can_not_be_made_again_is_said(recorded, tmp_path, capsys):
    right, _ = recorded
    plain = tmp_path / "plain"
    shutil.copytree(right, plain, ignore=shutil.ignore_patterns("original"))
    assert relabel(plain, code=3, capsys=capsys)["error"]["code"] == "no_original"
    with FolderLock(right):
        found = relabel(right, "--as-recorded", "--into", "held", code=3, capsys=capsys)
    assert found["error"]["code"] == "session_busy"
    assert relabel(right, plain, "--into", "two", code=3, capsys=capsys)["error"]["code"] == "refused"


def test_damaged_originals_are_left_out_and_named(recorded, tmp_path, capsys):
    folder = tmp_path / "damaged"
    shutil.copytree(recorded[0], folder)
    names = SessionReader(folder).samples()
    (folder / "original" / f"original_{names[0]}.png").write_bytes(b"no picture")
    found = relabel(folder, "--as-recorded", capsys=capsys)["made"][0]
    assert found["left_out"] == {"damaged": 1}
    assert names[0] in found["sentences"]
    again = SessionReader(folder.with_name("damaged-relabelled"))
    assert again.samples() == names[1:]
    removed = [json.loads(line) for line in (again.folder / "bin" / "removed.jsonl").read_text().splitlines()]
    assert [row["sample"] for row in removed] == [names[0]], "the ledger adds up"
    assert main(["inspect", str(again.folder), "--verify"]) == 0


def test_the_poses_of_other_frames_are_told_by_the_new_rig() -> None:
    """Solved by the mistaken rig, then carried over: as if the right rig had solved it."""
    label = label_of("cam0", camera(), intrinsics_from="truth")
    turn, _ = cv2.Rodrigues(np.array([0.2, 0.6, 0.1]))
    facing, _ = cv2.Rodrigues(np.array([np.pi / 2, 0.0, 0.0]))
    true = Pose(np.asarray(turn) @ np.asarray(facing), np.array([40.0, -20.0, 900.0]))
    # Only the front is seen, so the mistake of 12 mm along its right moves the whole box.
    right = replace(BOXES[0], sides=BOXES[0].sides[:1])
    wrong = mistaken(right)
    solved = Pose(true.rotation, true.translation - true.rotation @ np.array([12.0, 0.0, 0.0]))
    seen = Sighting(5, solved, np.eye(6))
    around = Around(
        {"box-1": Prior(solved, 9.0), "box-2": Prior(true, 1.0)}, (Expected("box-1", 9, seen),), steady=True
    )
    boxes = {"box-1": wrong, "box-2": BOXES[1]}, {"box-1": right, "box-2": BOXES[1]}
    found = carried(around, Described(boxes[0], label), Described(boxes[1], label))
    for pose in (found.previous["box-1"].pose, found.expected[0].before.pose):
        assert pose.angle_to(true) < 1e-4
        assert pose.translation == pytest.approx(true.translation, abs=0.01)
    assert found.previous["box-2"].pose is true
    assert carried(around, Described(boxes[0], label), Described(boxes[0], label)) is around
