"""``omad explore``: a local page with sliders for shape and joints, and a depth file to fit."""

from __future__ import annotations

import contextlib
import importlib.util
import socket
import sys
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from .errors import InputError
from .estimator import Estimator
from .explore.fitting import Fit, FitRequest, fit_demo, fit_file
from .options import CategoryName, Device, Json, Result, Seed, Weights, check_category, check_positive

LAST_PORT = 65535


@dataclass(frozen=True)
class Explore:
    """Open a local page: sliders for shape and joints of a category's objects, random objects, a depth file to fit.

    The page's address is printed; Ctrl-C ends it. It needs the extra omad[explore].
    """

    category: tyro.conf.Positional[CategoryName]
    depth: Path | None = None
    """Depth image or cloud to fit at the start; others can be given in the page."""
    intrinsics: str | None = None
    """Of the depth camera: fx,fy,cx,cy or a file (Open3D or RealSense JSON, ROS YAML, 3x3 text)."""
    mask: Path | None = None
    """Image, non-zero where the object is."""
    box: str | None = None
    """x1,y1,x2,y2 in pixels around the object, half-open."""
    segment: Literal["plane"] | None = None
    """plane: take away the dominant plane and keep the largest thing on it."""
    depth_scale: float | None = None
    """Metres per stored number; default 0.001 for integer images, 1 for floats and clouds."""
    demo: bool = False
    """Fit a procedural object that no training has seen at the start."""
    components: int = 5
    """Numbers of beta whose sliders are shown at once; the others are in a folder of the page."""
    host: str = "127.0.0.1"
    """Address to listen at. Whoever reaches another one can have this machine's depth files fitted."""
    port: int = 8080
    """0: any free one."""
    weights: Weights = None
    device: Device = "cpu"
    seed: Seed = 0
    json: Json = False

    def run(self) -> Result:
        check_positive(depth_scale=self.depth_scale, components=self.components)
        if self.demo and self.depth is not None:
            raise InputError("--demo and --depth: give one of them; both are things to fit at the start")
        if importlib.util.find_spec("viser") is None:
            raise InputError("omad explore needs the viewer library viser; pip install 'omad[explore]'")
        port = free_port(self.host, self.port)
        estimator = Estimator.from_pretrained(self.weights or self.category, self.device)
        check_category("--weights", self.weights, estimator.category, self.category)
        request = None if self.depth is None else self._request(self.depth)
        fit = fit_file(estimator, request) if request else fit_demo(estimator, self.seed) if self.demo else None
        self._serve(port, estimator, request, fit)
        return 0, {"category": estimator.category.name, "url": _url(self.host, port)}

    def _request(self, depth: Path) -> FitRequest:
        return FitRequest(depth, self.intrinsics, self.mask, self.box, self.segment, self.depth_scale)

    def _serve(self, port: int, estimator: Estimator, request: FitRequest | None, fit: Fit | None) -> None:
        """Until Ctrl-C."""
        import viser

        from .explore.page import ExplorerPage

        with contextlib.redirect_stdout(sys.stderr):  # stdout is for the answer; viser greets there
            server = viser.ViserServer(self.host, port, label=f"OMAD · {estimator.category.name}", verbose=False)
        page = ExplorerPage(server, estimator, self.components, self.seed)
        try:
            if request is not None:
                page.show_request(request)
            if fit is not None:
                page.show_fit(fit)
            print(f"omad: {_url(self.host, port)} (Ctrl-C ends it)", file=sys.stderr, flush=True)
            threading.Event().wait()
        except KeyboardInterrupt:
            print("omad: ended", file=sys.stderr)
        finally:
            with contextlib.redirect_stdout(sys.stderr):
                server.stop()
            page.close()


def free_port(host: str, port: int) -> int:
    """``port``, or a free one where it is 0. Raises InputError where another program has it."""
    if not 0 <= port <= LAST_PORT:
        raise InputError(f"--port {port}: give one between 0 and {LAST_PORT}")
    with socket.socket() as trial:
        trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # a port that was just left is free
        try:
            trial.bind((host, port))
        except PermissionError as error:
            raise InputError(f"--port {port}: not allowed for this user; give one above 1023") from error
        except socket.gaierror as error:
            raise InputError(f"--host {host}: no such address; give 127.0.0.1, or 0.0.0.0 for all") from error
        except OSError as error:
            cure = "another program listens there; give another --port, or --port 0 for any free one"
            raise InputError(f"--host {host} --port {port}: {cure}") from error
        return trial.getsockname()[1]


def _url(host: str, port: int) -> str:
    return f"http://{'127.0.0.1' if host in ('', '0.0.0.0') else host}:{port}"
