"""How the producer comes to be: built once, kept, shared, or refused in one clear line."""

import ctypes
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from sims.camera import ProducerError, build, producer


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv(build.VARIABLE, raising=False)
    return tmp_path / "irpmd-rig"


@pytest.fixture
def sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with other, smaller sources."""
    folder = tmp_path / "sources"
    folder.mkdir()
    (folder / "small.c").write_text("int GCInitLib(void) { return 0; }\n")
    monkeypatch.setattr(build, "SOURCES", folder)
    return folder


@pytest.mark.usefixtures("sources")
def test_it_is_built_once_and_nothing_else_is_left(cache: Path) -> None:
    with ThreadPoolExecutor(4) as pool:
        built = list(pool.map(lambda _: producer(), range(4)))
    assert len(set(built)) == 1
    assert sorted(path.name for path in cache.iterdir()) == sorted([built[0].name, "producer.lock"])
    first = built[0].stat().st_mtime_ns
    assert producer().stat().st_mtime_ns == first


def test_it_exports_the_calls_of_the_standard() -> None:
    library = ctypes.CDLL(str(producer()))
    for name in ("GCInitLib", "TLOpen", "IFOpenDevice", "DevOpenDataStream", "DSQueueBuffer", "EventGetData"):
        assert hasattr(library, name)
    # Before GCInitLib nothing can be opened: GC_ERR_NOT_INITIALIZED.
    assert library.TLOpen(ctypes.byref(ctypes.c_void_p())) == -1002


def test_other_sources_get_another_file(sources: Path) -> None:
    first = producer()
    (sources / "small.c").write_text("int GCInitLib(void) { return 1; }\n")
    assert producer() != first


def test_a_prebuilt_file_is_taken_as_it_is(cache: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    prebuilt = tmp_path / "ready.cti"
    prebuilt.touch()
    monkeypatch.setenv(build.VARIABLE, str(prebuilt))
    assert producer() == prebuilt
    assert not cache.exists()


def test_a_missing_prebuilt_file_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(build.VARIABLE, "/nowhere/x.cti")
    with pytest.raises(ProducerError, match=r"IRPMD_SIM_PRODUCER names '/nowhere/x\.cti', which is no file"):
        producer()


def test_without_a_compiler_the_package_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ProducerError, match=r"none is on the PATH: install the package gcc .*build-essential"):
        producer()


def test_sources_that_do_not_compile_show_the_compilers_words(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    broken = tmp_path / "broken"
    broken.mkdir()
    (broken / "bad.c").write_text("int main(void) { return nothing; }\n")
    monkeypatch.setattr(build, "SOURCES", broken)
    with pytest.raises(ProducerError, match="nothing"):
        producer()


def test_a_cache_that_cannot_be_written_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    with pytest.raises(ProducerError, match="set XDG_CACHE_HOME"):
        producer()
