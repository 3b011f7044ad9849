"""Searches side by side: what all of them ask for in one generation is evaluated at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from queue import SimpleQueue
from threading import Thread

from estimation.arrays import FloatArray
from estimation.tuning.search import Found, Objective


def side_by_side(
    searches: Sequence[Callable[[Objective], Found]],
    evaluate: Callable[[dict[int, FloatArray]], dict[int, FloatArray]],
) -> list[Found]:
    """Run every search with an objective that waits for the others'.

    A batch of a thousand candidates costs a few times one of twenty. Each search has its own thread, but only one works
    at a time on anything shared: the result does not depend on their order.

    Args:
        searches: each is given its objective, candidates (m, d) -> values (m,).
        evaluate: candidates by number of search -> values by the same.

    Raises:
        What a search has raised.
    """
    asked: SimpleQueue[tuple[int, FloatArray | Found | Exception]] = SimpleQueue()
    answers: list[SimpleQueue[FloatArray]] = [SimpleQueue() for _ in searches]

    def work(number: int) -> None:
        def objective(candidates: FloatArray) -> FloatArray:
            asked.put((number, candidates))
            return answers[number].get()

        try:
            asked.put((number, searches[number](objective)))
        except Exception as error:  # told to the caller, who waits
            asked.put((number, error))

    for number in range(len(searches)):
        Thread(target=work, args=(number,), daemon=True).start()  # daemon: an interrupt leaves them waiting
    found: dict[int, Found] = {}
    while len(found) < len(searches):
        candidates: dict[int, FloatArray] = {}
        for _ in range(len(searches) - len(found)):  # each asks or ends once
            number, what = asked.get()
            if isinstance(what, Exception):
                raise what
            if isinstance(what, Found):
                found[number] = what
            else:
                candidates[number] = what
        for number, values in evaluate(candidates).items() if candidates else ():
            answers[number].put(values)
    return [found[number] for number in range(len(searches))]
