"""The server's status for Prometheus, where it is asked for."""

from collections.abc import Iterator
from typing import Any

from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.messages import ServerStatus

DEFAULT_HOST = "127.0.0.1"


class Metrics:
    """Serves the newest status at `http://HOST:PORT/metrics`.

    Args:
        where: HOST:PORT, or PORT alone for this machine only.

    Raises:
        FleetPoseError: it is no such address, or it is in use.
    """

    def __init__(self, where: str) -> None:
        host, _, port = where.rpartition(":")
        if not port.isdigit():
            raise FleetPoseError(f"--metrics {where}: write HOST:PORT, e.g. 127.0.0.1:9464")
        from prometheus_client import CollectorRegistry, start_http_server

        self._status: ServerStatus | None = None
        self._located = self._robots = 0
        registry = CollectorRegistry()
        registry.register(self)  # pyright: ignore[reportArgumentType]
        try:
            self._server, self._thread = start_http_server(
                int(port), host or DEFAULT_HOST, registry
            )
        except (OSError, OverflowError) as error:
            raise FleetPoseError(
                f"--metrics {where}: {getattr(error, 'strerror', None) or error}"
            ) from error

    def show(self, status: ServerStatus, robots: int, located: int) -> None:
        """Takes the newest status, and how many robots are known and located."""
        self._status, self._robots, self._located = status, robots, located

    def close(self) -> None:
        """Serves no more."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def collect(self) -> Iterator[Any]:
        """What prometheus-client asks for at every scrape."""
        from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

        status = self._status
        if status is None:
            return
        for name, help_text, value in (
            ("views", "Views received.", status.views),
            ("alignments", "Pairs of views aligned.", status.alignments),
            ("solves", "Solves of the fleet's graph.", status.solves),
        ):
            yield CounterMetricFamily(f"fleetpose_{name}", help_text, value=value)
        for name, help_text, value in (
            ("robots", "Robots known.", self._robots),
            ("robots_located", "Robots located.", self._located),
            ("uptime_seconds", "Since the server started.", status.uptime_s),
            ("workers", "Workers for alignments.", status.workers),
            ("jobs_running", "Alignments at work.", status.pending_jobs),
            ("alignments_per_second", "Over the last ten seconds.", status.pairs_per_s),
            ("pair_wait_max_seconds", "Longest wait of a pair.", status.max_pair_wait_s),
            ("pair_wait_max_ratio", "The same, as a share of its bound.", status.wait_share),
            (
                "cpu_seconds_per_view",
                "The server's own thread and its network.",
                1e-3 * status.other_cpu_ms_per_view,
            ),
        ):
            yield GaugeMetricFamily(f"fleetpose_{name}", help_text, value=value)
        waiting = GaugeMetricFamily("fleetpose_waiting", "What waits, by line.", labels=["line"])
        for line, count in status.waiting.items():
            waiting.add_metric([line], count)
        stages = GaugeMetricFamily(
            "fleetpose_stage_seconds", "Median of the last times.", labels=["stage"]
        )
        for stage, ms in status.stage_ms.items():
            stages.add_metric([stage], 1e-3 * ms)
        drops = CounterMetricFamily("fleetpose_drops", "What was dropped.", labels=["reason"])
        for reason, count in status.drops.items():
            drops.add_metric([reason], count)
        yield from (waiting, stages, drops)
