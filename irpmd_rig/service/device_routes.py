"""Instruments commanded by hand, by whoever holds the lease."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query
from starlette.responses import Response, StreamingResponse

from irpmd_rig.acquisition.daemon import RigDaemon
from irpmd_rig.service.desk import Desk, HeldLease, TheDesk
from irpmd_rig.service.documented import BODY, COMMAND, binary, problems
from irpmd_rig.service.live import BOUNDARY
from irpmd_rig.service.models import CameraInForce, Device, DeviceStop, Position
from irpmd_rig.service.orders import CameraOrder, LedOrder, MoveOrder, ParkOrder, ShowOrder, ZeroOrder
from irpmd_rig.service.pictures import MEDIA_TYPES, PictureFormat, encoded
from irpmd_rig.service.problems import Problem, ProblemError
from irpmd_rig.service.streams import begun

router = APIRouter(prefix="/devices", tags=["devices"])
_MJPEG = f"multipart/x-mixed-replace; boundary={BOUNDARY}"


@router.get("", responses=problems())
async def devices(desk: TheDesk) -> dict[str, Device]:
    """All instruments of the rig, as last seen."""
    seen = (await desk.asking(desk.daemon.rig_status)).devices
    return {name: Device.model_validate(state) for name, state in seen.items()}


# --- camera


@router.post("/camera/settings", responses=problems(*BODY, *COMMAND))
async def camera_settings(desk: TheDesk, lease: HeldLease, order: CameraOrder) -> CameraInForce:  # noqa: ARG001
    """Set the camera; returns what is in force."""
    return CameraInForce.model_validate(await desk.commanding(desk.daemon.hand.camera_settings, order.settings()))


@router.post(
    "/camera/frame", response_class=Response, responses=binary(*MEDIA_TYPES.values()) | problems(*COMMAND, "invalid")
)
async def camera_frame(
    desk: TheDesk,
    lease: HeldLease,  # noqa: ARG001
    form: Annotated[PictureFormat, Query(alias="format")] = "tiff",
) -> Response:
    """Take one frame with the settings given last; headers say its bits and exposure."""

    def take() -> Response:
        frame = desk.daemon.hand.camera_frame()
        headers = {"X-Bits": str(frame.bits), "X-Frame-Id": str(frame.frame_id)}
        if frame.exposure_us is not None:
            headers["X-Exposure-Us"] = f"{frame.exposure_us:.3f}"
        return Response(encoded(frame.image, form), media_type=MEDIA_TYPES[form], headers=headers)

    return await desk.commanding(take)


@router.get(
    "/camera/live",
    response_class=StreamingResponse,
    responses=binary("multipart/x-mixed-replace") | problems(*COMMAND, "invalid"),
)
async def camera_live(
    desk: TheDesk,
    lease: HeldLease,
    limit: Annotated[int | None, Query(ge=1, description="End after so many pictures.")] = None,
) -> StreamingResponse:
    """Watch the camera (motion JPEG), as long as the lease lasts and no run begins."""
    pictures = await begun(desk.live.watch(lease.id, limit))
    return StreamingResponse(pictures, media_type=_MJPEG, headers={"Cache-Control": "no-store"})


# --- projector


@router.post("/projector/show", status_code=204, responses=problems(*BODY, *COMMAND))
async def projector_show(desk: TheDesk, lease: HeldLease, order: ShowOrder) -> None:  # noqa: ARG001
    """Show white, black or fringes, and leave it on; the LED is set apart."""
    await desk.commanding(
        desk.daemon.hand.projector_show,
        order.picture,
        count=order.count,
        step=order.step,
        steps=order.steps,
        axis=order.axis,
    )


@router.post("/projector/led", status_code=204, responses=problems(*BODY, *COMMAND))
async def projector_led(desk: TheDesk, lease: HeldLease, order: LedOrder) -> None:  # noqa: ARG001
    """Light one LED, all others off; 0 is off."""
    await desk.commanding(desk.daemon.hand.projector_led, order.led, order.intensity)


@router.post("/projector/park", status_code=204, responses=problems(*BODY, *COMMAND))
async def projector_park(desk: TheDesk, lease: HeldLease, order: ParkOrder) -> None:  # noqa: ARG001
    """Park the mirrors for transport or long rest, or make them ready again."""
    await desk.commanding(desk.daemon.hand.projector_park, parked=order.parked)


# --- stages


@router.post("/{name}/move", responses=problems(*BODY, *COMMAND, "no-such-device", "limit"))
async def stage_move(desk: TheDesk, name: str, lease: HeldLease, order: MoveOrder) -> Position:  # noqa: ARG001
    """Move a stage; answers when it stands there."""
    await _check_stage(desk, name)
    return Position.model_validate(await desk.commanding(desk.daemon.hand.stage_move, name, order.position_mm))


@router.post("/{name}/home", responses=problems(*COMMAND, "no-such-device", "limit", "invalid"))
async def stage_home(desk: TheDesk, name: str, lease: HeldLease) -> Position:  # noqa: ARG001
    """Let a stage find its own zero; answers when it stands there."""
    await _check_stage(desk, name)
    return Position.model_validate(await desk.commanding(desk.daemon.hand.stage_home, name))


@router.post("/{name}/zero", responses=problems(*BODY, *COMMAND, "no-such-device", "limit"))
async def stage_zero(desk: TheDesk, name: str, lease: HeldLease, order: ZeroOrder) -> Position:  # noqa: ARG001
    """Call the place where a stage stands `position_mm`, on the word of a person; nothing moves."""
    await _check_stage(desk, name)
    return Position.model_validate(
        await desk.commanding(desk.daemon.hand.stage_zero, name, order.position_mm, order.confirmed_by)
    )


@router.post("/{name}/stop", responses=problems(*COMMAND, "no-such-device", "invalid"))
async def stage_stop(desk: TheDesk, name: str, lease: HeldLease) -> DeviceStop:  # noqa: ARG001
    """Stop a stage, whatever has it."""
    await _check_stage(desk, name)
    answer = await desk.stopping(desk.daemon.hand.stage_stop, name)
    return DeviceStop(
        outcome="stopped" if answer.stopped else "cannot_be_stopped", ends_in_s=answer.ends_in_s, error=None
    )


async def _check_stage(desk: Desk, name: str) -> None:
    known = await desk.asking(_stages, desk.daemon)
    if name not in known:
        detail = f"the rig has no stage {name[:40]!r}: it has {', '.join(known)}"
        raise ProblemError(Problem("no-such-device", detail))


def _stages(daemon: RigDaemon) -> tuple[str, ...]:
    return tuple(name for name, state in daemon.rig_status().devices.items() if state.kind == "stage")
