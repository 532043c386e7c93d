"""The list of samples: read once, kept by the store's news, read anew where a piece of news was missed."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from common.messages import SamplesChanged, Stamp
from services.console.catalog import Catalog

Plain = dict[str, Any]


class Store:
    """Answers `samples` as the store does, in pages of two; counts how often it was asked."""

    def __init__(self, *names: str, session: str = "s") -> None:
        self.stored, self.binned, self.session = list(names), list[str](), session
        self.asked: list[Plain] = []
        self.refusal: Plain | None = None

    async def ask(self, fields: Plain, limit_s: float) -> Plain:
        self.asked.append(fields)
        if self.refusal is not None:
            return self.refusal
        binned = fields["filter"]["bin"]
        names = sorted(self.binned if binned else self.stored, reverse=True)
        begin = fields["offset"]
        page = names[begin : begin + min(2, fields["limit"])]
        following = begin + len(page) if begin + len(page) < len(names) else None
        return {"ok": True, "session": self.session, "samples": [item(name, binned) for name in page],
                "next_offset": following}  # fmt: skip


def item(name: str, binned: bool = False) -> Plain:
    return {"name": name, "files": {"rgb": f"{'bin/' if binned else ''}rgb/rgb_{name}.png"}}


def news(seq: int, what: str, *samples: str, session: str = "s", boot: str = "b") -> SamplesChanged:
    stamp = Stamp(source="store", boot=boot, seq=seq, mono_ns=0, wall_ns=0)
    return SamplesChanged(what=what, session=session, samples=samples, stored=0, in_bin=0, stamp=stamp)


def refreshed(catalog: Catalog) -> Plain | None:
    return asyncio.run(catalog.refresh())


def test_all_pages_are_read_once_and_then_nothing_is_asked() -> None:
    store = Store("a", "b", "c")
    store.binned = ["x"]
    catalog = Catalog(store.ask)
    assert refreshed(catalog) is None
    assert (catalog.stored.keys(), catalog.binned.keys(), catalog.session) == ({"a", "b", "c"}, {"x"}, "s")
    assert len(store.asked) == 3
    assert refreshed(catalog) is None
    assert len(store.asked) == 3
    assert catalog.find("x", binned=True) is not None
    assert catalog.find("x", binned=False) is None


def test_a_new_sample_is_asked_for_and_moves_need_no_question() -> None:
    store = Store("a")
    catalog = Catalog(store.ask)
    refreshed(catalog)
    version = catalog.version
    store.stored.append("b")
    catalog.hear(news(1, "stored", "b"))
    refreshed(catalog)
    assert catalog.stored.keys() == {"a", "b"}
    asked = len(store.asked)
    catalog.hear(news(2, "deleted", "a"))
    assert catalog.binned["a"]["files"]["rgb"] == "bin/rgb/rgb_a.png"
    catalog.hear(news(3, "restored", "a"))
    assert catalog.stored["a"]["files"]["rgb"] == "rgb/rgb_a.png"
    refreshed(catalog)
    assert len(store.asked) == asked
    assert catalog.version > version


def test_a_sample_is_found_where_it_was_moved_to_before_the_news_of_it_come() -> None:
    store = Store("a")
    store.binned = ["x"]
    catalog = Catalog(store.ask)
    refreshed(catalog)
    store.binned.remove("x")
    store.stored.append("x")
    item, refused = asyncio.run(catalog.look_up("x", binned=False))
    assert (item, refused) == ({"name": "x", "files": {"rgb": "rgb/rgb_x.png"}}, None)
    catalog.hear(news(1, "restored", "x"))
    assert asyncio.run(catalog.look_up("x", binned=True)) == (None, None)
    assert asyncio.run(catalog.look_up("x", binned=False)) == (item, None)


@pytest.mark.parametrize("whole", [True, False], ids=["all is read", "what is new is read"])
def test_a_sample_that_is_moved_while_the_list_is_read_is_not_found_where_it_was(whole: bool) -> None:
    store = Store("a")

    async def ask(fields: Plain, limit_s: float) -> Plain:
        answer = await store.ask(fields, limit_s)
        if moving and not fields["filter"]["bin"]:
            store.stored.remove("a")
            store.binned.append("a")
            catalog.hear(news(moving.pop(), "deleted", "a"))
        return answer

    moving: list[int] = []
    catalog = Catalog(ask)
    refreshed(catalog)
    store.stored.append("b")
    catalog.hear(news(1, "stored", "b"))
    if whole:
        catalog.heard_session("another")
    moving.append(2)
    refreshed(catalog)
    refreshed(catalog)
    assert (catalog.stored.keys(), catalog.binned.keys()) == ({"b"}, {"a"})


def test_missed_news_another_session_and_an_unknown_sample_make_it_read_anew() -> None:
    store = Store("a", "b")
    catalog = Catalog(store.ask)
    refreshed(catalog)
    catalog.hear(news(1, "stored", "a"))
    for told in (news(5, "stored", "b"), news(6, "stored", "b", session="t"), news(1, "stored", "b", boot="c"),
                 news(2, "deleted", "never heard of", boot="c")):  # fmt: skip
        refreshed(catalog)
        asked = len(store.asked)
        catalog.hear(told)
        refreshed(catalog)
        assert len(store.asked) > asked + 1, "both lists are read"
    store.session = "t"
    catalog.heard_session("t")
    refreshed(catalog)
    assert catalog.session == "t"


def test_a_refusal_is_passed_on_and_tried_again() -> None:
    store = Store("a")
    store.refusal = {"ok": False, "error": {"code": "store_down", "message": "no"}}
    catalog = Catalog(store.ask)
    assert refreshed(catalog) == store.refusal
    store.refusal = None
    assert refreshed(catalog) is None
    assert catalog.stored.keys() == {"a"}
