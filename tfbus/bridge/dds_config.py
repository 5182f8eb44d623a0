"""The configuration of Cyclone DDS with which it meets ROS 2 as it is by default."""

import os
import socket
from collections.abc import Mapping, Sequence
from xml.sax.saxutils import quoteattr

# Cyclone refuses what Fast DDS 3 says of types, and then matches nothing of it: for these vendors
# (Connext, Fast DDS, Cyclone itself) the name of a type decides, as everywhere in ROS.
_VENDORS = "1.1,1.15,1.16"

# Messages that a reader has not confirmed are at most those of the history; more than this many
# bytes of them would make a writer wait, and all of Python with it.
_MOST_WAITING = "256 MB"


def configuration(connect: Sequence[str], environ: Mapping[str, str] = os.environ) -> str:
    """What Cyclone DDS is to do, as XML.

    `connect` are names of network interfaces to use, and hosts to ask where multicast does not
    reach them. Without any, it is as ROS's variables say: ROS_LOCALHOST_ONLY,
    ROS_AUTOMATIC_DISCOVERY_RANGE and ROS_STATIC_PEERS. What CYCLONEDDS_URI says holds as well.
    """
    here = {name for _, name in socket.if_nameindex()}
    interfaces = [each for each in connect if each in here]
    peers = [each for each in connect if each not in here]
    if not connect:
        peers = [each for each in environ.get("ROS_STATIC_PEERS", "").split(";") if each]
        if _is_local(environ):
            # ROS finds others on this host by their ports, not by multicast.
            interfaces, peers = ["127.0.0.1"], ["127.0.0.1", *peers]
    asked = _domain(_general(interfaces) + _discovery(peers))
    return ",".join(filter(None, (_ALWAYS, environ.get("CYCLONEDDS_URI", "").strip(), asked)))


def _is_local(environ: Mapping[str, str]) -> bool:
    reach = environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper()
    return reach == "LOCALHOST" or (not reach and environ.get("ROS_LOCALHOST_ONLY") == "1")


def _domain(text: str) -> str:
    return f'<CycloneDDS><Domain Id="any">{text}</Domain></CycloneDDS>' if text else ""


def _general(interfaces: Sequence[str]) -> str:
    if not interfaces:
        return ""
    listed = "".join(
        f"<NetworkInterface {'address' if each[0].isdigit() else 'name'}={quoteattr(each)}/>"
        for each in interfaces
    )
    return f"<General><Interfaces>{listed}</Interfaces></General>"


def _discovery(peers: Sequence[str]) -> str:
    if not peers:
        return ""
    listed = "".join(f"<Peer Address={quoteattr(each)}/>" for each in peers)
    # At a port that others try when they ask this host. Hosts are asked for as long as there is no
    # ROS on them: Cyclone would give up after 30 s.
    settings = (
        "<ParticipantIndex>auto</ParticipantIndex>"
        "<SPDPInterval>2 s</SPDPInterval>"
        "<InitialLocatorPruneDelay>inf</InitialLocatorPruneDelay>"
    )
    return f"<Discovery>{settings}<Peers>{listed}</Peers></Discovery>"


_ALWAYS = _domain(
    "<Compatibility>"
    f"<IgnoreTypeInformation>{_VENDORS}</IgnoreTypeInformation>"
    "</Compatibility>"
    # Without a hash of the key Fast DDS does not understand that a writer or a whole participant
    # ends: ROS would show it until its lease ends, for 10 s.
    "<Internal>"
    "<GenerateKeyhash>true</GenerateKeyhash>"
    f"<Watermarks><WhcHigh>{_MOST_WAITING}</WhcHigh></Watermarks>"
    "</Internal>"
)
