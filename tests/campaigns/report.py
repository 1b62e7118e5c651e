"""What a campaign counts, and the one line that it prints."""

import json
import sys
from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass
class Report:
    """Counts of a campaign; everything in `bad` must be zero.

    Attributes
    ----------
    false_successes
        Runs that say succeeded and are not what they should be.
    lost_frames
        Frames that were durable once and are gone or damaged.
    hangs
        What did not end, or come back, within its bound.
    left_on
        Processes, LEDs, motions and armed cameras after an end.
    undefined
        States and reasons that nothing explains.
    failed_retries
        Runs that a retry, with no fault any more, did not complete.
    figures
        Everything else that is worth knowing.
    """

    campaign: str
    size: int
    seed: int
    false_successes: int = 0
    lost_frames: int = 0
    hangs: int = 0
    left_on: int = 0
    undefined: int = 0
    failed_retries: int = 0
    figures: dict[str, Any] = field(default_factory=dict)

    @property
    def bad(self) -> int:
        return (
            self.false_successes + self.lost_frames + self.hangs + self.left_on + self.undefined + self.failed_retries
        )

    def blame(self, what: str, why: object, count: int = 1) -> None:
        """Count something bad, and say on standard error what it was."""
        setattr(self, what, getattr(self, what) + count)
        sys.stderr.write(f"{self.campaign}: {what}: {why}\n")
        sys.stderr.flush()

    def count(self, figure: str, more: int = 1) -> None:
        self.figures[figure] = self.figures.get(figure, 0) + more

    def tell(self) -> int:
        """Print the line; returns the exit status."""
        sys.stdout.write(json.dumps({**asdict(self), "ok": not self.bad}) + "\n")
        return 1 if self.bad else 0
