"""A stream as its token and its description show it."""

from tfbus.runtime.structs import Struct
from tfbus.wire.descriptions import StreamDescription


class StreamState(Struct):
    """A stream as it is now.

    `name` is as `stream_of` gives it: `sim`, or `robot7/sim` outside of the namespace. `alive`
    is whether its publisher is there. `description` is the last it has sent, None before the
    first. `key` is that of its token and its description. `confirmed` is whether the description
    came from the session that it names, since the token did. `displaced` is the session
    that was there before others took over with later epochs, "" for none; `held` is whether it has
    come back since, as it lives.
    """

    name: str
    alive: bool = False
    description: StreamDescription | None = None
    key: str = ""
    confirmed: bool = False
    displaced: str = ""
    held: bool = False

    @property
    def owner(self) -> str:
        """The session that is known to publish it; "" for none."""
        return self.description.session if self.confirmed and self.description else ""
