"""Scripts of faults: seeded, timed, checked when they are read, ended when they are switched off."""

from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import pytest

from sims.errors import SimulationError, WorldError
from sims.process.faults import Faults
from sims.process.instruments import Conditions, Instruments
from sims.process.script import RandomFaults, Script, TimedFault, ending, random_events, read_script
from sims.world import World


@pytest.fixture(scope="module")
def instruments(tmp_path_factory: pytest.TempPathFactory, ideal: World) -> Iterator[Instruments]:
    folder = tmp_path_factory.mktemp("instruments")
    with Instruments(ideal, folder, Conditions(time_scale=100.0)) as served:
        yield served
    assert list(folder.iterdir()) == []


@pytest.fixture
def faults(instruments: Instruments) -> Faults:
    return Faults(instruments)


def test_the_seed_decides_what_comes_when() -> None:
    first, again, other = (
        list(islice(random_events(RandomFaults(seed=seed, rate_per_s=2.0)), 300)) for seed in (1, 1, 2)
    )
    assert first == again != other
    times = [event.at_s for event in first]
    assert times == sorted(times)
    # Ends come on top of the two a second.
    assert 50 < times[-1] < 150


def test_every_random_fault_is_one_of_the_world_and_what_lasts_is_ended(faults: Faults) -> None:
    events = list(islice(random_events(RandomFaults(seed=4, rate_per_s=1.0)), 2000))
    for event in events:
        assert faults.check(event.fault, event.arguments) is not None
    came = {event.fault for event in events}
    assert came == set(faults.names)
    for name in ("camera_unplug", "stage_mute", "camera_slow"):
        number, event = next((k, event) for k, event in enumerate(events) if event.fault == name)
        end = ending(event, 0.0)
        assert end is not None
        assert any((later.fault, later.arguments) == (end.fault, end.arguments) for later in events[number + 1 :])


def test_only_the_names_that_were_asked_for_come() -> None:
    settings = RandomFaults(seed=1, rate_per_s=1.0, names=("stage_stall", "frame_dropped"))
    assert {event.fault for event in islice(random_events(settings), 50)} == {"stage_stall", "frame_dropped"}
    with pytest.raises(SimulationError, match="did you mean 'stage_stall'"):
        random_events(RandomFaults(seed=1, rate_per_s=1.0, names=("stage_stal",)))


def test_a_script_file_is_carried_out_and_what_lasts_ends_with_it(
    tmp_path: Path, instruments: Instruments, faults: Faults
) -> None:
    path = tmp_path / "faults.yaml"
    path.write_text(
        "script:\n"
        "- {at_s: 2.0, fault: stage_mute, arguments: {stage: stage2}}\n"
        "- {at_s: 1.0, fault: camera_unplug}\n"
        "- {at_s: 3.0, fault: camera_replug}\n"
        "- {at_s: 3.5, fault: frame_dropped, arguments: {frames: 2}}\n"
    )
    script = Script(faults, instruments.clock)
    start_s = instruments.clock.now()
    script.start(read_script(path, faults))
    while len(faults.injected) < 4:
        instruments.clock.sleep(0.1)
        assert instruments.clock.now() - start_s < 6000
    assert [entry.name for entry in faults.injected] == [
        "camera_unplug",
        "stage_mute",
        "camera_replug",
        "frame_dropped",
    ]
    for entry, wanted_s in zip(faults.injected, (1.0, 2.0, 3.0, 3.5), strict=True):
        assert entry.time_s - start_s >= wanted_s
    assert instruments.stages["stage2"].faults.line.mute
    script.stop()
    assert not instruments.stages["stage2"].faults.line.mute
    assert faults.injected[-1].arguments == {"stage": "stage2", "on": False}
    script.stop()


def test_a_script_that_follows_ends_the_one_before(instruments: Instruments, faults: Faults) -> None:
    script = Script(faults, instruments.clock)
    script.start(iter([TimedFault(at_s=0, fault="camera_hang")]))
    while not instruments.camera.faults.hanging:
        instruments.clock.sleep(0.1)
    script.start_random(RandomFaults(seed=1, rate_per_s=0.001))
    assert not instruments.camera.faults.hanging
    script.stop()


@pytest.mark.parametrize(
    ("text", "complaints"),
    [
        ("script:\n- {at_s: -1, fault: camera_hang}\n", ["f.yaml:2:10: Input should be greater"]),
        ("script:\n- {at_s: 1}\n", ["f.yaml:2:3: Field required"]),
        ("scripts: []\n", ["f.yaml:1:10: Extra inputs"]),
        ("random: {seed: 1, rate_per_s: 0}\n", ["f.yaml:1:31: Input should be greater"]),
        ("random: {seed: 1, rate_per_s: 1, names: [x]}\n", ["f.yaml:1:41: no fault 'x' can come at random"]),
        ("[]\n", ["f.yaml:1:1: the file must be a mapping"]),
        (
            "script:\n- {at_s: 1, fault: hang}\n- {at_s: 1, fault: stage_stall, arguments: {stage: x}}\n",
            ["f.yaml:2:20: there is no fault 'hang'", "f.yaml:3:20: fault 'stage_stall': stage: Input should be"],
        ),
    ],
)
def test_a_wrong_script_says_where(tmp_path: Path, faults: Faults, text: str, complaints: list[str]) -> None:
    path = tmp_path / "f.yaml"
    path.write_text(text)
    with pytest.raises(WorldError) as raised:
        read_script(path, faults)
    lines = str(raised.value).splitlines()
    assert len(lines) == len(complaints)
    assert all(line.startswith(complaint) for line, complaint in zip(lines, complaints, strict=True))
