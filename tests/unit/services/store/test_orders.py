import pytest

from common.bus import Return
from common.messages import Answer, ErrorInfo, StoreOrder
from services.store.orders import StoreOrders, fault
from tests.support.samples import label_for

A, B = Return(b"a"), Return(b"b")


def order(frame: int = 1, ring: str = "ring", slot: int = 0) -> StoreOrder:
    label = label_for(frame)
    return StoreOrder(key=label.sample, recording="rec-a", camera="cam0", ring=ring, slot=slot, label=label)


def test_a_repeat_in_work_gets_the_same_answer_once() -> None:
    table = StoreOrders()
    assert not table.join(A, order())
    table.begin(A, order())
    assert table.join(A, order())
    assert table.join(B, order())
    assert len(table) == 1
    assert table.finish(order(), Answer(key=order().key)) == [A, B]
    assert len(table) == 0
    assert not table.join(A, order())


def test_a_refusal_is_remembered_for_the_pixels_it_was_about() -> None:
    table = StoreOrders()
    refusal = Answer(key=order().key, error=ErrorInfo(code="disk_full", message="x"))
    table.begin(A, order())
    table.finish(order(), refusal)
    assert table.refusal(order()) == refusal
    assert table.refusal(order(ring="another life's")) is None
    assert table.refusal(order(slot=1)) is None
    table.begin(A, order(2))
    table.finish(order(2), Answer(key=order(2).key, samples=(order(2).key,)))
    assert table.refusal(order(2)) is None


def test_refusals_are_not_kept_for_ever() -> None:
    table = StoreOrders()
    refused = order()
    for slot in range(5000):
        again = refused.model_copy(update={"slot": slot})
        table.begin(A, again)
        table.finish(again, Answer(key=again.key, error=ErrorInfo(code="x", message="x")))
    assert table.refusal(refused) is None
    assert table.refusal(refused.model_copy(update={"slot": 4999})) is not None


def test_a_good_order_has_no_fault() -> None:
    assert fault(order()) is None


@pytest.mark.parametrize(
    "change",
    [
        {"key": "../../etc/passwd"},
        {"key": ""},
        {"key": label_for(2).sample},
        {"key": label_for(1).sample + "\n"},
        {"camera": "cam1"},
        {"recording": "rec-b"},
        {"label": label_for(1).model_copy(update={"sample": "x/../../y"})},
    ],
)
def test_an_order_that_contradicts_itself_is_refused(change: dict[str, object]) -> None:
    wrong = fault(order().model_copy(update=change))
    assert wrong is not None
    assert wrong.code == "bad_sample"
