"""Queries for what a stream retains: by Zenoh's own key, and by the key of its static transforms.

If many peers meet at once, the declaration of a queryable may be lost for good
(eclipse-zenoh/zenoh#2516): no query reaches it by that link, also none of Zenoh's own. So each
thing that a stream retains has two queryables, and queries alternate between them.
"""

from collections.abc import Callable

from tfbus.bus.query import Answer
from tfbus.bus.retained import ask_retained_later
from tfbus.bus.session import Session
from tfbus.wire.keys import description_selector, static_transforms_key_beside

_ANSWER_WITHIN_S = 2.0


def ask_for_statics(
    session: Session,
    stream_key: str,
    turn: int,
    on_answer: Callable[[Answer], None],
    on_end: Callable[[], None],
) -> None:
    """Query the static transforms of the stream of this token; `turn` counts from 0."""
    key = static_transforms_key_beside(stream_key)
    if turn % 2:
        session.ask_later(key, None, on_answer, on_end, timeout_s=_ANSWER_WITHIN_S)
    else:
        ask_retained_later(session, key, on_answer, on_end, timeout_s=_ANSWER_WITHIN_S)


def ask_for_description(
    session: Session,
    stream_key: str,
    turn: int,
    on_answer: Callable[[Answer], None],
    on_end: Callable[[], None],
) -> None:
    """Query the description of the stream of this token; `turn` counts from 0."""
    if turn % 2 == 0:
        ask_retained_later(session, stream_key, on_answer, on_end, timeout_s=_ANSWER_WITHIN_S)
        return
    static_key = static_transforms_key_beside(stream_key)

    def on_any_answer(answer: Answer) -> None:
        # Earlier versions of tfbus answer with the static transforms, at their key.
        if answer.key != static_key:
            on_answer(answer)

    session.ask_later(
        description_selector(static_key),
        None,
        on_any_answer,
        on_end,
        timeout_s=_ANSWER_WITHIN_S,
        answers_at=stream_key,
    )
