import threading
import time

import pytest

from irpmd_rig.acquisition.hands import Hands, RigBusy, Zeros


def test_a_run_keeps_persons_away() -> None:
    hands = Hands()
    with hands.of_run("r1"):
        assert hands.run_id == "r1"
        for looking in (True, False):
            with pytest.raises(RigBusy, match="run r1") as raised, hands.of_person(looking=looking):
                pass
            assert raised.value.run_id == "r1"
        with hands.of_watch() as free:
            assert not free
    with hands.of_person():
        pass
    assert hands.run_id is None


def test_a_run_that_waits_for_a_person_lets_him_look_but_not_move() -> None:
    hands = Hands()
    with hands.of_run("r1"):
        with hands.at_ease():
            with hands.of_person(looking=True):
                pass
            with pytest.raises(RigBusy), hands.of_person():
                pass
            with hands.of_watch() as free:
                assert not free
        with pytest.raises(RigBusy), hands.of_person(looking=True):
            pass


def test_one_command_waits_for_another_but_not_for_ever() -> None:
    hands = Hands()
    inside, leave = threading.Event(), threading.Event()

    def command() -> None:
        with hands.of_person():
            inside.set()
            leave.wait(60)

    thread = threading.Thread(target=command)
    thread.start()
    inside.wait(60)
    with pytest.raises(RigBusy, match="another command"), hands.of_person(wait_s=0.02):
        pass
    with hands.of_watch() as free:
        assert not free
    threading.Timer(0.05, leave.set).start()
    began_s = time.monotonic()
    with hands.of_person(wait_s=60):
        assert time.monotonic() - began_s < 30
    thread.join()


def test_the_instruments_are_given_back_after_an_error() -> None:
    hands = Hands()
    with pytest.raises(ValueError, match="inside"), hands.of_run("r1"):
        raise ValueError("inside")
    with pytest.raises(ValueError, match="inside"), hands.of_person():
        raise ValueError("inside")
    with hands.of_watch() as free:
        assert free


def test_zeros_are_counted() -> None:
    zeros = Zeros()
    zeros.given("stage1", "stage2")
    before = zeros.now()
    zeros.given("stage1")
    assert zeros.now() == {"stage1": 2, "stage2": 1}
    assert before == {"stage1": 1, "stage2": 1}
