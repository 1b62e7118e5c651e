from irpmd_rig.acquisition.queue import STARTED, RunQueue


def test_it_begins_held_and_says_why() -> None:
    queue = RunQueue()
    assert queue.why_held == STARTED
    queue.resume()
    assert queue.why_held == ""
    queue.hold("run x failed")
    assert queue.why_held == "run x failed"


def test_first_come_first_served_whatever_the_order_of_reading() -> None:
    queue = RunQueue()
    for run_id, order in (("c", 30), ("a", 10), ("b", 20)):
        queue.add(run_id, order)
    assert queue.waiting() == ("a", "b", "c")
    assert queue.first() == "a"
    queue.remove("a")
    queue.remove("a")
    assert queue.first() == "b"


def test_places_only_grow() -> None:
    queue = RunQueue()
    queue.seen(41)
    queue.seen(None)
    assert queue.next_order() == 42
    queue.add("late", 50)
    assert queue.next_order() == 51
    assert queue.next_order() == 52


def test_an_empty_queue_has_no_first() -> None:
    assert RunQueue().first() is None


def test_leave_is_fresh_until_a_run_starts() -> None:
    queue = RunQueue()
    assert not queue.leave_is_fresh
    queue.resume()
    assert queue.leave_is_fresh
    queue.leave_used()
    assert not queue.leave_is_fresh
    assert queue.why_held == ""
    queue.resume()
    queue.hold("a run failed")
    assert not queue.leave_is_fresh
