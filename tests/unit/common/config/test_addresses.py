"""A login in a stream's address is hidden, wherever it stands."""

from __future__ import annotations

import pytest

from common.config.addresses import presentable, without_login


@pytest.mark.parametrize(
    ("url", "shown"),
    [
        ("rtsp://cam.local/stream1", "rtsp://cam.local/stream1"),
        ("rtsp://cam.local:8554", "rtsp://cam.local:8554"),
        ("rtsp://admin:hush@cam.local:8554/stream1", "rtsp://***@cam.local:8554/stream1"),
        ("rtsp://admin@cam.local/stream1", "rtsp://***@cam.local/stream1"),
        ("rtsp://admin:a@b#c/d?e@cam.local/x", "rtsp://***@cam.local/x"),
        ("http://cam.local/video?user=admin&pwd=hush", "http://cam.local/video?***"),
        ("rtsp://cam.local/user=admin&password=hush&channel=1", "rtsp://cam.local/***"),
        ("rtsp://[::1]:8554/x#hush", "rtsp://[::1]:8554/x"),
        ("udp://@:5000", "udp://:5000"),
    ],
)
def test_a_login_is_hidden(url: str, shown: str) -> None:
    assert without_login(url) == shown


def test_only_addresses_are_changed() -> None:
    keys = {"url": "rtsp://admin:hush@cam/x", "path": "photos/a@b", "width": 640, "controls": {"gain": 1}}
    assert presentable(keys) == {**keys, "url": "rtsp://***@cam/x"}
