"""What is wrong with a request, in one line."""

import difflib
from collections.abc import Iterable

from pydantic import ValidationError


def complaint(error: ValidationError) -> str:
    """Say what is wrong with the arguments of a call, or with the keys of a document."""
    lines = []
    for detail in error.errors():
        place = ".".join(str(part) for part in detail["loc"])
        kind = detail["type"]
        if "missing" in kind:
            lines.append(f"{place!r} is missing")
        elif kind in ("unexpected_keyword_argument", "extra_forbidden"):
            lines.append(f"there is no {place!r} here")
        else:
            lines.append(f"{place}: {detail['msg']}")
    return "; ".join(lines)


def one_of(wanted: str, known: Iterable[str]) -> str:
    """Suggest what may have been meant, or everything there is."""
    near = difflib.get_close_matches(wanted, list(known), 1)
    return f"; did you mean {near[0]!r}?" if near else f": one of {', '.join(known)}"
