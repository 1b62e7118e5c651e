"""Requests generated from the service's own description, with a valid token, against a simulated rig.

    python -m tests.campaigns.generated_requests --size 3000 [--seed 1]

No answer may be a server error but a documented 507, and every answer has to be as the description says. Endless
answers are left out; stopping everything is asked in a pass of its own, and cleared between requests.
"""

import argparse
import logging
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any
from unittest import SkipTest

import hypothesis
import requests
import schemathesis
from hypothesis import strategies
from hypothesis.errors import Unsatisfiable
from schemathesis import checks
from schemathesis.specs.openapi.checks import negative_data_rejection

from irpmd_rig.acquisition.daemon import RigDaemon
from irpmd_rig.acquisition.intake import RecipeText
from irpmd_rig.acquisition.lease import LeaseHeld, LeaseNeeded
from tests.service.service_world import ASKING, RECIPE, TOKEN, Service, serving
from tests.small_world import rig_file, until, world

ENDLESS = {"events", "run_events", "camera_live"}
STOPPING = {"stop", "clear_stop"}
CHECKS = [
    checks.not_a_server_error,
    checks.status_code_conformance,
    checks.content_type_conformance,
    checks.response_headers_conformance,
    checks.response_schema_conformance,
    negative_data_rejection,
]
POSITIVE, NEGATIVE = schemathesis.GenerationMode.POSITIVE, schemathesis.GenerationMode.NEGATIVE


@contextmanager
def small_service() -> Iterator[Service]:
    """A service on a small simulated rig, with a run that has succeeded."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        lab = stack.enter_context(world(folder / "world"))
        daemon = stack.enter_context(RigDaemon(rig_file(lab.folder, folder / "store")))
        yield stack.enter_context(serving(daemon))


def succeeded(daemon: RigDaemon, text: str) -> str:
    """Carry a run out; returns its id."""
    status, _ = daemon.submit(RecipeText(text))
    daemon.queue_action("resume")
    until(lambda: daemon.run(status.id).state == "succeeded")
    daemon.store.run(status.id).results.write_text("steps.csv", "step\n")
    return status.id


def can_be_wrong(described: dict[str, Any]) -> bool:
    """Whether an operation takes anything but free texts: looking for what is wrong with those takes long."""
    schemas = [parameter["schema"] for parameter in described.get("parameters", ())]
    every = [part for schema in schemas for part in schema.get("anyOf", [schema])]
    free = all(part["type"] in ("string", "null") and part.keys() <= {"type", "title"} for part in every)
    return "requestBody" in described or not free


class Campaign:
    """Sends generated requests until there were enough; keeps what is wrong."""

    def __init__(self, service: Service, seed: int) -> None:
        self.daemon = service.daemon
        self.url = service.url
        self.seed = seed
        self.statuses: Counter[tuple[str, int]] = Counter()
        self.failures: list[str] = []
        self.cases: dict[tuple[str, Any], Any] = {}
        self.seconds: Counter[str] = Counter()
        self.session = requests.Session()
        self.session.trust_env = False
        authorized = {"Authorization": f"Bearer {TOKEN}"}
        answer = self.session.get(f"{service.url}/api/v1/openapi.json", headers=authorized, timeout=60)
        self.schema = schemathesis.openapi.from_dict(answer.json())
        # All requests have the token: without it there is nothing behind it to look at.
        self.schema.config.generation.with_security_parameters = False
        self.authorized = authorized
        run_id = succeeded(self.daemon, RECIPE)
        self.known: dict[str, Any] = {"run_id": run_id, "form": "csv", "path": self._frame(run_id)}

    @property
    def sent(self) -> int:
        return sum(self.statuses.values())

    def _frame(self, run_id: str) -> str:
        return self.daemon.store.run(run_id).manifest()[0].path.removeprefix("frames/")

    def run(self, size: int) -> None:
        """Send at least `size` requests."""
        operations = [result.ok() for result in self.schema.get_all_operations()]
        ordinary = [one for one in operations if self._name(one) not in ENDLESS | STOPPING]
        stopping = [one for one in operations if self._name(one) in STOPPING]
        self._pass(stopping, max(4, size // 30), self.daemon.clear_stop)
        self._pass(ordinary, size - self.sent, lambda: None)

    def _pass(self, operations: list[Any], size: int, between: Callable[[], None]) -> None:
        until_sent = self.sent + size
        kinds = [(operation, POSITIVE) for operation in operations]
        kinds += [(operation, NEGATIVE) for operation in operations if can_be_wrong(operation.definition.raw)]
        turn = 0
        while kinds and self.sent < until_sent and not self.failures:
            each = max(1, (until_sent - self.sent) // len(kinds))
            for operation, mode in tuple(kinds):
                before = self.sent
                self._some(operation, mode, each, turn, between)
                # Where nothing was found, looking again takes long and finds nothing.
                if self.sent == before:
                    kinds.remove((operation, mode))
            turn += 1

    def _some(self, operation: Any, mode: Any, count: int, turn: int, between: Callable[[], None]) -> None:
        @hypothesis.seed(self.seed * 1_000_003 + turn)
        @hypothesis.settings(
            max_examples=count,
            database=None,
            deadline=None,
            phases=[hypothesis.Phase.generate],
            suppress_health_check=list(hypothesis.HealthCheck),
        )
        @hypothesis.given(case=self._cases_of(operation, mode))
        def send(case: Any) -> None:
            # Kept, not raised: the rig is another one afterwards, and the same request would not fail again.
            try:
                self._send(operation, case)
            except (Exception, BaseExceptionGroup) as error:
                causes = error.exceptions if isinstance(error, BaseExceptionGroup) else [error]
                sent = f"{case.method} {case.formatted_path} {case.query} {case.headers} {case.body}"[:600]
                self.failures += [f"{operation.label}: {cause}\n  sent: {sent}" for cause in causes]
            between()

        # In some operations there is nothing that could be wrong.
        with suppress(Unsatisfiable, SkipTest):
            send()

    def _cases_of(self, operation: Any, mode: Any) -> Any:
        key = operation.label, mode
        if key not in self.cases:
            self.cases[key] = self._cases(operation, mode)
        return self.cases[key]

    def _cases(self, operation: Any, mode: Any) -> Any:
        """Cases of what the description allows or forbids, also with what there is on this rig."""
        kinds = [operation.as_strategy(mode)]
        if mode is POSITIVE:
            fixed: dict[str, Any] = {}
            wanted = {one.name for one in operation.path_parameters}
            if wanted:
                known = self.known | {"name": "stage1" if "/devices/" in operation.path else "steps.csv"}
                known |= {"slug": "invalid"}
                fixed["path_parameters"] = {name: known[name] for name in wanted}
                if self._name(operation) != "delete":
                    kinds.append(operation.as_strategy(mode, **fixed))
            if self._name(operation) in ("submit", "validate"):
                kinds += [operation.as_strategy(mode, body={"text": text}) for text in (RECIPE, ASKING)]
        return strategies.one_of(*kinds)

    def _send(self, operation: Any, case: Any) -> None:
        name = self._name(operation)
        headers = dict(self.authorized)
        if "X-Lease" not in (case.headers or {}) and name != "take_lease":
            headers["X-Lease"] = self.daemon.take_lease("campaign", 60.0, override=True).id
        began_s = time.perf_counter()
        response = case.call(base_url=self.url, headers=headers, session=self.session, timeout=60)
        self.seconds[name] += time.perf_counter() - began_s
        with suppress(LeaseHeld, LeaseNeeded):
            # Runs that wait get their turn.
            self.daemon.release_lease(headers.get("X-Lease"))
        self.statuses[name, response.status_code] += 1
        # The one server error that is documented.
        excluded = [checks.not_a_server_error] if response.status_code == 507 else []
        case.validate_response(response, checks=CHECKS, excluded_checks=excluded)

    @staticmethod
    def _name(operation: Any) -> str:
        name: str = operation.definition.raw["operationId"]
        return name


def main() -> int:
    """Run a campaign; returns 1 if anything was wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=3000, help="number of requests")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    # Whatever the rig warns of, here it is asked for.
    logging.disable(logging.WARNING)
    began_s = time.monotonic()
    with small_service() as service:
        campaign = Campaign(service, arguments.seed)
        campaign.run(arguments.size)
    totals: Counter[int] = Counter()
    for (name, status), count in sorted(campaign.statuses.items()):
        totals[status] += count
        print(f"{name:22} {status} {count:6}")  # noqa: T201 - a report
    print("slowest, s:", [(name, round(took, 2)) for name, took in campaign.seconds.most_common(5)])  # noqa: T201
    took_s = time.monotonic() - began_s
    print(f"{campaign.sent} requests in {took_s:.0f} s, by status: {dict(sorted(totals.items()))}")  # noqa: T201
    for failure in campaign.failures:
        print(f"FAILED {failure}", file=sys.stderr)  # noqa: T201
    return 1 if campaign.failures else 0


if __name__ == "__main__":
    sys.exit(main())
