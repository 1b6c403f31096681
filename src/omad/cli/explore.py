"""``omad explore``: a local page with sliders for shape and joints, and a depth file to fit."""

import contextlib
import errno
import importlib.util
import os
import socket
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from tyro.conf import OmitArgPrefixes, Positional

from omad.common.errors import InputError
from omad.common.lazy import lazy_imports
from omad.common.processes.signals import exit_code
from omad.sensing.input_options import InputOptions

from .answer import Answer
from .options import CategoryCommand, CategoryName, Seed, check_positive, check_unused

with lazy_imports():
    from omad.applications.explorer.fitting import FitRequest, fit_demo, fit_file
    from omad.applications.explorer.gate import start_server
    from omad.applications.explorer.page import ExplorerPage
    from omad.applications.explorer.places import Places

LOCAL, LAST_PORT = "127.0.0.1", 65535


@dataclass(frozen=True, kw_only=True)
class Explore(CategoryCommand):
    """Open a local page: sliders for shape and joints of a category's objects, random objects, a depth file to fit.

    The page's address is printed; Ctrl-C ends it. It needs the extra omad[explore].
    """

    category: Positional[CategoryName]
    depth: Path | None = None
    """Depth image or cloud to fit at the start; others can be given in the page."""
    reading: OmitArgPrefixes[InputOptions] = InputOptions()
    demo: bool = False
    """Fit a procedural object that no training has seen at the start."""
    components: int = 5
    """Numbers of beta whose sliders are shown at once; the others are in a folder of the page."""
    folder: Path | None = None
    """Files below it may be named in the page; without it, files are uploaded there."""
    host: str = LOCAL
    """Address to listen at. Whoever reaches another one sees the page and may have files of the given folder fitted."""
    port: int = 8080
    """0: any free one."""
    seed: Seed = 0

    def run(self) -> Answer:
        check_positive(depth_scale=self.reading.depth_scale, components=self.components)
        if self.demo and self.depth is not None:
            raise InputError("--demo and --depth: give one of them; both are things to fit at the start")
        if self.depth is None:
            check_unused(self.reading, "goes with --depth")
        if importlib.util.find_spec("viser") is None:
            raise InputError("omad explore needs the viewer library viser; pip install 'omad[explore]'")
        port, places = free_port(self.host, self.port), self._places()
        estimator = self.estimator()
        request = FitRequest(self.depth, self.reading) if self.depth else None
        fit = fit_file(estimator, request) if request else fit_demo(estimator, self.seed) if self.demo else None
        name, url = estimator.category.name, f"http://{LOCAL if self.host in ('', '0.0.0.0') else self.host}:{port}"
        with contextlib.redirect_stdout(sys.stderr):  # stdout is for the answer; viser greets there
            server = start_server(self.host, port, f"OMAD · {name}")
        try:
            with contextlib.closing(ExplorerPage(server, estimator, self.components, self.seed, places)) as page:
                if request is not None:
                    page.show_request(request)
                if fit is not None:
                    page.show_fit(fit)
                print(f"omad: {url} (Ctrl-C ends it)", file=sys.stderr, flush=True)
                while not exit_code():  # of Ctrl-C that a library kept; Windows tells endless waits of none
                    time.sleep(1)
        except KeyboardInterrupt:  # SIGTERM, too
            print("omad: ended", file=sys.stderr)
        finally:
            with contextlib.redirect_stdout(sys.stderr):
                server.stop()
        return Answer({"category": name, "url": url})

    def _places(self) -> Places:
        """What the page may read: what was given at start, and what lies below --folder."""
        if self.folder is not None and not self.folder.is_dir():
            raise InputError(f"--folder {self.folder}: no such folder")
        given = (self.depth, self.reading.mask, self.reading.intrinsics)
        files = tuple(Path(file) for file in given if file is not None)
        return Places(() if self.folder is None else (self.folder,), files)


def free_port(host: str, port: int) -> int:
    """``port``, or a free one where it is 0. Raises InputError where another program has it."""
    if not 0 <= port <= LAST_PORT:
        raise InputError(f"--port {port}: give one between 0 and {LAST_PORT}")
    with socket.socket() as trial:
        if os.name == "posix":  # a port that was just left is free; on Windows each would be
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            trial.bind((host, port))
        except PermissionError as error:
            raise InputError(f"--port {port}: not allowed for this user; give one above 1023") from error
        except socket.gaierror as error:
            raise InputError(f"--host {host}: no such address; give 127.0.0.1, or 0.0.0.0 for all") from error
        except OSError as error:
            if error.errno == errno.EADDRNOTAVAIL:
                raise InputError(f"--host {host}: is not this machine's; give 127.0.0.1, or 0.0.0.0 for all") from error
            cure = "another program listens there; give another --port, or --port 0 for any free one"
            raise InputError(f"--host {host} --port {port}: {cure}") from error
        return trial.getsockname()[1]
