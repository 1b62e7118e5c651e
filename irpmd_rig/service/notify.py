"""Tells systemd that the service is ready, what it does, and, from the event loop itself, that the loop still turns."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import socket
from collections.abc import Mapping

_log = logging.getLogger(__name__)


class Notifier:
    """Sends the datagrams of sd_notify(3); does nothing where nobody wants them.

    Parameters
    ----------
    environment
        Where ``NOTIFY_SOCKET``, ``WATCHDOG_USEC`` and ``WATCHDOG_PID`` are looked for.
    """

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        self._address = environment.get("NOTIFY_SOCKET", "")
        own = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        usec = environment.get("WATCHDOG_USEC", "")
        self.watchdog_s = int(usec) / 1e6 if own and usec.isdecimal() else None

    def tell(self, **what: str) -> None:
        """Send e.g. ``READY="1"``; what goes wrong is logged."""
        if not self._address:
            return
        # A leading @ stands for the abstract name space.
        address = "\0" + self._address[1:] if self._address.startswith("@") else self._address
        message = "\n".join(f"{key}={value}" for key, value in what.items())
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as line:
                # A service manager that does not read must not hold up the event loop.
                line.setblocking(False)
                line.sendto(message.encode(), address)
        except OSError as error:
            _log.warning("the service manager cannot be told %s: %s", message.replace("\n", " "), error)

    async def feed(self) -> None:
        """Feed the watchdog from this event loop until cancelled."""
        if self.watchdog_s is None or not self._address:
            return
        with contextlib.suppress(asyncio.CancelledError):
            while True:
                self.tell(WATCHDOG="1")
                # Half of it is what systemd recommends; a third leaves room for one that is late.
                await asyncio.sleep(self.watchdog_s / 3)
