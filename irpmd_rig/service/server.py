"""The daemon as a process: from the rig file to a service that answers, and back to a rig at rest."""

from __future__ import annotations

import asyncio
import logging
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType

import uvicorn
from pydantic import ValidationError
from starlette.types import ASGIApp

from irpmd_rig.acquisition.daemon import AlreadyRunning, RigDaemon
from irpmd_rig.acquisition.errors import AcquisitionError
from irpmd_rig.acquisition.rig_file import RigFile, Service, read_rig
from irpmd_rig.recipes.document import DocumentError, Problem, parse_document
from irpmd_rig.service.app import create_app
from irpmd_rig.service.broken import Broken
from irpmd_rig.service.logs import configure
from irpmd_rig.service.notify import Notifier
from irpmd_rig.service.settings import ServiceSettings
from irpmd_rig.service.token import NAME, read_token
from irpmd_rig.shipped import rig_file as found_rig_file
from irpmd_rig.store.errors import StoreError

# Answers that are under way when the service ends get so long.
GRACE_S = 5
BACKLOG = 128
CONNECTIONS = 256

Told = Callable[[str, str | None], None]
_CANNOT_START = (AcquisitionError, StoreError, OSError)

_log = logging.getLogger(__name__)


class Server(uvicorn.Server):
    """Uvicorn on a socket that is open already, with what has to happen at its begin and end.

    Parameters
    ----------
    app
        What it serves.
    line
        The socket.
    notifier
        Whom to tell.
    let_go
        Called in the event loop when it begins to end: endless answers have to.
    close
        Called in a thread then: what is commanded ends, and with it the answers that wait for it.
    """

    def __init__(
        self,
        app: ASGIApp,
        line: socket.socket,
        notifier: Notifier,
        let_go: Callable[[], None] = lambda: None,
        close: Callable[[], None] = lambda: None,
    ) -> None:
        super().__init__(
            uvicorn.Config(
                app,
                log_config=None,
                access_log=False,
                server_header=False,
                ws="none",
                timeout_graceful_shutdown=GRACE_S,
                # Beyond what the service itself refuses with a problem.
                limit_concurrency=CONNECTIONS,
            )
        )
        self.url = address(line)
        self._line = line
        self._notifier = notifier
        self._let_go = let_go
        self._close = close

    def ask_to_end(self) -> None:
        """End in order; asked again: at once. From any thread, or a signal's handler."""
        self.force_exit = self.should_exit
        self.should_exit = True

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Leave signals to the process."""
        yield

    async def serve(self, sockets: list[socket.socket] | None = None) -> None:
        """Serve until told to end."""
        feeding = asyncio.create_task(self._notifier.feed(), name="watchdog")
        try:
            await super().serve(sockets or [self._line])
        finally:
            feeding.cancel()
            await asyncio.wait([feeding])

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to answer, and say so."""
        await super().startup(sockets)
        if self.started:
            _log.info("answers at %s", self.url)
            self._notifier.tell(READY="1", STATUS=f"answers at {self.url}")

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Take no more requests, close what is behind them, and let the last answers out."""
        self._notifier.tell(STOPPING="1", STATUS="makes the rig safe")
        self._let_go()
        await asyncio.gather(super().shutdown(sockets), asyncio.to_thread(self._close))


def serve(rig: str | Path, *, port: int | None = None, tell: Told | None = None) -> None:
    """Open a rig and serve it until SIGTERM or SIGINT; then LEDs are off and stages stopped.

    A rig file that is wrong, a world that does not start or a store that cannot be used do not end the process: the
    service answers whatever is asked by what is wrong, so that whoever supervises it need not start it again and
    again.

    Parameters
    ----------
    rig
        Rig file, or the name of a shipped one.
    port
        Where to listen instead of what the rig file says; 0: a free one.
    tell
        Called once requests are answered: with the address, and what is wrong where the rig could not be started.

    Raises
    ------
    AlreadyRunning
        Another daemon works on the store.
    FileNotFoundError
        There is no such rig file.
    OSError
        Somebody else listens there.
    """
    process = _Process(tell)
    with process.signals():
        configure(lambda: None)
        try:
            rig_file = read_rig(rig, deep=False)
        except DocumentError as error:
            with _listening(_service_of(rig), port) as line:
                process.answer_broken(error, _service_of(rig), line)
            return
        with _listening(rig_file.service, port) as line:
            process.serve_rig(rig_file, line)


class _Process:
    """What there is one of: signals, the service manager, and the server that runs."""

    def __init__(self, tell: Told | None) -> None:
        self._tell = tell
        self._notifier = Notifier()
        self._server: Server | None = None
        self._ends = False

    def serve_rig(self, rig_file: RigFile, line: socket.socket) -> None:
        """Open a rig and serve it."""
        self._notifier.tell(STATUS="opens the instruments")
        try:
            daemon = RigDaemon(rig_file)
        except AlreadyRunning:
            raise
        except _CANNOT_START as error:
            self.answer_broken(error, rig_file.service, line)
            return
        try:
            configure(lambda: daemon.queue_status().active_run)
            try:
                token = read_token(daemon.store.root)
                daemon.start()
            except _CANNOT_START as error:
                daemon.close()
                self.answer_broken(error, rig_file.service, line)
                return
            app = create_app(daemon, _settings(rig_file.service, token))
            _log.info("serves %s; the token is in %s", rig_file.name, daemon.store.root / NAME)
            self._run(Server(app, line, self._notifier, app.state.desk.close, daemon.close))
        finally:
            # Nothing interrupts this any more.
            self._ends = True
            daemon.close()

    def answer_broken(self, error: Exception, service: Service, line: socket.socket) -> None:
        """Serve what is wrong."""
        problems: tuple[Problem, ...] = error.problems if isinstance(error, DocumentError) else ()
        lines = [str(problem) for problem in problems] or [str(error)]
        for text in lines:
            _log.error("the rig cannot be started: %s", text)
        self._run(Server(Broken(str(error), problems, _settings(service, "")), line, self._notifier), lines[0])

    def _run(self, server: Server, wrong: str | None = None) -> None:
        self._server = server
        try:
            asyncio.run(self._work(server, wrong))
        finally:
            self._server = None

    async def _work(self, server: Server, wrong: str | None) -> None:
        serving = asyncio.create_task(server.serve())
        while not server.started and not serving.done():
            await asyncio.sleep(0.01)
        if server.started and self._tell is not None:
            self._tell(server.url, wrong)
        await serving

    @contextmanager
    def signals(self) -> Iterator[None]:
        """Let SIGTERM and SIGINT end the process in order, whatever it is doing."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        before = {number: signal.signal(number, self._end) for number in (signal.SIGTERM, signal.SIGINT)}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def _end(self, number: int, _: FrameType | None) -> None:
        if self._server is not None:
            self._server.ask_to_end()
        elif not self._ends:
            self._ends = True
            raise SystemExit(128 + number)


def _settings(service: Service, token: str) -> ServiceSettings:
    return ServiceSettings(token=token, host=service.host, port=service.port, allowed_hosts=service.allowed_hosts)


def _service_of(rig: str | Path) -> Service:
    """Where a rig file that is wrong elsewhere wants the service to listen; else where it usually does."""
    with suppress(DocumentError, OSError, ValidationError):
        written = parse_document(found_rig_file(str(rig))).values.get("service")
        return Service.model_validate(written if isinstance(written, dict) else {})
    return Service()


# --- the socket


def address(line: socket.socket) -> str:
    """Address of the service on a socket, as a URL."""
    host, port = line.getsockname()[:2]
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


def listen(host: str, port: int) -> socket.socket:
    """Open the service's socket; port 0: a free one. Raises OSError where somebody listens already."""
    line = socket.create_server(
        (host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET, backlog=BACKLOG
    )
    # Connections inherit it; else the second part of each answer waits 40 ms for the first one's receipt.
    line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return line


def _listening(service: Service, port: int | None) -> socket.socket:
    """Open the socket before the instruments: where somebody listens already, nothing of the rig is touched."""
    return listen(service.host, service.port if port is None else port)
