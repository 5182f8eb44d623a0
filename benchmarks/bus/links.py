"""The processes of `benchmarks.links`: a robot, and a listener at the other end of its link."""

import sys
import threading
import time
from dataclasses import asdict, dataclass

from benchmarks.bus.place import say, wait_for_line

DYNAMIC, STATICS = 50, 20
# The age of a lookup that is answered where frames come in time.
PAST_S = 0.5
JOIN_WITHIN_S = 20.0
# The link of datagrams opens after that of TCP, and some tries are lost.
SETTLE_S = 6.0
_LOOKS_A_SECOND = 50.0
CAMERA = "camera"


@dataclass(frozen=True)
class Heard:
    """A listener: seconds until it had all static transforms (None: not in time) and the first of
    each dynamic one, the ages of the newest transform of each frame (p50 and p99, in s), the share
    of lookups at PAST_S ago that were answered, messages a second, how often it took a frame for
    gone, images a second, and the ages of the newest image (None: none came).
    """

    statics_s: float | None
    joined_s: float | None
    age_p50_s: float
    age_p99_s: float
    answered: float
    messages_hz: float
    gone: int
    images_hz: float = 0.0
    image_age_p50_s: float | None = None
    image_age_p99_s: float | None = None


def publish(hz: float) -> None:
    """The robot, until its input ends; it says for how long its longest send took."""
    import numpy as np

    import tfbus

    frames = ("map", "base", *(f"moving{number:02}" for number in range(DYNAMIC - 1)))
    edges = np.array([(0, 1), *((1, row) for row in range(2, DYNAMIC + 1))], dtype=np.uint32)
    poses = np.tile([1.0, 2.0, 3.0, 0.0, 0.0, 0.6, 0.8], (DYNAMIC, 1))
    pose = tfbus.Transform((1.0, 2.0, 3.0))
    statics = [
        tfbus.TransformStamped(0, "base", f"fixed{number}", pose) for number in range(STATICS)
    ]
    with tfbus.Node("driver") as node:
        began_s = time.monotonic()
        tfbus.StaticTransformBroadcaster(node).send_transform(statics)
        longest_s = time.monotonic() - began_s
        broadcaster = tfbus.TransformBroadcaster(node, history_s=0.0)
        ended = threading.Event()

        def wait_for_end() -> None:
            sys.stdin.readline()
            ended.set()

        threading.Thread(target=wait_for_end, daemon=True).start()
        say("ready")
        due_s = time.monotonic()
        while not ended.is_set():
            stamps = np.full(DYNAMIC, time.time_ns())
            batch = tfbus.TransformBatch(frames, edges, stamps, poses)
            began_s = time.monotonic()
            broadcaster.send_transform(batch)
            longest_s = max(longest_s, time.monotonic() - began_s)
            due_s = max(due_s + 1.0 / hz, time.monotonic() - 1.0 / hz)
            time.sleep(max(0.0, due_s - time.monotonic()))
        say(longest_s)


def film(size: int, hz: float) -> None:
    """A camera beside the robot, until its input ends; it says how long its longest send took."""
    import numpy as np

    import tfbus
    from tfbus.messages import Image

    pixels = np.random.default_rng(1).integers(0, 255, size, np.uint8)
    with tfbus.Node("camera") as node:
        publisher = node.create_publisher(Image, CAMERA)
        ended = threading.Event()
        threading.Thread(target=lambda: (sys.stdin.readline(), ended.set()), daemon=True).start()
        say("ready")
        longest_s = 0.0
        while not ended.wait(1.0 / hz):
            began_s = time.monotonic()
            publisher.publish(Image(time.time_ns(), "camera", 1, size, "mono8", 0, size, pixels))
            longest_s = max(longest_s, time.monotonic() - began_s)
        say(longest_s)


def listen(seconds: float, camera: bool = False) -> None:
    """The listener, from its start on; with `camera` it has that one's images, too."""
    import tfbus
    from tfbus.messages import Image

    moving = ("base", *(f"moving{number:02}" for number in range(DYNAMIC - 1)))
    fixed = {f"fixed{number}" for number in range(STATICS)}
    with tfbus.Node("base_station") as node:
        began_s = time.monotonic()
        buffer = tfbus.Buffer()
        listener = tfbus.TransformListener(buffer, node)
        images: list[int] = []
        if camera:

            def on_image(image: Image) -> None:
                images.append(image.stamp_ns)

            node.create_subscription(Image, CAMERA, on_image)
        statics_s = joined_s = None
        while time.monotonic() < began_s + JOIN_WITHIN_S:
            known = {*buffer.frames()}
            if statics_s is None and fixed <= known:
                statics_s = time.monotonic() - began_s
            if statics_s is not None and known.issuperset(moving):
                joined_s = time.monotonic() - began_s
                break
            time.sleep(0.01)
        time.sleep(SETTLE_S)
        ages, image_ages, answered, asked, gone, were_gone = [], [], 0, 0, 0, False
        messages, since_s = _messages(listener), time.monotonic()
        before = len(images)
        moving = tuple({*moving} & {*buffer.frames()})
        at = 0
        while (now_s := time.monotonic()) < since_s + seconds:
            now_ns = time.time_ns()
            # Each time a fifth of the frames: the machine may be a small one.
            for frame in moving[at % 5 :: 5]:
                newest_ns = buffer.frame(frame).newest_ns or 0
                ages.append((now_ns - newest_ns) / 1e9)
                asked += 1
                answered += buffer.can_transform("map", frame, now_ns - round(PAST_S * 1e9))
            if images:
                image_ages.append((now_ns - images[-1]) / 1e9)
            is_gone = buffer.frame(moving[0]).gone if moving else True
            gone += is_gone and not were_gone
            were_gone, at = is_gone, at + 1
            time.sleep(max(0.0, now_s + 1.0 / _LOOKS_A_SECOND - time.monotonic()))
        passed_s = time.monotonic() - since_s
        hz = (_messages(listener) - messages) / passed_s
        p50, p99 = _parts(ages) or (-1.0, -1.0)
        share = answered / max(asked, 1)
        images_hz = (len(images) - before) / passed_s
        of_images = (images_hz, *(_parts(image_ages) or (None, None)))
        say(asdict(Heard(statics_s, joined_s, p50, p99, share, hz, gone, *of_images)))
        wait_for_line()


def _parts(ages: list[float]) -> tuple[float, float] | None:
    """The median of ages and their 99th percentile; None without any."""
    ages = sorted(ages)
    return (ages[len(ages) // 2], ages[int(0.99 * len(ages))]) if ages else None


def _messages(listener: object) -> int:
    import tfbus

    assert isinstance(listener, tfbus.TransformListener)
    return sum(stream.messages for stream in listener.streams())
