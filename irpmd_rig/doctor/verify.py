"""The checks of a first contact with real instruments, one question at a time."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from drivers.errors import InstrumentError
from drivers.protocols import Projector, Stage
from drivers.values import Led
from irpmd_rig.acquisition.rig import Rig
from irpmd_rig.doctor.asking import Asker
from irpmd_rig.doctor.record import Check, Record, Verdict, record_path, write_nodes
from irpmd_rig.doctor.report import DeviceReport, Report

INTENSITY = 0.10
MOVE_MM = 1.0


def verify(rig: Rig, report: Report, ask: Asker, record_file: Path | None = None) -> tuple[Record, Path]:
    """Walk through the checks of every instrument that answered, and write the record of it.

    Parameters
    ----------
    rig
        Open.
    report
        What was found at it.
    ask
        Asks the person in front of it.
    record_file
        Where the record goes; None: a name made of rig and time, in the working folder.

    Returns
    -------
    Record, Path
        The record and its file. It is written also where the walk is broken off (end of input, Ctrl-C, the terminal
        was closed), and the instruments are made safe.

    Raises
    ------
    OSError
        The record or the camera's nodes cannot be written.
    """
    began = datetime.now(UTC)
    path = record_file or record_path(Path(), report.rig, began)
    record = Record(report.rig, report.file, report.simulated, "", began)
    record.instruments = {
        device.name: {
            "driver": device.driver,
            "model": device.found.get("model", "not reached"),
            "serial_number": device.found.get("serial number", "not reached"),
        }
        for device in report.devices
    }
    with _signals_break_off():
        try:
            _walk(rig, report, ask, record, path)
            record.complete = True
        except (EOFError, KeyboardInterrupt):
            # A terminal that was closed takes no line any more.
            with suppress(OSError):
                ask.say("\nBroken off" + (": what was answered so far is kept." if record.who else "."), "yellow")
        finally:
            rig.make_safe()
            if record.who:
                record.write(path)
    return record, path


@contextmanager
def _signals_break_off() -> Iterator[None]:
    """Break off like Ctrl-C where the terminal is closed or the process is told to end: a light may be on."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def break_off(*_: object) -> None:
        # Once: what makes safe is not broken off.
        for number in former:
            signal.signal(number, signal.SIG_IGN)
        raise KeyboardInterrupt

    former = {number: signal.signal(number, break_off) for number in (signal.SIGTERM, signal.SIGHUP)}
    try:
        yield
    finally:
        for number, handler in former.items():
            signal.signal(number, handler)


def _walk(rig: Rig, report: Report, ask: Asker, record: Record, path: Path) -> None:
    ask.say("Every check may be skipped by Enter. Nothing lights or moves before you type yes.")
    while not record.who:
        record.who = ask.text("Your name, for the record:")
    # Now, not after an hour: where it cannot be written, nobody needs to begin.
    record.write(path)
    checks: dict[str, Callable[[DeviceReport], None]] = {
        "camera": lambda device: _camera(rig, device, ask, record, path),
        "projector": lambda device: _projector(rig, device, ask, record),
        "stage": lambda device: _stage(rig, device, ask, record),
    }
    for device in report.devices:
        ask.say(f"\n{device.name}: {device.found.get('model', device.driver)}", "bold")
        if not device.found:
            ask.say("  It does not answer: mend that first.", "red")
            record.checks.append(Check(device.name, "it answers", "no"))
            continue
        try:
            checks[device.kind](device)
        except InstrumentError as error:
            ask.say(f"  {error}", "red")
            record.checks.append(Check(device.name, "the checks go to their end", "no", remark=str(error)))
        for line in device.unverified:
            ask.say(f"  Unverified so far: {line}", "yellow")
            verdict = ask.verdict("  Did you check it, and is it so?")
            remark = ask.text("  What did you find?") if verdict != "skipped" else ""
            record.checks.append(Check(device.name, line, verdict, remark=remark))


def _camera(rig: Rig, device: DeviceReport, ask: Asker, record: Record, path: Path) -> None:
    number = device.found["serial number"]
    verdict = ask.verdict(f"  Is {number} the serial number on the camera's label?")
    record.checks.append(Check(device.name, "the serial number is that on the label", verdict, (number,)))
    written = write_nodes(rig.camera.dump(), path.with_name(f"{path.stem}-{device.name}-nodes.csv"))
    ask.say(f"  Its nodes are in {', '.join(map(str, written))}: compare the names that are unverified.")
    record.checks.append(Check(device.name, "its nodes were written", "yes", tuple(map(str, written))))


def _projector(rig: Rig, device: DeviceReport, ask: Asker, record: Record) -> None:
    projector = rig.projector
    can = projector.capabilities()
    led = rig.file.light.led if rig.file.light.led in can.leds else next(iter(can.leds), None)
    light = f"The {led} LED goes on at {INTENSITY:.0%}" if led else "A picture appears"
    ask.say(f"  {light}. Infrared is invisible: nobody may look into the beam, use a camera or a card.")
    if not ask.agreed("  Is the beam clear?"):
        record.checks.append(Check(device.name, "light", "skipped"))
        return
    try:
        _show_ramp(projector, led, load=can.can_load)
        record.checks.append(_light_check(device.name, led, ask))
        if can.can_load:
            question = "the picture is a ramp from black on the left to white on the right, without jumps"
            record.checks.append(Check(device.name, question, ask.verdict(f"  Is it so: {question}?")))
    finally:
        with suppress(InstrumentError):
            projector.stop()
        if led is not None:
            projector.set_led(led, 0.0)
    verdict = ask.verdict("  Is the light off again?")
    record.checks.append(Check(device.name, "the light goes off", verdict))


def _show_ramp(projector: Projector, led: Led | None, *, load: bool) -> None:
    if led is not None:
        projector.set_led(led, INTENSITY)
    if load:
        width, height = projector.capabilities().size_px
        ramp = np.linspace(0, 255, width).round().astype(np.uint8)
        projector.load(np.broadcast_to(ramp, (1, height, width)).copy())
    projector.show(0)


def _light_check(device: str, led: Led | None, ask: Asker) -> Check:
    what = f"the {led} LED, and no other, lights at {INTENSITY:.0%}" if led else "the picture is there"
    verdict = ask.verdict(f"  Is it so: {what}?")
    current = ask.number("  LED current, A (measured)") if led else None
    values: dict[str, float | str] = {} if led is None else {"led": led.value, "intensity": INTENSITY}
    if current is not None:
        values["current_a"] = current
    return Check(device, what, verdict, values=values)


def _stage(rig: Rig, device: DeviceReport, ask: Asker, record: Record) -> None:
    stage = rig.stage(device.name)
    preview = getattr(stage, "preview", None)
    if preview is not None:
        frames = tuple(frame.hex(" ") for frame in preview(MOVE_MM))
        ask.say(f"  These are the frames of a move by {MOVE_MM:g} mm; nothing was sent:")
        for frame in frames:
            ask.say(f"    {frame}    {bytes.fromhex(frame)!r}")
        verdict = ask.verdict("  Are they what the controller's manual says?")
        record.checks.append(Check(device.name, f"frames of a move by {MOVE_MM:g} mm", verdict, frames))
    if not device.found["stops"].startswith("yes"):
        ask.say("  Software cannot stop this stage: keep a hand at the emergency switch.", "red")
    if not ask.agreed(f"  It will move by {MOVE_MM:g} mm and back. Is the way clear, and the dial gauge in place?"):
        record.checks.append(Check(device.name, "a short move", "skipped"))
        return
    if stage.state().position is None and not _zero(stage, ask, record.who):
        record.checks.append(Check(device.name, "a short move", "skipped", remark="it has no zero"))
        return
    record.checks.append(_short_move(rig, device.name, stage, ask))


def _zero(stage: Stage, ask: Asker, who: str) -> bool:
    """Give the axis a zero; False: the person does not want to."""
    if stage.capabilities().can_home:
        if not ask.agreed("  It has no zero: it will travel to its origin. Is all of the way clear?"):
            return False
        stage.home()
        return True
    # Nothing can be asked of it: what an earlier program may have begun is waited for.
    if (left_s := stage.stop().ends_in_s) > 0.0:
        ask.say(f"  It may still move from before, for {left_s:.0f} s: waiting.")
        time.sleep(left_s)
    position_mm = ask.number("  It cannot home. Where does it stand on its scale, in mm?")
    if position_mm is None:
        return False
    stage.zero(position_mm, confirmed_by=who)
    return True


def _short_move(rig: Rig, name: str, stage: Stage, ask: Asker) -> Check:
    start_mm, limits = stage.position().position_mm, stage.limits()
    step_mm = MOVE_MM if start_mm + MOVE_MM <= limits.upper_mm else -MOVE_MM
    before = ask.number("  Dial gauge now, mm (larger = larger positions)")
    stage.move_to(start_mm + step_mm)
    there = stage.wait()
    after = ask.number("  Dial gauge after the move, mm")
    stage.move_to(start_mm)
    stage.wait()
    again = ask.number("  Dial gauge back at the start, mm")
    values: dict[str, float | str] = {
        "commanded_mm": step_mm,
        "position_mm": there.position_mm,
        "position_is": "measured" if there.measured else "estimated",
    }
    readings = {"gauge_before_mm": before, "gauge_after_mm": after, "gauge_back_mm": again}
    values |= {key: value for key, value in readings.items() if value is not None}
    moved_mm = None if before is None or after is None else after - before
    if moved_mm:
        counts = rig.file.devices[name].settings.get("counts_per_mm")
        values["moved_mm"] = moved_mm
        if isinstance(counts, int | float):
            values["counts_per_mm_in_force"] = counts
            values["counts_per_mm_by_gauge"] = abs(counts * step_mm / moved_mm)
    return Check(name, "a short move, by the dial gauge", _moved_as_told(moved_mm, step_mm, ask), values=values)


def _moved_as_told(moved_mm: float | None, step_mm: float, ask: Asker) -> Verdict:
    if moved_mm is not None:
        ask.say(f"  Commanded {step_mm:g} mm, moved {moved_mm:g} mm by the gauge.")
    return ask.verdict("  Did it move as far, and in the direction, as told?")
