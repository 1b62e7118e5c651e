import threading
import time
from collections.abc import Callable

import pytest

from irpmd_rig.acquisition.conduct import Conduct, Ending, RunEnded
from irpmd_rig.store.states import Reason, RunState

ABORT = Ending(RunState.ABORTED, Reason.ABORTED_BY_USER, "Ada aborted it")
STOP = Ending(RunState.FAILED, Reason.STOPPED, "stopped")


def later(do: object, *arguments: object) -> None:
    threading.Timer(0.03, do, arguments).start()  # type: ignore[arg-type]


def test_the_first_wish_to_end_counts() -> None:
    conduct = Conduct()
    conduct.check()
    conduct.end(ABORT)
    conduct.end(STOP)
    with pytest.raises(RunEnded, match="Ada aborted it") as raised:
        conduct.check()
    assert raised.value.ending == ABORT
    assert conduct.asked == "abort"


def test_a_pause_lasts_until_it_is_resumed() -> None:
    conduct, told = Conduct(), []
    conduct.pause_if_wanted(lambda: told.append("paused"), lambda: told.append("resumed"))
    assert told == []
    conduct.pause()
    assert conduct.asked == "pause"
    later(conduct.resume)
    conduct.pause_if_wanted(lambda: told.append("paused"), lambda: told.append("resumed"))
    assert told == ["paused", "resumed"]


def sleeps(conduct: Conduct) -> None:
    conduct.sleep(30)


def pauses(conduct: Conduct) -> None:
    conduct.pause_if_wanted(lambda: None, lambda: None)


def awaits(conduct: Conduct) -> None:
    conduct.ask(1)
    conduct.await_answer(30)


@pytest.mark.parametrize("wait", [sleeps, pauses, awaits])
def test_every_wait_ends_when_the_run_is_to_end(wait: Callable[[Conduct], None]) -> None:
    conduct = Conduct()
    conduct.pause()
    later(conduct.end, STOP)
    began_s = time.monotonic()
    with pytest.raises(RunEnded):
        wait(conduct)
    assert time.monotonic() - began_s < 20


def test_an_answer_reaches_only_the_prompt_that_waits() -> None:
    conduct = Conduct()
    assert not conduct.answer("done")
    conduct.ask(3)
    assert not conduct.answer("done", prompt=2)
    assert conduct.answer("done", prompt=3)
    assert not conduct.answer("again")
    assert conduct.await_answer(1.0) == "done"
    assert not conduct.answer("late")


def test_a_prompt_waits_only_so_long() -> None:
    conduct = Conduct()
    conduct.ask(1)
    assert conduct.await_answer(0.02) is None
    assert not conduct.answer("late")


def test_sleep_lasts_as_long_as_it_should() -> None:
    began_s = time.monotonic()
    Conduct().sleep(0.05)
    assert time.monotonic() - began_s >= 0.05
