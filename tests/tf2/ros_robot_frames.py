"""The transforms of ROS's robot_state_publisher for a robot and joint states. Not a test itself.

Run by a Python that has rospy, with a JSON object on stdin: `urdf`, and `states`, each with
`stamp_ns`, `names` and `positions`. Prints a JSON object: `static`, rows of parent, child and seven
numbers, and `dynamic`, a map from stamps to such rows.
"""

import json
import os
import socket
import subprocess
import sys
import threading
import time

PUBLISHER = "/usr/lib/robot_state_publisher/robot_state_publisher"
DEADLINE_S = 60.0


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def until(condition):
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        if time.monotonic() > deadline:
            raise TimeoutError(condition)
        time.sleep(0.01)


def row(transform):
    p, q = transform.transform.translation, transform.transform.rotation
    names = [transform.header.frame_id, transform.child_frame_id]
    return [*names, p.x, p.y, p.z, q.x, q.y, q.z, q.w]


def frames(given):
    import rospy
    from sensor_msgs.msg import JointState
    from tf2_msgs.msg import TFMessage

    lock = threading.Lock()
    found = {"static": [], "dynamic": {}}

    def on_static(message):
        with lock:
            found["static"] = [row(each) for each in message.transforms]

    def on_dynamic(message):
        with lock:
            for each in message.transforms:
                stamp = str(each.header.stamp.to_nsec())
                found["dynamic"].setdefault(stamp, []).append(row(each))

    rospy.init_node("asks", disable_signals=True)
    rospy.Subscriber("/tf_static", TFMessage, on_static)
    rospy.Subscriber("/tf", TFMessage, on_dynamic)
    states = rospy.Publisher("/joint_states", JointState, queue_size=100)
    until(lambda: states.get_num_connections() and found["static"])
    for state in given["states"]:
        message = JointState(name=state["names"], position=state["positions"])
        message.header.stamp = rospy.Time(0, state["stamp_ns"])

        def came(stamp=str(state["stamp_ns"])):
            with lock:
                return stamp in found["dynamic"]

        # The first may be sent before the way to /tf is there.
        while not came():
            states.publish(message)
            time.sleep(0.05)
    return found


def main():
    given = json.load(sys.stdin)
    port = str(free_port())
    os.environ["ROS_MASTER_URI"] = f"http://127.0.0.1:{port}"
    os.environ["ROS_IP"] = "127.0.0.1"
    started = [subprocess.Popen(["rosmaster", "--core", "-p", port], stdout=subprocess.DEVNULL)]
    try:
        import rosgraph

        master = rosgraph.Master("/asks")
        until(master.is_online)
        master.setParam("/robot_description", given["urdf"])
        # Whatever the stamps: states are sent again here until they have come.
        master.setParam("/robot_state_publisher/ignore_timestamp", True)
        started.append(subprocess.Popen([PUBLISHER], stdout=subprocess.DEVNULL))
        print(json.dumps(frames(given)))
    finally:
        for process in reversed(started):
            process.kill()
    sys.stdout.flush()
    os._exit(0)


if __name__ == "__main__":
    main()
