"""Why a process finds nothing: an endpoint that is silent, or a closed bus."""

from tfbus.bus.links import why_unreachable
from tfbus.bus.scout import scout
from tfbus.bus.session import Session
from tfbus.bus.zenoh_config import has_scouting
from tfbus.errors import BusError
from tfbus.wording import printable

# Others answer at once, and are asked again after 1 s.
_WITHIN_S = 1.5


def bus_out_of_reach(session: Session) -> str:
    """Which endpoint to connect to does not answer; or if processes are that the session has no
    link to, since their bus is closed or its own is, and how to join them; "" for neither, or if
    scouting does not show them.

    For those who have found nothing: it takes up to 1.5 s, or 2 s for each endpoint.
    """
    settings = session.settings
    for endpoint in settings.connect:
        if why := why_unreachable(endpoint):
            return (
                f"nothing answers at {endpoint} ({why}): start the router there, or correct "
                "--connect"
            )
    is_client = settings.mode == "client"
    if not has_scouting(settings):
        return ""
    is_closed = settings.closed is not None
    try:
        # A client has one link, to a router, and reaches all others by that.
        linked = session.linked() | {session.id}
        if is_client and len(linked) > 1:
            return ""

        def is_out(zid: str, endpoints: tuple[str, ...]) -> bool:
            return zid not in linked and bool(_what(endpoints, is_closed))

        found = scout(
            settings, _WITHIN_S, until=is_out, what="router" if is_client else "peer|router"
        )
        # One that was met meanwhile is no stranger.
        linked |= session.linked()
        others = (endpoints for zid, endpoints in found.items() if is_out(zid, endpoints))
        return next((_what(endpoints, is_closed) for endpoints in others), "")
    except BusError:
        return ""


def _what(endpoints: tuple[str, ...], is_closed: bool) -> str:
    """The words for a process at these endpoints, to one on a closed bus or an open one; "" if
    the two could have a link.
    """
    if not endpoints:
        return ""
    # An address of IPv4 is the shorter one.
    at = printable(min(endpoints, key=lambda each: ("[" in each, each)))
    if not all(each.startswith("tls/") for each in endpoints):
        return f"an open bus is here ({at}): join it without --secure" if is_closed else ""
    if is_closed:
        return (
            f"a closed bus is here ({at}) that this identity gets no link to: join it by one of "
            "its authority"
        )
    return f"a closed bus is here ({at}): join it by --secure DIR"
