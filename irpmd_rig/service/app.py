"""The application: routes, guard, and the description of both."""

from __future__ import annotations

from typing import Any

from fastapi import FastAPI
from fastapi.routing import APIRoute

from irpmd_rig.acquisition.daemon import RigDaemon
from irpmd_rig.service import device_routes, event_routes, file_routes, page_routes, rig_routes, run_routes
from irpmd_rig.service.desk import Desk
from irpmd_rig.service.faults import Net, add_handlers
from irpmd_rig.service.observe import Observe
from irpmd_rig.service.openapi import described
from irpmd_rig.service.security import Guard
from irpmd_rig.service.settings import ServiceSettings

PREFIX = "/api/v1"


def create_app(daemon: RigDaemon, settings: ServiceSettings) -> FastAPI:
    """Make the service of a rig.

    Parameters
    ----------
    daemon
        Started and closed by the caller.
    settings
        Token, names and limits.
    """
    app = routed()
    desk = Desk(daemon, settings)
    app.state.desk = desk
    # The last one is the outermost: what is refused is observed, too.
    app.add_middleware(Net)
    app.add_middleware(Guard, settings=settings)
    app.add_middleware(Observe, figures=desk.figures)
    return app


def routed() -> FastAPI:
    """Make the application without a rig: what it is described from."""
    app = FastAPI(
        title="irpmd-rig",
        version="1",
        docs_url=None,
        redoc_url=None,
        openapi_url=f"{PREFIX}/openapi.json",
        redirect_slashes=False,
        separate_input_output_schemas=False,
        generate_unique_id_function=_operation,
    )
    for module in (rig_routes, device_routes, run_routes, file_routes, event_routes):
        app.include_router(module.router, prefix=PREFIX)
    app.include_router(page_routes.api, prefix=PREFIX)
    app.include_router(page_routes.root)
    add_handlers(app)
    plain = app.openapi

    def openapi() -> dict[str, Any]:
        if not app.openapi_schema:
            app.openapi_schema = described(plain())
        return app.openapi_schema

    app.openapi = openapi  # type: ignore[method-assign]
    return app


def _operation(route: APIRoute) -> str:
    return route.name
