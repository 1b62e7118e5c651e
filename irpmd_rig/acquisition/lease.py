"""Who controls the rig by hand: one person at a time, for a bounded while."""

from __future__ import annotations

import math
import secrets
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from irpmd_rig.acquisition.errors import AcquisitionError

LONGEST_LEASE_S = 8 * 3600.0
OWNER_LIMIT = 100


@dataclass(frozen=True, slots=True)
class Lease:
    """The right to command devices and runs by hand.

    Attributes
    ----------
    id
        Secret of the holder: commands carry it.
    owner
        Name that others are told.
    taken_s, expires_s
        Seconds since 1970-01-01 UTC.
    overridden
        Name of the holder from whom it was taken away; None: it was free.
    """

    id: str
    owner: str
    taken_s: float
    expires_s: float
    overridden: str | None = None

    @property
    def holder(self) -> Holder:
        """What others may know of it."""
        return Holder(self.owner, self.taken_s, self.expires_s)


@dataclass(frozen=True, slots=True)
class Holder:
    """Who holds the lease, without its secret; times in seconds since 1970."""

    owner: str
    taken_s: float
    expires_s: float


class LeaseHeld(AcquisitionError):
    """The rig is controlled by somebody else.

    Parameters
    ----------
    holder
        Who.
    """

    def __init__(self, holder: Holder) -> None:
        until = time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(holder.expires_s))
        super().__init__(
            f"the rig is controlled by {holder.owner} until {until}",
            "ask for its release, wait for its end, or take the lease with override",
        )
        self.holder = holder


class LeaseNeeded(AcquisitionError):
    """No lease was given, or it has expired or was released, and nobody holds one."""

    def __init__(self) -> None:
        super().__init__("this needs the lease, and there is none", "take the lease first")


class BadLease(AcquisitionError):
    """An owner or a duration that no lease can have."""


class LeaseBook:
    """Gives the one lease out, renews it, takes it back; safe to use from any thread.

    Expiry is counted on the monotonic clock, so that a change of the computer's time frees or keeps nothing.
    """

    def __init__(self, monotonic: Callable[[], float] = time.monotonic, clock: Callable[[], float] = time.time) -> None:
        self._monotonic = monotonic
        self._clock = clock
        self._lock = threading.Lock()
        self._lease: Lease | None = None
        self._ends_at = 0.0

    def take(self, owner: str, duration_s: float, *, override: bool = False) -> Lease:
        """Take the lease for `duration_s` seconds.

        Raises
        ------
        LeaseHeld
            Somebody has it, and `override` is False.
        BadLease
            No owner, or a duration that is not above 0 and at most `LONGEST_LEASE_S`.
        """
        owner = owner.strip()
        if not owner or len(owner) > OWNER_LIMIT or not owner.isprintable():
            raise BadLease("a lease needs its owner's name", f"give 1 to {OWNER_LIMIT} printable characters")
        _check_duration(duration_s)
        with self._lock:
            held = self._current()
            if held is not None and not override:
                raise LeaseHeld(held.holder)
            now_s = self._clock()
            overridden = None if held is None else held.owner
            self._lease = Lease(secrets.token_urlsafe(16), owner, now_s, now_s + duration_s, overridden)
            self._ends_at = self._monotonic() + duration_s
            return self._lease

    def renew(self, lease_id: str | None, duration_s: float) -> Lease:
        """Let the lease end `duration_s` seconds from now; raises as `check`, and BadLease as `take`."""
        _check_duration(duration_s)
        with self._lock:
            held = self._checked(lease_id)
            self._lease = replace(held, expires_s=self._clock() + duration_s)
            self._ends_at = self._monotonic() + duration_s
            return self._lease

    def release(self, lease_id: str | None) -> None:
        """Give the lease back; raises as `check`."""
        with self._lock:
            self._checked(lease_id)
            self._lease = None

    def check(self, lease_id: str | None) -> Lease:
        """Pass the lease that `lease_id` stands for.

        Raises
        ------
        LeaseHeld
            Somebody else has it.
        LeaseNeeded
            Nobody has it.
        """
        with self._lock:
            return self._checked(lease_id)

    def holder(self) -> Holder | None:
        """Tell who has it."""
        with self._lock:
            held = self._current()
            return None if held is None else held.holder

    def left_s(self) -> float:
        """Seconds until the lease ends; 0 when nobody has it."""
        with self._lock:
            return 0.0 if self._current() is None else self._ends_at - self._monotonic()

    def _current(self) -> Lease | None:
        if self._lease is not None and self._monotonic() >= self._ends_at:
            self._lease = None
        return self._lease

    def _checked(self, lease_id: str | None) -> Lease:
        held = self._current()
        if held is None:
            raise LeaseNeeded
        # In constant time: the id is a secret.
        if lease_id is None or not secrets.compare_digest(held.id.encode(), lease_id.encode()):
            raise LeaseHeld(held.holder)
        return held


def _check_duration(duration_s: float) -> None:
    if not (math.isfinite(duration_s) and 0.0 < duration_s <= LONGEST_LEASE_S):
        raise BadLease(f"a lease of {duration_s:g} s is refused", f"give more than 0 and at most {LONGEST_LEASE_S:g} s")
