"""A headless Chromium, driven by its own debugging protocol."""

import base64
import itertools
import json
import os
import re
import shutil
import subprocess
import threading
import time
import urllib.request
from pathlib import Path

import pytest

PROGRAM = next(filter(None, map(shutil.which, ["chromium", "chromium-browser", "google-chrome", "chrome"])), None)


class HeadlessBrowser:
    """One tab of ``width`` x ``height`` pixels with WebGL in software. Skips the test where no browser is there."""

    def __init__(self, profile: Path, width: int, height: int) -> None:
        if PROGRAM is None:
            pytest.skip("no Chromium or Chrome on the path: the page was not opened")
        client = pytest.importorskip("websockets.sync.client", reason="websockets, which comes with viser, is missing")
        self._process = subprocess.Popen(
            [
                PROGRAM, "--headless=new", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
                "--ignore-gpu-blocklist", "--hide-scrollbars", "--remote-debugging-port=0",
                f"--window-size={width},{height}", f"--user-data-dir={profile}",
                *(["--no-sandbox"] if os.geteuid() == 0 else []), "about:blank",
            ],
            stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert self._process.stderr is not None
        port = next(m[1] for line in self._process.stderr if (m := re.search(r"ws://127.0.0.1:(\d+)/", line)))
        threading.Thread(target=self._process.stderr.read, daemon=True).start()  # a full pipe would stop it
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/json") as tabs:
            tab = next(tab for tab in json.load(tabs) if tab["type"] == "page")
        self._socket = client.connect(tab["webSocketDebuggerUrl"], max_size=None)
        self._numbers = itertools.count(1)
        self.errors: list[str] = []
        for domain in ("Runtime", "Page", "Log"):
            self.command(f"{domain}.enable")
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.command("Emulation.setDeviceMetricsOverride", **size)  # the window's own size counts its frame, too

    def command(self, method: str, **parameters) -> dict:
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while (said := json.loads(self._socket.recv(timeout=120))).get("id") != number:
            self._note(said)
        assert "error" not in said, said
        return said["result"]

    def run(self, script: str):
        """The value of a JavaScript expression."""
        return self.command("Runtime.evaluate", expression=script, returnByValue=True)["result"].get("value")

    def wait(self, script: str, seconds: float = 90.0) -> None:
        """Until an expression holds."""
        until = time.monotonic() + seconds
        while not self.run(script):
            assert time.monotonic() < until, f"{script}; the page says: {self.run('document.body.innerText')}"
            time.sleep(0.1)

    def click(self, selector: str, label: str) -> None:
        """The first element of a kind whose text is ``label``."""
        found = f"[...document.querySelectorAll({selector!r})].find(e => e.innerText.trim() === {label!r})"
        self.wait(f"!!{found}")
        self.run(f"{found}.click()")

    def picture(self) -> bytes:
        """PNG of the tab."""
        return base64.b64decode(self.command("Page.captureScreenshot", format="png")["data"])

    def close(self) -> None:
        self._socket.close()
        self._process.terminate()
        self._process.wait(20)

    def _note(self, said: dict) -> None:
        parameters = said.get("params", {})
        wrong = (
            said.get("method") == "Runtime.exceptionThrown"
            or (said.get("method") == "Runtime.consoleAPICalled" and parameters["type"] == "error")
            or (said.get("method") == "Log.entryAdded" and parameters["entry"]["level"] == "error")
        )
        if wrong:
            self.errors.append(json.dumps(parameters)[:500])
