"""What is not about the rig: health, figures, and the pages that explain problems."""

from __future__ import annotations

from fastapi import APIRouter
from prometheus_client.exposition import CONTENT_TYPE_LATEST, generate_latest
from starlette.responses import HTMLResponse, Response

from irpmd_rig.service.desk import TheDesk
from irpmd_rig.service.documented import problems, text
from irpmd_rig.service.models import Health
from irpmd_rig.service.problems import Problem, ProblemError, page

api = APIRouter(tags=["service"])
root = APIRouter(tags=["service"])


@api.get("/health", responses=problems())
async def health() -> Health:
    """Tell that the service is alive; needs no token."""
    return Health()


@root.get("/health", include_in_schema=False)
async def health_at_root() -> Health:
    """Tell the same, where monitors look first."""
    return Health()


@root.get(
    "/metrics",
    response_class=Response,
    responses=text("Figures", "text/plain") | problems(),
)
async def metrics(desk: TheDesk) -> Response:
    """Figures, as Prometheus reads them."""
    content = await desk.listing(generate_latest, desk.figures.registry)
    return Response(content, headers={"Content-Type": CONTENT_TYPE_LATEST})


@root.get("/problems/{slug}", response_class=HTMLResponse, responses=problems("not-found", "invalid"))
async def problem_page(slug: str) -> HTMLResponse:
    """Explain a kind of problem."""
    found = page(slug)
    if found is None:
        raise ProblemError(Problem("not-found", f"there is no problem type {slug[:60]!r}"))
    return found
