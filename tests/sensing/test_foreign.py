"""Cameras, images and clouds of other packages are taken by what they carry. ROS messages are rosbags' own classes; the
others are stand-ins with the names that librealsense's and Open3D's Python packages give."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from helpers.command_line import laptop_view
from omad.applications.bulk.stream import Frame
from omad.common.errors import InputError
from omad.geometry.lens import Distortion
from omad.sensing.camera_files import read_camera
from omad.sensing.foreign.images import eight_bits
from omad.sensing.observation import Observation

BROWN = [0.1, -0.2, 0.001, -0.0005, 0.03]


class Model:
    """pyrealsense2's enum says its name so."""

    def __str__(self) -> str:
        return "distortion.inverse_brown_conrady"


def realsense(lens: bool = False):
    told = {"width": 640, "height": 480, "fx": 600.0, "fy": 600.0, "ppx": 319.5, "ppy": 239.5}
    return SimpleNamespace(**told, model=Model(), coeffs=BROWN if lens else [0.0] * 5)


def open3d():
    K = np.array([[600.0, 0, 319.5], [0, 600, 239.5], [0, 0, 1]])
    return SimpleNamespace(width=640, height=480, intrinsic_matrix=K, get_focal_length=lambda: (600, 600))


def messages(distribution: str = "ROS2_HUMBLE"):
    stores = pytest.importorskip("rosbags.typesys", reason="rosbags is an extra: pip install 'omad[bags]'")
    return stores.get_typestore(stores.Stores[distribution]).types


def header(types):
    stamp = types["builtin_interfaces/msg/Time"](1, 2)
    Header = types["std_msgs/msg/Header"]
    return Header(stamp=stamp, frame_id="c") if "seq" not in Header.__annotations__ else Header(0, stamp, "c")


def camera_info(distribution: str, d=()):
    types = messages(distribution)
    upper = distribution.startswith("ROS1")
    roi = types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    K, R, P = np.array([600.0, 0, 319.5, 0, 600, 239.5, 0, 0, 1]), np.eye(3).ravel(), np.zeros(12)
    names = dict(zip("DKRP" if upper else "dkrp", (np.array(d, float), K, R, P), strict=True))
    told = {"header": header(types), "height": 480, "width": 640, "distortion_model": "plumb_bob"}
    return types["sensor_msgs/msg/CameraInfo"](**told, **names, binning_x=0, binning_y=0, roi=roi)


def image(distribution: str, array: np.ndarray, encoding: str, pad: int = 0, big: bool = False):
    types = messages(distribution)
    stored = array.astype(array.dtype.newbyteorder(">")) if big else array
    rows = stored.reshape(len(array), -1).view(np.uint8)
    rows = np.pad(rows, ((0, 0), (0, pad)))
    told = {"header": header(types), "height": array.shape[0], "width": array.shape[1], "encoding": encoding}
    return types["sensor_msgs/msg/Image"](**told, is_bigendian=int(big), step=rows.shape[1], data=rows.ravel())


def cloud(points: np.ndarray, dtype: str = "f4"):
    """As a driver sends it: x, y, z in another order, behind a colour, 32 bytes a point."""
    types = messages()
    Field, number = types["sensor_msgs/msg/PointField"], 7 if dtype == "f4" else 8
    size = np.dtype(dtype).itemsize
    table = np.zeros((len(points), 32), np.uint8)
    fields = [Field("rgb", 0, 6, 1)]
    for place, axis in enumerate("zyx"):
        offset = 4 + place * size
        table[:, offset : offset + size] = points[:, ["xyz".index(axis)]].astype(f"<{dtype}").view(np.uint8)
        fields.append(Field(axis, offset, number, 1))
    told = {"header": header(types), "height": 1, "width": len(points), "fields": fields, "is_bigendian": False}
    data = {"point_step": 32, "row_step": 32 * len(points), "data": table.ravel(), "is_dense": True}
    return types["sensor_msgs/msg/PointCloud2"](**told, **data)


@pytest.fixture
def plain() -> Observation:
    view = laptop_view()
    return Observation.from_depth(view.depth, view.camera)


@pytest.mark.parametrize(
    "camera",
    [realsense, open3d, lambda: SimpleNamespace(intrinsic=open3d(), extrinsic=np.eye(4)),
     lambda: camera_info("ROS2_HUMBLE"), lambda: camera_info("ROS1_NOETIC"),
     lambda: {"fx": 600, "fy": 600, "cx": 319.5, "cy": 239.5}, lambda: "600,600,319.5,239.5"],
    ids=["rs2", "o3d intrinsic", "o3d parameters", "ros2", "ros1", "table", "text"],
)  # fmt: skip
def test_cameras_are_taken_as_they_are(camera, plain):
    seen = Observation.from_depth(laptop_view().depth, camera())
    assert np.array_equal(seen.points, plain.points)
    assert seen.warnings == ()


@pytest.mark.parametrize(
    "camera", [lambda: realsense(True), lambda: camera_info("ROS2_HUMBLE", BROWN)], ids=["rs2", "ros"]
)
def test_their_lenses_are_undone(camera, plain):
    seen = Observation.from_depth(laptop_view().depth, camera())
    assert np.abs(seen.points - plain.points).max() > 0.001
    assert seen.camera is not None
    assert seen.camera.distortion is None


def test_a_camera_of_another_size_is_refused():
    small = realsense()
    small.width, small.height = 1280, 720
    with pytest.raises(InputError, match="640x480 but its camera 1280x720"):
        Observation.from_depth(laptop_view().depth, small)


def test_a_binned_window_of_a_sensor_is_seen_where_it_lies(tmp_path, plain):
    info = camera_info("ROS2_HUMBLE")
    info.width, info.height, info.binning_x, info.binning_y = 1400, 1500, 2, 3
    info.roi = messages()["sensor_msgs/msg/RegionOfInterest"](60, 30, 1440, 1280, False)
    info.k = np.array([1200.0, 0, 639 + 60, 0, 1800, 718.5 + 30, 0, 0, 1])
    info.p = np.c_[info.k.reshape(3, 3), np.zeros(3)].ravel()
    seen = Observation.from_depth(laptop_view().depth, info)
    np.testing.assert_allclose(seen.points, plain.points, atol=1e-6)
    (tmp_path / "info.yaml").write_text(  # as `ros2 topic echo` has it
        f"width: 1400\nheight: 1500\nk: {info.k.tolist()}\np: {info.p.tolist()}\nbinning_x: 2\nbinning_y: 3\n"
        "roi: {x_offset: 60, y_offset: 30, width: 1280, height: 1440, do_rectify: false}\n"
    )
    found = read_camera(tmp_path / "info.yaml")
    np.testing.assert_allclose(found.without_lens().K, laptop_view().camera.K, atol=1e-12)
    assert found.size == (640, 480)


def test_open3d_parameters_are_read_from_their_file(tmp_path):
    inner = {"width": 640, "height": 480, "intrinsic_matrix": [600.0, 0, 0, 0, 600, 0, 319.5, 239.5, 1]}
    told = {"class_name": "PinholeCameraParameters", "extrinsic": np.eye(4).ravel().tolist(), "intrinsic": inner}
    (tmp_path / "view.json").write_text(json.dumps(told))
    found = read_camera(tmp_path / "view.json")
    assert found.size == (640, 480)
    assert found.K[0, 2] == 319.5


@pytest.mark.parametrize("big", [False, True], ids=["little", "big"])
@pytest.mark.parametrize("distribution", ["ROS2_HUMBLE", "ROS1_NOETIC"])
def test_ros_images_hold_metres_or_millimetres(distribution, big, plain):
    depth = laptop_view().depth.astype(np.float32)
    seen = Observation.from_depth(image(distribution, depth, "32FC1", 12, big), camera_info(distribution))
    assert np.array_equal(seen.points, plain.points)
    stored = np.rint(1000 * depth).astype(np.uint16)
    seen = Observation.from_depth(image(distribution, stored, "16UC1", 4, big), camera_info(distribution))
    np.testing.assert_allclose(seen.depth, stored * 0.001, rtol=0, atol=1e-6)


def test_ros_masks_colours_and_compressed_depth(tmp_path, plain):
    view, types = laptop_view(), messages()
    stored = np.rint(1000 * view.depth).astype(np.uint16)
    Image.fromarray(stored).save(tmp_path / "d.png")
    data = np.frombuffer(b"\0" * 12 + (tmp_path / "d.png").read_bytes(), np.uint8)
    packed = types["sensor_msgs/msg/CompressedImage"](header(types), "16UC1; compressedDepth png", data)
    mask = image("ROS2_HUMBLE", (view.depth > 0).astype(np.uint8) * 255, "mono8")
    bgr = np.random.default_rng(0).integers(0, 255, (480, 640, 3), np.uint8)
    seen = Observation.from_depth(packed, camera_info("ROS2_HUMBLE"), mask, color=image("ROS2_HUMBLE", bgr, "bgr8"))
    assert len(seen.points) == len(plain.points)
    labels = image("ROS2_HUMBLE", (view.depth > 0).astype(np.int32), "32SC1")
    assert np.array_equal(Observation.from_depth(packed, camera_info("ROS2_HUMBLE"), labels).points, seen.points)
    with pytest.raises(InputError, match="depth: encoding '32SC1' is one of labels"):
        Observation.from_depth(labels, camera_info("ROS2_HUMBLE"))
    Image.fromarray(np.ones((480, 640), np.int32)).save(tmp_path / "d.tif")
    data = np.frombuffer((tmp_path / "d.tif").read_bytes(), np.uint8)
    with pytest.raises(InputError, match="32SC1; tiff compressed' is one of labels"):
        Observation.from_depth(types["sensor_msgs/msg/CompressedImage"](header(types), "32SC1; tiff compressed", data))
    assert np.array_equal(seen.color, bgr[..., ::-1])


def test_colours_up_to_one_may_overshoot_it_a_little():
    assert eight_bits(np.array([-0.01, 0.5, 1.01])).tolist() == [0, 127, 255]
    assert eight_bits(np.array([0.5, 128.0, 255.0])).tolist() == [0, 128, 255]


@pytest.mark.parametrize("dtype", ["f4", "f8"])
def test_clouds_of_ros_and_open3d(dtype, plain):
    points = plain.points.astype(np.float32)
    message = cloud(points, dtype)
    assert np.array_equal(Observation.from_points(message).points, points)
    rows = np.pad(message.data[: 64 * (len(points) // 2)].reshape(2, -1), ((0, 0), (0, 16)), constant_values=255)
    told = {"height": 2, "width": len(points) // 2, "row_step": rows.shape[1], "data": rows.ravel()}
    padded = Observation.from_points(SimpleNamespace(**vars(message) | told))
    assert np.array_equal(padded.points, points[: 2 * (len(points) // 2)])
    assert np.array_equal(Observation.from_points(SimpleNamespace(points=points.astype(float))).points, points)


def test_rgbd_image_of_open3d_and_frame_of_librealsense(plain):
    depth = laptop_view().depth.astype(np.float32)
    color = np.full((480, 640, 3), 77, np.uint8)
    seen = Observation.from_depth(SimpleNamespace(depth=depth, color=color), open3d())
    assert np.array_equal(seen.points, plain.points)
    assert seen.color is not None
    assert seen.color.max() == 77
    profile = SimpleNamespace(as_video_stream_profile=lambda: SimpleNamespace(get_intrinsics=realsense))
    stored = np.rint(depth * 10000).astype(np.uint16)
    frame = SimpleNamespace(get_data=lambda: stored, get_units=lambda: 0.0001, get_profile=lambda: profile)
    for seen in (Observation.from_depth(frame), Frame.of_depth("first", frame).load()):
        np.testing.assert_allclose(seen.points, plain.points, rtol=0, atol=1e-4)
    for order, blue in (("rgb8", 2), ("bgr8", 0)):
        color[:] = 0
        color[..., blue] = 200
        kind = SimpleNamespace(format=lambda order=order: f"format.{order}")
        coloured = SimpleNamespace(get_data=lambda: color, get_profile=lambda kind=kind: kind)
        seen = Observation.from_depth(depth, open3d(), color=coloured)
        assert seen.color is not None
        assert seen.color.reshape(-1, 3).max(0).tolist() == [0, 0, 200]


def test_broken_messages_are_refused_in_a_line():
    broken = image("ROS2_HUMBLE", np.ones((480, 640), np.float32), "32FC1")
    broken.data = broken.data[:-8]
    with pytest.raises(InputError, match="640x480"):
        Observation.from_depth(broken, realsense())
    broken.encoding = "yuv422"
    with pytest.raises(InputError, match="encoding"):
        Observation.from_depth(broken, realsense())
    short = cloud(np.ones((100, 3)))
    short.data = short.data[:-1]
    with pytest.raises(InputError, match="100 points"):
        Observation.from_points(short)
    with pytest.raises(InputError, match="x, y and z"):
        Observation.from_points(SimpleNamespace(**{**vars(cloud(np.ones((100, 3)))), "fields": []}))
    with pytest.raises(InputError, match="intrinsics: none given"):
        Observation.from_depth(np.ones((480, 640)))


def test_a_calibration_of_kalibr(tmp_path):
    lens = "distortion_coeffs: [0.1, -0.2, 0.001, 0.002]\n  distortion_model"
    for model, known in (("radtan", "plumb_bob"), ("equidistant", "equidistant"), ("equi", "equidistant")):
        told = f"intrinsics: [600, 601, 319.5, 239.5]\n  {lens}: {model}\n  resolution: [640, 480]\n"
        (tmp_path / "camchain.yaml").write_text(f"cam0:\n  camera_model: pinhole\n  {told}")
        camera = read_camera(tmp_path / "camchain.yaml")
        assert np.allclose(camera.K, [[600, 0, 319.5], [0, 601, 239.5], [0, 0, 1]])
        assert (camera.size, camera.distortion) == ((640, 480), Distortion(known, (0.1, -0.2, 0.001, 0.002)))


def test_a_camera_of_colmap(tmp_path):
    file, head = tmp_path / "cameras.txt", "# Camera list\n# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
    for model, numbers, lens in (
        ("PINHOLE", "600 601 320 240", None),
        (
            "OPENCV",
            "600 601 320 240 0.1 -0.2 0.001 0.002",
            Distortion("plumb_bob", (0.1, -0.2, 0.001, 0.002, 0, 0, 0, 0)),
        ),
        ("OPENCV_FISHEYE", "600 601 320 240 0.1 -0.2 0.03 0.01", Distortion("equidistant", (0.1, -0.2, 0.03, 0.01))),
    ):
        file.write_text(f"{head}1 {model} 640 480 {numbers}\n")
        camera = read_camera(file)
        assert np.allclose(camera.K, [[600, 0, 319.5], [0, 601, 239.5], [0, 0, 1]])  # its pixels' corners are whole
        assert (camera.size, camera.distortion) == ((640, 480), lens)
    file.write_text(f"{head}7 SIMPLE_RADIAL 640 480 600 320 240 0.1\n")
    assert np.allclose(read_camera(file).K, [[600, 0, 319.5], [0, 600, 239.5], [0, 0, 1]])
    for lines in (
        2 * "1 PINHOLE 640 480 600 601 320 240\n",
        "1 PINHOLE 640 480 600 320 240\n",
        "1 FOV 640 480 6 6 3 2 1",
    ):
        file.write_text(head + lines)
        with pytest.raises(InputError, match=r"cameras\.txt: not as COLMAP writes one camera"):
            read_camera(file)


def test_cameras_of_radiance_fields_and_of_record3d(tmp_path):
    told = {
        "fl_x": 600,
        "fl_y": 601,
        "cx": 320,
        "cy": 240,
        "w": 640,
        "h": 480,
        "k1": 0.1,
        "k2": 0.0,
        "p1": 0,
        "p2": 0,
    }
    (tmp_path / "transforms.json").write_text(json.dumps(told | {"camera_model": "OPENCV", "frames": []}))
    camera = read_camera(tmp_path / "transforms.json")
    assert camera.size == (640, 480)
    assert camera.distortion == Distortion("plumb_bob", (0.1, 0, 0, 0, 0, 0, 0, 0))
    (tmp_path / "metadata").write_text(json.dumps({"K": [600, 0, 0, 0, 601, 0, 319.5, 239.5, 1], "fps": 60}))
    for K in (camera.K, read_camera(tmp_path / "metadata").K):
        assert np.allclose(K, [[600, 0, 319.5], [0, 601, 239.5], [0, 0, 1]])
