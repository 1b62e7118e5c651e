"""A daemon on a world with write-only stages that ran before: what may still move there is waited for."""

from dataclasses import replace
from pathlib import Path

from daemon_world import carried_out, stations

from irpmd_rig.acquisition.daemon import RigDaemon
from irpmd_rig.acquisition.rig_file import read_rig
from irpmd_rig.store.states import RunState
from tests.small_world import world as served


def test_the_first_run_waits_for_what_an_earlier_program_may_have_begun(tmp_path: Path) -> None:
    with served(tmp_path / "world", **{"time-scale": 1, "stages": "gcd-0301m"}) as world:
        file = read_rig("sim-gcd").with_simulation(folder=world.folder)
        storage = file.storage.model_copy(update={"root": tmp_path / "data", "reserve_gb": 0.0})
        with RigDaemon(replace(file, storage=storage)) as daemon:
            status = carried_out(daemon, stations(1))
    assert status.state is RunState.SUCCEEDED, status.detail
