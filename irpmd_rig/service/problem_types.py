"""Every kind of problem that the service answers with, under a type that stays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

PAGES = "/problems"


@dataclass(frozen=True, slots=True)
class ProblemType:
    """A kind of problem: its slug (the end of its type), status, title, and what its page says."""

    slug: str
    status: int
    title: str
    help: str

    @property
    def uri(self) -> str:
        """The type, as in the problem document; a path of the service that shows its page."""
        return f"{PAGES}/{self.slug}"


_TYPES = (
    ProblemType(
        "malformed-json",
        400,
        "The body is not JSON",
        "Send one JSON value in UTF-8. `detail` says where it ends to be one.",
    ),
    ProblemType(
        "unauthorized",
        401,
        "The token is missing or wrong",
        "Send the header `Authorization: Bearer TOKEN`. The token is in the file `token` of the store's "
        "folder, which only the daemon's user can read.",
    ),
    ProblemType(
        "foreign-host",
        403,
        "The service is not called by this name",
        "The name in the header `Host` is none of the service's. Call it by 127.0.0.1 or localhost, or enter "
        "the name in the rig file under `service.allowed_hosts`. This keeps web pages from reaching the rig "
        "through a name of their own.",
    ),
    ProblemType(
        "foreign-origin",
        403,
        "A web page from elsewhere may not command the rig",
        "The request comes from a web page of another origin. Only pages of the service itself may send requests.",
    ),
    ProblemType(
        "not-found",
        404,
        "There is nothing at this address",
        "See `/api/v1/openapi.json` for all addresses.",
    ),
    ProblemType(
        "no-such-run",
        404,
        "There is no such run",
        "`GET /api/v1/runs` lists them. It may have been deleted.",
    ),
    ProblemType(
        "no-such-file",
        404,
        "The run has no such file",
        "`GET /api/v1/runs/ID/frames` and `.../results` list the files of a run. Results are there when it has ended.",
    ),
    ProblemType("no-such-device", 404, "The rig has no such instrument", "`GET /api/v1/rig` lists the instruments."),
    ProblemType(
        "method-not-allowed",
        405,
        "This address does not take this method",
        "The header `Allow` names the methods it takes.",
    ),
    ProblemType("late-body", 408, "The body did not arrive in time", "Send the whole body at once."),
    ProblemType(
        "lease-held",
        409,
        "Somebody else controls the rig",
        "`holder` says who, and until when. Ask for its release, wait, or take the lease with `override`, "
        "which is recorded. Commands to instruments and runs carry the id of the lease in the header "
        "`X-Lease`.",
    ),
    ProblemType(
        "rig-busy",
        409,
        "The instruments are in use",
        "A run (`run_id`) or another command has them. Wait for its end, or abort it.",
    ),
    ProblemType(
        "stopped",
        409,
        "Everything was stopped",
        "Nothing starts until the stop is cleared: see that it is safe to go on, then `DELETE /api/v1/stop`.",
    ),
    ProblemType(
        "not-ready",
        409,
        "The rig cannot begin a run now",
        "`reasons` lists every reason. They are in `GET /api/v1/rig`, too.",
    ),
    ProblemType(
        "action-refused",
        409,
        "The state does not allow this",
        "`detail` says what is in the way and what to do.",
    ),
    ProblemType(
        "run-in-use",
        409,
        "The run cannot be deleted now",
        "It has not ended, or a measurement may use it: it is an active calibration or reference, or one was "
        "made with it.",
    ),
    ProblemType(
        "not-usable",
        409,
        "The run cannot serve as calibration or reference",
        "It has to have succeeded, and to be of that kind.",
    ),
    ProblemType(
        "unreadable-run",
        409,
        "The run's folder cannot be read",
        "A file in it is wrong: `detail` says which. Correct it by hand.",
    ),
    ProblemType(
        "nothing-to-export",
        409,
        "The run does not hold what this export shows",
        "Only what was computed can be exported. Reconstruct the run first.",
    ),
    ProblemType(
        "key-reused",
        409,
        "The idempotency key belongs to another recipe",
        "Give every new request a key of its own.",
    ),
    ProblemType(
        "instrument-refused",
        409,
        "The instrument refuses this now",
        "`detail` says what is in the way and what to do.",
    ),
    ProblemType("body-too-large", 413, "The body is too large", "A request may have 1 MB."),
    ProblemType(
        "not-json",
        415,
        "The body's media type is not JSON",
        "Send the header `Content-Type: application/json`.",
    ),
    ProblemType(
        "invalid",
        422,
        "The request does not say what it must",
        "`errors` lists everything that is wrong, each with its place.",
    ),
    ProblemType(
        "recipe-refused",
        422,
        "The recipe cannot be run",
        "`errors` lists everything that is wrong, each with file, line, column and what to do. `POST "
        "/api/v1/recipes/validate` checks a recipe without running it.",
    ),
    ProblemType(
        "no-such-recipe",
        422,
        "There is no shipped recipe of this name",
        "`GET /api/v1/recipes` lists them. Or send the text of your own.",
    ),
    ProblemType(
        "limit",
        422,
        "The target is outside the limits",
        "`detail` gives the limits of the axis, which are set in the rig file.",
    ),
    ProblemType(
        "unsupported",
        422,
        "The instrument cannot do this",
        "No instrument of this model can. `detail` says what it can do instead.",
    ),
    ProblemType(
        "device-lost",
        424,
        "The instrument is not there",
        "Plug it in, switch it on. The daemon looks for it by itself.",
    ),
    ProblemType(
        "device-timeout",
        424,
        "The instrument did not answer in time",
        "It may still be at it. See `GET /api/v1/rig`, stop it if in doubt.",
    ),
    ProblemType("device-fault", 424, "The instrument reports a fault", "`detail` says which, and what mends it."),
    ProblemType(
        "motion-failed",
        424,
        "The stage is not where it was sent",
        "It stalled, was stopped or missed its target. Look at it before moving it again.",
    ),
    ProblemType(
        "frames-lost",
        424,
        "The frame did not arrive whole",
        "Try again; if it happens often, look at cable and port.",
    ),
    ProblemType("simulation-failed", 424, "The simulated world refuses", "`detail` says why."),
    ProblemType(
        "lease-needed",
        428,
        "This needs the lease",
        "Take it with `POST /api/v1/lease`, and send its id in the header `X-Lease`.",
    ),
    ProblemType(
        "too-busy",
        429,
        "Too many requests at the same time",
        "Try again after the seconds in the header `Retry-After`.",
    ),
    ProblemType(
        "fault",
        500,
        "A fault of the program",
        "It is in the log, with its place in the program. The rig is not affected: runs go on.",
    ),
    ProblemType(
        "not-started",
        503,
        "The rig could not be started",
        "`errors` says what is wrong with the rig file, each with file, line and column. Correct it and start"
        " the service again.",
    ),
    ProblemType(
        "disk-full",
        507,
        "There is no room on the disk",
        "Delete or move old runs, or choose another `storage.root` in the rig file.",
    ),
    ProblemType("write-failed", 507, "The disk refuses to write", "See that the store's folder can be written."),
)

TYPES: Mapping[str, ProblemType] = {kind.slug: kind for kind in _TYPES}
