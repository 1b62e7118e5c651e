"""The secret that every request carries: a file that only the daemon's user can read."""

from __future__ import annotations

import os
import re
import secrets
from pathlib import Path

from irpmd_rig.acquisition.errors import AcquisitionError

NAME = "token"
_TOKEN = re.compile(r"[A-Za-z0-9_-]{32,200}")


class TokenError(AcquisitionError):
    """A token file that is no secret, or holds none."""


def read_token(root: Path) -> str:
    """Return the token of a store; it is made at the first start.

    Parameters
    ----------
    root
        The store's folder; the token is in its file ``token``, which nobody else may read (mode 0600).

    Raises
    ------
    TokenError
        Others can read it, it is a link, or it holds no token.
    OSError
        It cannot be read or written.
    """
    path = root / NAME
    if not path.is_symlink() and not path.exists():
        _make(path)
    mend = f"delete {path}: the next start makes a new one"
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
    except OSError as error:
        raise TokenError(f"the token {path} cannot be read: {error.strerror}", mend) from error
    with os.fdopen(descriptor, "r", encoding="ascii", errors="replace") as stream:
        seen = os.fstat(stream.fileno())
        if seen.st_mode & 0o077 or seen.st_uid != os.geteuid():
            raise TokenError(f"the token {path} can be read by others, so that it is no secret any more", mend)
        token = stream.read(1000).strip()
    if not _TOKEN.fullmatch(token):
        raise TokenError(f"{path} holds no token", mend)
    return token


def _make(path: Path) -> None:
    # Beside its place first: a start that is killed leaves no half of a token.
    beside = path.with_name(f".{path.name}-{secrets.token_hex(4)}")
    descriptor = os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
    try:
        with os.fdopen(descriptor, "w", encoding="ascii") as stream:
            os.fchmod(stream.fileno(), 0o600)
            stream.write(secrets.token_urlsafe(32) + "\n")
            stream.flush()
            os.fsync(stream.fileno())
        beside.rename(path)
    except BaseException:
        beside.unlink(missing_ok=True)
        raise
