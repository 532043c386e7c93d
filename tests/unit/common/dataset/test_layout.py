import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.dataset import PICTURES, label_path, picture_path
from common.dataset.layout import sample_of_label, sample_of_picture
from common.ids import NAME_PATTERN, sample_name

SAMPLE = "20260830T120431.120Z-cam0-48211"


def test_names_are_those_of_the_design() -> None:
    assert str(picture_path("rgb", SAMPLE)) == f"rgb/rgb_{SAMPLE}.png"
    assert str(picture_path("depth", SAMPLE)) == f"depth/depth_{SAMPLE}.png"
    assert str(picture_path("original", SAMPLE)) == f"original/original_{SAMPLE}.png"
    assert str(label_path(SAMPLE)) == f"label/label_{SAMPLE}.json"


@given(
    wall=st.integers(0, 4_000_000_000 * 10**9),
    camera=st.from_regex(NAME_PATTERN, fullmatch=True),
    frame=st.integers(0, 10**18 - 1),
)
def test_a_sample_is_found_in_its_files_names(wall: int, camera: str, frame: int) -> None:
    camera = camera.strip()
    sample = sample_name(wall, camera, frame)
    assert sample_of_label(label_path(sample).name) == sample
    for kind in PICTURES:
        assert sample_of_picture(kind, picture_path(kind, sample).name) == sample
        assert sample_of_picture(kind, picture_path(kind, sample, "jpg").name) == sample


@pytest.mark.parametrize(
    "name",
    [
        "",
        "label_.json",
        "label_a.json",
        f"{SAMPLE}.json",
        f"label_{SAMPLE}.json.bak",
        f".label_{SAMPLE}.json.tmp",
        f"label_{SAMPLE}\n.json",
    ],
)
def test_other_names_belong_to_no_sample(name: str) -> None:
    assert sample_of_label(name) is None
    assert sample_of_picture("rgb", name) is None


@given(st.text())
def test_any_text_is_taken_apart_without_an_error(name: str) -> None:
    assert sample_of_label(name) is None or name.startswith("label_")
    sample_of_picture("rgb", name)
