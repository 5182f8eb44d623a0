"""The definitions of the ROS types of topics, as their publishers say them."""

from tfbus.base.bounded import Bounded
from tfbus.base.errors import BusError, DecodeError
from tfbus.bus.presence import key_beside
from tfbus.bus.session import Session
from tfbus.ros.definitions import Definition, standard_definition
from tfbus.ros.rmw import is_message_type
from tfbus.ros.schema import MessageCodec
from tfbus.wire.codec import decode_message
from tfbus.wire.descriptions import NodeDefinitions
from tfbus.wire.keys import definitions_selector, node_key

_ANSWER_WITHIN_S = 1.0

# Names come from the bus: at most as many types are remembered.
_MOST_TYPES = 10_000


class RosTypes:
    """Codecs of the ROS types that nodes publish: by the definition that the node gives, else by
    the standard type's of this name. Not thread-safe.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        # By the names of nodes and types; in the place of a codec the text that a node has said, ""
        # for none, until the codec is asked for.
        self._known: Bounded[tuple[str, str], MessageCodec | str | None] = Bounded(_MOST_TYPES)

    def codec(self, node: str, type_name: str) -> MessageCodec | None:
        """The codec of a type that a node publishes; None if it is no type of ROS, or its
        definition is not known. Asks the node of this full name once for all that it publishes.
        """
        if not is_message_type(type_name):
            return None
        key = node, type_name
        if key not in self._known:
            said = {(node, each): text for each, text in self._said(node).items()}
            self._known.update(said)
        known = self._known.get(key, "")
        if isinstance(known, str):
            known = self._known[key] = _codec(type_name, known)
        return known

    def forget(self, node: str) -> None:
        """Ask this node again: it may be another one of the same name."""
        for key in [key for key in self._known if key[0] == node]:
            del self._known[key]

    def _said(self, node: str) -> dict[str, str]:
        """The definitions of all types that the node publishes, "" for standard ones."""
        key = key_beside(node, node_key, self._session.settings.namespace)
        found: dict[str, str] = {}
        try:
            for answer in self._session.ask(definitions_selector(key), timeout_s=_ANSWER_WITHIN_S):
                if answer.refusal is None:
                    said = decode_message(NodeDefinitions, answer.payload)
                    announced = filter(is_message_type, said.publishes.values())
                    found |= dict.fromkeys(announced, "") | said.definitions
        except (BusError, DecodeError):
            return found  # it says nothing that can be read
        return found


def _codec(type_name: str, said: str) -> MessageCodec | None:
    try:
        definition = Definition(type_name, said) if said else standard_definition(type_name)
        return None if definition is None else MessageCodec.of_definition(definition)
    except DecodeError:
        return None
