"""Make docs/images/live.png: the page of a run, in a browser without a screen.

    python docs/live_picture.py

It needs Chromium (Debian: apt-get install chromium) and takes some minutes without a GPU.
"""

from __future__ import annotations

import base64
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from typing import Any

import cv2
import numpy as np

from make_pictures import IMAGES, shrink, write_small

RUN = ("-m", "vergence", "track", "--seconds", "20", "--profile", "paper", "--serve")
PORT = 9370
SHOWN_S = 150.0
"""Time after which a page without a GPU shows two seconds of the run [s]; measured."""
BROWSER = (
    "chromium", "--headless=new", "--no-sandbox", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--disable-background-networking", "--window-size=1600,1000",
    "--remote-debugging-pipe",
)  # fmt: skip


def screenshot(page: str, after_s: float) -> np.ndarray:
    """Open a page in Chromium, wait, and return what it shows (H, W, 3), BGR."""
    to_browser, from_browser = os.pipe(), os.pipe()

    def connect() -> None:  # the browser reads file 3 and writes file 4
        os.dup2(to_browser[0], 3)
        os.dup2(from_browser[1], 4)

    with (
        tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile,
        subprocess.Popen(
            [*BROWSER, f"--user-data-dir={profile}", page],
            preexec_fn=connect,
            close_fds=False,
            stderr=subprocess.DEVNULL,
        ) as browser,
        os.fdopen(to_browser[1], "wb", buffering=0) as requests,
        os.fdopen(from_browser[0], "rb") as answers,
    ):

        def ask(method: str, session: str | None = None, **parameters: Any) -> dict[str, Any]:
            request = {"id": 1, "method": method, "params": parameters}
            if session is not None:
                request["sessionId"] = session
            requests.write(json.dumps(request).encode() + b"\0")
            while True:
                letters = iter(lambda: answers.read(1), b"\0")
                message = json.loads(b"".join(letters))
                if message.get("id") == 1:
                    return message["result"]

        try:
            time.sleep(after_s)
            targets = ask("Target.getTargets")["targetInfos"]
            (target,) = [each["targetId"] for each in targets if each["type"] == "page"]
            session = ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
            png = base64.b64decode(ask("Page.captureScreenshot", session, format="png")["data"])
        finally:
            browser.kill()
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return image


def main() -> None:
    command = [sys.executable, *RUN, str(PORT)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as run:
        assert run.stderr is not None
        try:
            page = next(line.split()[-1] for line in run.stderr if line.startswith("Watch at"))
            image = screenshot(page, SHOWN_S)
        finally:
            run.send_signal(signal.SIGINT)
    write_small(IMAGES / "live.png", shrink(image, 1440))


if __name__ == "__main__":
    main()
