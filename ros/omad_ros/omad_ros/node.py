"""The node: ``ros2 run omad_ros omad_node --ros-args -p category:=laptop -r depth:=... -r info:=...``

Subscribes ``depth`` (sensor_msgs/Image, 16UC1 millimetres or 32FC1 metres), ``info`` (sensor_msgs/CameraInfo of that
image) and with ``use_mask`` ``mask`` (sensor_msgs/Image, not zero on the object). Publishes ``joint_states``
(sensor_msgs/JointState), ``base_pose`` (geometry_msgs/PoseWithCovarianceStamped), ``probability`` (std_msgs/Float32,
that the answer is right, 0 where there is none), ``markers`` (visualization_msgs/MarkerArray) and transforms from the
camera to the links.
"""

import sys
from pathlib import Path
from typing import Any

import rclpy
from builtin_interfaces.msg import Time
from geometry_msgs.msg import (
    Point,
    Pose,
    PoseWithCovariance,
    PoseWithCovarianceStamped,
    Quaternion,
    Transform,
    TransformStamped,
    Vector3,
)
from message_filters import ApproximateTimeSynchronizer, Subscriber
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import ColorRGBA, Float32, Header
from tf2_ros import TransformBroadcaster
from visualization_msgs.msg import Marker, MarkerArray

from omad.common.errors import InputError
from omad.estimation.estimator import Estimator
from omad.sensing.foreign.bags import RECTIFIED

from .messages import Messages
from .perception import Perception

CLASSES = {
    "builtin_interfaces": (Time,),
    "geometry_msgs": (
        *(Point, Pose, PoseWithCovariance, PoseWithCovarianceStamped),
        *(Quaternion, Transform, TransformStamped, Vector3),
    ),
    "sensor_msgs": (JointState,),
    "std_msgs": (ColorRGBA, Float32, Header),
    "visualization_msgs": (Marker, MarkerArray),
}
QUEUE = 4
"""Messages that are kept for subscribers."""
RECENT, APART = 30, 0.05
"""Images that wait for their masks, which are worked out meanwhile, and seconds that messages of one moment may be
apart."""
DEFAULTS = {"category": "laptop", "weights": "", "use_mask": False, "track": True, "frame_prefix": ""}


class OmadNode(Node):
    """Answers each depth image."""

    def __init__(self) -> None:
        super().__init__("omad")
        told = {name: self.declare_parameter(name, default).value for name, default in DEFAULTS.items()}
        # a path is a folder, even one that is called like a category
        estimator = Estimator.from_pretrained(Path(told["weights"]) if told["weights"] else told["category"], "cpu")
        self.perception = Perception(estimator, told["track"], RECTIFIED in self.resolve_topic_name("depth"))
        types = {f"{package}/msg/{kind.__name__}": kind for package, kinds in CLASSES.items() for kind in kinds}
        prefix = told["frame_prefix"] or f"{estimator.category.name}/"  # other robots' links are called base, too
        self.messages = Messages(types, prefix=prefix)
        self.states = self.create_publisher(JointState, "joint_states", QUEUE)
        self.base_pose = self.create_publisher(PoseWithCovarianceStamped, "base_pose", QUEUE)
        self.probability = self.create_publisher(Float32, "probability", QUEUE)
        self.markers = self.create_publisher(MarkerArray, "markers", QUEUE)
        self.broadcaster = TransformBroadcaster(self)
        topics = [(Image, "depth"), (CameraInfo, "info")] + [(Image, "mask")] * told["use_mask"]
        seen = [Subscriber(self, kind, name, qos_profile=qos_profile_sensor_data) for kind, name in topics]
        self.synchronizer = ApproximateTimeSynchronizer(seen, RECENT, APART)
        self.synchronizer.registerCallback(self.answer)

    def answer(self, depth: Any, info: Any, mask: Any = None) -> None:
        """Publish what is seen; of an object that is not, that it is gone."""
        if depth.header.stamp.sec == depth.header.stamp.nanosec == 0:  # some cameras leave it out
            depth.header.stamp = self.get_clock().now().to_msg()
        if self.perception.is_late(depth):
            self.get_logger().warning("depth: is no newer than the last image, left out", throttle_duration_sec=5.0)
            return
        try:
            estimate = self.perception(depth, info, mask)
        except InputError as error:
            self.get_logger().error(str(error), throttle_duration_sec=5.0)
            return
        header, make = depth.header, self.messages
        self.probability.publish(make.probability(estimate))
        if estimate is None:
            self.markers.publish(make.nothing(header))
            return
        self.states.publish(make.joint_state(estimate, header))
        self.base_pose.publish(make.base_pose(estimate, header))
        self.broadcaster.sendTransform(make.transforms(estimate, header))
        # surfaces that are fitted to what was seen take ten times as long as an answer
        self.markers.publish(make.markers(estimate.without_labels(), header))


def main() -> None:
    """Run until it is interrupted."""
    rclpy.init()
    try:
        node = OmadNode()
        try:
            rclpy.spin(node)
        finally:
            node.destroy_node()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except InputError as error:  # of its parameters
        sys.exit(f"omad: {error}")
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
