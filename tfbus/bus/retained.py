"""Retained messages: the last one of a publisher also reaches subscribers that join later.

This file has all uses of Zenoh's unstable `zenoh.ext`.
"""

from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

import zenoh
from zenoh import ext

from tfbus.bus import zenoh_library
from tfbus.bus.callbacks import OnSample, OnSignedSample
from tfbus.bus.network_session import UNDECLARED, BytesPublisher, BytesSubscriber, Declaration
from tfbus.bus.query import Answer
from tfbus.bus.session import Session
from tfbus.bus.zenoh_library import bus_errors

# A subscriber that lost the last message learns of it within this, and asks for it again.
_HEARTBEAT_S = 0.5

# An answer comes later only if a link carries hardly anything; then Zenoh's own may, too.
_ANSWER_WITHIN_S = 10.0

# A publisher serves its retained messages below its key, and has its token there.
_BELOW = "/@adv/pub/"
_RETAINED = f"{_BELOW}**"


def _extensions() -> Any:
    """Zenoh's extensions, or a simulated network's."""
    return zenoh_library.simulated() or ext


class RetainedPublisher:
    """A publisher of Zenoh's with the token by which subscribers find it, at the key of Zenoh's own
    tokens.

    Zenoh's own token and heartbeat end while Zenoh holds Python's lock, and their ends wait for
    subscribers of the same session, whose callbacks may wait for Python's lock. The end of this
    token leaves it free, and so does the end of a publisher that nothing refers to any more.
    """

    def __init__(self, session: zenoh.Session, key: str, *, samples: int, **options: Any):
        self._publisher: ext.AdvancedPublisher | None = _extensions().declare_advanced_publisher(
            session,
            key,
            cache=ext.CacheConfig(max_samples=samples),
            sample_miss_detection=ext.MissDetectionConfig(
                heartbeat=None, sporadic_heartbeat=_HEARTBEAT_S
            ),
            **options,
        )
        self.put: Callable[..., None] = self._publisher.put
        own = self._publisher.id
        token = f"{key}{_BELOW}{own.zid}/{own.eid}/_"
        self._token = session.liveliness().declare_token(token)

    def undeclare(self) -> None:
        """End it; if another thread sends by it just then, as soon as that is done."""
        with suppress(zenoh.ZError):  # it has ended the first time
            self._token.undeclare()
        self.put, self._publisher = _refuse, None


def _refuse(*_: Any, **__: Any) -> None:
    raise zenoh.ZError(UNDECLARED)


class RetainedSubscriber:
    """A subscriber of Zenoh's, until `undeclare` or the end of its session.

    Of one with a callback alone Zenoh's own `undeclare` leaves the subscriptions to heartbeats and
    to late publishers, 4 kB. A handle that also has an object to keep, here this one, ends with all
    of them when Python lets go of it.
    """

    def __init__(self, session: zenoh.Session, key: str, handler: Any, **options: Any):
        self._subscriber: ext.AdvancedSubscriber[Any] | None = (
            _extensions().declare_advanced_subscriber(
                session,
                key,
                (handler, self),
                recovery=ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
                subscriber_detection=True,
                **options,
            )
        )

    def undeclare(self) -> None:
        """End it; twice is fine. Zenoh lets go of Python's lock meanwhile."""
        self._subscriber = None


def declare_retained_publisher(
    session: Session, key: str, *, urgent: bool = True
) -> BytesPublisher:
    """A publisher whose last message also reaches late joiners, and is sent again if lost.

    Transforms and their descriptions are `urgent`, and have the priority of dynamic transforms: at
    the topics' a put waited 0.2 s when a camera filled the link. On a bad network theirs is one
    above.
    """
    at, key = session.placed(key)
    with bus_errors(f"publish {key}", session.settings.name):
        publisher = RetainedPublisher(
            at.zenoh,
            key,
            samples=1,
            congestion_control=zenoh.CongestionControl.BLOCK,
            priority=at.retained_priority if urgent else zenoh.Priority.DATA,
        )
    return BytesPublisher(key, publisher, session.settings.limits, session.settings.name)


def declare_retained_subscriber(
    session: Session,
    key: str,
    callback: OnSample,
    *,
    others: bool = False,
    urgent: bool = False,
) -> BytesSubscriber:
    """Call `callback(key, payload)` for the retained message of each publisher within `key`, also
    of publishers that come later, then for each new message. A message may come again when a link
    is back. With `others` messages of this session itself do not come as they are sent. On a bad
    network the messages that are `urgent` may come twice.
    """
    if urgent and session.network.is_bad:
        _ask_urgently(session, key, callback, others=others)
    at, key = session.placed(key)
    handler, dropped = session.callbacks.of_samples(key, callback)
    return BytesSubscriber(_subscriber(at, key, handler, others=others), dropped)


def declare_signed_subscriber(
    session: Session,
    key: str,
    callback: OnSignedSample,
    *,
    only_new: bool = False,
) -> Declaration:
    """As `declare_retained_subscriber`; `callback(key, payload, sender)` also gets the id of the
    session that the message is from, "" if it does not say. With `only_new` nothing comes that is
    retained now.
    """
    handler = session.callbacks.of_signed_samples(key, callback)
    return Declaration(_subscriber(session, key, handler, only_new=only_new))


def _ask_urgently(session: Session, key: str, callback: OnSample, *, others: bool) -> None:
    """Query retained messages by ourselves, too. Zenoh's query has the priority of topics: if
    transforms fill a link, as before a link of datagrams is open, it comes after all of them.
    """

    def take(answer: Answer) -> None:
        if answer.refusal is None:
            callback(answer.key, answer.payload)

    session.ask_later(
        retained_selector(key),
        None,
        take,
        lambda: None,
        timeout_s=_ANSWER_WITHIN_S,
        answers_at=key,
        others=others,
        priority="urgent",
    )


def _subscriber(
    session: Session, key: str, handler: Any, *, others: bool = False, only_new: bool = False
) -> RetainedSubscriber:
    zenoh_library.check_not_forked()
    history = ext.HistoryConfig(detect_late_publishers=True, max_samples=1)
    with bus_errors(f"subscribe to {key}", session.settings.name):
        return RetainedSubscriber(
            session.zenoh,
            key,
            handler,
            allowed_origin=zenoh.Locality.REMOTE if others else None,
            history=None if only_new else history,
        )


def ask_retained(session: Session, key: str, *, timeout_s: float = 1.0) -> Iterator[Answer]:
    """Iterate over the retained messages within `key`, each at its own key, as `Session.ask`."""
    return session.ask(retained_selector(key), timeout_s=timeout_s, answers_at=key)


def retained_selector(key: str) -> str:
    """The selector of the retained messages within `key`; answers are at keys of their own."""
    return f"{key}{_RETAINED}"


# As rmw_zenoh does it, by any session


def declare_caching_publisher(session: zenoh.Session, key: str, samples: int) -> RetainedPublisher:
    """A publisher whose last `samples` messages reach late joiners of other sessions."""
    return RetainedPublisher(
        session,
        key,
        samples=samples,
        congestion_control=zenoh.CongestionControl.DROP,
        allowed_destination=zenoh.Locality.REMOTE,
    )


def declare_history_subscriber(
    session: zenoh.Session, key: str, samples: int, handler: Any
) -> RetainedSubscriber:
    """A subscriber to kept and new messages of publishers of other sessions, at most `samples` kept
    ones of one session; also of publishers that come later.
    """
    return RetainedSubscriber(
        session,
        key,
        handler,
        allowed_origin=zenoh.Locality.REMOTE,
        history=ext.HistoryConfig(detect_late_publishers=True, max_samples=samples),
    )
