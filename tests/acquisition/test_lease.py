import contextlib
import itertools
import math
import threading

import pytest

from irpmd_rig.acquisition.lease import LONGEST_LEASE_S, BadLease, LeaseBook, LeaseHeld, LeaseNeeded


class Clock:
    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def book(clock: Clock) -> LeaseBook:
    return LeaseBook(monotonic=clock, clock=lambda: clock() + 1e9)


def test_one_holder_at_a_time_and_the_other_is_told_who(book: LeaseBook) -> None:
    lease = book.take("Ada", 60)
    with pytest.raises(LeaseHeld, match=r"controlled by Ada until 2001-.*override") as raised:
        book.take("Bea", 60)
    assert raised.value.holder.owner == "Ada"
    assert raised.value.holder.expires_s == lease.expires_s
    assert lease.id not in str(raised.value)
    assert book.check(lease.id) == lease


def test_the_holder_takes_no_second_one(book: LeaseBook) -> None:
    book.take("Ada", 60)
    with pytest.raises(LeaseHeld):
        book.take("Ada", 60)


def test_it_expires(book: LeaseBook, clock: Clock) -> None:
    lease = book.take("Ada", 60)
    clock.now_s += 59.9
    assert book.left_s() == pytest.approx(0.1)
    clock.now_s += 0.1
    assert book.holder() is None
    assert book.left_s() == 0.0
    with pytest.raises(LeaseNeeded, match="take the lease first"):
        book.check(lease.id)
    assert book.take("Bea", 1).overridden is None


def test_renewed_it_lasts_from_now(book: LeaseBook, clock: Clock) -> None:
    lease = book.take("Ada", 60)
    clock.now_s += 50
    renewed = book.renew(lease.id, 30)
    assert renewed.id == lease.id
    assert renewed.expires_s == lease.expires_s + 20
    clock.now_s += 29
    book.check(lease.id)


def test_released_it_is_free(book: LeaseBook) -> None:
    lease = book.take("Ada", 60)
    book.release(lease.id)
    assert book.holder() is None
    with pytest.raises(LeaseNeeded):
        book.release(lease.id)


def test_an_override_is_recorded_and_ends_the_first(book: LeaseBook) -> None:
    first = book.take("Ada", 60)
    second = book.take("Bea", 60, override=True)
    assert second.overridden == "Ada"
    for use in (book.check, book.release, lambda lease: book.renew(lease, 10)):
        with pytest.raises(LeaseHeld, match="Bea"):
            use(first.id)


@pytest.mark.parametrize("given", [None, "", "wrong", "ä"])
def test_a_wrong_id_is_refused(book: LeaseBook, given: str | None) -> None:
    with pytest.raises(LeaseNeeded):
        book.check(given)
    book.take("Ada", 60)
    with pytest.raises(LeaseHeld, match="Ada"):
        book.check(given)


@pytest.mark.parametrize("duration_s", [0.0, -1.0, math.nan, math.inf, LONGEST_LEASE_S + 1])
def test_a_duration_out_of_bounds_is_refused(book: LeaseBook, duration_s: float) -> None:
    with pytest.raises(BadLease, match="give more than 0"):
        book.take("Ada", duration_s)
    lease = book.take("Ada", 60)
    with pytest.raises(BadLease):
        book.renew(lease.id, duration_s)
    assert book.check(lease.id) == lease


@pytest.mark.parametrize("owner", ["", "  ", "x" * 101, "a\nb"])
def test_an_owner_without_a_name_is_refused(book: LeaseBook, owner: str) -> None:
    with pytest.raises(BadLease, match="name"):
        book.take(owner, 60)


def test_of_many_who_ask_at_once_one_gets_it() -> None:
    book = LeaseBook()
    got: list[str] = []
    begin = threading.Barrier(8)

    def ask(number: int) -> None:
        begin.wait()
        with contextlib.suppress(LeaseHeld):
            got.append(book.take(f"person {number}", 60).owner)

    threads = [threading.Thread(target=ask, args=(number,)) for number in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(got) == 1


def test_ids_are_never_given_twice(book: LeaseBook) -> None:
    ids = {book.take("Ada", 60, override=True).id for _ in itertools.repeat(None, 50)}
    assert len(ids) == 50
