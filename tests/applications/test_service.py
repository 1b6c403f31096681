"""The service: the library's own answers, for many at a time, within bounds, whatever it is sent."""

import io
import json
import signal
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from PIL.PngImagePlugin import PngInfo

import omad
from helpers.command_line import LAPTOP, K, answer, laptop_view, save_png
from helpers.fuzzing.spoiling import spoil
from helpers.service import FORM, INTRINSICS, Running, form, served
from omad.applications.service.asked import in_fields
from omad.applications.service.metrics import Metrics

for needed in ("fastapi", "uvicorn", "python_multipart"):
    pytest.importorskip(needed, reason="needs a server: pip install 'omad[serve]'")

MANY = 16


@cache
def depths() -> np.ndarray:
    """(16, 480, 640) uint16 millimetres: one view moved about, so that answers differ."""
    depth = np.rint(laptop_view().depth * 1000).astype(np.uint16)
    return np.stack([np.roll(depth, (3 * (i % 4), -4 * i), (0, 1)) for i in range(MANY)])


def png(image: np.ndarray, **options) -> bytes:
    return stored(Image.fromarray(image).save, "PNG", **options)


def stored(write, *args, **named) -> bytes:
    file = io.BytesIO()
    write(file, *args, **named)
    return file.getvalue()


def fields(i: int = 0, **more: bytes) -> dict[str, bytes]:
    return {"depth": png(depths()[i]), "intrinsics": INTRINSICS, "category": b"laptop", "checks": b"few", **more}


@cache
def alone(i: int, masked: bool = False) -> omad.Estimate:
    depth = (depths()[i] * 0.001).astype(np.float32)
    mask = np.broadcast_to(np.arange(640) < 330, depth.shape) if masked else None
    return estimator()(omad.Observation.from_depth(depth, (600, 600, 319.5, 239.5), mask))


@cache
def estimator() -> omad.Estimator:
    return omad.Estimator.from_pretrained("laptop", "cpu")


def assert_same(record: dict, expected: omad.Estimate) -> None:
    assert [joint["state"] for joint in record["joints"]] == pytest.approx(expected.joint_states, abs=1e-6)
    np.testing.assert_allclose(record["T_camera_base"], expected.T_camera_base, atol=1e-6)
    np.testing.assert_allclose(record["keypoints"], expected.keypoints, atol=1e-6)


@pytest.fixture(scope="module")
def temporary(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("temporary")


@pytest.fixture(scope="module")
def service(temporary):
    with served("--seconds", "60", "--queue", "32", TMPDIR=str(temporary)) as running:
        yield running
        healthy(running)
        assert running.ended() == 0
        assert not [line for line in running.said if "Traceback" in line or "failed" in line], running.said
    assert not list(temporary.iterdir())


def healthy(running: Running) -> None:
    found = running.ask("GET", "/health")
    assert (found.status, found.record["status"], found.record["categories"]) == (200, "ok", ["laptop"])


def test_the_answer_is_that_of_the_command(service, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    save_png("a.png", depths()[0] * 0.001)
    told = answer(capsys, "estimate", "a.png", *LAPTOP, *K)
    found = service.post(fields(checks=b"all"))
    assert (found.status, found.headers["content-type"]) == (200, "application/json")
    assert found.record.keys() == told.keys() - {"input", "output"}
    assert_same(found.record, alone(0))
    for key in ("category", "converged", "doubtful", "checks", "warnings", "mirrored"):
        assert found.record[key] == told[key]


def test_images_cameras_and_masks_in_their_formats(service):
    metres = (depths()[1] * 0.001).astype(np.float32)
    for depth in (stored(np.save, metres), stored(np.savez_compressed, depth=metres), stored(np.save, depths()[1])):
        assert_same(service.post(fields(depth=depth)).record, alone(1))
    K = {"fx": 600, "fy": 600, "cx": 319.5, "cy": 239.5, "width": 640, "height": 480}
    assert_same(service.post(fields(1, intrinsics=json.dumps(K).encode())).record, alone(1))
    mask = np.zeros((480, 640), np.uint8)
    mask[:, :330] = 255
    own = stored(np.savez, depth=depths()[0], mask=mask)
    for sent in ({"mask": png(mask)}, {"mask": stored(np.save, mask > 0)}, {"depth": own}):
        assert_same(service.post(fields(0, **sent)).record, alone(0, masked=True))
    told = {"intrinsics": b"\xef\xbb\xbf" + json.dumps(K | {"depth_scale": 0.0005}).encode()}
    for more in ({"depth_scale": b"0.0005"}, told):
        assert_same(service.post(fields(depth=png(depths()[1] * 2), **more)).record, alone(1))
    text = PngInfo()
    text.add_text("depth_scale", "0.0005")
    assert_same(service.post(fields(depth=png(depths()[1] * 2, pnginfo=text))).record, alone(1))


def test_the_page_on_request(service):
    for page in (service.post(fields(), Accept="text/html,*/*"), service.post(fields(format=b"html"))):
        assert page.status == 200
        assert page.headers["content-type"].startswith("text/html")
        assert b"laptop" in page.body
        assert page.body.strip().endswith(b"</html>")
    asked = service.post(fields(format=b"json", checks=b"few"), Accept="text/html,*/*")
    assert asked.record["category"] == "laptop"  # whatever a browser accepts


def test_auto_tells_the_category(service):
    found = service.post({key: value for key, value in fields().items() if key != "category"}).record
    assert found["category"] == "laptop"
    assert [each["category"] for each in found["categories"]] == ["laptop"]


def test_many_at_a_time_get_each_their_own(service):
    with ThreadPoolExecutor(MANY) as pool:
        found = list(pool.map(lambda i: service.post(fields(i % MANY)), range(2 * MANY)))
    for i, reply in enumerate(found):
        assert reply.status == 200
        assert_same(reply.record, alone(i % MANY))


WRONG = {
    "no depth": ({"intrinsics": INTRINSICS}, "depth: is missing"),
    "no intrinsics": ({"depth": b"x"}, "intrinsics: is missing"),
    "a path for intrinsics": (fields(intrinsics=b"/etc/passwd"), "intrinsics: holds no intrinsics"),
    "a path for depth": (fields(depth=b"/etc/passwd"), "depth: not readable as an image; send the file itself"),
    "another category": (fields(category=b"../laptop"), "category '../laptop': not served"),
    "an unknown field": (fields(colour=b"1"), "colour: no such field; there are depth, intrinsics"),
    "no number": (fields(depth_scale=b"many"), "depth_scale 'many': give a number"),
    "no scale": (fields(depth_scale=b"nan"), "depth scale nan"),
    "a box of three": (fields(box=b"1,2,3"), "box 1,2,3: expected 4 numbers"),
    "checks": (fields(checks=b"none"), "checks 'none': give all or few"),
    "an object of no mask": (fields(mask_id=b"3"), "mask_id 3: tells one of a mask's objects; give mask"),
    "a list for a mask": (fields(mask=b'[{"size": [480, 640]}]'), "mask: holds no mask; give one COCO segmentation"),
    "endless JSON": (fields(mask=b"[" + b"[]," * 1_400_000 + b"[]]"), "mask: the JSON has 4.2e+06, more than 4000000"),
    "an endless text": (fields(category=b"x" * 1_100_000), "category: is a text of more than 1000000 bytes"),
    "no text": (fields(category=b"\xff\xfe"), "category"),
    "eight bits": (fields(depth=png(np.zeros((480, 640), np.uint8))), "uint8 of shape (480, 640) is no depth image"),
    "nothing seen": (fields(depth=png(np.zeros((480, 640), np.uint16))), "no pixel holds a measurement"),
    "an empty mask": (fields(mask=b""), "mask: is an empty file; send a mask"),
    "a mask of another size": (fields(mask=png(np.ones((4, 4), np.uint8))), "mask: shape (4, 4) differs"),
    "objects": (fields(depth=stored(np.save, np.array([{}]), allow_pickle=True)), "is not of numbers"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_said_in_one_line(service, name):
    sent, told = WRONG[name]
    reply = service.post(sent)
    assert reply.status == 400
    assert told in reply.record["error"]
    assert len(reply.record["error"].splitlines()) == 1


@pytest.mark.slow
def test_bombs_are_refused_before_they_are_unpacked(service):
    head = b"{'descr': '<f8', 'fortran_order': False, 'shape': (100000, 100000), }".ljust(117) + b"\n"
    claims = b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head
    sparse = stored(np.savez_compressed, depth=np.zeros((9000, 9000)))
    wide = io.BytesIO()
    Image.new("I;16", (9000, 9000)).save(wide, "PNG")
    for bomb in (claims, sparse, wide.getvalue()):
        assert len(bomb) < 1_000_000
        began = time.monotonic()
        for name in ("depth", "mask"):
            assert service.post(fields(**{name: bomb})).status == 400
        assert time.monotonic() - began < 30
    healthy(service)


@pytest.mark.slow
def test_spoilt_files_and_bodies_harm_nobody(service):
    rng = np.random.default_rng(0)
    good = fields(mask=png((depths()[0] > 0).astype(np.uint8) * 255))
    for i in range(40):
        name = ("depth", "mask", "intrinsics")[i % 3]
        sent = form({**good, name: spoil(good[name], "x.txt" if name == "intrinsics" else "x.png", rng)})
        if i % 4 == 0:
            sent = sent[: int(rng.integers(len(sent)))]
        reply = service.ask("POST", "/estimate", sent, {"Content-Type": FORM})
        assert reply.status in (200, 400), reply.body
        assert reply.status == 200 or len(reply.record["error"].splitlines()) == 1
    assert_same(service.post(fields()).record, alone(0))


def test_what_is_no_form_is_refused(service):
    assert service.ask("POST", "/estimate", b"{}", {"Content-Type": "application/json"}).status == 400
    charsets = (f"{FORM}; charset={each}" for each in ("x\xe9", "undefined", "punycode"))
    for kind in ("multipart/form-data", "multipart/form-data; boundary=", *charsets):
        assert service.ask("POST", "/estimate", form(fields()), {"Content-Type": kind}).status in (200, 400)
    twice = form(fields())[: -len("--a-boundary--\r\n")] + form({"category": b"laptop"})
    assert "twice" in service.ask("POST", "/estimate", twice, {"Content-Type": FORM}).record["error"]
    assert b"ends before" in service.ask("POST", "/estimate", form(fields())[:-4], {"Content-Type": FORM}).body
    crowd = form({f"f{i}": b"" for i in range(2000)})
    assert service.ask("POST", "/estimate", crowd, {"Content-Type": FORM}).status == 400
    assert service.ask("GET", "/../../etc/passwd").status == 404


def test_other_addresses_and_methods_are_refused_in_the_words_of_all_errors(service):
    for method, path, status in (
        ("GET", "/estimate", 405), ("PUT", "/health", 405), ("GET", "/estimates", 404), ("POST", "/estimate/", 404),
    ):  # fmt: skip
        reply = service.ask(method, path)
        assert (reply.status, reply.record.keys()) == (status, {"error"})
        assert reply.headers["content-type"] == "application/json"
        assert "POST /estimate" in reply.record["error"]


def test_a_monitor_may_ask_for_the_head_alone(service):
    for path in ("/health", "/metrics"):
        reply = service.ask("HEAD", path)
        assert (reply.status, reply.body) == (200, b"")


def test_an_endless_field_keeps_nobody_waiting(service):
    began = time.monotonic()
    answer = service.post(fields(box=b"look at estimate.png " * 40_000))
    assert (answer.status, time.monotonic() - began < 5) == (400, True)
    assert len(answer.body) < 5000


def test_an_endless_field_that_is_sent_as_a_file_is_not_read(service):
    sent = form(fields(box=b"12," * 1_000_000)).replace(b'name="box"', b'name="box"; filename=x')
    reply = service.ask("POST", "/estimate", sent, {"Content-Type": FORM})
    assert (reply.status, reply.record["error"][:24]) == (400, "box: the text has 3e+06,")
    assert reply.record["error"].endswith("; give a smaller one")


def test_messages_name_fields_and_no_options(service):
    labels = png((depths()[0] > 0).astype(np.uint8) + 1)
    error = service.post(fields(mask=labels)).record["error"]
    assert "give mask_id, or" in error
    assert "--" not in error
    jpeg = stored(Image.fromarray(np.zeros((480, 640), np.uint8)).save, "JPEG")
    error = service.post(fields(mask=jpeg, mask_id=b"1")).record["error"]
    assert error == "mask: compression has blurred its ids; store label images as PNG, or leave mask_id out"
    odd = fields(mask=png(np.full((480, 640), 255, np.uint8)), depth_scale=b"0.0001")
    for reply in (service.post(odd), service.post(odd | {"format": b"html"})):
        assert reply.status == 200
        assert b"try another viewpoint, a better mask" in reply.body
        assert b"--gravity" not in reply.body
    found = service.post(odd).record
    assert found["checks"][0]["cure"].startswith("depth_scale 0.001, or another mask")
    assert "--" not in json.dumps([found["warnings"], found["checks"]])
    for told, said in (
        ("(on the command line: --depth-scale 0.001)", "(depth_scale 0.001)"),
        ("undistort it, or --distortion", "undistort it"),
        ("align it, or on the command line --color-intrinsics and --color-extrinsics", "align it"),
        ("--mask-id 3", "mask_id 3"),
        ("try --category oven, or --category auto", "try category oven, or category auto"),
        ("a better mask, or --gravity where it stands upright; or go on", "a better mask; or go on"),
        ("look at estimate.png, where they are coloured; give omad estimate a mask", "give a mask"),
    ):
        assert in_fields(told) == said


def test_who_leaves_before_the_body_is_there_sent_no_wrong_request(service):
    before = service.ask("GET", "/metrics").body.decode()
    service.begun().close()
    until = time.monotonic() + 10
    while 'status="499"' not in (after := service.ask("GET", "/metrics").body.decode()) and time.monotonic() < until:
        time.sleep(0.05)
    counts = [[line for line in text.splitlines() if 'status="400"' in line] for text in (before, after)]
    assert 'omad_requests_total{status="499"} 1' in after
    assert counts[0] == counts[1]


def test_what_is_no_request_is_refused(service):
    for sent in (
        b"\x16\x03\x01\x02\x00\x01\x00",
        b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX: " + b"a" * 1_000_000,
        b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n" + b"X: a\r\n" * 100_000,
        b"POST /estimate HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: -1\r\n\r\n",
        b"POST /estimate HTTP/1.1\r\nHost: 127.0.0.1\r\nTransfer-Encoding: chunked\r\n\r\nzz\r\n",
    ):
        try:
            found = service.raw(sent)
        except ConnectionError:  # it was cut off while it was still sent
            continue
        assert found[:12] in (b"HTTP/1.1 400", b"HTTP/1.1 431", b""), found[:80]
    healthy(service)


def test_only_its_own_names_and_pages_may_ask(service):
    own = f"127.0.0.1:{service.port}"
    assert service.post(fields(), Origin=f"http://{own}").status == 200
    assert service.post(fields(), Origin="http://evil.example").status == 403
    assert service.post(fields(), Host="evil.example", Origin="http://evil.example").status == 403
    assert service.ask("GET", "/metrics", headers={"Host": "evil.example"}).status == 403


@pytest.mark.skipif(sys.platform != "linux", reason="/proc tells at which address a port listens")
def test_only_this_machine_is_listened_to(service):
    listening = [line.split()[1:4:2] for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    assert [address for address, state in listening if state == "0A" and address.endswith(f":{service.port:04X}")] == [
        f"0100007F:{service.port:04X}"
    ]


def test_metrics_count_what_was_answered(service):
    def total(text: str, status: int) -> int:
        [line] = [line for line in text.splitlines() if line.startswith(f'omad_requests_total{{status="{status}"}}')]
        return int(line.split()[1])

    service.post(fields())
    service.post({})
    before = service.ask("GET", "/metrics").body.decode()
    service.post(fields())
    service.post({})
    after = service.ask("GET", "/metrics").body.decode()
    assert total(after, 200) == total(before, 200) + 1
    assert total(after, 400) == total(before, 400) + 1


def test_a_histogram_is_cumulative():
    metrics = Metrics()
    for seconds in (0.005, 0.3, 0.4, 99.0):
        metrics.add(200, seconds)
    lines = dict(line.rsplit(" ", 1) for line in metrics.text(inside=3).splitlines() if line[0] != "#")
    assert lines['omad_request_seconds_bucket{le="0.2"}'] == "1"
    assert lines['omad_request_seconds_bucket{le="0.5"}'] == "3"
    assert lines['omad_request_seconds_bucket{le="+Inf"}'] == lines["omad_request_seconds_count"] == "4"
    assert lines["omad_inside"] == "3"


@pytest.mark.slow
def test_bounds_hold():
    """Too large, too many, too slow."""
    with served("--seconds", "2", "--queue", "3", "--body-bytes", "2000000", "--workers", "1") as small:
        large = form(fields(depth=b"x" * 2_500_000))
        assert small.ask("POST", "/estimate", large, {"Content-Type": FORM}).status == 413
        lines = ["POST /estimate HTTP/1.1", "Host: 127.0.0.1", f"Content-Type: {FORM}", "Transfer-Encoding: chunked"]
        chunks = "\r\n".join([*lines, "", ""])
        endless = (b"%x\r\n" % 2_500_000) + large[:2_500_000] + b"\r\n"
        assert small.raw(chunks.encode() + endless).startswith(b"HTTP/1.1 413")
        slow = [small.begun() for _ in range(3)]
        time.sleep(0.3)
        full = small.post(fields())
        assert (full.status, full.headers["retry-after"]) == (503, "1")
        for each in slow:
            assert each.recv(12) == b"HTTP/1.1 408"
            each.close()
        trickle = small.raw(b"GET /health HTTP/1.1\r\nHost:")
        assert trickle == b""
        assert small.raw(b"") == b""  # closed, as who says nothing keeps others from being heard


@pytest.mark.slow
def test_what_was_begun_is_answered_before_the_end():
    with served("--seconds", "60", "--workers", "1") as running:
        with ThreadPoolExecutor(3) as pool:
            asked = [pool.submit(running.post, fields(i, format=b"html")) for i in range(3)]
            while b"omad_requests_inside 3" not in running.ask("GET", "/metrics").body and not asked[0].done():
                time.sleep(0.02)
            running.process.send_signal(signal.SIGTERM)
            assert [each.result().status for each in asked] == [200] * 3
        assert running.process.wait(60) == 0
        assert not [line for line in running.said if "Traceback" in line], running.said
