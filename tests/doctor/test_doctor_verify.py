"""The walk through a first contact: on instruments without a word about a world, as a lab has them."""

import io
import os
import re
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from rich.console import Console
from ruamel.yaml import YAML

from irpmd_rig.acquisition.control import WorldControl
from irpmd_rig.acquisition.simulated import serve_command
from irpmd_rig.doctor import doctor
from irpmd_rig.shipped import world_file

LAB = """\
name: Lab 1
camera:
  driver: harvesters
  producer: {producer}
projector:
  driver: lightcommander
  transport: usb
  profile: lightcommander-sim
  backend: {usb_backend}
  backend_argument: {usb_argument}
  sequences: {sequences}
stage1:
  driver: serial
  port: {ports[stage1]}
  dialect: gcd-0301m
  counts_per_mm: 1250.0
  sign: 1
  limits_mm: [-20.0, 20.0]
  speeds: {{kind: table, speeds: [{{code: 0xEF, speed_mm_per_s: 20.0}}]}}
  ramp_s: 0.2
  speed_mm_per_s: 20.0
  accept_no_stop: true
  moving_at_open_s: 0.5
"""

DARK = {"led": None, "intensity": 0.0}


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    folder = tmp_path_factory.mktemp("world")
    command = serve_command(world_file("misaligned"), folder, {"size-px": 64, "stages": "gcd-0301m"})
    process = subprocess.Popen(
        [*command, "--until-stdin-closes"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
    )
    assert process.stdout.readline().startswith(b"ready")
    yield WorldControl(folder)
    process.communicate(timeout=60)


@pytest.fixture
def lab(world, tmp_path):
    path = tmp_path / "lab.yaml"
    path.write_text(LAB.format(**world.hello()), encoding="utf-8")
    return path


class Person:
    """Answers questions: by the first pattern that a question fits; else presses Enter."""

    def __init__(self, answers: dict[str, str | Callable[[], str]]) -> None:
        self._answers = answers
        self.asked: list[str] = []

    def __call__(self, prompt: str) -> str:
        self.asked.append(prompt)
        for pattern, answer in self._answers.items():
            if re.search(pattern, prompt):
                return answer if isinstance(answer, str) else answer()
        return ""


def walked(lab: Path, person: Person) -> tuple[int, dict, str]:
    console, record = Console(file=io.StringIO(), width=200), lab.with_name("record.yaml")
    status = doctor(str(lab), verify=True, as_json=False, console=console, record=record, read=person)
    return status, YAML(typ="safe").load(record), console.file.getvalue()


def checks(record: dict, device: str) -> dict[str, dict]:
    return {check["check"]: check for check in record["checks"] if check["device"] == device}


def light(world: WorldControl) -> dict:
    state = world.call("state")
    return {key: state[key] for key in DARK}


def position_mm(world: WorldControl) -> float:
    return world.call("state")["stages"]["stage1"]["position_mm"]


def test_a_whole_walk_lights_moves_and_writes_it_down(world, lab):
    seen = []

    def lit() -> str:
        seen.append(light(world))
        return "y"

    # The scale is asked for again after an answer that is no number.
    scale = iter(["abc", "0.0"])
    person = Person(
        {
            "Your name": "Ada",
            "label": "y",
            "beam clear": "yes",
            "LED, and no other": lit,
            "current": "0.35",
            "ramp": "y",
            "light off": lit,
            "manual": "y",
            "way clear": "yes",
            "stand on its scale": lambda: next(scale),
            "Dial gauge": lambda: f"{position_mm(world):.3f}",
            "as far": "n",
            "Did you check": "y",
            "What did you find": "as it says",
        }
    )
    status, record, text = walked(lab, person)

    assert status == 1, "a check that is answered no is a finding"
    assert (record["who"], record["complete"], record["simulated"]) == ("Ada", True, False)
    assert record["began"] <= record["ended"]
    assert record["instruments"]["camera"]["serial_number"] == "SIM00001"
    assert seen == [{"led": "infrared", "intensity": 0.1}, DARK]
    led = checks(record, "projector")["the infrared LED, and no other, lights at 10%"]
    assert (led["answer"], led["values"]["current_a"]) == ("yes", 0.35)

    frames = checks(record, "stage1")["frames of a move by 1 mm"]["shown"]
    # @1D01, @1SEF, @1P000004E2 (1250 counts), @0G, each with CR LF.
    assert frames == [
        "40 31 44 30 31 0d 0a",
        "40 31 53 45 46 0d 0a",
        "40 31 50 30 30 30 30 30 34 45 32 0d 0a",
        "40 30 47 0d 0a",
    ]
    assert frames[0] in text
    # The box has 1000 counts to a millimetre, the rig file says 1250: the dial gauge finds it.
    move = checks(record, "stage1")["a short move, by the dial gauge"]
    assert move["answer"] == "no"
    assert move["values"]["moved_mm"] == pytest.approx(1.25, abs=0.02)
    assert move["values"]["counts_per_mm_by_gauge"] == pytest.approx(1000, abs=10)
    assert move["values"]["position_is"] == "estimated"
    assert position_mm(world) == pytest.approx(0.0, abs=0.02)
    assert sum("Did you check it" in question for question in person.asked) >= 10
    assert any("stage1 never answers" in check for check in checks(record, "stage1"))

    nodes = lab.with_name("record-camera-nodes.csv").read_text(encoding="utf-8")
    assert "ExposureTime," in nodes
    assert b"RegisterDescription" in lab.with_name("record-camera-nodes.xml").read_bytes()


def test_without_consent_nothing_lights_and_nothing_moves(world, lab):
    seen = []

    def look() -> str:
        seen.append(light(world))
        return "y"

    before = position_mm(world)
    status, record, _ = walked(lab, Person({"Your name": "Ada", "type yes": "y", "manual": look, "Did you": look}))
    assert status == 0
    assert record["complete"]
    assert {str(state) for state in seen} == {str(DARK)}
    assert position_mm(world) == before
    assert checks(record, "projector")["light"]["answer"] == "skipped"
    assert checks(record, "stage1")["a short move"]["answer"] == "skipped"


@pytest.mark.parametrize("how", [EOFError, KeyboardInterrupt, signal.SIGHUP, signal.SIGTERM])
def test_a_walk_that_is_broken_off_leaves_darkness_and_what_was_answered(world, lab, how):
    """By the person, by closing the terminal, by whoever ends the process."""
    seen, before = [], [signal.getsignal(number) for number in (signal.SIGHUP, signal.SIGTERM)]

    def leave() -> str:
        seen.append(light(world))
        if isinstance(how, signal.Signals):
            os.kill(os.getpid(), how)
            time.sleep(10)
            return ""
        raise how

    person = Person({"Your name": "Ada", "label": "y", "beam clear": "yes", "LED, and no other": leave})
    status, record, text = walked(lab, person)
    assert status == 1
    assert seen[0]["led"] == "infrared"
    assert light(world) == DARK
    assert not record["complete"]
    assert checks(record, "camera")["the serial number is that on the label"]["answer"] == "yes"
    assert "Broken off" in text
    assert [signal.getsignal(number) for number in (signal.SIGHUP, signal.SIGTERM)] == before


def test_an_instrument_that_does_not_answer_is_written_down(world, lab):
    world.call("fault", name="camera_unplug")
    try:
        status, record, _ = walked(lab, Person({"Your name": "Ada"}))
    finally:
        world.call("fault", name="camera_replug")
    assert status == 1
    assert checks(record, "camera")["it answers"]["answer"] == "no"
    assert record["instruments"]["camera"]["serial_number"] == "not reached"
    assert "light" in checks(record, "projector")


def test_a_record_that_cannot_be_written_is_an_error_and_leaves_darkness(world, lab):
    person = Person({"Your name": "Ada"})
    with pytest.raises(OSError, match="nowhere"):
        doctor(
            str(lab), verify=True, as_json=False, console=Console(file=io.StringIO()),
            record=lab.parent / "nowhere" / "record.yaml", read=person,
        )  # fmt: skip
    assert len(person.asked) == 1, "nobody walks for nothing"
    assert light(world) == DARK
