"""What people may do to a run that has not ended."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from irpmd_rig.acquisition.book import ActionRefused, RunBook
from irpmd_rig.acquisition.conduct import Ending
from irpmd_rig.acquisition.queue import RunQueue
from irpmd_rig.acquisition.runner import Runner
from irpmd_rig.acquisition.runs import Run
from irpmd_rig.store.states import Reason, RunState

Steering = Literal["abort", "pause", "resume", "answer"]
Action = Literal[Steering, "retry"]

# A run has ended within this after an abort or a stop, whatever its instruments do.
END_LIMIT_S = 30.0


@dataclass(frozen=True, slots=True)
class Wish:
    """What somebody wants of a run.

    Attributes
    ----------
    run_id, action
        Which run, and what.
    owner
        Who.
    answer
        The answer to the prompt, where the action is ``answer``.
    prompt
        The number of the prompt that it is for; None: whichever waits.
    """

    run_id: str
    action: Steering
    owner: str
    answer: str = "done"
    prompt: int | None = None


def steer(book: RunBook, queue: RunQueue, runner: Runner | None, wish: Wish) -> None:
    """Do what somebody wants, if the run's state allows it; an abort returns when the run has ended.

    Raises
    ------
    ActionRefused
        The run's state does not allow it.
    RunNotFound
        There is no such run.
    """
    state = book.status(wish.run_id).state
    run = book.known(wish.run_id)
    if run is None or state is None or run.state.final:
        raise ActionRefused(f"the run is {state}", f"there is nothing to {wish.action}")
    if wish.action == "abort":
        _abort(run, queue, runner, wish.owner)
    elif run.state is RunState.QUEUED:
        raise ActionRefused(
            "the run waits in the queue", f"hold or resume the queue: there is nothing to {wish.action}"
        )
    elif wish.action == "answer":
        if not run.conduct.answer(wish.answer, wish.prompt):
            raise ActionRefused(
                "the run asks nothing, or something else by now",
                "answer the prompt of a run that is waiting_for_operator",
            )
    elif wish.action == "pause" and run.state is not RunState.RECONSTRUCTING:
        run.conduct.pause()
    elif wish.action == "resume" and run.conduct.asked == "pause":
        run.conduct.resume()
    else:
        raise ActionRefused(f"the run is {run.state}", f"there is nothing to {wish.action}")


def _abort(run: Run, queue: RunQueue, runner: Runner | None, owner: str) -> None:
    ending = Ending(RunState.ABORTED, Reason.ABORTED_BY_USER, f"aborted by {owner}")
    queue.remove(run.id)
    # Before anything else: it may be about to begin.
    run.conduct.end(ending)
    if runner is not None and runner.active is run:
        runner.end_active(ending, END_LIMIT_S)
    elif not run.state.final:
        run.end(ending)
