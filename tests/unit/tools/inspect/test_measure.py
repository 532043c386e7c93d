"""What is measured on one sample, in this process."""

from __future__ import annotations

from pathlib import Path

from common.dataset import SessionReader
from common.dataset.boxes import boxes_of
from common.geometry import CameraModel
from tests.support.recorded import Painter, label_of, moving, write_session
from tools.export.classes import naming
from tools.export.model import Source
from tools.export.targets import targets_of
from tools.inspect.measure import Inspector, Job


def test_a_window_has_the_class_that_an_export_gives_it(tmp_path: Path) -> None:
    """The side that faces the camera most, whether or not one of its markers was seen (these labels name none)."""
    write_session(tmp_path, ((label_of(n, moving(n)), Painter().paint(moving(n))) for n in range(0, 40, 7)))
    reader = SessionReader(tmp_path)
    boxes = boxes_of(reader.session, tmp_path)
    inspector = Inspector(Job(tmp_path, boxes, None, pictures=False))
    seen = set()
    for sample in reader.samples():
        source = Source(tmp_path, reader.label(sample), {box.name: box for box in boxes})
        camera = CameraModel.from_label(source.label.camera)
        exported = targets_of(source, camera, naming("side", boxes, all_sides=False), (), all_sides=False)
        found = {item.name: item for item in inspector.look(sample).objects}
        for target in exported:
            assert found[target.item.name].class_name == target.class_name
            assert 0.0 <= found[target.item.name].angle_deg < 90.0
            seen.add(target.class_name)
    assert len(seen) > 1
