"""Keys on the bus, their contents, and the names that are valid in them.

The name of a stream, node or parameter is one chunk of a key; characters that mean something to
Zenoh are percent-escaped there. Topics, services and actions are paths of chunks. The namespace is
part of no key here: Zenoh puts it in front (its `namespace` setting).
"""

import re

from tfbus.base.errors import InvalidNameError
from tfbus.base.wording import is_printable, printable

TRANSFORMS = "tf"
STATIC_TRANSFORMS = "tf_static"

ALL_TRANSFORMS = "tf/**"
ALL_STATIC_TRANSFORMS = "tf_static/**"
ALL_STREAMS = "@tfbus/stream/*"
ALL_STREAMS_EVERYWHERE = f"**/{ALL_STREAMS}"
ALL_TRANSFORMS_EVERYWHERE = f"**/{ALL_TRANSFORMS}"
ALL_STATIC_TRANSFORMS_EVERYWHERE = f"**/{ALL_STATIC_TRANSFORMS}"
ALL_NODES = "@tfbus/node/*"
ALL_NODES_EVERYWHERE = f"**/{ALL_NODES}"
ALL_KEEPERS = "@tfbus/kept/*"
ALL_KEEPERS_EVERYWHERE = f"**/{ALL_KEEPERS}"

CLOCK_TOPIC = "clock"

# The number of chunks that say the kind of a key, by the first of them.
_CHUNKS_OF_KIND = {"@tfbus": 2, TRANSFORMS: 1, STATIC_TRANSFORMS: 1}

# How many chunks follow in keys of transforms: the stream, and a frame of a split one.
_MOST_BELOW = {TRANSFORMS: 2, STATIC_TRANSFORMS: 1}

# Part of each type's name in the keys of ROS 2 on Zenoh, and of no stream's.
_ROS_TYPE = "::dds_::"

_ESCAPES = str.maketrans({char: f"%{ord(char):02X}" for char in "%*$?#/@"})
_NODE_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]*")
_RESERVED = re.compile(r"[*$?#\s]")


def escape(name: str) -> str:
    """The chunk of a key for `name`; `unescape` gives `name` back."""
    return name.translate(_ESCAPES)


def unescape(chunk: str) -> str:
    """The name of a chunk that `escape` made."""
    if "%" not in chunk:
        return chunk
    from urllib.parse import unquote  # slow to import, and most names need none

    return unquote(chunk)


def transforms_key(stream: str) -> str:
    """The key of a stream's dynamic transforms."""
    return f"tf/{escape(stream)}"


def static_transforms_key(stream: str) -> str:
    """The key of a stream's whole set of static transforms."""
    return f"tf_static/{escape(stream)}"


def stream_key(stream: str) -> str:
    """The key of a stream's liveliness token and of its description."""
    return f"@tfbus/stream/{escape(stream)}"


def may_describe(key: str) -> bool:
    """Whether a key has the token and the description of a stream, in any namespace."""
    return "/@tfbus/stream/" in f"/{key}"


def transforms_key_beside(stream_key: str, child: str | None = None) -> str:
    """The key of the dynamic transforms beside a `stream_key`, in the same namespace; with `child`,
    of that frame in a split stream.
    """
    prefix, _, stream = stream_key.rpartition("@tfbus/stream/")
    below = "" if child is None else f"/{escape(child)}"
    return f"{prefix}{TRANSFORMS}/{stream}{below}"


def static_transforms_key_beside(stream_key: str) -> str:
    """The key of the static transforms beside a `stream_key`, in the same namespace."""
    prefix, _, stream = stream_key.rpartition("@tfbus/stream/")
    return f"{prefix}{STATIC_TRANSFORMS}/{stream}"


def description_selector(static_key: str) -> str:
    """The selector of a stream's description at the key of its static transforms."""
    return f"{static_key}?description=1"


def kept_transforms_selector(key: str, last_s: float) -> str:
    """The selector of the dynamic transforms of the last `last_s` seconds at a key or key
    expression.
    """
    return f"{key}?last_s={last_s:g}"


def page_selector(selector: str, most_bytes: int, place: str = "") -> str:
    """The selector of a page of another selector's answer: from a place on that the page before has
    named, or the first.
    """
    begins = f";from={place}" if place else ""
    return f"{selector}{';' if '?' in selector else '?'}page={most_bytes}{begins}"


def node_key(node: str) -> str:
    """The key of a node's liveliness token and of its description."""
    return f"@tfbus/node/{escape(node)}"


def definitions_selector(key: str) -> str:
    """The selector of a node's description at its key, with the definitions of its ROS types."""
    return f"{key}?definitions=1"


def changed_selector(key: str, within_s: float) -> str:
    """The selector of the nodes at a key whose descriptions have changed in the last seconds."""
    return f"{key}?changed={within_s:.1f}"


def clock_key(node: str) -> str:
    """The key under which a node answers with the time of its system's clock."""
    return f"@tfbus/clock/{escape(node)}"


def kept_key(node: str) -> str:
    """The key of a recorder's token if it serves its kept messages, and of its answers."""
    return f"@tfbus/kept/{escape(node)}"


def kept_selector(key: str, from_s: float, until_s: float) -> str:
    """The selector of a recorder's kept messages at its `kept_key`: all that it recorded from
    `from_s` to `until_s` seconds ago.
    """
    return f"{key}?last_s={from_s:.3f};until_s={until_s:.3f}"


def parameter_key(node: str, parameter: str) -> str:
    """The key of one parameter of a node, to read and set it."""
    return f"@tfbus/param/{escape(node)}/{escape(parameter)}"


def node_parameters_key(node: str) -> str:
    """The key expression of all parameters of a node."""
    return f"@tfbus/param/{escape(node)}/*"


def setting_key(node: str, parameter: str) -> str:
    """The key to set one parameter of a node on a closed bus, if `parameter_key` only reads."""
    return f"@tfbus/set/{escape(node)}/{escape(parameter)}"


def node_settings_key(node: str) -> str:
    """The key expression to set all parameters of a node on a closed bus."""
    return f"@tfbus/set/{escape(node)}/*"


def last_name(key: str) -> str:
    """The name in the last chunk of a key: the stream, the node or the parameter."""
    return unescape(key.rsplit("/", 1)[-1])


def stream_of(key: str) -> str:
    """The stream of a key made by `transforms_key`, `static_transforms_key` or `stream_key`.

    A namespace in front stays part of the name: `robot7/tf/sim` is of stream `robot7/sim`.
    """
    above, below = _split(key)
    return "/".join([*above, *map(unescape, below[:1])])


def is_foreign(key: str) -> bool:
    """Whether a key that `ALL_TRANSFORMS`, or another such expression, matches is not one of
    tfbus's.

    ROS 2 has such keys: `robot7/tf` (zenoh-bridge-ros2dds), and by rmw_zenoh
    `0/robot7/tf/tf2_msgs::msg::dds_::TFMessage_/RIHS01_...`. Skip their messages without a word.
    """
    chunks = key.split("/")
    for at, chunk in enumerate(chunks):
        most = _MOST_BELOW.get(chunk)
        if most is not None:
            below = chunks[at + 1 :]
            return not 0 < len(below) <= most or _ROS_TYPE in below[0]
    return True


def mistake_in_stream(name: str) -> str:
    """Why a stream cannot have this name, as the end of a sentence; "" if it can."""
    if not name or not is_printable(name):
        return "use 1 to 255 letters that can be printed"
    if _ROS_TYPE in name:
        return f"'{_ROS_TYPE}' is part of ROS 2's keys on Zenoh, which listeners skip"
    return ""


def namespace_of(key: str) -> str:
    """The namespace in front of a stream's key: `robot7` of `robot7/tf/sim`."""
    return "/".join(_split(key)[0])


def _split(key: str) -> tuple[list[str], list[str]]:
    """The chunks before and after the chunks that say the kind of a stream's key."""
    chunks = key.split("/")
    for at, chunk in enumerate(chunks):
        if chunk in _CHUNKS_OF_KIND:
            return chunks[:at], chunks[at + _CHUNKS_OF_KIND[chunk] :]
    return chunks, []


def full_name(key: str, namespace: str = "") -> str:
    """The full name of the node whose `node_key` is `key` as seen from `namespace`.

    `robot7/@tfbus/node/sim` is the node `/robot7/sim`.
    """
    prefix = key.partition("@tfbus/")[0].strip("/")
    return "/" + "/".join(part for part in (namespace, prefix, last_name(key)) if part)


def check_node_name(name: str) -> str:
    """The name itself if it is a valid node name.

    Raises InvalidNameError: a node's name is letters, digits, `_`, `-` and `.`.
    """
    if not isinstance(name, str):
        raise InvalidNameError(f"a node's name must be a str, not {type(name).__name__}")
    if _NODE_NAME.fullmatch(name):
        return name
    hint = ": give the namespace with --namespace" if "/" in name else ""
    raise InvalidNameError(
        f"'{printable(name, 60)}' cannot be a node's name: use letters, digits, '_', '-' and '.', "
        f"and begin with a letter, a digit or '_'{hint}"
    )


def check_namespace(namespace: str) -> str:
    """The namespace without slashes around it; "" for none.

    Raises InvalidNameError if a part is empty or has a character that Zenoh reserves.
    """
    if not isinstance(namespace, str):
        raise InvalidNameError(f"a namespace must be a str, not {type(namespace).__name__}")
    path = namespace.removeprefix("/").removesuffix("/")
    if path:
        _check_path(path, namespace, "namespace")
    if "~" in path.split("/"):
        raise InvalidNameError(
            f"'{printable(namespace, 60)}' cannot be a namespace: '~' stands for a node's own names"
        )
    if not {TRANSFORMS, STATIC_TRANSFORMS}.isdisjoint(path.split("/")):
        raise InvalidNameError(
            f"'{printable(namespace, 60)}' cannot be a namespace: 'tf' and 'tf_static' are the "
            "keys of transforms"
        )
    return path


def check_topic(name: str, *, kind: str = "topic") -> str:
    """The name itself if it is valid for a topic, service or action.

    Names are paths such as `turtle1/pose`, relative to a namespace; `/robot7/scan` is absolute.
    Raises InvalidNameError if a part is empty, begins with `@`, or has white space, one of
    `* $ ? #`, or a character that cannot be printed.
    """
    if not isinstance(name, str):
        raise InvalidNameError(f"the name of a {kind} must be a str, not {type(name).__name__}")
    if name == "~" or name.startswith("~/"):
        raise InvalidNameError(
            f"{kind} '{printable(name, 60)}' is private to a node: write the node's name instead "
            "of '~'"
        )
    _check_path(name.removeprefix("/"), name, kind)
    return name


def check_no_transforms(topic: str) -> str:
    """The topic itself if messages may be published on it.

    Raises InvalidNameError for the keys of transforms, which listeners read as such.
    """
    if not {TRANSFORMS, STATIC_TRANSFORMS}.isdisjoint(topic.split("/")):
        raise InvalidNameError(
            f"topic '{printable(topic, 60)}' is of transforms: publish these by a "
            "TransformBroadcaster, and messages on a topic without a part 'tf' or 'tf_static'"
        )
    return topic


def check_parameter(name: str) -> str:
    """The name itself if it is valid for a parameter: as for a topic, and never absolute."""
    if not isinstance(name, str):
        raise InvalidNameError(f"a parameter's name must be a str, not {type(name).__name__}")
    _check_path(name, name, "parameter")
    return name


def resolve(name: str, node: str, namespace: str) -> str:
    """The name of a topic, service or action of a node as its session uses it.

    `~/pose` is `<node>/pose`; an absolute name within the namespace is relative to it. Raises as
    `check_topic`.
    """
    if isinstance(name, str) and name.startswith("~/"):
        name = f"{node}{name[1:]}"
    return relative(check_topic(name), namespace)


def relative(name: str, namespace: str) -> str:
    """A name or key without its slash if it is absolute and within the namespace.

    Any other is as it was: `/robot8/scan`, seen from `robot7`, stays absolute.
    """
    if not name.startswith("/"):
        return name
    prefix = f"/{namespace}/" if namespace else "/"
    return name.removeprefix(prefix)


def namespace_of_node(name: str) -> str:
    """The namespace in a node's full name: `robot7` of `/robot7/sim`, "" of `/sim`."""
    return name.strip("/").rpartition("/")[0]


def relative_name(name: str, namespace: str) -> str:
    """A node's name relative to the namespace: `/robot7/sim` is `sim` in robot7.

    A node's elsewhere stays absolute, with its slash.
    """
    return relative(name.rstrip("/"), namespace)


def _check_path(path: str, name: str, kind: str) -> None:
    parts = path.split("/")
    shown = f"'{printable(name, 60)}'"
    if not all(parts) or _RESERVED.search(path) or any(part.startswith("@") for part in parts):
        raise InvalidNameError(
            f"{shown} cannot be the name of a {kind}: use parts joined by '/', none of them "
            "empty or beginning with '@', without white space or any of * $ ? #"
        )
    if not path.isprintable():
        raise InvalidNameError(
            f"{shown} cannot be the name of a {kind}: it has a character that cannot be printed"
        )
