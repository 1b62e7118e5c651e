import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from irpmd_rig.store.durable import Journal, write_file, write_text
from irpmd_rig.store.errors import DiskFull, RunFolderError, WriteFailed


@contextmanager
def largest_file(nbytes: int) -> Iterator[None]:
    """Let the system refuse files beyond a size: writing behaves as on a full disk, in part or not at all."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (nbytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.fixture
def journal(tmp_path: Path) -> Journal:
    return Journal(tmp_path / "lines.jsonl")


def test_lines_come_back_with_their_numbers(journal: Journal) -> None:
    assert journal.read() == []
    journal.append(['{"a": 1}', '{"a": 2}'])
    journal.append(['{"a": 3}'])
    assert journal.read() == [(1, {"a": 1}), (2, {"a": 2}), (3, {"a": 3})]


@pytest.mark.parametrize("torn", [b'{"a": 2', b"\0\0\0", b"{", b'{"a": "\xff', b"17"])
def test_a_torn_last_line_is_no_line_and_the_next_append_removes_it(journal: Journal, torn: bytes) -> None:
    journal.path.write_bytes(b'{"a": 1}\n' + torn)
    assert journal.read() == [(1, {"a": 1})]
    journal.append(['{"a": 2}'])
    assert journal.path.read_bytes() == b'{"a": 1}\n{"a": 2}\n'


def test_a_whole_last_line_without_its_newline_counts_and_is_kept(journal: Journal) -> None:
    journal.path.write_bytes(b'{"a": 1}\n{"a": 2}')
    assert [content["a"] for _, content in journal.read()] == [1, 2]
    assert not journal.mend()
    journal.append(['{"a": 3}'])
    assert [content["a"] for _, content in journal.read()] == [1, 2, 3]


def test_mend_says_whether_something_was_torn(journal: Journal) -> None:
    assert not journal.mend()
    journal.path.write_bytes(b'{"a": 1}\n{"a"')
    assert journal.mend()
    assert journal.path.read_bytes() == b'{"a": 1}\n'


def test_a_damaged_line_before_the_last_is_named(journal: Journal) -> None:
    journal.path.write_bytes(b'{"a": 1}\n[2]\n{"a": 3}\n')
    with pytest.raises(RunFolderError, match=r"lines.jsonl:2: not a JSON object"):
        journal.read()


def test_a_line_that_does_not_fit_leaves_nothing_of_itself(journal: Journal) -> None:
    journal.append(['{"a": 1}'])
    with largest_file(20), pytest.raises(DiskFull):
        journal.append(['{"a": "far more than there is room for"}'])
    assert journal.path.read_bytes() == b'{"a": 1}\n'
    journal.append(['{"a": 2}'])
    assert len(journal.read()) == 2


def test_a_file_is_there_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "file.txt"
    write_text(path, "first")
    with largest_file(100), pytest.raises(DiskFull) as caught:
        write_text(path, "second" * 100)
    assert caught.value.path == path
    assert path.read_text() == "first"
    assert [left.name for left in tmp_path.iterdir()] == ["file.txt"]


def test_a_writer_that_raises_leaves_nothing(tmp_path: Path) -> None:
    def write(_stream: object) -> None:
        raise KeyError("unrelated")

    with pytest.raises(KeyError):
        write_file(tmp_path / "file.txt", write)
    assert not list(tmp_path.iterdir())


def test_a_disk_that_refuses_for_another_reason_is_a_typed_error(tmp_path: Path) -> None:
    (tmp_path / "file.txt").mkdir()
    with pytest.raises(WriteFailed, match=r"file\.txt"):
        write_text(tmp_path / "file.txt", "text")
    with pytest.raises(WriteFailed, match="missing"):
        write_text(tmp_path / "missing" / "file.txt", "text")
