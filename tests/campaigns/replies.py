"""Generated replies of every instrument: `python -m tests.campaigns.replies --examples 20000`.

The drivers' own code reads what could come over a line: sound replies that are cut, prolonged, swapped, bent, sent
twice or late, and bytes of no meaning. Whatever comes, the driver returns, or raises a typed error that names the
instrument and says what mends it. Most examples end above the line (no waiting); one in a hundred is a session of a
stage on a real line, with real time-outs.
"""

import argparse
import functools
import json
import random
import struct
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from drivers.camera.backend import NodeFailed, NodeRefused
from drivers.camera.channel import ChannelError, Messages
from drivers.camera.control import CameraControl
from drivers.camera.messages import capabilities_from, dump_from, error_from, settings_from
from drivers.camera.options import CameraOptions
from drivers.errors import InstrumentError, TimedOut
from drivers.projector.dlpc350_controller import Dlpc350Controller
from drivers.projector.lightcommander import LightCommander
from drivers.projector.ti_usb import UsbTransport
from drivers.projector.usb_link import UsbBackend
from drivers.projector.usb_profile import load_profile
from drivers.registry import make
from drivers.stage.dialect import load_dialect
from drivers.stage.frames import ReplyReader, read_acknowledge, read_busy, read_status
from drivers.values import CameraSettings, Led
from sims.projector.sequence_file import Sequence, batch_file
from tests.campaigns.report import Report
from tests.campaigns.wild_nodes import WildNodes
from tests.drivers.stage.stage_peers import Gsc, Peer

SIZES = {"u8": 1, "u16": 2, "u32": 4, "f64": 8}
Example = Callable[[random.Random], None]
SESSION_EVERY = 100
# One example of a session, with the time-outs of its lines, ends within this.
BOUND_S = 20.0


def bent(chance: random.Random, reply: bytes) -> bytes:
    """A reply as a bad line may bring it."""
    kind = chance.randrange(8)
    data = bytearray(reply)
    if kind == 0:
        return reply
    if kind == 1:
        return bytes(data[: chance.randint(0, len(data))])
    if kind == 2:
        return reply + chance.randbytes(chance.randint(1, 20))
    if kind == 3:
        return chance.randbytes(chance.randint(0, 80))
    if kind == 4:
        return reply + reply
    if kind == 5 and len(data) > 1:
        chance.shuffle(data)
    for _ in range(chance.randint(1, 3) if data else 0):
        data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
    return bytes(data)


# --- stages


@functools.cache
def _gsc() -> Any:
    replies = load_dialect("gsc", device="stage1").replies
    assert replies is not None
    return replies


def stage_frames(chance: random.Random) -> None:
    """Replies of a stage controller, in pieces."""
    counts = chance.choice([0, 1, -1, 12_345, -(2**24), 10**12])
    sound = chance.choice([b"OK", b"NG", f"{counts:>10},K,{chance.choice('KLX')},{chance.choice('BR')}".encode()])
    sent = bent(chance, sound + b"\r\n")
    reader, replies = ReplyReader("stage1", _gsc()), _gsc()
    at = 0
    while at < len(sent):
        size = chance.randint(1, 9)
        answer = reader.feed(sent[at : at + size])
        at += size
        if answer is None:
            continue
        for read in (read_status, read_busy, functools.partial(read_acknowledge, frame=b"G:\r\n")):
            try:
                read("stage1", replies, answer)
            except InstrumentError as error:
                checked(error)
        return


class Sessions:
    """A stage of the shipped dialect on a pseudo terminal, whose peer answers wildly."""

    def __init__(self, folder: Path) -> None:
        source = Path(__file__).parents[2] / "drivers" / "stage" / "dialects" / "gsc.yaml"
        self._dialect = folder / "gsc-impatient.yaml"
        self._dialect.write_text(source.read_text().replace("timeout_s: 1.0", "timeout_s: 0.1"))
        self._link = folder / "tty"

    def __call__(self, chance: random.Random) -> None:
        controller, left = Gsc(), [chance.random() < 0.5 for _ in range(8)]

        def wild(frame: bytes) -> bytes:
            return bent(chance, controller(frame)) if left and left.pop() else controller(frame)

        peer = Peer(wild, None, self._link)
        settings = {
            "port": peer.url,
            "dialect": str(self._dialect),
            "counts_per_mm": 1000.0,
            "sign": 1,
            "limits_mm": (-50.0, 50.0),
            "speed_mm_per_s": 10.0,
            "settle_s": 0.0,
            "reconnect_s": 0.5,
            "progress_timeout_s": 0.3,
        }
        stage = make("stage", "serial", "stage1", settings)
        try:
            for operation in (
                stage.open,
                lambda: stage.zero(0.0, confirmed_by="Ada"),
                lambda: stage.move_to(0.5),
                stage.wait,
                stage.home,
                stage.position,
                stage.stop,
            ):
                typed(operation)
        finally:
            stage.close()
            peer.end()


# --- projectors


class Line:
    """Stands for a USB line: what is written is answered by whatever `answer` makes of it."""

    is_open = True

    def __init__(self, answer: Callable[[bytes], list[bytes]]) -> None:
        self._answer = answer
        self._waiting: list[bytes] = []

    def open(self) -> None:
        self._waiting.clear()

    def close(self) -> None:
        self._waiting.clear()

    def write(self, data: bytes) -> None:
        self._waiting += self._answer(data)

    def read(self, size: int, timeout_s: float | None = None) -> bytes:  # noqa: ARG002
        if not self._waiting:
            raise TimedOut("projector1", "no answer on USB", "look at the projector, then retry")
        return self._waiting.pop(0)[:size]

    def recover(self, size: int) -> None:  # noqa: ARG002
        self._waiting.clear()


class LightCommanders:
    """A whole driver of a LightCommander, from opening it to turning it off."""

    def __init__(self, folder: Path) -> None:
        path = folder / "patterns.bf"
        path.write_text(batch_file(Sequence(20_000.0, 25_000.0, 8, ("infrared", "green"))))
        profile = {"transport": "usb", "profile": "lightcommander-sim", "timeout_s": 0.05, "sequences": (str(path),)}
        # Made once, opened again for each example: reading a profile takes longer than all the rest.
        self._driver = LightCommander("projector1", LightCommander.Settings(**profile))
        operations = load_profile("lightcommander-sim", device="projector1").operations.values()
        self._replies = {int(layout.opcode): layout.reply for layout in operations}

    def __call__(self, chance: random.Random) -> None:
        driver = self._driver
        transport = driver._transport
        assert isinstance(transport, UsbTransport)
        transport._link = Line(functools.partial(self._answer, chance))  # type: ignore[assignment]
        for operation in (
            driver.open,
            lambda: driver.set_led(Led.INFRARED, 0.5),
            driver.status,
            driver.stop,
            driver.park,
            driver.unpark,
            lambda: driver.set_led(Led.GREEN, 0.0),
            driver.stop,
        ):
            typed(operation)
        driver.close()

    def _answer(self, chance: random.Random, request: bytes) -> list[bytes]:
        sequence, opcode = struct.unpack_from("<BH", request, 1)
        reply = self._replies[opcode]
        payload = b"" if reply is None else b"1.0" if reply == "text" else bytes(SIZES[str(reply)])
        if chance.random() < 0.1:
            payload = chance.randbytes(len(payload) if chance.random() < 0.7 else chance.randint(0, 12))
        status = chance.choice([1, 5, 8, 77, 255]) if chance.random() < 0.03 else 0
        head = struct.pack("<BBHBBH", 0x5A, sequence, opcode, status, 0, len(payload)) + payload
        sound = head + struct.pack("<H", sum(head) & 0xFFFF)
        if chance.random() > 0.07:
            return [sound]
        return chance.choice([[], [bent(chance, sound)], [bent(chance, sound), sound], [sound, sound]])


def dlpc350(chance: random.Random) -> None:
    """The controller of other boxes: what it says of itself, and what it does not."""

    def answer(packet: bytes) -> list[bytes]:
        flags, sequence = packet[0], packet[1]
        size = chance.randint(0, 58)
        sound = bytes([flags & 0xC0 | 0x40 & flags, sequence, size, 0]) + chance.randbytes(size)
        sound = sound.ljust(64, b"\0")
        return chance.choice([[sound], [bent(chance, sound)], [bent(chance, sound), sound], []])

    controller = Dlpc350Controller("projector1", None, UsbBackend(), 0.05)
    controller.link = Line(answer)  # type: ignore[assignment]
    for operation in (
        controller.faults,
        controller.stop,
        lambda: controller.ask(chance.choice([0x1A0C, 0x1A05, 0x0205]), chance.randint(1, 20)),
        controller.recover,
    ):
        typed(operation)


# --- cameras


def camera_messages(chance: random.Random) -> None:
    """What the camera's process says: bytes, messages, and their contents."""
    told = _json(chance)
    body = json.dumps({"reply": chance.randint(0, 9), "result": told}).encode()
    messages = Messages()
    with suppress(ChannelError):
        for message in messages.feed(bent(chance, len(body).to_bytes(4, "big") + body)):
            assert isinstance(message, dict)
    for read in (settings_from, capabilities_from, dump_from, lambda told: error_from("camera", told)):
        with suppress(ChannelError):
            read(told)


def _json(chance: random.Random, depth: int = 0) -> Any:
    kind = chance.randrange(8 if depth < 3 else 6)
    if kind == 6:
        return [_json(chance, depth + 1) for _ in range(chance.randint(0, 4))]
    if kind == 7:
        names = ["kind", "what", "remedy", "location", "region", "trigger", "xml", "nodes", "vendor", "exposure_us"]
        return {name: _json(chance, depth + 1) for name in chance.sample(names, chance.randint(0, 6))}
    return chance.choice([None, True, chance.randint(-9, 9), chance.uniform(-1e9, 1e9), "DeviceLost", "On", "", "é"])


def camera_nodes(chance: random.Random) -> None:
    """A camera that tells no sense about itself."""
    nodes = WildNodes(chance)
    control = CameraControl("camera", nodes, CameraOptions(), ("maker", "model", "1"))
    settings = CameraSettings(
        exposure_us=chance.choice([None, 1.0, 2000.0]),
        pixel_format=chance.choice([None, "Mono8", "Mono12Packed"]),
        trigger=chance.choice(["free", "software", "hardware"]),
    )
    for operation in (
        control.capabilities,
        lambda: control.configure(settings),
        control.frame_format,
        control.exposure_us,
        control.alive,
        lambda: control.check_temperature(60.0),
        control.trigger,
    ):
        # What a node refuses or fails to do gets its type from the camera's session.
        typed(operation, NodeFailed, NodeRefused)


# --- all


def checked(error: InstrumentError) -> None:
    """An error says which instrument, what, and what to do."""
    assert error.device, error
    assert error.what, error
    assert error.remedy, error


def typed(operation: Callable[[], object], *others: type[Exception]) -> None:
    """An operation that returns, or raises a typed error; anything else is passed on."""
    try:
        operation()
    except others:
        return
    except InstrumentError as error:
        checked(error)


def campaign(examples: int, seed: int) -> Report:
    """Make a campaign of a size."""
    report = Report("replies", examples, seed)
    began_s, made, slowest_s = time.monotonic(), Counter[str](), 0.0
    with tempfile.TemporaryDirectory() as folder:
        session = Sessions(Path(folder))
        quick: tuple[Example, ...] = (
            stage_frames,
            LightCommanders(Path(folder)),
            dlpc350,
            camera_messages,
            camera_nodes,
        )
        for number in range(examples):
            example = session if number % SESSION_EVERY == 0 else quick[number % len(quick)]
            name = getattr(example, "__name__", type(example).__name__)
            made[name] += 1
            example_s = time.monotonic()
            try:
                example(random.Random(f"{seed} {number}"))
            except InstrumentError as error:
                checked(error)
            except Exception as error:
                report.blame("undefined", (name, number, repr(error), _place(error)))
            took_s = time.monotonic() - example_s
            slowest_s = max(slowest_s, took_s)
            if took_s > BOUND_S:
                report.blame("hangs", (name, number, took_s))
    report.figures |= {**made, "slowest_s": round(slowest_s, 3), "duration_s": round(time.monotonic() - began_s, 1)}
    return report


def _place(error: BaseException) -> str:
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return "" if trace is None else f"{trace.tb_frame.f_code.co_filename}:{trace.tb_lineno}"


def main() -> int:
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("--examples", type=int, default=20_000)
    asked.add_argument("--seed", type=int, default=1)
    given = asked.parse_args()
    return campaign(given.examples, given.seed).tell()


if __name__ == "__main__":
    sys.exit(main())
