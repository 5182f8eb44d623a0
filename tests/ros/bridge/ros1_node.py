"""A node of ROS 1, run by a Python that has rospy and tf2_ros; it prints messages, once each.

ros1_node.py NAME lookup TARGET SOURCE
ros1_node.py NAME twist X           (publishes it on cmd_vel, and prints others' messages)
ros1_node.py NAME broadcast PARENT CHILD
"""

import sys
from collections.abc import Callable

import rospy
import tf2_ros
from geometry_msgs.msg import TransformStamped, Twist


def lookup(target: str, source: str) -> Callable[[], None]:
    buffer = tf2_ros.Buffer()
    listener = tf2_ros.TransformListener(buffer)

    def look() -> None:
        assert listener
        try:
            found = buffer.lookup_transform(target, source, rospy.Time(0))
        except tf2_ros.TransformException:
            return
        say("found", found.transform.translation.x, found.transform.translation.y)

    return look


def twist(x: str) -> Callable[[], None]:
    publisher = rospy.Publisher("cmd_vel", Twist, queue_size=10)
    own = rospy.get_name()

    def hear(message: Twist) -> None:
        caller = message._connection_header["callerid"]
        if caller != own:
            say("heard", message.linear.x, "from", caller)

    rospy.Subscriber("cmd_vel", Twist, hear)
    message = Twist()
    message.linear.x = float(x)
    return lambda: publisher.publish(message)


def broadcast(parent: str, child: str) -> Callable[[], None]:
    broadcaster = tf2_ros.TransformBroadcaster()
    transform = TransformStamped()
    transform.header.frame_id = parent
    transform.child_frame_id = child
    transform.transform.translation.x = 1.5
    transform.transform.rotation.w = 1.0

    def send() -> None:
        transform.header.stamp = rospy.Time.now()
        broadcaster.sendTransform(transform)

    return send


said = set()


def say(*words: object) -> None:
    line = " ".join(map(str, words))
    if line not in said:
        said.add(line)
        print(line, flush=True)


name, what, *arguments = sys.argv[1:]
rospy.init_node(name, argv=[], disable_rosout=True)
step = {"lookup": lookup, "twist": twist, "broadcast": broadcast}[what](*arguments)
say("ready")
while not rospy.is_shutdown():
    step()
    rospy.rostime.wallsleep(0.05)
