"""The ROS 2 node: its messages are those that ROS reads, and it answers what it subscribes. Message classes are
rosbags' own; rclpy, which pip does not have, is a stand-in that notes what is published."""

import importlib
import runpy
import sys
from itertools import count
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.command_line import laptop_view
from omad.estimation.estimate import Estimate
from omad.estimation.estimator import Estimator
from omad.geometry.rigid import rigid
from omad.model.surfaces import surfaces
from omad.sensing.observation import Observation

fit = surfaces.SurfaceFit.of
PACKAGE = Path(__file__).parents[2] / "ros" / "omad_ros"


@pytest.fixture
def store(monkeypatch):
    typesys = pytest.importorskip("rosbags.typesys", reason="rosbags is an extra: pip install 'omad[bags]'")
    monkeypatch.setattr(sys, "path", [str(PACKAGE), *sys.path])
    return typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)


@pytest.fixture
def estimate() -> Estimate:
    view = laptop_view()
    return Estimator.from_pretrained("laptop")(Observation.from_depth(view.depth, view.camera))


def header(store, sec: int = 5):
    return store.types["std_msgs/msg/Header"](store.types["builtin_interfaces/msg/Time"](sec, 7), "depth_optical")


def read_back(store, message, kind: str):
    """As another process gets it."""
    return store.deserialize_cdr(store.serialize_cdr(message, kind), kind)


def inputs(store, sec: int = 5) -> tuple:
    depth = laptop_view().depth.astype(np.float32)
    types, info = store.types, store.types["sensor_msgs/msg/CameraInfo"]
    image = types["sensor_msgs/msg/Image"](header(store, sec), 480, 640, "32FC1", 0, 2560, depth.view(np.uint8).ravel())
    mask = np.uint8(depth > 0).ravel() * 255
    roi = types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    K, d = np.array([600.0, 0, 319.5, 0, 600, 239.5, 0, 0, 1]), np.zeros(5)
    told = info(header(store, sec), 480, 640, "plumb_bob", d, K, np.eye(3).ravel(), np.zeros(12), 0, 0, roi)
    return image, told, types["sensor_msgs/msg/Image"](header(store, sec), 480, 640, "mono8", 0, 640, mask)


def test_messages_are_those_that_ros_reads(store, estimate):
    make = importlib.import_module("omad_ros.messages").Messages(store.types, np.array)
    states = read_back(store, make.joint_state(estimate, header(store)), "sensor_msgs/msg/JointState")
    assert states.name == ["hinge"]
    assert states.position == pytest.approx(estimate.joint_states)
    assert states.header.frame_id == "depth_optical"
    sent = [
        read_back(store, one, "geometry_msgs/msg/TransformStamped") for one in make.transforms(estimate, header(store))
    ]
    assert [(one.header.frame_id, one.child_frame_id) for one in sent] == [
        ("depth_optical", "base"),
        ("base", "screen"),
    ]
    poses = []
    for one in sent:
        t, q = one.transform.translation, one.transform.rotation
        poses.append(rigid(Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix(), np.array([t.x, t.y, t.z])))
    assert poses[0] == pytest.approx(estimate.T_camera_base, abs=1e-6)
    kind = "geometry_msgs/msg/PoseWithCovarianceStamped"
    base = read_back(store, make.base_pose(estimate, header(store)), kind).pose
    place, turn = base.pose.position, sent[0].transform.rotation
    assert [place.x, place.y, place.z] == pytest.approx(estimate.T_camera_base[:3, 3])
    assert [base.pose.orientation.x, base.pose.orientation.w] == [turn.x, turn.w]
    assert np.sqrt(base.covariance[::7]) == pytest.approx(np.roll(estimate.base_std, 3))  # translation first
    assert base.covariance[1] == base.covariance[6] != 0
    hinge = estimate.joints[0]  # the screen's frame stands on its axis
    apart = (poses[0] @ poses[1])[:3, 3] - hinge.pivot
    assert np.linalg.norm(apart - (apart @ hinge.axis) * hinge.axis) < 1e-6
    markers = read_back(store, make.markers(estimate, header(store)), "visualization_msgs/msg/MarkerArray").markers
    assert [marker.ns for marker in markers] == ["base", "screen", "hinge axis"]
    corners = np.array([[p.x, p.y, p.z] for p in markers[0].points])
    assert corners == pytest.approx(estimate.parts[0].mesh_in_camera.triangles.reshape(-1, 3))
    assert read_back(store, make.nothing(header(store)), "visualization_msgs/msg/MarkerArray").markers[0].action == 3


@pytest.mark.parametrize("with_mask", [True, False])
def test_perception_follows_messages(store, with_mask):
    perception = importlib.import_module("omad_ros.perception").Perception(Estimator.from_pretrained("laptop"))
    for sec in (5, 6):
        depth, info, mask = inputs(store, sec)
        found = perception(depth, info, mask if with_mask else None)
        assert abs(found.joint_states[0] - laptop_view().states[0]) < 0.1
    assert perception(*inputs(store, 6)) is None  # an old one
    depth, info, _ = inputs(store, 6)
    depth.header.stamp.nanosec = 300_000_000
    depth.data = np.zeros_like(depth.data)
    assert perception(depth, info).warnings  # not seen: predicted
    depth, info, mask = inputs(store, 2)  # the recording begins anew
    assert not perception.is_late(depth)
    assert abs(perception(depth, info, mask).joint_states[0] - laptop_view().states[0]) < 0.1


def test_rectified_images_have_no_lens(store):
    kind, (depth, info, mask) = importlib.import_module("omad_ros.perception").Perception, inputs(store)
    info.p, info.k = (
        np.array([600.0, 0, 319.5, 0, 0, 600, 239.5, 0, 0, 0, 1, 0]),
        np.array([720.0, 0, 319.5, 0, 720, 239.5, 0, 0, 1]),
    )
    info.d = np.array([-0.3, 0.1, 0, 0, 0])
    right = Estimator.from_pretrained("laptop")(Observation.from_depth(laptop_view().depth, laptop_view().camera))
    found = kind(Estimator.from_pretrained("laptop"), track=False, rectified=True)(depth, info, mask)
    np.testing.assert_allclose(found.keypoints, right.keypoints, atol=1e-3)


class Synchronizer:
    """Like message_filters': of each topic it keeps the newest, and passes on those of one moment."""

    def __init__(self, topics: list, queue: int, apart: float) -> None:
        self.waiting: list[dict] = [{} for _ in topics]
        self.queue, self.apart = queue, apart

    def registerCallback(self, callback) -> None:
        self.callback = callback

    def add(self, topic: int, taken: float, message) -> None:
        self.waiting[topic][taken] = message
        if len(self.waiting[topic]) > self.queue:
            del self.waiting[topic][min(self.waiting[topic])]
        near = [min(kept, key=lambda other: abs(other - taken), default=np.inf) for kept in self.waiting]
        if np.ptp(near) < self.apart:
            self.callback(*(kept.pop(time) for kept, time in zip(self.waiting, near, strict=True)))


@pytest.fixture
def published(store, monkeypatch) -> list:
    """What a node without ROS publishes, by topic."""
    said: list = []
    seconds = count(1000)

    class Node:
        def __init__(self, name: str) -> None:
            self.name = name

        def declare_parameter(self, name, default):
            return SimpleNamespace(value=default)

        def create_publisher(self, kind, topic, queue):
            return SimpleNamespace(publish=lambda message: said.append((topic, message)))

        def resolve_topic_name(self, topic):
            return f"/{topic}"

        def get_logger(self):
            return SimpleNamespace(
                error=lambda text, **_: said.append(("error", text)),
                warning=lambda text, **_: said.append(("warning", text)),
            )

        def get_clock(self):
            times = store.types["builtin_interfaces/msg/Time"]
            return SimpleNamespace(now=lambda: SimpleNamespace(to_msg=lambda: times(next(seconds), 0)))

    def module(name: str, **members) -> None:
        made = ModuleType(name)
        vars(made).update(members)
        monkeypatch.setitem(sys.modules, name, made)

    packages: dict[str, dict] = {}
    for name, kind in store.types.items():
        package, _, short = name.partition("/msg/")
        packages.setdefault(package, {})[short] = kind
    for package in ("builtin_interfaces", "geometry_msgs", "sensor_msgs", "std_msgs", "visualization_msgs"):
        module(package)
        module(f"{package}.msg", **packages[package])
    module("rclpy")
    module("rclpy.executors", ExternalShutdownException=RuntimeError)
    module("rclpy.node", Node=Node)
    module("rclpy.qos", qos_profile_sensor_data=None)
    broadcaster = SimpleNamespace(sendTransform=lambda transforms: said.append(("tf", transforms)))
    module("tf2_ros", TransformBroadcaster=lambda node: broadcaster)
    module("message_filters", Subscriber=lambda *_, **__: None, ApproximateTimeSynchronizer=Synchronizer)
    monkeypatch.delitem(sys.modules, "omad_ros.node", raising=False)
    return said


def test_the_node_answers_each_image(store, published, monkeypatch):
    node = importlib.import_module("omad_ros.node")
    classes = {**store.types}
    monkeypatch.setattr(
        node,
        "Messages",
        lambda _, prefix: importlib.import_module("omad_ros.messages").Messages(classes, prefix=prefix),
    )
    running = node.OmadNode()
    running.answer(*inputs(store)[:2])
    assert [topic for topic, _ in published] == ["probability", "joint_states", "base_pose", "tf", "markers"]
    assert published[0][1].data > 0.5
    assert [sent.child_frame_id for sent in published[3][1]] == ["laptop/base", "laptop/screen"]
    running.answer(*inputs(store)[:2])  # an image that is late says nothing of the object
    assert [topic for topic, _ in published[5:]] == ["warning"]
    depth, info, _ = inputs(store, 6)
    info.width = 320
    running.answer(depth, info)
    assert published[-1][0] == "error"
    depth, info, _ = inputs(store, 90)  # long gone
    depth.data = np.zeros_like(depth.data)
    running.answer(depth, info)
    assert [topic for topic, _ in published[-2:]] == ["probability", "markers"]
    assert published[-2][1].data == 0


def test_markers_do_not_wait_for_a_fit_to_the_image(store, published, monkeypatch):
    node, make = importlib.import_module("omad_ros.node"), importlib.import_module("omad_ros.messages").Messages
    monkeypatch.setattr(node, "Messages", lambda _, prefix: make({**store.types}, prefix=prefix))
    fits: list = []
    monkeypatch.setattr(surfaces.SurfaceFit, "of", lambda *told: fits.append(told) or fit(*told))
    node.OmadNode().answer(*inputs(store))
    [shown] = [message.markers for topic, message in published if topic == "markers"]
    assert len(shown[0].points) > 100
    assert fits == []


def test_images_without_a_time_stamp_were_taken_when_they_came(store, published, monkeypatch):
    node, make = importlib.import_module("omad_ros.node"), importlib.import_module("omad_ros.messages").Messages
    monkeypatch.setattr(node, "Messages", lambda _, prefix: make({**store.types}, prefix=prefix))
    running = node.OmadNode()
    for _ in range(2):
        depth, info, _ = inputs(store, 0)
        depth.header.stamp.nanosec = 0
        running.answer(depth, info)
    stamps = [message.header.stamp.sec for topic, message in published if topic == "joint_states"]
    assert stamps == [1000, 1001]


def test_a_mask_that_took_long_meets_its_own_image(published, monkeypatch):
    node, answered = importlib.import_module("omad_ros.node"), []
    monkeypatch.setattr(node, "DEFAULTS", {**node.DEFAULTS, "use_mask": True})
    monkeypatch.setattr(node.OmadNode, "answer", lambda _, *messages: answered.append(messages))
    synchronizer = node.OmadNode().synchronizer
    rate, late = 30, 10
    for number in range(2 * rate):
        for topic, delay in enumerate((0, 0, late)):
            if number >= delay:
                synchronizer.add(topic, (number - delay) / rate, number - delay)
    assert answered == [(number, number, number) for number in range(2 * rate - late)]


def test_the_launch_file_takes_what_the_node_takes(published, monkeypatch):
    node, asked = importlib.import_module("omad_ros.node"), []
    loaded = Estimator.from_pretrained("laptop")
    stand_in_for_launch(monkeypatch)
    told = runpy.run_path(str(PACKAGE / "launch" / "omad.launch.py"))
    assert told["PARAMETERS"].keys() == told["TYPES"].keys() == node.DEFAULTS.keys()
    assert told["generate_launch_description"]() is not None
    monkeypatch.setattr(node.Estimator, "from_pretrained", lambda weights, device: asked.append(weights) or loaded)
    monkeypatch.setattr(node, "Perception", lambda *_: None)
    monkeypatch.setattr(node, "DEFAULTS", {**node.DEFAULTS, "weights": "laptop"})
    node.OmadNode()
    assert asked == [Path("laptop")]  # a path: the folder, not the shipped category of its name


def test_the_launch_file_gives_the_node_a_namespace(monkeypatch):
    stand_in_for_launch(monkeypatch)
    found = {}
    monkeypatch.setattr(sys.modules["launch_ros.actions"], "Node", lambda **given: found.update(given))
    monkeypatch.setattr(sys.modules["launch.substitutions"], "LaunchConfiguration", str)
    runpy.run_path(str(PACKAGE / "launch" / "omad.launch.py"))["generate_launch_description"]()
    assert found["namespace"] == "namespace"


def stand_in_for_launch(monkeypatch) -> None:
    """Stands for the packages launch and launch_ros, which pip does not have."""

    def anything(*_, **__) -> object:
        return object()

    for name, member in (
        ("launch", "LaunchDescription"),
        ("launch.actions", "DeclareLaunchArgument"),
        ("launch.substitutions", "LaunchConfiguration"),
        ("launch_ros", ""),
        ("launch_ros.actions", "Node"),
        ("launch_ros.parameter_descriptions", "ParameterValue"),
    ):
        made = ModuleType(name)
        setattr(made, member, anything)
        monkeypatch.setitem(sys.modules, name, made)
