"""Every kind of mistake in a rig file is told with its line, its field and a reason."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import pytest

from common.config import load_rig
from common.errors import EXIT_BAD_CONFIG, ConfigError

GOOD = """\
dataset: {root: ./dataset, session: monday}
markers: {family: apriltag_36h11}
objects:
  - name: box-1
    type: box
    size_mm: {width: 400, height: 300, depth: 200}
    sides:
      front: {marker: 0, marker_size_mm: 50, border_mm: 10}
      left: {marker: 1, marker_size_mm: 50, border_mm: 10, offset_mm: [20, -35]}
      lid: {face: top, marker: 2, marker_size_mm: 50}
cameras:
  cam0: {driver: synthetic, width: 1280, height: 720, fps: 30}
"""


class Broken(NamedTuple):
    """One change of ``GOOD`` and what is said about it."""

    what: str
    old: str
    new: str
    line: int
    field: str
    says: str


TABLE = (
    Broken("text for a number", "width: 400", "width: wide", 6, "objects[0].size_mm.width", "must be a number"),
    Broken("a unit", "width: 400", "width: 400 mm", 6, "objects[0].size_mm.width", "write 400 without the unit"),
    Broken("bool for a number", "marker_size_mm: 50}", "marker_size_mm: true}", 10,
           "objects[0].sides.lid.marker_size_mm", "must be a number, not true"),
    Broken("bool for a whole number", "marker: 2", "marker: true", 10, "objects[0].sides.lid.marker", "not true"),
    Broken("fraction for a whole number", "marker: 2", "marker: 2.5", 10, "objects[0].sides.lid.marker",
           "must be a whole number"),
    Broken("number for a bool", "session: monday", "keep_original: 1", 1, "dataset.keep_original", "true or false"),
    Broken("yes for true", "session: monday", "keep_original: yes", 1, "dataset.keep_original", "not 'yes'"),
    Broken("number for a name", "name: box-1", "name: 1", 4, "objects[0].name", 'write it in quotes: "1"'),
    Broken("list for a map", "dataset: {root: ./dataset, session: monday}", "dataset: [a, b]", 1, "dataset",
           "must be a map (key: value), not a list"),
    Broken("map for a list", "offset_mm: [20, -35]", "offset_mm: {right: 20}", 9, "objects[0].sides.left.offset_mm",
           "must be a list, not a map"),
    Broken("scalar for an object", "  - name: box-1", "  - 5\n  - name: box-1", 4, "objects[0]", "must be a map"),
    Broken("empty section", "markers: {family: apriltag_36h11}", "markers:", 2, "markers", "not nothing"),
    Broken("negative size", "depth: 200", "depth: -200", 6, "objects[0].size_mm.depth", "must be greater than 0"),
    Broken("zero size", "depth: 200", "depth: 0", 6, "objects[0].size_mm.depth", "0 is not allowed"),
    Broken("infinity", "depth: 200", "depth: .inf", 6, "objects[0].size_mm.depth", "finite number"),
    Broken("not a number", "fps: 30", "fps: .nan", 12, "cameras.cam0.fps", ".nan is not allowed"),
    Broken("beyond all numbers", "depth: 200", "depth: 1e999", 6, "objects[0].size_mm.depth", "too large"),
    Broken("picture too large", "height: 720", "height: 72000", 12, "cameras.cam0.height", "must be at most 16384"),
    Broken("too few offsets", "[20, -35]", "[20]", 9, "objects[0].sides.left.offset_mm", "needs at least 2"),
    Broken("too many offsets", "[20, -35]", "[1, 2, 3, 4]", 9, "objects[0].sides.left.offset_mm", "at most 3"),
    Broken("text among offsets", "[20, -35]", "[20, up]", 9, "objects[0].sides.left.offset_mm[1]", "must be a number"),
    Broken("missing size part", ", depth: 200", "", 6, "objects[0].size_mm.depth", "is missing"),
    Broken("missing driver", "driver: synthetic, ", "", 12, "cameras.cam0.driver", "is missing"),
    Broken("missing object name", "- name: box-1\n    type: box", "- type: box", 4, "objects[0].name", "is missing"),
    Broken("missing sizes", "    size_mm: {width: 400, height: 300, depth: 200}\n", "", 4, "objects[0]",
           "size_mm is missing"),
    Broken("missing marker", "marker: 2, marker_size_mm: 50", "border_mm: 5", 10, "objects[0].sides.lid",
           "marker or markers is missing"),
    Broken("missing marker size", "marker: 2, marker_size_mm: 50", "marker: 2", 10, "objects[0].sides.lid",
           "marker_size_mm is missing"),
    Broken("marker beside markers", "marker: 2, marker_size_mm: 50",
           "marker: 2, markers: [{marker: 5, marker_size_mm: 20}]", 10, "objects[0].sides.lid.marker",
           "stands beside markers"),
    Broken("no sides", "    sides:\n", "    sides: {}\n    x:\n", 7, "objects[0].sides", "at least 1"),
    Broken("no markers", "marker: 2, marker_size_mm: 50", "markers: []", 10, "objects[0].sides.lid.markers",
           "0 entries"),
    Broken("unknown section", "markers: {", "marker: {", 2, "marker", "did you mean 'markers'?"),
    Broken("unknown key", "border_mm: 10}", "boarder_mm: 10}", 8, "objects[0].sides.front.boarder_mm",
           "did you mean 'border_mm'?"),
    Broken("unknown key of a driver", "fps: 30}", "fps: 30, sede: 4}", 12, "cameras.cam0.sede", "did you mean 'seed'?"),
    Broken("bad value of a driver", "fps: 30}", "fps: 30, noise: -1}", 12, "cameras.cam0.noise", "must be at least 0"),
    Broken("missing key of a driver", "driver: synthetic", "driver: files", 12, "cameras.cam0.path", "is missing"),
    Broken("unknown driver", "driver: synthetic", "driver: syntetic", 12, "cameras.cam0.driver",
           "did you mean 'synthetic'?"),
    Broken("unknown face", "lid: {face: top", "lid: {face: topp", 10, "objects[0].sides.lid.face",
           "did you mean 'top'?"),
    Broken("side that is no face", "left: {", "lefft: {", 9, "objects[0].sides.lefft", "did you mean 'left'?"),
    Broken("unknown family", "apriltag_36h11", "apriltag_36h12", 2, "markers.family", "apriltag_36h11"),
    Broken("family file that isn't there", "apriltag_36h11", "mine.yml", 2, "markers.family", "does not exist"),
    Broken("id outside the family", "marker: 2", "marker: 587", 10, "objects[0].sides.lid.marker", "0 to 586"),
    Broken("negative id", "marker: 2", "marker: -2", 10, "objects[0].sides.lid.marker", "must be at least 0"),
    Broken("marker on two sides", "marker: 2", "marker: 0", 10, "objects[0].sides.lid.marker",
           "first by objects[0].sides.front.marker (line 8)"),
    Broken("marker too large for its side", "marker_size_mm: 50}", "marker_size_mm: 210}", 10,
           "objects[0].sides.lid.marker", "reaches 5 mm beyond the upper edge"),
    Broken("marker over the edge by its offset", "[20, -35]", "[80, 0]", 9, "objects[0].sides.left.marker",
           "reaches 15 mm beyond the right edge"),
    Broken("marker over the edge by its rotation", "[20, -35]", "[65, 0], rotation_deg: 45", 9,
           "objects[0].sides.left.marker", "turned by 45 degrees"),
    Broken("overlapping markers", "lid: {face: top, marker: 2, marker_size_mm: 50}",
           "logo: {face: front, marker: 2, marker_size_mm: 50, offset_mm: [49, 0]}", 10, "objects[0].sides.logo",
           "overlaps marker 0 of side 'front'"),
    Broken("side size against object size", "marker: 1,", "marker: 1, size_mm: {width: 200, height: 300, depth: 410},",
           9, "objects[0].sides.left.size_mm", "makes the box 410 x 300 x 200"),
    Broken("bad object name", "name: box-1", "name: box 1", 4, "objects[0].name", "can't be a name"),
    Broken("bad camera name", "cam0:", "cam/0:", 12, "cameras.cam/0", "can't be a name"),
    Broken("bad session name", "session: monday", "session: ../up", 1, "dataset.session", "can't be a name"),
    Broken("unknown choice", "cameras:", "inpaint: {method: telia}\ncameras:", 11, "inpaint.method",
           "did you mean 'telea'?"),
    Broken("calibration that isn't there", "fps: 30", "calibration: cal.yaml", 12, "cameras.cam0.calibration",
           "there is no such file"),
    Broken("command is no address", "cameras:", "network: {command: localhost}\ncameras:", 11, "network.command",
           "is no ZeroMQ address"),
    Broken("command without port", "cameras:", "network: {command: 'tcp://127.0.0.1:x'}\ncameras:", 11,
           "network.command", "the port must be 1 to 65535"),
    Broken("open command without keys", "cameras:", "network: {command: 'tcp://0.0.0.0:5750'}\ncameras:", 11,
           "network.command", "can be reached from other machines"),
    Broken("keys folder that isn't there", "cameras:", "network: {keys: keys}\ncameras:", 11, "network.keys",
           "there is no folder"),
    Broken("console is no URL", "cameras:", "network: {console: here}\ncameras:", 11, "network.console",
           "is no console address"),
    Broken("key twice", "fps: 30", "fps: 30, fps: 25", 12, "cameras.cam0.fps", "is given twice (first on line 12)"),
    Broken("section twice", "cameras:", "markers: {}\ncameras:", 11, "markers", "first on line 2"),
    Broken("merge key", "fps: 30", "<<: 1", 12, "cameras.cam0", "merge keys (<<) are not supported"),
    Broken("YAML tag", "fps: 30", "fps: !!python/name:os.system x", 12, "cameras.cam0.fps", "YAML tag"),
    Broken("control character", "type: box", 'type: "b\\0x"', 5, "objects[0].type", "control character"),
    Broken("tab", "    type: box", "\ttype: box", 5, "", "indented with a tab"),
    Broken("no end of a list", "[20, -35]", "[20, -35", 9, "", "no valid YAML"),
    Broken("unknown alias", "depth: 200", "depth: *deep", 6, "", "undefined alias"),
    Broken("two documents", "cameras:", "---\ncameras:", 11, "", "another document"),
    Broken("endless alias", "type: box", "type: &a [*a]", 5, "", "aliases"),
)  # fmt: skip


@pytest.mark.parametrize("case", TABLE, ids=[case.what for case in TABLE])
def test_a_mistake_is_told_with_line_field_and_reason(case: Broken, tmp_path: Path) -> None:
    assert case.old in GOOD
    path = tmp_path / "rig.yaml"
    path.write_text(GOOD.replace(case.old, case.new, 1))

    with pytest.raises(ConfigError) as caught:
        load_rig(path)

    assert caught.value.exit_code == EXIT_BAD_CONFIG
    start = f"{path}:{case.line}: {case.field}: " if case.field else f"{path}:{case.line}: "
    told = [problem for problem in caught.value.problems if problem.startswith(start)]
    assert told, caught.value.problems
    assert any(case.says in problem for problem in told), told


def test_the_table_starts_from_a_good_rig(tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(GOOD)
    assert load_rig(path).warnings == ()


def test_one_mistake_is_told_once(tmp_path: Path) -> None:
    """A broken field takes nothing else with it: no size is 'missing' because its depth is negative."""
    path = tmp_path / "rig.yaml"
    alone = {"two documents", "missing marker size", "no sides"}
    for case in TABLE:
        path.write_text(GOOD.replace(case.old, case.new, 1))
        with pytest.raises(ConfigError) as caught:
            load_rig(path)
        if case.what not in alone:
            assert len(caught.value.problems) == 1, (case.what, caught.value.problems)


def test_all_mistakes_of_a_file_are_told_at_once_from_top_to_bottom(tmp_path: Path) -> None:
    text = GOOD
    chosen = ("yes for true", "unknown family", "number for a name", "too few offsets", "marker on two sides",
              "unknown driver")  # fmt: skip
    cases = [case for case in TABLE if case.what in chosen]
    for case in cases:
        text = text.replace(case.old, case.new, 1)
    path = tmp_path / "rig.yaml"
    path.write_text(text)

    with pytest.raises(ConfigError) as caught:
        load_rig(path)

    problems = caught.value.problems
    assert len(problems) == len(cases)
    lines = [int(problem.removeprefix(f"{path}:").split(":")[0]) for problem in problems]
    assert lines == sorted(lines)
    for case in cases:
        assert sum(case.field in problem and case.says in problem for problem in problems) == 1, (case, problems)


def test_two_objects_that_claim_one_marker_and_one_name(tmp_path: Path) -> None:
    second = "".join(f"{line}\n" for line in GOOD.splitlines()[3:8])
    path = tmp_path / "rig.yaml"
    path.write_text(GOOD.replace("cameras:", second + "cameras:"))

    with pytest.raises(ConfigError) as caught:
        load_rig(path)

    names, markers = caught.value.problems
    assert names.startswith(f"{path}:11: objects[1].name: 'box-1' is the name of another object")
    assert "objects[0].name (line 4)" in names
    assert markers.startswith(f"{path}:15: objects[1].sides.front.marker: marker 0 is claimed twice")


def test_markers_in_a_list_are_told_by_their_number(tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    listed = "markers: [{marker: 5, marker_size_mm: 20}, {marker: 5, marker_size_mm: 20, offset_mm: [300, 0]}]"
    path.write_text(GOOD.replace("marker: 2, marker_size_mm: 50", listed))

    with pytest.raises(ConfigError) as caught:
        load_rig(path)

    field = f"{path}:10: objects[0].sides.lid.markers[1].marker: "
    assert [problem.startswith(field) for problem in caught.value.problems] == [True, True]


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "is empty"),
        (b"# nothing yet\n", "is empty"),
        (b"- a\n- b\n", ":1: must be a map (key: value) at the top, not a list"),
        (b"hello\n", "not a single value"),
        (b"dataset:\n  root: caf\xe9\n", ":2: is not UTF-8 text (byte 0xe9)"),
        (b"a: \x00\n", ":1: contains a character"),
        (b"a: " + b"[" * 3000, "nested deeper"),
        (b"a: " + b"x" * 300_000, "larger than 256 KiB"),
        (b"".join(b"k%d: &k%d [%s]\n" % (i, i, b"*k%d,*k%d" % (i - 1, i - 1) if i else b"1") for i in range(40)),
         "aliases"),
    ],
)  # fmt: skip
def test_a_file_that_is_no_map_of_keys(content: bytes, says: str, tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    path.write_bytes(content)
    with pytest.raises(ConfigError) as caught:
        load_rig(path)
    assert len(caught.value.problems) == 1
    assert str(path) in caught.value.problems[0]
    assert says in caught.value.problems[0]


def test_a_missing_file_and_a_folder(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"missing\.yaml: there is no such file"):
        load_rig(tmp_path / "missing.yaml")
    with pytest.raises(ConfigError, match="is a directory"):
        load_rig(tmp_path)


def test_a_dataset_root_below_a_file(tmp_path: Path) -> None:
    (tmp_path / "dataset").write_text("a file")
    path = tmp_path / "rig.yaml"
    path.write_text(GOOD)
    with pytest.raises(ConfigError, match=r"rig\.yaml:1: dataset\.root: .*dataset is not a folder"):
        load_rig(path)


def test_inputs_that_are_not_there_are_told_where_asked(tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(GOOD.replace("driver: synthetic", "driver: files, path: photos/*.png, depth_path: depth"))

    assert load_rig(path).config.cameras["cam0"].driver == "files"
    with pytest.raises(ConfigError) as caught:
        load_rig(path, inputs=True)
    first, second = caught.value.problems
    assert first == f"{path}:12: cameras.cam0.path: there is nothing at {tmp_path.resolve()}/photos/*.png"
    assert "cameras.cam0.depth_path: there is nothing" in second

    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "a.png").touch()
    (tmp_path / "depth").mkdir()
    assert load_rig(path, inputs=True)
