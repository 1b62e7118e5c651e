"""What a report's page may do: show what is in it and run the one script that turns a surface; nothing else."""

from __future__ import annotations

import base64
import hashlib
from importlib.resources import files

VIEWER = files(__package__).joinpath("templates", "viewer.js").read_text(encoding="utf-8")
"""The script of a page, the same in all: its hash tells it from any other."""

_HASH = base64.b64encode(hashlib.sha256(VIEWER.encode()).digest()).decode()

POLICY = f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'sha256-{_HASH}'"
"""Content security policy (W3C, CSP Level 3): no request leaves the page, no other script runs in it."""
