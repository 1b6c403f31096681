"""ROS messages as JSON: sensor_msgs/JointState and tf2_msgs/TFMessage, field by field."""

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from omad.estimation.estimate import Estimate

from .frame import CAMERA, Frame
from .robots.robot import link_frames


def ros_messages(
    estimate: Estimate, stamp_ns: int = 0, frame: Frame | np.ndarray = CAMERA, prefix: str = ""
) -> dict[str, Any]:
    """``{"joint_state": JointState, "tf": TFMessage, "probability": that it is right, or None}`` of plain Python
    values. ``stamp_ns``: nanoseconds, when the image was taken. ``frame`` is the parent of the base link, a ``Frame``
    or the camera's pose (4, 4) in the world; each other link hangs on its parent link, as in the URDF; ``prefix``
    stands before links' names, so that they are not those of a robot's links. Metres, radians; quaternions x, y, z, w.
    Raises InputError for what is no pose."""
    frame = frame if isinstance(frame, Frame) else Frame.of(frame)
    seconds, rest = divmod(int(stamp_ns), 10**9)
    stamp = {"sec": seconds, "nanosec": rest}
    names = [prefix + part.name for part in estimate.category.parts]
    frames = link_frames(estimate)
    transforms = [_transform(stamp, frame.name, names[0], frame.T_frame_camera @ frames[0])]
    for child, parent in enumerate(estimate.category.tree.parents, start=1):
        relative = np.linalg.inv(frames[parent]) @ frames[child]
        transforms.append(_transform(stamp, names[parent], names[child], relative))
    states = {joint.name: float(joint.state) for joint in estimate.joints}
    told = {"name": list(states), "position": list(states.values()), "velocity": [], "effort": []}
    joint_state = {"header": {"stamp": stamp, "frame_id": frame.name}} | told
    return {"joint_state": joint_state, "tf": {"transforms": transforms}, "probability": estimate.probability}


def _transform(stamp: dict[str, int], parent: str, child: str, T: np.ndarray) -> dict[str, Any]:
    quaternion = Rotation.from_matrix(T[:3, :3]).as_quat(canonical=True)
    translation = dict(zip("xyz", T[:3, 3].tolist(), strict=True))
    transform = {"translation": translation, "rotation": dict(zip("xyzw", quaternion.tolist(), strict=True))}
    return {"header": {"stamp": stamp, "frame_id": parent}, "child_frame_id": child, "transform": transform}
