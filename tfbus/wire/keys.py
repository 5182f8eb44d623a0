"""Keys on the bus: which key carries what, and which names are valid.

The name of a stream, node or parameter is one chunk of a key; characters that mean something to
Zenoh are percent-escaped there. Topics, services and actions are paths of chunks. The namespace is
part of no key here: Zenoh puts it in front (its `namespace` setting).
"""

import re
from urllib.parse import unquote

from tfbus.errors import InvalidNameError

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

CLOCK_TOPIC = "clock"

# How many chunks say what a key is for, by the first of them.
_CHUNKS_OF_KIND = {"@tfbus": 2, TRANSFORMS: 1, STATIC_TRANSFORMS: 1}

_ESCAPES = str.maketrans({char: f"%{ord(char):02X}" for char in "%*$?#/@"})
_NODE_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]*")
_RESERVED = re.compile(r"[*$?#\s]")


def escape(name: str) -> str:
    """The chunk of a key for `name`; `unescape` gives `name` back."""
    return name.translate(_ESCAPES)


def unescape(chunk: str) -> str:
    """The name of a chunk that `escape` made."""
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


def kept_transforms_selector(key: str, last_s: float) -> str:
    """The selector of the dynamic transforms of the last `last_s` seconds at a key or key
    expression.
    """
    return f"{key}?last_s={last_s:g}"


def node_key(node: str) -> str:
    """The key of a node's liveliness token and of its description."""
    return f"@tfbus/node/{escape(node)}"


def clock_key(node: str) -> str:
    """The key under which a node answers with the time of its system's clock."""
    return f"@tfbus/clock/{escape(node)}"


def parameter_key(node: str, parameter: str) -> str:
    """The key of one parameter of a node, to read and set it."""
    return f"@tfbus/param/{escape(node)}/{escape(parameter)}"


def node_parameters_key(node: str) -> str:
    """The key expression of all parameters of a node."""
    return f"@tfbus/param/{escape(node)}/*"


def last_name(key: str) -> str:
    """The name in the last chunk of a key: the stream, the node or the parameter."""
    return unescape(key.rsplit("/", 1)[-1])


def stream_of(key: str) -> str:
    """The stream of a key made by `transforms_key`, `static_transforms_key` or `stream_key`.

    A namespace in front stays part of the name: `robot7/tf/sim` is of stream `robot7/sim`.
    """
    above, below = _split(key)
    return "/".join([*above, *map(unescape, below[:1])])


def namespace_of(key: str) -> str:
    """The namespace in front of a stream's key: `robot7` of `robot7/tf/sim`."""
    return "/".join(_split(key)[0])


def _split(key: str) -> tuple[list[str], list[str]]:
    """The chunks before and after those that say what a stream's key is for."""
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
    """The name itself where it is a valid node name.

    Raises InvalidNameError: a node's name is letters, digits, `_`, `-` and `.`.
    """
    if _NODE_NAME.fullmatch(name):
        return name
    hint = ": give the namespace with --namespace" if "/" in name else ""
    raise InvalidNameError(
        f"{name!r} cannot be a node's name: use letters, digits, '_', '-' and '.', "
        f"and begin with a letter, a digit or '_'{hint}"
    )


def check_namespace(namespace: str) -> str:
    """The namespace without slashes around it; "" for none.

    Raises InvalidNameError where a part is empty or has a character that Zenoh reserves.
    """
    namespace = namespace.strip("/")
    return check_topic(namespace, kind="namespace") if namespace else ""


def check_topic(name: str, *, kind: str = "topic") -> str:
    """The name itself where it is valid for a topic, service or action.

    Raises InvalidNameError: names are relative paths such as `turtle1/pose`; no part is empty,
    begins with `@` or has white space or one of `* $ ? #`.
    """
    if name.startswith("/"):
        raise InvalidNameError(
            f"{kind} {name!r} begins with '/': names are relative to the node's namespace, "
            f"write {name.lstrip('/')!r}"
        )
    parts = name.split("/")
    if not all(parts) or _RESERVED.search(name) or any(part.startswith("@") for part in parts):
        raise InvalidNameError(
            f"{name!r} cannot be the name of a {kind}: use parts joined by '/', none of them "
            "empty or beginning with '@', without white space or any of * $ ? #"
        )
    return name
