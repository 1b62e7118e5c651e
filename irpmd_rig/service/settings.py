"""What the service is told when it starts."""

from __future__ import annotations

from dataclasses import dataclass, field

LOOPBACK = frozenset({"localhost", "127.0.0.1", "::1"})
_ANY = frozenset({"0.0.0.0", "::", ""})


@dataclass(frozen=True, slots=True)
class ServiceSettings:
    """How the service may be reached.

    Attributes
    ----------
    token
        What every request but the health check has to carry.
    host, port
        Where it listens; port 0: a free one.
    allowed_hosts
        Names by which it may be called besides the loopback's and `host`.
    body_limit_bytes
        Largest body of a request.
    body_limit_s
        How long a body may take to arrive.
    """

    token: str = field(repr=False)
    host: str = "127.0.0.1"
    port: int = 8321
    allowed_hosts: tuple[str, ...] = ()
    body_limit_bytes: int = 1_000_000
    body_limit_s: float = 30.0

    @property
    def names(self) -> frozenset[str]:
        """Every name by which it may be called, in lower case and without port or brackets."""
        given = {name.lower().strip("[]") for name in (*self.allowed_hosts, self.host)}
        return LOOPBACK | (given - _ANY)
