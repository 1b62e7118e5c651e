"""Whatever a controller answers, a move ends in a measured arrival or in a typed error, within a bound."""

import os
import time
from collections.abc import Callable
from pathlib import Path

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from stage_peers import Gsc, Peer

from drivers.errors import InstrumentError
from drivers.stage.engine import SerialStage

Build = Callable[..., SerialStage]

# Each of them is a whole session; a long campaign sets the number.
SESSIONS = int(os.environ.get("IRPMD_SESSION_EXAMPLES", "15"))

PIECE = st.sampled_from(
    [b"OK", b"NG", b"\r\n", b"\r", b",", b"K", b"L", b"B", b"R", b"-", b"17", b" ", b"\x00", b"\xff"]
)
ANSWERS = st.one_of(st.none(), st.lists(PIECE, max_size=8).map(b"".join), st.binary(max_size=200))


def impatient(tmp_path: Path) -> str:
    """The shipped dialect, but for the time that an answer may take."""
    source = Path(__file__).parents[3] / "drivers" / "stage" / "dialects" / "gsc.yaml"
    copy = tmp_path / "gsc-impatient.yaml"
    copy.write_text(source.read_text().replace("timeout_s: 1.0", "timeout_s: 0.1"))
    return str(copy)


@settings(max_examples=SESSIONS, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(answers=st.lists(ANSWERS, min_size=1, max_size=12))
def test_a_session_with_wild_answers_stays_typed_and_bounded(
    answers: list[bytes | None], tmp_path: Path, stage_on: Build, peer_at: Callable[..., Peer]
) -> None:
    controller = Gsc()
    peer = peer_at(controller)
    stage = stage_on(peer, impatient(tmp_path), progress_timeout_s=0.3)
    left = list(answers)

    def wild(frame: bytes) -> bytes:
        answer = left.pop() if left else None
        return controller(frame) if answer is None else answer

    peer.answer = wild
    for operation in (
        lambda: stage.zero(0.0, confirmed_by="Ada"),
        lambda: stage.move_to(0.5),
        stage.wait,
        stage.stop,
        stage.position,
    ):
        began_s = time.monotonic()
        try:
            operation()
        except InstrumentError as error:
            assert error.device == "stage1" and error.remedy  # noqa: PT017, PT018 - no error is a success, too
        assert time.monotonic() - began_s < 60.0
    stage.close()
    peer.end()
