"""One simulated world for all tests of several instruments at once."""

import importlib.util
from collections.abc import Iterator

import pytest
from world_bench import WorldBench


@pytest.fixture(scope="session")
def served() -> Iterator[WorldBench]:
    if importlib.util.find_spec("harvesters") is None:
        pytest.skip("harvesters is not installed: pip install 'irpmd-rig[camera]'")
    bench = WorldBench()
    try:
        bench.open()
        bench.works()
        yield bench
    finally:
        bench.close()
        bench.operator.close()


@pytest.fixture
def bench(served: WorldBench) -> Iterator[WorldBench]:
    """Return all instruments, each of which has worked at least once; what lasts of a fault is mended afterwards."""
    yield served
    served.mend()
