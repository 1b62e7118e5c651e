"""What is known of an instrument: apart, because clients read it without loading a rig."""

from __future__ import annotations

from enum import StrEnum


class DeviceCondition(StrEnum):
    """What is known of an instrument of a rig."""

    CLOSED = "closed"
    READY = "ready"
    MISSING = "missing"
    MISCONFIGURED = "misconfigured"
    LOST = "lost"
    FAULT = "fault"
