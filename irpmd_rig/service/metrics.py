"""Figures for Prometheus: the rig as it is when it is asked, and what the service answered."""

from __future__ import annotations

from collections import Counter as Tally
from collections.abc import Iterator
from typing import TYPE_CHECKING

from prometheus_client import CollectorRegistry, Counter, Histogram, ProcessCollector
from prometheus_client.metrics_core import GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from irpmd_rig.acquisition.rig import DeviceCondition

if TYPE_CHECKING:
    from irpmd_rig.acquisition.daemon import RigDaemon
    from irpmd_rig.service.desk import Desk

_BUCKETS_S = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.25, 1.0, 5.0, 30.0)


class Figures:
    """All figures of one application, in a registry of their own.

    Attributes
    ----------
    registry
        What is shown.
    requests, seconds
        Answers by method, operation and status; how long they took to begin.
    """

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        ProcessCollector(registry=self.registry)
        labels = ("method", "operation")
        self.requests = Counter(
            "irpmd_rig_requests", "Answers of the service", (*labels, "status"), registry=self.registry
        )
        self.seconds = Histogram(
            "irpmd_rig_request_seconds",
            "Time until an answer began",
            labels,
            registry=self.registry,
            buckets=_BUCKETS_S,
        )

    def watch(self, desk: Desk) -> None:
        """Show the rig, too."""
        self.registry.register(_RigFigures(desk))


class _RigFigures(Collector):
    """Asks the daemon whenever somebody asks for figures."""

    def __init__(self, desk: Desk) -> None:
        self._desk = desk

    def describe(self) -> Iterator[Metric]:
        """Nothing is asked at registration."""
        return iter(())

    def collect(self) -> Iterator[Metric]:
        """Yield the figures of now."""
        daemon = self._desk.daemon
        yield from _rig(daemon)
        yield from _runs(daemon)
        yield _gauge("irpmd_rig_streams", "Event streams and live views that are open", self._desk.streams)


def _rig(daemon: RigDaemon) -> Iterator[Metric]:
    status = daemon.rig_status()
    ready = GaugeMetricFamily("irpmd_rig_device_ready", "Whether an instrument is ready", labels=["device"])
    for name, state in status.devices.items():
        ready.add_metric([name], state.state is DeviceCondition.READY)
    yield ready
    position = GaugeMetricFamily("irpmd_rig_axis_position_millimetres", "Where an axis is", labels=["axis", "measured"])
    for name, axis in status.axes.items():
        if axis.position is not None:
            position.add_metric([name, str(axis.position.measured).lower()], axis.position.position_mm)
    yield position
    yield _gauge("irpmd_rig_can_start", "Whether a run would begin now", status.can_start)
    yield _gauge("irpmd_rig_stop_latched", "Whether everything was stopped", status.stop_latched)
    yield _gauge("irpmd_rig_lease_held", "Whether somebody controls the rig by hand", status.lease is not None)
    yield _gauge("irpmd_rig_run_active", "Whether a run is under way", status.active_run is not None)
    yield _gauge("irpmd_rig_disk_free_bytes", "Room on the disk of the store", status.free_bytes)


def _runs(daemon: RigDaemon) -> Iterator[Metric]:
    queue = daemon.queue_status()
    yield _gauge("irpmd_rig_queue_length", "Runs that wait", len(queue.waiting))
    yield _gauge("irpmd_rig_queue_held", "Whether the queue is held", queue.held)
    tally = Tally((str(run.state), str(run.reason or "")) for run in daemon.runs())
    runs = GaugeMetricFamily("irpmd_rig_runs", "Runs in the store", labels=["state", "reason"])
    for labels, count in tally.items():
        runs.add_metric(list(labels), count)
    yield runs


def _gauge(name: str, text: str, value: float) -> Metric:
    return GaugeMetricFamily(name, text, value=float(value))
