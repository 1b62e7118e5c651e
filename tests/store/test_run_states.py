import itertools
from datetime import datetime

import pytest

from irpmd_rig.store import ENDED, ENDED_BADLY, TRANSITIONS, Reason, RunState, Transition, TransitionRefused
from irpmd_rig.store import check_transition as check


def transition(state: RunState, attempt: int = 1) -> Transition:
    return Transition(state, Reason.STOPPED if state in ENDED_BADLY else None, attempt=attempt)


def test_every_state_has_its_transitions() -> None:
    assert set(TRANSITIONS) == set(RunState)


def test_the_way_to_success() -> None:
    way = ["queued", "preparing", "running", "paused", "running", "waiting_for_operator", "running"]
    way += ["reconstructing", "succeeded"]
    check(None, transition(RunState.QUEUED))
    for before, after in itertools.pairwise(way):
        check(transition(RunState(before)), transition(RunState(after)))


@pytest.mark.parametrize("state", sorted(set(RunState) - ENDED))
@pytest.mark.parametrize("end", sorted(ENDED_BADLY))
def test_whatever_has_not_ended_may_end_badly(state: RunState, end: RunState) -> None:
    check(transition(state), transition(end))


@pytest.mark.parametrize("end", sorted(ENDED_BADLY))
def test_a_retry_queues_again_with_the_next_attempt(end: RunState) -> None:
    check(transition(end), transition(RunState.QUEUED, attempt=2))
    with pytest.raises(TransitionRefused, match="attempt 2"):
        check(transition(end), transition(RunState.QUEUED, attempt=1))
    assert TRANSITIONS[end] == {RunState.QUEUED}


def test_success_is_final_and_nothing_skips_the_frames() -> None:
    for state in RunState:
        with pytest.raises(TransitionRefused, match="it has ended"):
            check(transition(RunState.SUCCEEDED), transition(state))
    only = [state for state in RunState if RunState.SUCCEEDED in TRANSITIONS[state]]
    assert only == [RunState.RECONSTRUCTING]


def test_a_run_begins_queued() -> None:
    with pytest.raises(TransitionRefused, match="begins as queued"):
        check(None, transition(RunState.RUNNING))


def test_a_bad_end_needs_a_reason_and_nothing_else_has_one() -> None:
    with pytest.raises(TransitionRefused, match="needs a reason"):
        Transition(RunState.FAILED)
    with pytest.raises(TransitionRefused, match="has no reason"):
        Transition(RunState.RUNNING, Reason.LIMIT)


def test_a_transition_knows_when_it_happened() -> None:
    time = transition(RunState.QUEUED).time
    assert isinstance(time, datetime)
    assert time.tzinfo is not None
