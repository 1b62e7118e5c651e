import threading
import time

import pytest

from irpmd_rig.acquisition.events import Event, EventLog


@pytest.fixture
def log() -> EventLog:
    return EventLog(kept=10, clock=lambda: 5.0)


def names(events: list[Event] | None) -> list[str]:
    assert events is not None
    return [str(event.data.get("name", event.kind)) for event in events]


def test_ids_grow_by_one_and_above_those_of_an_earlier_start() -> None:
    first = EventLog(clock=lambda: 1000.0)
    ids = [first.announce("state").id for _ in range(3)]
    assert ids == [ids[0], ids[0] + 1, ids[0] + 2]
    assert EventLog(clock=lambda: 1000.01).announce("state").id > ids[-1]


def test_a_reader_sees_what_comes_after_it_subscribed(log: EventLog) -> None:
    log.announce("state", name="before")
    reader = log.subscribe()
    assert reader.take() == []
    event = log.announce("state", "run", name="after")
    assert (event.run_id, event.time_s) == ("run", 5.0)
    assert reader.take() == [event]
    assert reader.take() == []


def test_a_reader_resumes_after_an_id(log: EventLog) -> None:
    ids = [log.announce("state", name=str(number)).id for number in range(5)]
    assert names(log.subscribe(after_id=ids[1]).take()) == ["2", "3", "4"]
    assert log.subscribe(after_id=ids[-1]).take() == []


def test_a_reader_of_one_run_sees_only_that(log: EventLog) -> None:
    reader = log.subscribe(run_id="a")
    log.announce("state", "a", name="mine")
    log.announce("state", "b", name="other")
    log.announce("rig", name="rig")
    assert names(reader.take()) == ["mine"]


def test_a_slow_reader_is_told_of_the_gap_and_goes_on(log: EventLog) -> None:
    reader = log.subscribe(run_id="a")
    for number in range(25):
        log.announce("progress", "a", name=str(number))
    events = reader.take()
    assert names(events) == ["gap", *(str(number) for number in range(15, 25))]
    assert events is not None
    assert events[0].data["missed"] == 15
    assert [event.id for event in events] == list(range(events[0].id, events[0].id + 11))
    assert reader.take() == []


def test_an_id_that_was_never_given_is_a_gap_of_unknown_size(log: EventLog) -> None:
    log.announce("state", name="first")
    last = log.announce("state", name="second")
    events = log.subscribe(after_id=last.id + 1000).take()
    assert names(events) == ["gap", "first", "second"]
    assert events is not None
    assert events[0].data["missed"] is None


def test_an_old_id_without_any_event_is_a_gap(log: EventLog) -> None:
    reader = log.subscribe(after_id=17)
    assert names(reader.take()) == ["gap"]
    assert reader.take() == []


def test_waiting_ends_with_an_event_or_with_its_time(log: EventLog) -> None:
    reader = log.subscribe(run_id="a")
    began_s = time.monotonic()
    assert reader.wait(0.05) == []
    threading.Timer(0.02, lambda: (log.announce("state", "b"), log.announce("state", "a", name="mine"))).start()
    assert names(reader.wait(100.0)) == ["mine"]
    assert time.monotonic() - began_s < 60.0


def test_a_closed_log_is_read_to_its_end(log: EventLog) -> None:
    reader = log.subscribe()
    log.announce("state", name="last")
    log.close()
    assert names(list(reader)) == ["last"]
    assert reader.take() is None


def test_a_reader_that_does_not_block_is_woken(log: EventLog) -> None:
    woken: list[int] = []
    with log.subscribe(wake=lambda: woken.append(1)) as reader:
        log.announce("state")
        assert len(woken) == 1
        assert len(reader.take() or []) == 1
    log.announce("state")
    log.close()
    assert len(woken) == 1


def test_a_thousand_readers_that_never_read_hold_nobody_up() -> None:
    log = EventLog(kept=100)
    readers = [log.subscribe() for _ in range(1000)]
    began_s = time.monotonic()
    for _ in range(2000):
        log.announce("progress")
    assert time.monotonic() - began_s < 30.0
    assert len(readers[0].take() or []) == 101
