"""ros2 launch omad_ros omad.launch.py category:=laptop depth:=/camera/depth/image_rect_raw
info:=/camera/depth/camera_info"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

TOPICS = {"depth": "/camera/depth/image_rect_raw", "info": "/camera/depth/camera_info", "mask": "/mask"}
PARAMETERS = {"category": "laptop", "weights": "", "use_mask": "false", "track": "true", "frame_prefix": ""}
TYPES = {"category": str, "weights": str, "use_mask": bool, "track": bool, "frame_prefix": str}
"""Left to itself ROS takes an empty text for no value, and a folder called 12 for a number."""


def generate_launch_description() -> LaunchDescription:
    told = [DeclareLaunchArgument(name, default_value=topic) for name, topic in TOPICS.items()]
    told += [DeclareLaunchArgument(name, default_value=value) for name, value in PARAMETERS.items()]
    parameters = {name: ParameterValue(LaunchConfiguration(name), value_type=TYPES[name]) for name in PARAMETERS}
    told.append(DeclareLaunchArgument("namespace", default_value=""))
    settings = {"parameters": [parameters], "remappings": [(name, LaunchConfiguration(name)) for name in TOPICS]}
    space = LaunchConfiguration("namespace")
    node = Node(package="omad_ros", executable="omad_node", namespace=space, **settings)
    return LaunchDescription([*told, node])
