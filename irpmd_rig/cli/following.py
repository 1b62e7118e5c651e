"""A run watched from a terminal: its progress, its questions, its end."""

from __future__ import annotations

import getpass
import queue
import socket
import threading
from collections.abc import Callable
from functools import partial
from typing import Literal

from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from irpmd_rig.cli.application import note, notes
from irpmd_rig.cli.terminal import Terminal
from irpmd_rig.client import Client, ClientError, Event, ProblemError, Run

LOOK_S = 0.2
# While it waits in the queue, the reasons are asked for so often.
REASONS_S = 1.0
LEASE_S = 30.0

_COLUMNS = (
    TextColumn("{task.fields[state]}"),
    BarColumn(),
    TextColumn("{task.completed}/{task.total} frames"),
    TimeElapsedColumn(),
    TextColumn("{task.description}", markup=False),
)


class Following:
    """One run, followed to its end.

    Parameters
    ----------
    client
        The daemon.
    run
        The run as it was submitted.
    """

    def __init__(self, client: Client, run: Run) -> None:
        self._client = client
        self._run = run
        self._terminal = Terminal()
        self._inbox: queue.Queue[Event | Run | ClientError | Callable[[], None]] = queue.Queue()
        self._state: str | None = run.state
        self._asked: tuple[int, str] | None = None
        self._told: set[str] = set()
        self._left = False

    def to_the_end(self) -> Run | None:
        """Return the run when it has ended; None: it is left to the daemon.

        Raises
        ------
        ClientError
            The daemon does not answer any more.
        """
        threading.Thread(target=self._listen, name="events", daemon=True).start()
        with Progress(*_COLUMNS, console=notes) as progress:
            frames = self._run.estimate.frames if self._run.estimate else None
            task = progress.add_task("", total=frames, state=self._state)
            while True:
                try:
                    self._make_room(progress)
                    item = self._next()
                    if isinstance(item, Run):
                        progress.update(task, description="", state=item.state)
                        return item
                    if isinstance(item, ClientError):
                        raise item
                    if isinstance(item, Event):
                        self._take(item, progress)
                    elif item is not None:
                        item()
                    self._answer()
                    if self._left:
                        return None
                except KeyboardInterrupt:
                    progress.stop()
                    if not self._go_on():
                        return None

    def _make_room(self, progress: Progress) -> None:
        """Let no bar be drawn over what is typed."""
        if progress.live.is_started and self._asked is not None:
            progress.stop()
        elif not progress.live.is_started and self._asked is None:
            progress.start()

    # --- what comes from the daemon

    def _listen(self) -> None:
        try:
            listening = partial(self._inbox.put, self._let_start)
            self._inbox.put(self._client.wait(self._run.id, on_event=self._inbox.put, on_begin=listening))
        except ClientError as error:
            self._inbox.put(error)

    def _next(self) -> Event | Run | ClientError | Callable[[], None] | None:
        waits = self._state == "queued"
        try:
            return self._inbox.get(timeout=REASONS_S if waits else LOOK_S)
        except queue.Empty:
            if waits:
                self._tell_reasons()
            return None

    def _take(self, event: Event, progress: Progress) -> None:
        (task,) = progress.task_ids
        data = event.data
        if event.kind == "state":
            self._state = str(data["state"])
            if self._state != "waiting_for_operator":
                self._asked = None
            progress.update(task, state=self._state)
        elif event.kind == "progress":
            progress.update(task, completed=data["frames_done"], total=data["frames"], description=data["doing"])
        elif event.kind == "prompt":
            self._ask((data["prompt"], str(data["text"])))

    def _tell_reasons(self) -> None:
        """Say why it does not begin, each reason once; leave to go on that is ours to give is given."""
        try:
            if self._run.id in self._client.queue().why:
                # Held for want of an operator, and here is one.
                self._resume()
                return
            reasons = self._client.rig().reasons
        except ClientError:
            return  # the events tell of it
        for reason in reasons:
            # It may have begun meanwhile.
            if reason not in self._told and self._run.id not in reason:
                self._told.add(reason)
                note(f"the run waits: {reason}")

    # --- what the person says

    def _ask(self, prompt: tuple[int, str]) -> None:
        self._asked = prompt
        self._terminal.forget()
        note(f"\n{prompt[1]}", style="bold")
        if self._terminal.somebody_there:
            note("Enter when it is done; abort ends the run.")
        else:
            note("Nobody can answer here: take the lease, then irpmd-rig runs RUN answer.")

    def _answer(self) -> None:
        if self._asked is None and self._state != "queued":
            return
        typed = self._terminal.line()
        if typed is None:
            return
        if self._asked is None:
            self._resume()
        elif typed in ("", "done", "abort"):
            self._act("answer", "abort" if typed == "abort" else "done")
        else:
            note(f"{typed!r} is no answer: Enter when it is done, or abort")

    def _go_on(self) -> bool:
        """After Ctrl-C: whether to watch on; the run is aborted here if that is wanted."""
        note("\nAbort the run? a aborts it, l leaves it to the daemon, Enter goes on.")
        try:
            typed = None
            while typed is None and self._terminal.somebody_there:
                typed = self._terminal.line(wait_s=1.0)
        except KeyboardInterrupt:
            return False
        if typed is None or typed.lower().startswith("l"):
            return False
        if typed.lower().startswith("a"):
            self._act("abort")
        elif self._asked is not None:
            self._ask(self._asked)
        return True

    def _act(self, action: Literal["abort", "answer"], answer: Literal["done", "abort"] = "done") -> None:
        # The prompt that was read here, not one that came since.
        prompt = self._asked[0] if action == "answer" and self._asked is not None else None
        owner = f"{getpass.getuser()} at {socket.gethostname()}"
        try:
            with self._client.lease(owner, LEASE_S):
                self._client.act(self._run.id, action, answer, prompt)
        except ProblemError as error:
            note(f"{error}", style="red")

    # --- the queue

    def _let_start(self) -> None:
        """Let the queue go on if nobody is before this run: who runs a recipe wants it to begin."""
        run = self._client.run(self._run.id)
        self._state = run.state
        if run.prompt is not None:
            self._ask((run.prompt.id, run.prompt.text))
        if self._state == "queued" and self._client.queue().waiting[:1] == (self._run.id,):
            self._resume()
        elif self._state == "queued":
            self._tell_reasons()

    def _resume(self) -> None:
        try:
            self._client.resume_queue()
        except ProblemError as error:
            for line in error.extras.get("reasons") or (str(error),):
                note(f"the run waits: {line}", style="red")
            self._terminal.forget()
            self._left = not self._terminal.somebody_there
            if not self._left:
                note("Enter tries again; Ctrl-C leaves it to the daemon.")
