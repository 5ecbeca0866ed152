"""`eitskin stream --view`: a page on this machine that shows the stream, by http.server and
server-sent events; it loads nothing from elsewhere.
"""

import json
import queue
import sys
import threading
import time
from collections import deque
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np

from eitskin.errors import InputError
from eitskin.physics.geometry import even_angles
from eitskin.stream.frames import Frame, Trouble
from eitskin.stream.judge import Verdict
from eitskin.stream.view import View, as_json

HOST = "127.0.0.1"
PAGE = Path(__file__).with_name("page.html")
KEPT = 2000  # events for who comes late: ten seconds of the fastest board
WAITING = 1000  # events that a browser may be behind; of more the oldest are left out
END = "event: end\ndata: {}\n\n"
GOODBYE_S = 1.0  # for browsers to take the end, at most
BEAT_S = 1.0  # from one look at a connection without events to the next


class PageView:
    """A view that passes on to another one, and to the browsers that look at `address`.

    skin: `Skin.metadata` of the model, for its radius and angles, None where unknown. Raises
    InputError where the port is in use or is none.
    """

    def __init__(
        self,
        view: View,
        targets: list[str],
        channels: np.ndarray,
        skin: dict | None,
        source: str,
        port: int = 0,
    ):
        stated = skin or {}
        angles = stated.get("electrode_deg") or even_angles(int(np.max(channels)) + 1).tolist()
        radius_mm = stated.get("radius_mm")
        self.skin = {"radius_mm": radius_mm, "electrode_deg": list(angles), "source": source}
        self._view, self._targets = view, targets
        self._kept: deque[str] = deque(maxlen=KEPT)
        self._readers: list[queue.Queue[str]] = []
        self._lock, self.ended = threading.Lock(), threading.Event()
        try:
            self._server = _Server(port, self)
        except (OSError, OverflowError) as error:
            actual = getattr(error, "strerror", None) or str(error)
            raise InputError("--view", f"{HOST}:{port}", actual, "a free port") from error
        self.address = f"http://{HOST}:{self._server.server_port}/"
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def frame(self, frame: Frame, verdict: Verdict) -> None:
        """Show a frame's verdict in both."""
        late_s = self._view.frame(frame, verdict)
        self._publish(as_json(self._targets, frame, verdict, late_s))

    def trouble(self, trouble: Trouble) -> None:
        """Show what came in place of a frame in both."""
        self._view.trouble(trouble)
        self._publish({"time_s": round(trouble.time_s, 4), "trouble": trouble.message})

    def close(self) -> None:
        """Tell the browsers that the stream has ended, and end the server."""
        self._view.close()
        self.ended.set()
        with self._lock:
            for reader in self._readers:
                _put(reader, END)
        deadline = time.monotonic() + GOODBYE_S
        while self._readers and time.monotonic() < deadline:
            time.sleep(GOODBYE_S / 100)
        self._server.shutdown()
        self._server.server_close()

    def reader(self) -> "queue.Queue[str]":
        """The events of one more browser, those that are kept first."""
        events: queue.Queue[str] = queue.Queue(KEPT + WAITING)
        with self._lock:
            for event in self._kept:
                events.put_nowait(event)
            self._readers.append(events)
        return events

    def leave(self, reader: "queue.Queue[str]") -> None:
        """One browser less."""
        with self._lock:
            self._readers.remove(reader)

    def _publish(self, content: dict) -> None:
        event = f"data: {json.dumps(content, allow_nan=False)}\n\n"
        with self._lock:
            self._kept.append(event)
            for reader in self._readers:
                _put(reader, event)


def _put(reader: "queue.Queue[str]", event: str) -> None:
    """Add an event; where the browser is far behind, in place of its oldest."""
    try:
        reader.put_nowait(event)
    except queue.Full:
        reader.get_nowait()
        reader.put_nowait(event)


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def __init__(self, port: int, view: PageView):
        self.view = view
        super().__init__((HOST, port), _Handler)

    def handle_error(self, request: object, client_address: object) -> None:
        """Say nothing of a browser that disconnected; of other errors what socketserver says."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)  # type: ignore[arg-type]


class _Handler(BaseHTTPRequestHandler):
    server: _Server

    def do_GET(self) -> None:
        """The page, the skin, or the events."""
        port = self.server.server_port
        if self.headers.get("Host") not in (f"{HOST}:{port}", f"localhost:{port}"):
            self.send_error(403, "another host's name")  # a page elsewhere that names this machine
        elif self.path == "/":
            self._answer("text/html; charset=utf-8", PAGE.read_bytes())
        elif self.path == "/skin":
            self._answer("application/json", json.dumps(self.server.view.skin).encode())
        elif self.path == "/events":
            self._stream()
        else:
            self.send_error(404)

    def _answer(self, kind: str, content: bytes) -> None:
        self.send_response(200)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def _stream(self) -> None:
        view = self.server.view
        self.send_response(200)
        self.send_header("Content-Type", "text/event-stream")
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        events = view.reader()
        try:
            while True:
                try:
                    event = events.get(timeout=BEAT_S)
                except queue.Empty:
                    event = END if view.ended.is_set() else ": \n\n"
                self.wfile.write(event.encode())
                if event == END:
                    return
        finally:
            view.leave(events)

    def log_message(self, *_: object) -> None:
        """Say nothing: stderr is the stream's."""
