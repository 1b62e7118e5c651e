"""Positions in a burst never shift, whatever is lost."""

from hypothesis import given
from hypothesis import strategies as st

from drivers.camera.counting import Arrival, FrameCount


def test_frames_in_order():
    count = FrameCount(3)
    assert [count.frame(number) for number in (7, 8, 9)] == [Arrival(0, 0), Arrival(0, 1), Arrival(0, 2)]
    assert count.complete
    assert count.first_id == 7


def test_a_gap_is_a_lost_frame_and_keeps_its_place():
    count = FrameCount(None)
    assert count.frame(0) == Arrival(0, 0)
    assert count.frame(3) == Arrival(2, 3)


def test_a_frame_that_comes_again_is_stale_and_takes_no_place():
    count = FrameCount(3)
    assert [count.frame(number).index for number in (5, 6, 6, 7)] == [0, 1, None, 2]
    assert count.complete


def test_the_first_frame_that_comes_again_is_known_by_its_time_or_by_what_the_camera_did_before():
    count = FrameCount(3)
    times_s = ((5, 1.0), (5, 1.0), (6, 1.5), (7, 2.0))
    assert [count.frame(number, 0, time_s).index for number, time_s in times_s] == [0, None, 1, 2]
    assert count.advances
    count = FrameCount(2, advances=True)
    assert [count.frame(number).index for number in (5, 5, 6)] == [0, None, 1]


def test_of_a_camera_that_counts_nothing_no_frame_is_lost():
    count = FrameCount(3)
    assert [count.frame(0) for _ in range(3)] == [Arrival(0, 0), Arrival(0, 1), Arrival(0, 2)]
    assert count.complete
    assert not count.advances
    count = FrameCount(3)
    assert [count.frame(0, 0, time_s).index for time_s in (1.0, 1.5, 1.5, 2.0)] == [0, 1, None, 2]
    count = FrameCount(3)
    count.frame(0)
    assert count.incomplete() == 1
    assert count.frame(0) == Arrival(0, 2)


def test_an_incomplete_frame_keeps_its_place():
    count = FrameCount(None)
    count.frame(0)
    assert count.incomplete() == 1
    assert count.frame(2) == Arrival(0, 2)


def test_frames_before_the_first_are_lost_only_where_the_transport_says_so():
    assert FrameCount(None).frame(2, stream_lost=2) == Arrival(2, 2)
    assert FrameCount(None, first_id=1).frame(2, stream_lost=5) == Arrival(1, 1)
    assert FrameCount(None).frame(65401, stream_lost=0) == Arrival(0, 0)
    assert FrameCount(None).frame(65401, stream_lost=3) == Arrival(0, 0)


def test_silent_losses_are_not_counted_again_by_the_gap():
    count = FrameCount(None)
    count.frame(0)
    assert count.silent(2) == 2
    assert count.frame(3) == Arrival(0, 3)
    assert count.silent(2) == 0


def test_a_burst_ends_with_its_last_position():
    count = FrameCount(3)
    count.frame(0)
    assert count.frame(9) == Arrival(2, None)
    assert count.complete


def test_a_count_that_begins_anew_is_followed():
    count = FrameCount(None)
    count.frame(500)
    assert count.frame(0) == Arrival(0, 1)
    assert count.frame(1) == Arrival(0, 2)


@given(fates=st.lists(st.sampled_from(["good", "lost", "incomplete"]), max_size=40), first=st.integers(0, 9))
def test_the_index_is_the_position_whatever_befalls_the_others(fates, first):
    fates = ["good", *fates]
    count = FrameCount(len(fates))
    for position, fate in enumerate(fates):
        if fate == "good":
            assert count.frame(first + position).index == position
        elif fate == "incomplete":
            lost_before = fates[:position][::-1].index("good") if "good" in fates[:position] else 0
            told = count.incomplete()
            # Lost frames right before it show only with the next good one.
            assert position - lost_before <= told <= position
            if told != position:
                return
    count.silent(fates.count("lost"))
    assert count.complete
