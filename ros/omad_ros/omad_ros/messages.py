"""ROS messages of estimates, made of whatever message classes there are: rclpy's, or those of a library without ROS."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from omad.estimation.estimate import Estimate
from omad.output.picture import part_colours
from omad.output.ros import ros_messages

TRIANGLES, ARROW, ADD, DELETE_ALL = 11, 0, 0, 3
"""Of visualization_msgs/Marker: kinds and actions."""
SHAFT, HEAD = 0.004, 0.01
"""Metres: how thick arrows are."""
LENGTH = 0.6
"""Of an axis' arrow, as a share of the object's size."""
CRIMSON = (0.86, 0.08, 0.24)


@dataclass(frozen=True)
class Messages:
    """Builds messages with the frame and time stamp of the image that they answer."""

    types: Mapping[str, Any]
    """Classes by full names, as sensor_msgs/msg/JointState."""
    numbers: Callable[[Sequence[float]], Any] = list
    """What a sequence of numbers is made into: rclpy takes lists."""
    prefix: str = ""
    """What stands before the names of links' frames."""

    def joint_state(self, estimate: Estimate, header: Any) -> Any:
        """sensor_msgs/JointState, radians and metres."""
        told = ros_messages(estimate)["joint_state"]
        none = self.numbers([])
        states = {"name": told["name"], "position": self.numbers(told["position"])}
        return self._make("sensor_msgs/JointState", header=header, **states, velocity=none, effort=none)

    def transforms(self, estimate: Estimate, header: Any) -> list[Any]:
        """geometry_msgs/TransformStamped: camera to base, and each link from its parent link."""
        found = []
        for number, told in enumerate(ros_messages(estimate, prefix=self.prefix)["tf"]["transforms"]):
            parent = header.frame_id if number == 0 else told["header"]["frame_id"]
            place, turn = told["transform"]["translation"], told["transform"]["rotation"]
            translation = self._make("geometry_msgs/Vector3", **place)
            transform = self._make(
                "geometry_msgs/Transform",
                translation=translation,
                rotation=self._make("geometry_msgs/Quaternion", **turn),
            )
            stamped = {"header": self._header(header.stamp, parent), "child_frame_id": told["child_frame_id"]}
            found.append(self._make("geometry_msgs/TransformStamped", **stamped, transform=transform))
        return found

    def base_pose(self, estimate: Estimate, header: Any) -> Any:
        """geometry_msgs/PoseWithCovarianceStamped in the camera frame, as sure as ``Estimate.base_std`` says."""
        told = ros_messages(estimate)["tf"]["transforms"][0]["transform"]
        position = self._make("geometry_msgs/Point", **told["translation"])
        orientation = self._make("geometry_msgs/Quaternion", **told["rotation"])
        pose = self._make("geometry_msgs/Pose", position=position, orientation=orientation)
        order = [3, 4, 5, 0, 1, 2]  # translation first
        least = estimate.covariance[:6, :6]
        wider = np.divide(estimate.base_std, np.sqrt(least.diagonal()), out=np.ones(6), where=least.diagonal() > 0)
        covariance = (wider[:, None] * least * wider)[np.ix_(order, order)]
        told = self._make(
            "geometry_msgs/PoseWithCovariance", pose=pose, covariance=self.numbers(covariance.ravel().tolist())
        )
        return self._make("geometry_msgs/PoseWithCovarianceStamped", header=header, pose=told)

    def markers(self, estimate: Estimate, header: Any) -> Any:
        """visualization_msgs/MarkerArray in the camera frame: a mesh a part, an arrow a joint axis."""
        found = [
            self._marker(header, part.name, TRIANGLES, part.mesh_in_camera.triangles.reshape(-1, 3), part_colours(k))
            for k, part in enumerate(estimate.parts)
        ]
        size = float(np.linalg.norm(np.ptp(estimate.keypoints, axis=0)))
        part_of = np.array(estimate.category.part_of_keypoint)
        for index, joint in enumerate(estimate.joints):
            middle = estimate.keypoints[part_of == index + 1].mean(0) if joint.pivot is None else joint.pivot
            ends = middle + np.array([[-0.5], [0.5]]) * LENGTH * size * joint.axis
            found.append(self._marker(header, f"{joint.name} axis", ARROW, ends, CRIMSON))
        return self._make("visualization_msgs/MarkerArray", markers=found)

    def probability(self, estimate: Estimate | None) -> Any:
        """std_msgs/Float32 that the answer is right; NaN where that is not known, 0 where there is no answer."""
        told = 0.0 if estimate is None else estimate.probability
        return self._make("std_msgs/Float32", data=float("nan" if told is None else told))

    def nothing(self, header: Any) -> Any:
        """visualization_msgs/MarkerArray that takes away what was shown."""
        marker = self._marker(header, "", ARROW, np.zeros((0, 3)), CRIMSON, DELETE_ALL)
        return self._make("visualization_msgs/MarkerArray", markers=[marker])

    def _marker(
        self, header: Any, name: str, kind: int, points: np.ndarray, colour: Sequence[float], action: int = ADD
    ) -> Any:
        make = self._make
        unmoved = make(
            "geometry_msgs/Pose",
            position=make("geometry_msgs/Point", x=0.0, y=0.0, z=0.0),
            orientation=make("geometry_msgs/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
        )
        scale = (SHAFT, HEAD, 0.0) if kind == ARROW else (1.0, 1.0, 1.0)
        shown = {"x": scale[0], "y": scale[1], "z": scale[2]}
        red, green, blue = map(float, colour)
        values = {"header": self._header(header.stamp, header.frame_id), "ns": name, "id": 0, "type": kind}
        values |= {"action": action, "pose": unmoved, "scale": make("geometry_msgs/Vector3", **shown)}
        values["color"] = make("std_msgs/ColorRGBA", r=red, g=green, b=blue, a=0.8)
        values["points"] = [make("geometry_msgs/Point", x=x, y=y, z=z) for x, y, z in points.tolist()]
        marker = self.types["visualization_msgs/msg/Marker"]
        if hasattr(marker, "__dataclass_fields__"):  # classes without defaults want every field
            values |= {name: self._empty(name) for name in marker.__dataclass_fields__ if name not in values}
        return marker(**{name: value for name, value in values.items() if not name.startswith("_")})

    def _empty(self, field: str) -> Any:
        """What a Marker's field that is not used holds."""
        make, time = self._make, self.types["builtin_interfaces/msg/Duration"]
        empty = {"lifetime": time(sec=0, nanosec=0), "frame_locked": False, "mesh_use_embedded_materials": False}
        empty |= {"colors": [], "uv_coordinates": [], "text": "", "mesh_resource": "", "texture_resource": ""}
        if field == "texture":
            header = self._header(self.types["builtin_interfaces/msg/Time"](sec=0, nanosec=0), "")
            return make("sensor_msgs/CompressedImage", header=header, format="", data=np.zeros(0, np.uint8))
        if field == "mesh_file":
            return make("visualization_msgs/MeshFile", filename="", data=np.zeros(0, np.uint8))
        return empty.get(field)

    def _header(self, stamp: Any, frame: str) -> Any:
        return self._make("std_msgs/Header", stamp=stamp, frame_id=frame)

    def _make(self, kind: str, **values: Any) -> Any:
        return self.types[kind.replace("/", "/msg/")](**values)
