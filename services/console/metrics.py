"""What Prometheus reads: counts and gauges from what was heard, latencies as histograms of every frame and picture."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

from prometheus_client import CollectorRegistry, Histogram, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from common import clock
from common.messages import Labels

if TYPE_CHECKING:
    from services.console.state import State

SECONDS = (0.005, 0.01, 0.015, 0.02, 0.03, 0.04, 0.05, 0.075, 0.1, 0.15, 0.2, 0.3, 0.5, 1.0, 2.0, 5.0)


class Metrics:
    """The console's own registry: nothing of Python or of the process, which says nothing about a rig."""

    def __init__(self, state: State) -> None:
        self._registry = CollectorRegistry()
        self._labels = Histogram(
            "tagmill_label_latency_seconds",
            "from a frame's capture to its label, as heard here",
            ("camera",),
            buckets=SECONDS,
            registry=self._registry,
        )
        self._labelling = Histogram(
            "tagmill_label_work_seconds",
            "a label's own computing time",
            ("camera",),
            buckets=SECONDS,
            registry=self._registry,
        )
        self.sent = Histogram(
            "tagmill_picture_age_seconds",
            "from a frame's capture to its sending to a page",
            ("kind",),
            buckets=SECONDS,
            registry=self._registry,
        )
        self.drawn = Histogram(
            "tagmill_picture_drawn_seconds",
            "from a picture's sending to the page's word that it was drawn",
            buckets=SECONDS,
            registry=self._registry,
        )
        self._registry.register(_Heard(state))

    def label(self, labels: Labels) -> None:
        """A label was heard."""
        camera = labels.ref.camera
        stamp = labels.stamp
        if stamp is not None:
            self._labels.labels(camera).observe(max(0, stamp.mono_ns - labels.ref.captured_mono_ns) / 1e9)
        self._labelling.labels(camera).observe(labels.took_ns / 1e9)

    def text(self) -> bytes:
        """Prometheus's text format."""
        return generate_latest(self._registry)


class _Heard(Collector):
    """Counts that the services keep themselves: told on, not counted again."""

    def __init__(self, state: State) -> None:
        self._state = state

    def collect(self) -> Iterable[Metric]:
        """See prometheus_client."""
        yield from self._services()
        yield from self._cameras()
        yield from self._recordings()
        status = self._state.status
        free = (status.get("disk") or {}).get("free_bytes")
        if free is not None:
            yield GaugeMetricFamily("tagmill_disk_free_bytes", "room for samples", value=free)
        yield GaugeMetricFamily("tagmill_viewers", "pages that are connected", value=self._state.hub.viewers)

    def _services(self) -> Iterator[Metric]:
        now = clock.monotonic_ns()
        up = GaugeMetricFamily("tagmill_service_up", "1 while its heartbeat is heard", labels=["service"])
        restarts = CounterMetricFamily("tagmill_service_restarts", "since the console's start", labels=["service"])
        dropped = CounterMetricFamily(
            "tagmill_dropped", "what was dropped, by service and place or reason", labels=["service", "reason"]
        )
        rates = GaugeMetricFamily("tagmill_rate", "a second, as the service says", labels=["service", "what"])
        backlog = GaugeMetricFamily("tagmill_backlog_samples", "samples that wait for the disk", labels=["service"])
        for name, seen in sorted(self._state.liveness.seen().items()):
            up.add_metric([name], float(self._state.liveness.is_alive(name, now)))
            restarts.add_metric([name], seen.restarts)
            for reason, count in seen.state.dropped.items():
                dropped.add_metric([name, reason], count)
            for what, rate in seen.state.rates.items():
                rates.add_metric([name, what], rate)
            if "backlog" in seen.state.numbers:
                backlog.add_metric([name], seen.state.numbers["backlog"])
        yield from (up, restarts, dropped, rates, backlog)

    def _cameras(self) -> Iterator[Metric]:
        captured = CounterMetricFamily("tagmill_frames_captured", "in this life of its capture", labels=["camera"])
        lost = CounterMetricFamily("tagmill_frames_lost", "before they were in the ring", labels=["camera", "reason"])
        for name, (state, _) in sorted(self._state.cameras.items()):
            captured.add_metric([name], state.captured)
            for reason, count in state.lost.items():
                lost.add_metric([name, reason], count)
        yield from (captured, lost)

    def _recordings(self) -> Iterator[Metric]:
        frames = GaugeMetricFamily(
            "tagmill_recording_frames",
            "what became of the frames of the recordings that run",
            labels=["recording", "camera", "outcome", "reason"],
        )
        for state in self._state.record.live(clock.monotonic_ns()):
            account = state.ledger.cameras.get(state.camera)
            if account is None:
                continue
            names = [state.ledger.spec.recording, state.camera]
            frames.add_metric([*names, "captured", ""], account.captured)
            frames.add_metric([*names, "recorded", ""], account.recorded)
            for outcome, counts in (("refused", account.refused), ("dropped", account.dropped)):
                for reason, count in counts.items():
                    frames.add_metric([*names, outcome, reason], count)
        yield frames
