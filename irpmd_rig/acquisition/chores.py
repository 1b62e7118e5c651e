"""What is to be done from time to time, beside looking after the instruments."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

from irpmd_rig.acquisition.book import RunBook
from irpmd_rig.acquisition.by_hand import ByHand
from irpmd_rig.acquisition.lease import LeaseBook
from irpmd_rig.store.errors import StoreError
from irpmd_rig.store.store import Store

RETENTION_S = 3600.0

_log = logging.getLogger(__name__)


class Chores:
    """Writes what the disk refused, leaves the rig dark after a lease that expired, deletes what is too old.

    Parameters
    ----------
    book, store
        The runs.
    leases, hand
        Who controls the rig by hand, and what was done by hand.
    retention_days
        Measurements that ended longer ago are deleted; None: none ever.
    monotonic
        Seconds that only grow.
    """

    def __init__(
        self,
        book: RunBook,
        store: Store,
        leases: LeaseBook,
        hand: ByHand,
        retention_days: int | None,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self._book = book
        self._store = store
        self._leases = leases
        self._hand = hand
        self._retention_days = retention_days
        self._monotonic = monotonic
        self._deleted_s: float | None = None

    def __call__(self) -> None:
        """Do what is due."""
        self._book.save()
        if self._leases.holder() is None:
            self._hand.leave_safe()
        now_s = self._monotonic()
        if self._retention_days is not None and (self._deleted_s is None or now_s - self._deleted_s >= RETENTION_S):
            self._deleted_s = now_s
            self._delete_old(self._retention_days)

    def _delete_old(self, days: int) -> None:
        try:
            deleted = self._store.delete_older(days)
        except StoreError as error:
            _log.error("runs that are older than %d days could not be deleted: %s", days, error)
            return
        for run_id in deleted:
            _log.warning("run %s was deleted: it ended more than %d days ago", run_id, days)
            self._book.forget(run_id)
