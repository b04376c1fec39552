"""Headless Chromium, driven through the DevTools protocol over a pair of pipes (--remote-debugging-pipe)."""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome")
FLAGS = ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
         "--no-first-run", "--disable-extensions", "--disable-background-networking", "--force-device-scale-factor=1",
         "--hide-scrollbars", "--mute-audio", "--remote-debugging-pipe")  # fmt: skip
PATIENCE_S = 240.0


def executable() -> str | None:
    return next((path for name in NAMES if (path := shutil.which(name))), None)


class Browser:
    """One page. Use as a context manager. problems: what the page's console complained about. patience_s: for an answer.

    group: of its processes.
    """

    def __init__(self, profile: Path, size: tuple[int, int] = (800, 600)) -> None:
        path = executable()
        assert path is not None
        read_commands, self._write = os.pipe()
        self._read, write_answers = os.pipe()

        def connect() -> None:  # Chromium reads commands from 3 and answers to 4
            first, second = os.dup(read_commands), os.dup(write_answers)
            os.dup2(first, 3)
            os.dup2(second, 4)

        words = [*FLAGS, f"--user-data-dir={profile}", f"--window-size={size[0]},{size[1]}", "about:blank"]
        self._process = subprocess.Popen(
            [path, *words], preexec_fn=connect, close_fds=False, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            start_new_session=True,
        )  # fmt: skip
        os.close(read_commands)
        os.close(write_answers)
        self._buffer, self._number, self._session = b"", 0, ""
        self.problems: list[str] = []
        self.patience_s, self.group = PATIENCE_S, self._process.pid
        while not (targets := [t for t in self._send("Target.getTargets")["targetInfos"] if t["type"] == "page"]):
            time.sleep(0.05)
        self._session = self._send("Target.attachToTarget", targetId=targets[0]["targetId"], flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self._send(f"{domain}.enable")
        self.resize(*size)

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, *_: object) -> None:
        if self._process.poll() is None:
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
        os.close(self._read)
        os.close(self._write)

    def resize(self, width: int, height: int, *, touch: bool = False) -> None:
        self._send("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=touch)
        self._send("Emulation.setTouchEmulationEnabled", enabled=touch, maxTouchPoints=5)

    def open(self, address: str) -> None:
        self._send("Page.navigate", url=address)
        while self.evaluate("document.readyState") != "complete" or self.evaluate("location.href") == "about:blank":
            time.sleep(0.05)

    @contextmanager
    def before_scripts(self, script: str) -> Iterator[None]:
        """Within the block, pages run `script` before their own."""
        made = self._send("Page.addScriptToEvaluateOnNewDocument", source=script)
        yield
        self._send("Page.removeScriptToEvaluateOnNewDocument", identifier=made["identifier"])

    def evaluate(self, script: str) -> Any:
        """The value of an expression, awaited."""
        answer = self._send("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in answer:
            details = answer["exceptionDetails"]
            raise RuntimeError(details.get("exception", {}).get("description") or details["text"])
        return answer["result"].get("value")

    def until(self, script: str) -> None:
        """Waits until an expression is true, also while a page that is being loaded cannot say."""
        end, failure = time.monotonic() + self.patience_s, ""
        while True:
            try:
                if self.evaluate(script):
                    return
            except RuntimeError as error:
                failure = str(error)
            assert time.monotonic() < end, f"never true: {script} {failure}"
            time.sleep(0.05)

    def screenshot(self) -> bytes:
        return base64.b64decode(self._send("Page.captureScreenshot", format="png")["data"])

    def mouse(self, kind: str, x: float, y: float, **fields: Any) -> None:
        self._send("Input.dispatchMouseEvent", type=kind, x=x, y=y, **fields)

    def touch(self, kind: str, *points: tuple[float, float]) -> None:
        listed = [{"x": x, "y": y, "id": i} for i, (x, y) in enumerate(points)]
        self._send("Input.dispatchTouchEvent", type=kind, touchPoints=listed)

    def key(self, kind: str, key: str, code: str = "") -> None:
        self._send("Input.dispatchKeyEvent", type=kind, key=key, code=code or f"Key{key.upper()}")

    def _send(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        end = time.monotonic() + self.patience_s
        while True:
            answer = self._receive(end)
            if answer.get("id") == self._number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                return answer["result"]
            self._listen(answer)

    def _receive(self, end: float) -> dict[str, Any]:
        while b"\0" not in self._buffer:
            ready, _, _ = select.select([self._read], [], [], max(end - time.monotonic(), 0))
            assert ready, "Chromium does not answer"
            data = os.read(self._read, 1 << 20)
            assert data, "Chromium ended"
            self._buffer += data
        message, _, self._buffer = self._buffer.partition(b"\0")
        return json.loads(message)

    def _listen(self, event: dict[str, Any]) -> None:
        kind, fields = event.get("method"), event.get("params", {})
        if kind == "Runtime.exceptionThrown":
            details = fields["exceptionDetails"]
            self.problems.append(details.get("exception", {}).get("description") or details["text"])
        elif kind == "Log.entryAdded" and fields["entry"]["level"] == "error":
            self.problems.append(fields["entry"]["text"])
        elif kind == "Network.requestWillBeSent":
            address = fields["request"]["url"]
            if not address.startswith(("file:", "data:", "blob:")):
                self.problems.append(f"asked for {address}")
