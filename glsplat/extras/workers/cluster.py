"""Workers as Ray actors, on any number of machines (extra ``glsplat[ray]``).

Ray places, starts and ends the actors. Pictures go from the actor's own socket to the gateway, because a call of an
actor takes 1.5 ms and copies its result through the object store.

Ray's driver runs in a separate process, because it ends with Ray's head. The gateway continues: the actors serve its
clients without the head. They are detached from the driver and end with the gateway's connection.
"""

from __future__ import annotations

import asyncio
import multiprocessing
import os
import re
import secrets
import signal
import socket
import threading
import traceback
from collections.abc import Callable
from concurrent.futures import Future, InvalidStateError
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

from glsplat.errors import ContextError, GlsplatError
from glsplat.net.backend import Backend
from glsplat.net.worker.wire import WorkerLostError, greet
from glsplat.net.worker.work import GREETING_S, greet_server, work
from glsplat.optional import require_package

Address = tuple[str, int]

_HOST = re.compile(r"[\w.-]+:\d+")  # HOST:PORT of a Ray head

_ROOM_S = 60.0  # time-out of Ray's placement and start of an actor
_DRIVER_S = 30.0  # further time-out of the driver's answer
_END_S = 3.0  # time-out of the driver's end
_UNACKNOWLEDGED_MS = 2000  # time-out of the other machine's acknowledgements (TCP)


def require_ray() -> None:
    """Raise GlsplatError if Ray is not installed."""
    require_package("work on a cluster", "ray", "ray", "leave Ray out; every machine of the cluster needs it")


class RayCluster:
    """A Ray cluster whose workers run the backend of ``make()``.

    ``address`` is that of ``ray.init``: None is the cluster of RAY_ADDRESS or of this machine, else a new one on this
    machine. ``cpus`` and ``gpus`` are the share of a node for one actor.
    """

    def __init__(
        self, make: Callable[[], Backend], address: str | None = None, cpus: float = 1.0, gpus: float = 0.0
    ) -> None:
        require_ray()
        self._options = make, address, cpus, gpus
        self.secret: bytes = secrets.token_bytes(32)
        self._lock = threading.Lock()
        self._driver: _Driver | None = None

    def launchers(self, count: int) -> list[RayLauncher]:
        """Return the launchers of ``count`` workers."""
        return [RayLauncher(self, f"Ray worker {index}") for index in range(1, count + 1)]

    def room(self) -> int:
        """Return how many workers fit into the cluster, at least 1: by GPUs if they use any, else one per node."""
        return int(self.ask("room"))

    def ask(self, *order: Any, pending: Callable[[Future[Any]], None] = lambda _: None) -> Any:
        """Send Ray's driver an order and return its answer. Blocks; thread-safe. Raises ContextError.

        ``pending`` receives the future of the answer, so that another thread can end the wait.
        """
        with self._lock:
            if self._driver is None or not self._driver.alive:
                self._driver = _Driver(*self._options, self.secret)
            driver = self._driver
        answer = driver.ask(order)
        pending(answer)
        try:
            return answer.result(_ROOM_S + _DRIVER_S)
        except TimeoutError:
            driver.end()
            raise ContextError(f"Ray did not answer within {_ROOM_S + _DRIVER_S:g} s; is its head there?") from None

    def end(self, actor: str, seconds: float) -> None:
        """Have Ray end an actor after ``seconds``. Without a driver it ends with its connection."""
        driver = self._driver
        if driver is not None and driver.alive:
            with suppress(TimeoutError, GlsplatError):
                driver.ask(("end", actor, seconds)).result(seconds + 1.0)

    def close(self) -> None:
        """End Ray's driver, and its cluster if it started one."""
        with self._lock:
            if self._driver is not None:
                self._driver.end()


class RayLauncher:
    """Starts and ends one actor at a time."""

    def __init__(self, cluster: RayCluster, name: str) -> None:
        self.name: str = name
        self.slots: None = None
        self._cluster = cluster
        self._actor: str | None = None
        self._connection: socket.socket | None = None  # until ``start`` returns it
        self._starting = threading.Lock()
        self._pending: Future[Any] | None = None  # answer of the newest order

    async def start(self) -> tuple[socket.socket, bytes]:
        """Have Ray start an actor, and connect to it. Raises ContextError, WorkerLostError."""
        key = await asyncio.to_thread(self._start)
        connection, self._connection = self._connection, None
        assert connection is not None
        return connection, key

    async def cause(self) -> tuple[str, bool]:
        """Blame no picture: Ray reports how an actor ended only after several seconds."""
        return "the actor's process or its machine has ended", False

    def stopped(self) -> bool:
        """Return False: Ray does not report it."""
        return False

    async def end(self, seconds: float) -> None:
        """Wait for the actor to end, then have Ray end it."""
        await asyncio.to_thread(self._end, seconds)

    def _end(self, seconds: float) -> None:
        if self._pending is not None:  # an actor without a gateway ends
            _settle(self._pending, ContextError("the gateway no longer needs the actor"))
        with self._starting:
            connection, self._connection = self._connection, None
            actor, self._actor = self._actor, None
        if connection is not None:
            connection.close()
        if actor is not None:
            self._cluster.end(actor, seconds)

    def _start(self) -> bytes:
        with self._starting:
            return self._begin()

    def _begin(self) -> bytes:
        self._actor, address = self._cluster.ask("start", pending=self._wait)
        connection: socket.socket | None = None
        try:
            connection = socket.create_connection(address, GREETING_S)
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            if hasattr(socket, "TCP_USER_TIMEOUT"):  # a lost machine does not close its sockets
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _UNACKNOWLEDGED_MS)
            key = greet(connection, self._cluster.secret, worker=False)
        except (EOFError, OSError) as error:
            if connection is not None:
                connection.close()
            raise WorkerLostError(f"an actor at {address[0]}:{address[1]} cannot be reached: {error}") from None
        self._connection = connection
        return key

    def _wait(self, answer: Future[Any]) -> None:
        self._pending = answer


class _Driver:
    """The gateway's side of the process that calls Ray."""

    def __init__(self, *options: Any) -> None:
        spawn = multiprocessing.get_context("spawn")
        self._pipe, theirs = spawn.Pipe()
        self._process = spawn.Process(target=_drive, args=(theirs, *options), name="glsplat ray driver", daemon=True)
        self._process.start()
        theirs.close()
        self._asked: dict[int, Future[Any]] = {}
        self._number = 0
        self._lock = threading.Lock()
        self.alive: bool = True
        threading.Thread(target=self._read, name="ray driver", daemon=True).start()

    def ask(self, order: tuple[Any, ...]) -> Future[Any]:
        future: Future[Any] = Future()
        with self._lock:
            self._number += 1
            self._asked[self._number] = future
            try:
                self._pipe.send((self._number, *order))
            except OSError:
                _settle(future, ContextError("Ray's driver has ended; is Ray's head there?"))
        return future

    def end(self) -> None:
        self.alive = False
        with suppress(OSError):
            self._pipe.send(None)
        self._process.join(_END_S)
        self._process.kill()

    def _read(self) -> None:
        with suppress(EOFError, OSError):
            while True:
                number, answer = self._pipe.recv()
                _settle(self._asked.pop(number), answer)
        self.alive = False
        with self._lock:
            for future in self._asked.values():
                _settle(future, ContextError("Ray's driver has ended; is Ray's head there?"))
            self._asked.clear()


def _settle(future: Future[Any], answer: Any) -> None:
    with suppress(InvalidStateError):  # another thread has settled it
        if isinstance(answer, Exception):
            future.set_exception(answer)
        else:
            future.set_result(answer)


# ------------------------------------------------------------------------------------------------ the driver's process


def _drive(
    pipe: Connection, make: Callable[[], Backend], address: str | None, cpus: float, gpus: float, secret: bytes
) -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    os.dup2(2, 1)  # Ray prints messages to stdout
    os.environ.setdefault("RAY_worker_niceness", "0")  # of a cluster started here; Ray's default is 15
    import ray

    error: Exception | None = None
    try:
        if address is not None and _HOST.fullmatch(address):  # fail at once: Ray itself tries for a minute
            host, port = address.rsplit(":", 1)
            socket.create_connection((host, int(port)), GREETING_S).close()
        ray.init(address, log_to_driver=False, namespace="glsplat", configure_logging=False)
        kind = ray.remote(num_cpus=cpus, num_gpus=gpus, max_restarts=0, max_concurrency=2, lifetime="detached")(_Actor)
        made = ray.put(make)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # Ray has set a handler of its own
    except Exception as found:
        error = ContextError(f"Ray cannot be reached: {_line(found)}")
    actors: dict[str, tuple[Any, Any]] = {}

    def room() -> int:
        whole = ray.cluster_resources()
        if gpus:
            return max(1, int(whole.get("GPU", 0.0) / gpus))
        return max(1, sum(node["Alive"] and node["Resources"].get("CPU", 0.0) >= cpus for node in ray.nodes()))

    def start() -> tuple[str, Address]:
        actor = kind.remote(made, secret)
        try:
            address = ray.get(actor.listen.remote(), timeout=_ROOM_S)
        except Exception as found:
            ray.kill(actor)
            if isinstance(found, ray.exceptions.GetTimeoutError):
                what = f"{cpus:g} CPUs and {gpus:g} GPUs"
                raise ContextError(f"Ray had no room within {_ROOM_S:g} s for a worker that takes {what}") from None
            raise ContextError(f"Ray could not start a worker: {_line(found)}") from None
        name = secrets.token_hex(8)
        actors[name] = actor, actor.ended.remote()
        return name, address

    def end(name: str, seconds: float) -> None:
        actor, ended = actors.pop(name)
        ray.wait([ended], timeout=seconds)
        ray.kill(actor)

    orders: dict[str, Callable[..., Any]] = {"room": room, "start": start, "end": end}
    sending = threading.Lock()

    def answer(number: int, order: str, *arguments: Any) -> None:
        try:
            if error is not None:
                raise error
            found = orders[order](*arguments)
        except GlsplatError as refused:
            found = refused
        except Exception as fault:
            found = ContextError(f"Ray: {_line(fault)}")
        with sending, suppress(OSError):
            pipe.send((number, found))

    with suppress(EOFError, OSError):
        while (asked := pipe.recv()) is not None:
            threading.Thread(target=answer, args=asked, daemon=True).start()
            if error is not None:
                break  # the next order gets a new driver, which tries again
    if error is not None:
        threading.Event().wait(0.2)  # until the answer is sent
    with suppress(Exception):
        ray.shutdown()
    os._exit(0)


def _line(error: BaseException) -> str:
    """Return the last line that is not empty; an actor's traceback may precede it."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[-1][:200] if lines else type(error).__name__


# ------------------------------------------------------------------------------------------------ the actor's process


class _Actor:
    """A worker in Ray: listens on its node's address for the gateway, serves it, and ends with it."""

    def __init__(self, make: Callable[[], Backend], secret: bytes) -> None:
        self._make, self._secret = make, secret
        self._taken = False
        self._over = threading.Event()

    def listen(self) -> Address:
        """Return the address to which the gateway may connect, within a minute."""
        import ray

        with suppress(OSError, AttributeError):  # undo Ray's niceness, if permitted
            os.setpriority(os.PRIO_PROCESS, 0, 0)
        gpus = ray.get_gpu_ids()
        if gpus:  # OpenGL ignores CUDA_VISIBLE_DEVICES
            os.environ.setdefault("GLSPLAT_DEVICE", str(gpus[0]))
        host = ray.util.get_node_ip_address()
        listening = socket.create_server((host, 0), family=socket.AF_INET6 if ":" in host else socket.AF_INET)
        listening.settimeout(_ROOM_S)
        threading.Thread(target=self._accept, args=(listening,), daemon=True).start()
        return host, listening.getsockname()[1]

    def ended(self) -> None:
        """Wait until the gateway has ended the connection properly."""
        self._over.wait()

    def _accept(self, listening: socket.socket) -> None:
        with listening, suppress(OSError):  # closed: by the time-out, or once the gateway is connected
            while True:
                connection, _ = listening.accept()
                threading.Thread(target=self._serve, args=(connection, listening), daemon=True).start()
        if not self._taken:
            os._exit(0)

    def _serve(self, connection: socket.socket, listening: socket.socket) -> None:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        try:
            key = greet_server(connection, self._secret)
        except (GlsplatError, EOFError, OSError):  # not the gateway
            connection.close()
            return
        self._taken = True
        listening.close()
        try:
            work(connection, key, self._make)
        except Exception:
            traceback.print_exc()
            os._exit(1)
        self._over.set()
        threading.Event().wait(_END_S)  # until Ray ends it, if Ray is there
        os._exit(0)
