"""The rig as a whole: its state, who controls it, stopping it."""

from __future__ import annotations

from fastapi import APIRouter

from irpmd_rig.acquisition.status import RigStatus, StopReport
from irpmd_rig.service.desk import LeaseId, TheDesk
from irpmd_rig.service.documented import BODY, problems
from irpmd_rig.service.models import DeviceStop, Lease, Rig, Stop
from irpmd_rig.service.orders import RenewLease, TakeLease

router = APIRouter()


@router.get("/rig", responses=problems(), tags=["rig"])
async def rig(desk: TheDesk) -> Rig:
    """Instruments, positions (measured or estimated), lease, and every reason why a run would not begin now."""
    return rig_answer(await desk.asking(desk.daemon.rig_status))


def rig_answer(status: RigStatus) -> Rig:
    """Make the answer of a rig's state."""
    return Rig.model_validate(status)


@router.post("/lease", status_code=201, responses=problems(*BODY, "lease-held"), tags=["lease"])
async def take_lease(desk: TheDesk, order: TakeLease) -> Lease:
    """Take control by hand; the id that is returned goes into the header `X-Lease`."""
    lease = await desk.asking(desk.daemon.take_lease, order.owner, order.duration_s, override=order.override)
    return Lease.model_validate(lease)


@router.put("/lease", responses=problems(*BODY, "lease-held", "lease-needed"), tags=["lease"])
async def renew_lease(desk: TheDesk, order: RenewLease, lease_id: LeaseId = None) -> Lease:
    """Let the lease end later, or sooner."""
    return Lease.model_validate(await desk.asking(desk.daemon.renew_lease, lease_id, order.duration_s))


@router.delete("/lease", status_code=204, responses=problems("lease-held", "lease-needed", "invalid"), tags=["lease"])
async def release_lease(desk: TheDesk, lease_id: LeaseId = None) -> None:
    """Give the lease back; the rig is made safe if it was commanded by hand."""
    await desk.commanding(desk.daemon.release_lease, lease_id)


@router.post("/stop", responses=problems(), tags=["stop"])
async def stop(desk: TheDesk) -> Stop:
    """Stop everything now: LED off, stages stopped, run ended. Needs no lease; latched until it is cleared."""
    reports = await desk.stopping(desk.daemon.stop)
    return Stop(devices={name: _device_stop(report) for name, report in reports.items()})


@router.delete("/stop", status_code=204, responses=problems(), tags=["stop"])
async def clear_stop(desk: TheDesk) -> None:
    """Allow starting again; the queue stays held."""
    await desk.stopping(desk.daemon.clear_stop)


def _device_stop(report: StopReport) -> DeviceStop:
    outcome = "stopped" if report.stopped else "unknown" if report.error else "cannot_be_stopped"
    return DeviceStop(outcome=outcome, ends_in_s=report.ends_in_s, error=report.error)  # type: ignore[arg-type]
