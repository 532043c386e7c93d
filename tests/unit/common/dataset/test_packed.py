"""Samples in the list's memory: small, and whole again."""

import sys

from common.dataset.layout import PICTURES, picture_path
from common.dataset.listing import item_of_label
from common.dataset.packed import pack, peek, unpack
from common.messages import SampleItem
from tests.support.samples import label_for, object_label


def item(objects: int) -> SampleItem:
    label = label_for(7).model_copy(update={"objects": tuple(map(object_label, range(objects)))})
    return item_of_label(label, {kind: str(picture_path(kind, label.sample)) for kind in PICTURES})


def test_what_is_packed_comes_back() -> None:
    for objects in (0, 1, 3):
        whole = item(objects)
        again = unpack(whole.name, pack(whole))
        assert again == whole
        assert SampleItem.model_validate(again.model_dump(), strict=True) == whole


def test_what_is_looked_at_has_the_same_attributes() -> None:
    whole = item(2)
    looked = peek(whole.name, pack(whole))
    for field in set(SampleItem.model_fields) - {"objects"}:
        assert getattr(looked, field) == getattr(whole, field)
    assert [vars(found) for found in looked.objects] == [dict(found) for found in whole.objects]


def test_a_sample_of_two_objects_takes_less_than_half_a_kilobyte() -> None:
    assert sys.getsizeof(pack(item(2))) < 500
