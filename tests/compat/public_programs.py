"""The names of ROS that public programs use: facts about them, not their text.

Each ran with new imports on a bus with the topics that it listens to;
docs/guide/porting-tf2-ros.md has the results.
"""

# Repository and file, and the names that the program imports, reads and calls.
PROGRAMS: dict[str, str] = {
    "riththurn/ENGR489_Navigation: relativePositionLogger.py": (
        "geometry_msgs.msg.PoseStamped geometry_msgs.msg.Twist nav_msgs.msg.Path "
        "rclpy.init rclpy.node.Node.create_publisher rclpy.node.Node.create_timer "
        "rclpy.node.Node.get_clock rclpy.node.Node.get_logger rclpy.shutdown rclpy.spin "
        "rclpy.time.Time tf2_ros.Buffer.lookup_transform tf2_ros.TransformException "
        "tf2_ros.buffer.Buffer tf2_ros.transform_listener.TransformListener"
    ),
    "Lucas-ohmygoal/Learning_ROS2: static_tf_broadcaster.py": (
        "geometry_msgs.msg.TransformStamped rclpy.init rclpy.node.Node.destroy_node "
        "rclpy.node.Node.get_clock rclpy.shutdown rclpy.spin "
        "tf2_ros.TransformBroadcaster.sendTransform "
        "tf2_ros.static_transform_broadcaster.StaticTransformBroadcaster "
        "tf_transformations.quaternion_from_euler"
    ),
    "Lucas-ohmygoal/Learning_ROS2: tf_listener.py": (
        "rclpy.init rclpy.node.Node.create_timer rclpy.node.Node.declare_parameter "
        "rclpy.node.Node.destroy_node rclpy.node.Node.get_logger "
        "rclpy.node.Node.get_parameter rclpy.shutdown rclpy.spin rclpy.time.Time "
        "tf2_ros.Buffer.lookup_transform tf2_ros.TransformException tf2_ros.buffer.Buffer "
        "tf2_ros.transform_listener.TransformListener "
        "tf_transformations.euler_from_quaternion"
    ),
    "OsamahShamsan/Nexus_4WD_Mecanum_Robot: odom_tf_broadcaster.py": (
        "geometry_msgs.msg.TransformStamped nav_msgs.msg.Odometry rclpy.init "
        "rclpy.node.Node.create_subscription rclpy.node.Node.destroy_node "
        "rclpy.node.Node.get_logger rclpy.shutdown rclpy.spin "
        "tf2_ros.TransformBroadcaster.sendTransform"
    ),
    "DaniyalAneeq/Physical-AI-Robotic-Book: static_tf2_broadcaster.py": (
        "geometry_msgs.msg.TransformStamped rclpy.init rclpy.node.Node.destroy_node "
        "rclpy.node.Node.get_clock rclpy.node.Node.get_logger rclpy.shutdown rclpy.spin "
        "tf2_ros.StaticTransformBroadcaster tf2_ros.TransformBroadcaster.sendTransform "
        "tf_transformations.quaternion_from_euler"
    ),
    "Echo-here/echo_mcu: odom_node.py": (
        "geometry_msgs.msg.Quaternion geometry_msgs.msg.TransformStamped "
        "nav_msgs.msg.Odometry rclpy.init rclpy.node.Node.create_publisher "
        "rclpy.node.Node.create_subscription rclpy.node.Node.create_timer "
        "rclpy.node.Node.destroy_node rclpy.node.Node.get_clock "
        "rclpy.node.Node.get_logger rclpy.shutdown rclpy.spin std_msgs.msg.String "
        "tf2_ros.TransformBroadcaster.sendTransform "
        "tf_transformations.quaternion_from_euler"
    ),
    "Echo-here/echo_mcu: tf_node.py": (
        "geometry_msgs.msg.TransformStamped nav_msgs.msg.Odometry rclpy.init "
        "rclpy.node.Node.create_subscription rclpy.node.Node.destroy_node rclpy.shutdown "
        "rclpy.spin tf2_ros.TransformBroadcaster.sendTransform "
        "tf_transformations.euler_from_quaternion"
    ),
    "Echo-here/echo_mcu: virtual_odom_node.py": (
        "geometry_msgs.msg.Quaternion geometry_msgs.msg.TransformStamped "
        "geometry_msgs.msg.Twist nav_msgs.msg.Odometry rclpy.init "
        "rclpy.node.Node.create_publisher rclpy.node.Node.create_subscription "
        "rclpy.node.Node.create_timer rclpy.node.Node.destroy_node "
        "rclpy.node.Node.get_clock rclpy.node.Node.get_logger rclpy.shutdown rclpy.spin "
        "tf2_ros.TransformBroadcaster.sendTransform "
        "tf_transformations.quaternion_from_euler"
    ),
    "gkdldy153/meric_f1tenth: imu_tf_broadcaster.py": (
        "geometry_msgs.msg.TransformStamped rclpy.init rclpy.node.Node.create_timer "
        "rclpy.node.Node.get_clock rclpy.shutdown rclpy.spin "
        "tf2_ros.TransformBroadcaster.sendTransform"
    ),
    "gkdldy153/meric_f1tenth: tf_publisher.py": (
        "geometry_msgs.msg.TransformStamped rclpy.init rclpy.node.Node.create_timer "
        "rclpy.node.Node.get_clock rclpy.shutdown rclpy.spin "
        "tf2_ros.TransformBroadcaster.sendTransform"
    ),
    "robobe/new_blog: ctrl1.py": (
        "geometry_msgs.msg.PoseStamped geometry_msgs.msg.TransformStamped "
        "geometry_msgs.msg.Twist rclpy.init rclpy.node.Node.create_publisher "
        "rclpy.node.Node.create_subscription rclpy.node.Node.create_timer "
        "rclpy.node.Node.destroy_node rclpy.node.Node.get_clock "
        "rclpy.node.Node.get_logger rclpy.shutdown rclpy.spin "
        "tf2_ros.TransformBroadcaster.sendTransform "
        "tf_transformations.quaternion_from_euler turtlesim.msg.Pose"
    ),
    "robobe/new_blog: ctrl_lqr.py": (
        "geometry_msgs.msg.PoseStamped geometry_msgs.msg.TransformStamped "
        "geometry_msgs.msg.Twist rclpy.init rclpy.node.Node.create_publisher "
        "rclpy.node.Node.create_subscription rclpy.node.Node.create_timer "
        "rclpy.node.Node.destroy_node rclpy.node.Node.get_clock "
        "rclpy.node.Node.get_logger rclpy.shutdown rclpy.spin "
        "tf2_ros.TransformBroadcaster.sendTransform "
        "tf_transformations.quaternion_from_euler turtlesim.msg.Pose"
    ),
    "robobe/new_blog: ctrl_mpc.py": (
        "geometry_msgs.msg.PoseStamped geometry_msgs.msg.TransformStamped "
        "geometry_msgs.msg.Twist rclpy.init rclpy.node.Node.create_publisher "
        "rclpy.node.Node.create_subscription rclpy.node.Node.create_timer "
        "rclpy.node.Node.destroy_node rclpy.node.Node.get_clock "
        "rclpy.node.Node.get_logger rclpy.shutdown rclpy.spin "
        "tf2_ros.TransformBroadcaster.sendTransform "
        "tf_transformations.euler_from_quaternion "
        "tf_transformations.quaternion_from_euler turtlesim.msg.Pose"
    ),
    "robobe/new_blog: ctrl_pid.py": (
        "geometry_msgs.msg.PoseStamped geometry_msgs.msg.TransformStamped "
        "geometry_msgs.msg.Twist rclpy.init rclpy.node.Node.create_publisher "
        "rclpy.node.Node.create_subscription rclpy.node.Node.create_timer "
        "rclpy.node.Node.destroy_node rclpy.node.Node.get_clock "
        "rclpy.node.Node.get_logger rclpy.shutdown rclpy.spin "
        "tf2_ros.TransformBroadcaster.sendTransform "
        "tf_transformations.quaternion_from_euler turtlesim.msg.Pose"
    ),
    "robobe/new_blog: demo1_reslove.py": (
        "geometry_msgs.msg.TransformStamped rclpy.init rclpy.node.Node.create_timer "
        "rclpy.node.Node.get_logger rclpy.shutdown rclpy.spin rclpy.time.Time "
        "tf2_ros.Buffer.lookup_transform tf2_ros.ConnectivityException "
        "tf2_ros.ExtrapolationException tf2_ros.LookupException tf2_ros.TransformListener"
    ),
    "robobe/new_blog: demo2_static_broadcast.py": (
        "geometry_msgs.msg.TransformStamped rclpy.init rclpy.node.Node.get_clock "
        "rclpy.node.Node.get_logger rclpy.shutdown rclpy.spin "
        "tf2_ros.StaticTransformBroadcaster tf2_ros.TransformBroadcaster.sendTransform"
    ),
    "robobe/new_blog: demo3_dynamic_reolver.py": (
        "geometry_msgs.msg.TransformStamped rclpy.duration.Duration rclpy.init "
        "rclpy.node.Node.create_timer rclpy.node.Node.get_logger rclpy.shutdown "
        "rclpy.spin rclpy.time.Time tf2_ros.Buffer.lookup_transform "
        "tf2_ros.ConnectivityException tf2_ros.ExtrapolationException "
        "tf2_ros.LookupException tf2_ros.TransformListener"
    ),
    "robobe/new_blog: demo3_dynamic_reolver_qos.py": (
        "geometry_msgs.msg.TransformStamped rclpy.duration.Duration rclpy.init "
        "rclpy.node.Node.create_timer rclpy.node.Node.get_logger "
        "rclpy.qos.QoSDurabilityPolicy.VOLATILE rclpy.qos.QoSHistoryPolicy.KEEP_LAST "
        "rclpy.qos.QoSProfile rclpy.qos.QoSReliabilityPolicy.BEST_EFFORT rclpy.shutdown "
        "rclpy.spin rclpy.time.Time tf2_ros.Buffer.lookup_transform "
        "tf2_ros.ConnectivityException tf2_ros.ExtrapolationException "
        "tf2_ros.LookupException tf2_ros.TransformListener"
    ),
    "robobe/new_blog: demo3_dynamic_tf_broadcaster.py": (
        "geometry_msgs.msg.TransformStamped rclpy.init rclpy.node.Node.create_timer "
        "rclpy.node.Node.get_clock rclpy.node.Node.get_logger rclpy.shutdown rclpy.spin "
        "tf2_ros.TransformBroadcaster.sendTransform"
    ),
    "robobe/new_blog: tf_visual.py": (
        "geometry_msgs.msg.Pose rclpy.duration.Duration rclpy.init "
        "rclpy.node.Node.create_client rclpy.node.Node.create_timer "
        "rclpy.node.Node.destroy_node rclpy.node.Node.get_logger rclpy.shutdown "
        "rclpy.spin rclpy.spin_until_future_complete rclpy.time.Time "
        "tf2_geometry_msgs.do_transform_pose tf2_ros.Buffer.lookup_transform "
        "tf2_ros.ConnectivityException tf2_ros.ExtrapolationException "
        "tf2_ros.LookupException tf2_ros.TransformListener turtlesim.srv.SetPen.Request "
        "turtlesim.srv.Spawn.Request turtlesim.srv.TeleportAbsolute.Request"
    ),
    "IntelRealSense/realsense-ros: set_cams_transforms.py": (
        "geometry_msgs.msg.TransformStamped rclpy.init rclpy.node.Node.get_clock "
        "tf2_ros.TransformBroadcaster.sendTransform "
        "tf2_ros.static_transform_broadcaster.StaticTransformBroadcaster "
        "tf_transformations.quaternion_from_euler"
    ),
    "introlab/rtabmap_ros: republish_tf_static.py": (
        "rclpy.init rclpy.node.Node.create_publisher rclpy.node.Node.create_subscription "
        "rclpy.node.Node.destroy_node rclpy.node.Node.get_logger "
        "rclpy.qos.DurabilityPolicy.TRANSIENT_LOCAL rclpy.qos.HistoryPolicy.KEEP_LAST "
        "rclpy.qos.QoSProfile rclpy.shutdown rclpy.spin tf2_msgs.msg.TFMessage"
    ),
    "introlab/rtabmap_ros: transform_to_tf.py": (
        "geometry_msgs.msg.TransformStamped rclpy.init "
        "rclpy.node.Node.create_subscription rclpy.node.Node.declare_parameter "
        "rclpy.node.Node.destroy_node rclpy.node.Node.get_parameter rclpy.shutdown "
        "rclpy.spin tf2_ros.TransformBroadcaster.sendTransform"
    ),
    "A7med205/shelf_detector: tf_relay.py": (
        "rclpy.init rclpy.node.Node.create_publisher rclpy.node.Node.create_subscription "
        "rclpy.node.Node.destroy_node rclpy.node.Node.get_logger "
        "rclpy.qos.QoSDurabilityPolicy.TRANSIENT_LOCAL "
        "rclpy.qos.QoSDurabilityPolicy.VOLATILE rclpy.qos.QoSProfile "
        "rclpy.qos.QoSReliabilityPolicy.RELIABLE rclpy.shutdown rclpy.spin "
        "tf2_msgs.msg.TFMessage"
    ),
    "su1jun/src: odom_node.py": (
        "geometry_msgs.msg.TransformStamped geometry_msgs.msg.Twist nav_msgs.msg.Odometry "
        "rclpy.init rclpy.node.Node.create_publisher rclpy.node.Node.create_subscription "
        "rclpy.node.Node.destroy_node rclpy.node.Node.get_clock "
        "rclpy.qos.qos_profile_sensor_data rclpy.shutdown rclpy.spin "
        "tf2_ros.TransformBroadcaster.sendTransform"
    ),
    "hello-robot/stretch_ros2: align_to_aruco.py": (
        "control_msgs.action.FollowJointTrajectory.Goal geometry_msgs.msg.Transform "
        "geometry_msgs.msg.TransformStamped rclpy.action.ActionClient "
        "rclpy.duration.Duration rclpy.init rclpy.node.Node.create_timer "
        "rclpy.node.Node.get_clock rclpy.node.Node.get_logger rclpy.shutdown rclpy.spin "
        "rclpy.spin_once rclpy.time.Time sensor_msgs.msg.JointState "
        "tf2_ros.Buffer.lookup_transform tf2_ros.TransformException tf2_ros.buffer.Buffer "
        "tf2_ros.transform_listener.TransformListener "
        "tf_transformations.euler_from_quaternion "
        "tf_transformations.quaternion_from_euler tf_transformations.quaternion_matrix "
        "trajectory_msgs.msg.MultiDOFJointTrajectoryPoint"
    ),
    "lpandath/tb4_ws: odom_to_tf_broadcaster.py": (
        "geometry_msgs.msg.TransformStamped nav_msgs.msg.Odometry rclpy.init "
        "rclpy.node.Node.create_subscription rclpy.node.Node.create_timer "
        "rclpy.node.Node.get_clock rclpy.node.Node.get_logger "
        "rclpy.node.Node.get_namespace rclpy.qos.QoSDurabilityPolicy.TRANSIENT_LOCAL "
        "rclpy.qos.QoSProfile rclpy.qos.QoSReliabilityPolicy.RELIABLE rclpy.shutdown "
        "rclpy.spin tf2_ros.TransformBroadcaster.sendTransform"
    ),
    "lpandath/tb4_ws: phase2_circle_controller.py": (
        "geometry_msgs.msg.Twist rclpy.duration.Duration rclpy.init "
        "rclpy.node.Node.create_publisher rclpy.node.Node.create_service "
        "rclpy.node.Node.create_timer rclpy.node.Node.declare_parameter "
        "rclpy.node.Node.destroy_node rclpy.node.Node.get_clock "
        "rclpy.node.Node.get_logger rclpy.node.Node.get_parameter rclpy.qos.QoSProfile "
        "rclpy.qos.QoSReliabilityPolicy.RELIABLE rclpy.spin rclpy.time.Time "
        "rclpy.try_shutdown std_srvs.srv.Trigger tf2_ros.Buffer.lookup_transform "
        "tf2_ros.ConnectivityException tf2_ros.ExtrapolationException "
        "tf2_ros.LookupException tf2_ros.TransformListener"
    ),
    "lpandath/tb4_ws: tf_relay_node.py": (
        "rclpy.executors.SingleThreadedExecutor rclpy.init "
        "rclpy.node.Node.create_publisher rclpy.node.Node.create_subscription "
        "rclpy.node.Node.destroy_node rclpy.node.Node.get_clock "
        "rclpy.qos.QoSDurabilityPolicy.TRANSIENT_LOCAL "
        "rclpy.qos.QoSDurabilityPolicy.VOLATILE rclpy.qos.QoSProfile "
        "rclpy.qos.QoSReliabilityPolicy.RELIABLE rclpy.try_shutdown "
        "tf2_msgs.msg.TFMessage"
    ),
    "ROBOTIS-GIT/turtlebot3_applications: turtlebot3_automatic_parking_vision.py": (
        "geometry_msgs.msg.Twist nav_msgs.msg.Odometry rclpy.init "
        "rclpy.node.Node.create_publisher rclpy.node.Node.create_subscription "
        "rclpy.node.Node.create_timer rclpy.node.Node.destroy_node "
        "rclpy.node.Node.get_logger rclpy.qos.QoSProfile rclpy.shutdown rclpy.spin "
        "rclpy.time.Time std_msgs.msg.Int32 tf2_ros.Buffer.lookup_transform "
        "tf2_ros.TransformListener"
    ),
    "cyberbotics/webots_ros2: epuck_node.py": (
        "geometry_msgs.msg.TransformStamped nav_msgs.msg.Odometry rclpy.init "
        "rclpy.node.Node.create_publisher rclpy.node.Node.create_subscription "
        "rclpy.node.Node.destroy_node rclpy.node.Node.get_clock "
        "rclpy.node.Node.get_logger rclpy.shutdown rclpy.spin sensor_msgs.msg.LaserScan "
        "sensor_msgs.msg.Range tf2_ros.StaticTransformBroadcaster "
        "tf2_ros.TransformBroadcaster.sendTransform"
    ),
    "cyberbotics/webots_ros2: simple_mapper.py": (
        "builtin_interfaces.msg.Time geometry_msgs.msg.TransformStamped "
        "nav_msgs.msg.OccupancyGrid rclpy.init rclpy.node.Node.create_publisher "
        "rclpy.node.Node.create_subscription rclpy.node.Node.create_timer "
        "rclpy.node.Node.declare_parameter rclpy.node.Node.destroy_node "
        "rclpy.node.Node.get_clock rclpy.qos.DurabilityPolicy.TRANSIENT_LOCAL "
        "rclpy.qos.HistoryPolicy.KEEP_LAST rclpy.qos.QoSProfile rclpy.shutdown rclpy.spin "
        "sensor_msgs.msg.LaserScan tf2_ros.Buffer.lookup_transform "
        "tf2_ros.ConnectivityException tf2_ros.ExtrapolationException "
        "tf2_ros.LookupException tf2_ros.StaticTransformBroadcaster "
        "tf2_ros.TransformBroadcaster.sendTransform tf2_ros.TransformListener"
    ),
    "tier4/AutowareArchitectureProposal.iv: pose2tf.py": (
        "geometry_msgs.msg.PoseStamped geometry_msgs.msg.TransformStamped rclpy.init "
        "rclpy.node.Node.create_subscription rclpy.node.Node.destroy_node rclpy.shutdown "
        "rclpy.spin tf2_ros.TransformBroadcaster.sendTransform tf2_ros.TransformException"
    ),
    "tier4/AutowareArchitectureProposal.iv: tf2pose.py": (
        "geometry_msgs.msg.PoseStamped rclpy.init rclpy.node.Node.create_publisher "
        "rclpy.node.Node.create_timer rclpy.node.Node.destroy_node rclpy.shutdown "
        "rclpy.spin rclpy.time.Time tf2_ros.Buffer.lookup_transform "
        "tf2_ros.LookupException tf2_ros.buffer.Buffer "
        "tf2_ros.transform_listener.TransformListener"
    ),
    "hoyneschang/ros2_learning: tf_broadcaster.py": (
        "geometry_msgs.msg.TransformStamped rclpy.init rclpy.node.Node.create_timer "
        "rclpy.node.Node.destroy_node rclpy.node.Node.get_clock "
        "rclpy.node.Node.get_logger rclpy.shutdown rclpy.spin "
        "tf2_ros.TransformBroadcaster.sendTransform"
    ),
    "hoyneschang/ros2_learning: tf_listener.py": (
        "rclpy.init rclpy.node.Node.create_timer rclpy.node.Node.destroy_node "
        "rclpy.node.Node.get_logger rclpy.shutdown rclpy.spin rclpy.time.Time "
        "tf2_ros.Buffer.lookup_transform tf2_ros.TransformListener"
    ),
    "dk9480/robotspace_Assignment: marker_tf.py": (
        "geometry_msgs.msg.TransformStamped rclpy.init rclpy.node.Node.create_timer "
        "rclpy.node.Node.get_clock rclpy.spin tf2_ros.TransformBroadcaster.sendTransform"
    ),
}
