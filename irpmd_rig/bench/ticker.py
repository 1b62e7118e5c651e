"""A thread that wants to run every millisecond, and how late it gets to: `python -m irpmd_rig.bench.ticker SECONDS`."""

from __future__ import annotations

import json
import sys
import time

TICK_S = 0.001


def lateness_ms(seconds: float) -> list[float]:
    """Lateness of each tick, in ms; ticks that are missed altogether count as late as they are noticed."""
    late = []
    start_s = time.perf_counter()
    for number in range(1, round(seconds / TICK_S) + 1):
        due_s = start_s + number * TICK_S
        left_s = due_s - time.perf_counter()
        if left_s > 0:
            time.sleep(left_s)
        late.append(1e3 * (time.perf_counter() - due_s))
    return late


def main() -> None:
    """Say that it is ready, tick from the first line of standard input on, and print the lateness as JSON."""
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    sys.stdin.readline()
    sys.stdout.write(json.dumps(lateness_ms(float(sys.argv[1]))))


if __name__ == "__main__":
    main()
