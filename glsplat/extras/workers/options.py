"""Options of a gateway's workers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from glsplat.extras.workers.cluster import RayCluster
from glsplat.extras.workers.pool import WorkerPool
from glsplat.net.backend import Backend
from glsplat.net.worker.process import ProcessLauncher

_HEADLESS_S = 120.0  # for which a gateway without workers waits for Ray to return


@dataclass(frozen=True, slots=True, kw_only=True)
class Workers:
    """``count`` processes on this machine, or with ``ray`` that many actors (None: as many as fit)."""

    count: int | None = 1
    ray: bool = False
    cpus: float = 1.0  # per actor
    gpus: float = 0.0
    address: str | None = None  # as for ray.init; None: RAY_ADDRESS, a cluster on this machine, or a new one

    def pool(
        self, makes: Sequence[Callable[[], Backend]], rate: float | None, seconds: float, video: bool = False
    ) -> WorkerPool:
        """Return a pool whose workers run ``makes`` in turn; Ray's all run the first. The rest is as for WorkerPool.

        Raises GlsplatError if Ray is not installed or cannot be reached.
        """
        if not self.ray:
            count = self.count or 1
            launchers = [ProcessLauncher(makes[i % len(makes)], f"worker {i + 1}") for i in range(count)]
            return WorkerPool(launchers, rate, seconds, video=video)
        cluster = RayCluster(makes[0], self.address, self.cpus, self.gpus)
        try:
            count = cluster.room() if self.count is None else self.count
            return WorkerPool(cluster.launchers(count), rate, seconds, _HEADLESS_S, close=cluster.close, video=video)
        except BaseException:
            cluster.close()
            raise
